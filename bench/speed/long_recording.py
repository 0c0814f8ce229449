# Copyright 2026 selfcal_ros contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
Ten minutes of 1080p at 30 Hz: time, memory, error and sigma; beside every frame where it is small.

The recordings repeat what the renderer makes of a path, there and back, with noise and brightness
that vary; standing and straight stretches lie between. They are made in a temporary folder.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from bench.inputs import process_environment
from bench.tables import percent, Report
import cv2
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import numpy as np
from selfcal_ros.synthetic.paths import planar_poses
from selfcal_ros.synthetic.recordings import agv_drive, arm_move, Recording

SIZE, SMALL, RATE_HZ = (1920, 1080), (640, 480), 30
#: Images rendered of each path, and noisy variants of each.
RENDERED = {'drive': 300, 'straight': 60, 'arm': 240}
VARIANTS, NOISE, JPEG_QUALITY = 2, 1.5, 85
#: Parts of each recording: path, share of the time.
RECORDINGS = {
    'driving': (('drive', 1.0),),
    'mostly straight': (('straight', 0.45), ('drive', 0.05), ('straight', 0.45), ('drive', 0.05)),
    'mostly standing': (('stand', 0.5), ('drive', 0.1), ('stand', 0.4)),
    'an arm': (('arm', 1.0),),
}
MINUTES, SHORT_MINUTES = 10.0, 2.0
MAX_SECONDS, MAX_MEMORY_GB, MAX_SIGMA_RATIO = 180.0, 2.0, 1.2


def run(report: Report, options) -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(options.cache or folder)
        cache.mkdir(parents=True, exist_ok=True)
        report.section('Ten minutes of 1080p at 30 Hz', 'A process of its own each; memory is its '
                       'largest resident set. "every image" follows all of the same recording of '
                       f'{SHORT_MINUTES:g} minutes at 1080p, and of all ten at '
                       f'{SMALL[0]} x {SMALL[1]}.')
        rows = []
        for name, parts in RECORDINGS.items():
            bag = Path(folder) / 'long'
            camera = write_recording(bag, parts, MINUTES, cache)
            found = calibrated(bag)
            rows.append(_row(name, MINUTES, 'segments', found, camera))
            _remove(bag)
            report.verdict(f'{name}: processor time', found['cpu_s'], 2 * MAX_SECONDS, 's')
            report.verdict(f'{name}: wall time', found['wall_s'], MAX_SECONDS, 's')
            report.verdict(f'{name}: memory', found['memory_gb'], MAX_MEMORY_GB, 'GB')
        for name, parts in RECORDINGS.items():
            camera = write_recording(bag, parts, SHORT_MINUTES, cache)
            both = [calibrated(bag), calibrated(bag, '--every', '1')]
            _remove(bag)
            rows += [_row(name, SHORT_MINUTES, how, found, camera)
                     for how, found in zip(('segments', 'every image'), both)]
            if all(one['sigma'] for one in both):
                report.verdict(f'{name}: sigma of fx over that of every image',
                               both[0]['sigma']['fx'] / both[1]['sigma']['fx'], MAX_SIGMA_RATIO)
            else:
                report.judge(bool(both[0]['sigma']), f'{name}: the segments calibrate')
        rows += _small(report, Path(folder), cache)
        report.table(('recording', 'minutes', 'followed', 'wall s', 'processor s', 'GB',
                      'fx error %', 'sigma %', 'error / sigma', ''), rows)


def _small(report: Report, folder: Path, cache: Path) -> list[tuple]:
    """Follow every image of ten minutes of a small drive, and the segments of its video."""
    bag, video = folder / 'small', folder / 'small.mp4'
    camera = write_recording(bag, RECORDINGS['driving'], MINUTES, cache, SMALL)
    found = {'segments': calibrated(bag), 'every image': calibrated(bag, '--every', '1')}
    _remove(bag)
    write_video(video, RECORDINGS['driving'], MINUTES, cache, SMALL)
    found['segments of an mp4'] = calibrated(video)
    video.unlink()
    for name in ('fx', 'cx', 'cy'):
        report.verdict(f'ten small minutes: sigma of {name} over that of every image',
                       found['segments']['sigma'][name] / found['every image']['sigma'][name],
                       MAX_SIGMA_RATIO)
    return [_row(f'driving, {SMALL[0]} x {SMALL[1]}', MINUTES, how, one, camera)
            for how, one in found.items()]


def _row(name, minutes, how, found, camera) -> tuple:
    figures = ('', '', '')
    if found['sigma']:
        error = percent(found['camera']['fx'], camera.K[0, 0])
        sigma = 100 * found['sigma']['fx'] / camera.K[0, 0]
        figures = f'{error:+.4f}', f'{sigma:.4f}', f'{error / sigma:+.1f}'
    return (name, f'{minutes:g}', how, f'{found["wall_s"]:.0f}', f'{found["cpu_s"]:.0f}',
            f'{found["memory_gb"]:.2f}', *figures, found['reason'][:60])


def calibrated(bag: Path, *options: str) -> dict:
    """Run `selfcal calibrate`; return result.json with its times and its memory."""
    result = bag.parent / 'result.json'
    command = [sys.executable, '-c',
               'import sys; from selfcal_ros.cli.main import main; sys.exit(main())', 'calibrate',
               str(bag), '--aspect-ratio', '1', '--skew', '0', '--json', str(result), '--quiet',
               '--force', '--output', str(bag.parent / 'camera.yaml'), *options]
    began = time.perf_counter()
    process = subprocess.Popen(command, env=process_environment(), stdout=subprocess.DEVNULL)
    _, _, usage = os.wait4(process.pid, 0)
    return {'wall_s': time.perf_counter() - began, 'cpu_s': usage.ru_utime + usage.ru_stime,
            'memory_gb': usage.ru_maxrss / 2**20, **json.loads(result.read_text())}


def write_recording(path: Path, parts, minutes: float, cache: Path, size=SIZE):
    """Write a bag of JPEG images; returns the true camera."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
    store, kind = get_typestore(Stores.ROS2_JAZZY), 'sensor_msgs/msg/CompressedImage'
    types, rng = rosbags_types(store), np.random.default_rng(0)
    coded: dict = {}
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/camera/image_raw/compressed', kind, typestore=store)
        for number, (name, place) in enumerate(_course(parts, round(60 * minutes * RATE_HZ))):
            if name not in coded:
                coded[name] = _coded(rendered(name, cache, size), rng)
            stamp = 10**18 + round(number * 1e9 / RATE_HZ)
            message = types.CompressedImage(
                header=header_message(stamp, 'camera', types), format='jpeg',
                data=coded[name][place][rng.integers(VARIANTS)])
            writer.write(connection, stamp, store.serialize_cdr(message, kind))
    return _recording('drive', size).camera


def write_video(path: Path, parts, minutes: float, cache: Path, size=SIZE) -> None:
    """Write the same as an mp4 without stamps."""
    rng, shown = np.random.default_rng(0), {}
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'mp4v'), RATE_HZ, size)
    for name, place in _course(parts, round(60 * minutes * RATE_HZ)):
        if name not in shown:
            shown[name] = [[cv2.imdecode(data, cv2.IMREAD_COLOR) for data in variants]
                           for variants in _coded(rendered(name, cache, size), rng)]
        video.write(shown[name][place][rng.integers(VARIANTS)])
    video.release()


def _course(parts, count: int):
    """Yield the path and the place on it, image by image: there and back."""
    for name, share in parts:
        path = 'drive' if name == 'stand' else name
        images = 1 if name == 'stand' else RENDERED[path]
        for k in range(round(share * count)):
            k %= max(2 * images - 2, 1)
            yield path, min(k, 2 * images - 2 - k)


def _coded(images: np.ndarray, rng) -> list:
    """Return JPEGs of each image with noise, at a brightness of their own."""
    noise = [rng.normal(0.0, NOISE, images[0].shape).astype(np.float32) for _ in range(4)]
    coded = []
    for grey in images:
        coded.append([])
        for _ in range(VARIANTS):
            noisy = grey * np.float32(rng.uniform(0.95, 1.0)) + np.roll(
                noise[rng.integers(4)], rng.integers(2000), axis=1)
            noisy = np.clip(noisy + 0.5, 0, 255).astype(np.uint8)
            coded[-1].append(cv2.imencode('.jpg', noisy, [cv2.IMWRITE_JPEG_QUALITY,
                                                          JPEG_QUALITY])[1].ravel())
    return coded


def rendered(name: str, cache: Path, size=SIZE) -> np.ndarray:
    """Return the images of a path (N, H, W), rendered or as they lie in the cache."""
    file = cache / (f'{name}.npy' if size == SIZE else f'{name}_{size[0]}.npy')
    if not file.exists():
        recording = _recording(name, size)
        renderer = recording.renderer(2)
        np.save(file, np.stack([recording.frame(k, renderer) for k in range(len(recording))]))
    return np.load(file, mmap_mode='r')


def _recording(name: str, size=SIZE) -> Recording:
    if name == 'arm':
        return arm_move(RENDERED[name], size, noise_sigma=0.0)
    drive = agv_drive(RENDERED['drive'], size, noise_sigma=0.0)
    if name == 'drive':
        return drive
    count = RENDERED[name]
    heading = np.full(count, np.deg2rad(-25.0))
    along = np.linspace(0.0, 0.8, count)[:, None] * [np.cos(heading[0]), np.sin(heading[0])]
    return Recording(name, drive.camera, planar_poses(along, heading, 1.1, 0.35, 20.0),
                     drive.stamps_ns[:count], drive.surfaces, noise_sigma=0.0)


def _remove(bag: Path) -> None:
    for file in bag.iterdir():
        file.unlink()
    bag.rmdir()
