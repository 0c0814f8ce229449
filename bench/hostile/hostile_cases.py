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
"""Inputs that are wrong in some way: good files of every kind, and what chance does to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
import os
from pathlib import Path
import shutil
import sqlite3

import cv2
import numpy as np
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.camera_files.formats import write_camera
from selfcal_ros.report.result_json import result_to_json
from selfcal_ros.rorapid.model import read_model, write_model
from selfcal_ros.synthetic.special_scenes import drive

from bench.hostile.hostile_robots import write_robot_files
from bench.inputs import ROOT

#: Numbers and words that are seldom thought of.
ODD = ('nan', 'inf', '-inf', '1e999', '1e308', '1e-308', '-1', '0', '-0.0', '1e300', '1e-300',
       '99999999999999999999', '2147483648', '18446744073709551616', '0x10', '1_000', 'null',
       'true', '[]', '{}', '""', 'a', '\x00', 'ä',
       '1e', '--', '~', '&a', '*a', '<<', '!!binary x', '%', "'", '"', '\\', '#', '...',
       '9' * 5000)
OUTPUTS = ('out.yaml', 'out.json', 'out.html', 'out.csv', 'out.mp4', 'out.cao', 'out.obj',
           'out_bag', 'out.ply', 'out.tum', 'out.urdf', 'out.calib', 'out.xml',
           'out.cameramodel', 'out.txt', 'out.bin')


@dataclass(frozen=True)
class Case:
    """
    One bad input.

    Attributes
    ----------
    kind : str
        What is wrong, for the table.
    arguments : tuple of str
        For the command line.
    prepare : callable, optional
        Of the folder and a generator; makes the bad file where the good ones are.
    call : callable, optional
        In place of the command line: raises whatever it raises.
    file_bytes : int or None
        The disk is full after so many bytes of a file.

    """

    kind: str
    arguments: tuple[str, ...] = ()
    prepare: Callable | None = None
    call: Callable | None = None
    file_bytes: int | None = None


def write_good_files(folder: Path) -> None:
    """Write a small good file of every kind that is read."""
    rng = np.random.default_rng(0)
    sequence = drive(rng, 0.1, 6, 120)
    sequence.tracks.to_csv(folder / 'tracks.csv')
    K = [[200, 0, 80], [0, 200, 60], [0, 0, 1]]
    camera = Camera(K, (-0.1, 0.01, 0.0, 0.0, 0.0), 160, 120)
    fisheye = Camera(K, (0.01, 0.0, 0.0, 0.0), 160, 120, 'equidistant')
    for kind, name in (('ros', 'camera.yaml'), ('opencv', 'camera.xml'),
                       ('mrcal', 'm.cameramodel'), ('opencv', 'opencv.yaml'),
                       ('colmap', 'cameras.txt'),
                       ('colmap', 'cameras.bin')):
        write_camera(folder / name, kind, camera)
    write_camera(folder / 'camchain.yaml', 'kalibr', fisheye)
    from selfcal_ros import calibrate, CameraFacts
    known = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
    result = calibrate(drive(rng, 0.1, 10, 300).tracks, facts=known)
    (folder / 'result.json').write_text(result_to_json(result), encoding='utf-8')
    with open_source(ROOT / 'bags' / 'tracked_object', colour=True) as source:
        frames = [frame for frame, _ in zip(source, range(5))]
    (folder / 'images').mkdir()
    for k, suffix in enumerate(('png', 'jpg', 'bmp', 'tiff', 'pgm')):
        small = cv2.resize(frames[k].image, (160, 120))
        cv2.imwrite(str(folder / 'images' / f'{k}.{suffix}'), small)
    few = [Frame(k, 10**18 + k * 10**8, cv2.resize(frame.image, (160, 120)), 'camera')
           for k, frame in enumerate(frames)]
    write_image_bag(folder / 'bag', few)
    write_image_bag(folder / 'jpegs', few, compressed='jpeg')
    write_image_bag(folder / 'sqlite', few, storage='sqlite3')
    for name, code in (('video.avi', 'MJPG'), ('video.mp4', 'mp4v')):
        writer = cv2.VideoWriter(str(folder / name), cv2.VideoWriter.fourcc(*code), 30, (160, 120))
        for frame in few:
            writer.write(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
        writer.release()
    cv2.imwrite(str(folder / 'mask.png'), np.pad(np.zeros((40, 80), np.uint8), 40,
                                                 constant_values=255))
    model = read_model(ROOT / 'bags' / 'tracked_object.model.yaml')
    write_model(model, folder / 'model.yaml')
    write_model(model, folder / 'model.cao')
    for name in ('pos', 'camera.yaml'):
        shutil.copy(ROOT / 'bags' / f'tracked_object.{name}', folder / f'object.{name}')
    write_image_bag(folder / 'object', [Frame(f.index, f.stamp_ns, f.image, 'c')
                                        for f in frames[:3]])
    (folder / 'start.init').write_text('4\n0 0 0\n0.1 0 0\n0.1 0.1 0\n0 0.1 0.1\n',
                                       encoding='utf-8')
    (folder / 'points.csv').write_text('point,X,Y,Z\n' + ''.join(
        f'{k},{k % 5},{k // 5},{k % 3}\n' for k in range(40)), encoding='utf-8')
    (folder / 'picked.yaml').write_text(
        'vertices:\n  a: [20, 20, 22, 20]\n  b: [90, 25, 93, 25]\n  c: [60, 80, 64, 80]\n'
        '  d: [30, 70, 35, 70]\n'
        'faces:\n- [a, b, c]\nframe: [a, b, c]\n', encoding='utf-8')
    write_robot_files(folder, np.stack([frame.image for frame in few]))


#: What is read by which command; @ stands for the bad file.
READERS: tuple[tuple[str, str], ...] = (
    ('tracks.csv', 'calibrate @ --image-size 640 480 --output out.yaml --json out.json'),
    ('tracks.csv', 'calibrate @ --image-size 640 480 --motion planar --lens none --report '
                   'out.html --ply out.ply --poses out.tum'),
    ('tracks.csv', 'calibrate @ --image-size 640 480 --object points.csv'),
    ('points.csv', 'calibrate tracks.csv --image-size 640 480 --object @'),
    ('mask.png', 'calibrate images --mask @ --output out.yaml'),
    ('images', 'calibrate @ --output out.yaml'), ('images', 'convert @ out_bag'),
    ('bag', 'calibrate @ --output out.yaml'), ('bag', 'convert @ out_bag'),
    ('sqlite', 'convert @ out_bag --storage sqlite3'), ('jpegs', 'convert @ out_bag'),
    ('video.avi', 'convert @ out_bag'), ('video.mp4', 'calibrate @ --output out.yaml'),
    *((name, f'compare @ {name}') for name in ('camera.yaml', 'camera.xml', 'm.cameramodel',
                                               'cameras.txt', 'cameras.bin', 'result.json',
                                               'camchain.yaml', 'opencv.yaml')),
    ('result.json', 'compare result.json result.json --result-a @ --json out.json'),
    ('camera.yaml', 'convert @ out.xml'), ('camchain.yaml', 'convert @ out.yaml'),
    ('result.json', 'convert @ out.cameramodel'), ('opencv.yaml', 'convert @ out.txt'),
    ('model.cao', 'track object --camera object.camera.yaml --model @ --init object.pos --output '
                  'out.csv'),
    ('model.yaml', 'track object --camera object.camera.yaml --model @ --init object.pos --output '
                   'out.csv --overlay out.mp4'),
    ('object.pos', 'track object --camera object.camera.yaml --model model.cao --init @ --output '
                   'out.csv'),
    ('start.init', 'track object --camera object.camera.yaml --model model.cao --init @ --clicks '
                   '10 10 90 10 90 90 10 90 --output out.csv'),
    ('object.camera.yaml', 'track object --camera @ --model model.cao --init object.pos --output '
                           'out.csv'),
    ('object', 'track @ --camera object.camera.yaml --model model.cao --init object.pos --output '
               'out.csv'),
    *((name, 'track object --camera object.camera.yaml --model @ --init object.pos --output '
             'out.csv') for name in ('mesh.obj', 'mesh.ply', 'mesh.stl')),
    ('robot.csv', 'calibrate tracks.csv --image-size 640 480 --motion planar --lens none '
                  '--robot @ --json out.json --mount-output out.urdf --report out.html'),
    ('gyro.csv', 'calibrate robot_bag --robot @ --output out.yaml --json out.json'),
    ('robot_bag', 'calibrate @ --robot /odom --output out.yaml --mount-output out.calib'),
    ('left', 'calibrate left right --cameras left,right --baseline 0.1:0.001 --output out.yaml '
             '--json out.json'),
    ('picked.yaml', 'model images --camera camera.yaml --vertices @ --baseline 0.1 --output '
                    'out.cao --obj out.obj'),
)


def damaged(data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Return what chance does to the bytes of a file, and its name."""
    ways = ['truncated', 'flipped', 'zeroed', 'odd words', 'repeated', 'shuffled lines', 'grown',
            'other encoding', 'numbers']
    way = str(rng.choice(ways))
    size = max(len(data), 1)
    if way == 'truncated':
        data = data[:int(rng.integers(0, size))]
    elif way == 'flipped':
        changed = bytearray(data or b' ')
        for at in rng.integers(0, size, int(rng.choice([1, 3, 30]))):
            changed[at] ^= 1 << int(rng.integers(8))
        data = bytes(changed)
    elif way == 'zeroed':
        at, length = int(rng.integers(0, size)), int(rng.choice([1, 8, 64, 1024]))
        data = data[:at] + bytes(length) + data[at + length:]
    elif way == 'odd words':
        for _ in range(int(rng.choice([1, 2, 5]))):
            at = int(rng.integers(0, size))
            data = data[:at] + _odd(rng) + data[at + int(rng.choice([0, 1, 5])):]
    elif way == 'repeated':
        begin, end = sorted(rng.integers(0, size, 2))
        data = data[:end] + data[begin:end] * int(rng.choice([1, 2, 50])) + data[end:]
    elif way == 'shuffled lines':
        lines = data.split(b'\n')
        data = b'\n'.join(lines[k] for k in rng.permutation(len(lines)))
    elif way == 'grown':
        data = data[:size // 2] + bytes([int(rng.choice([32, 10, 45, 91, 123, 60]))]) * 300_000 \
            + data[size // 2:]
    elif way == 'other encoding':
        data = data.decode('utf-8', 'replace').encode(str(rng.choice(
            ['utf-16', 'utf-8-sig', 'utf-32'])))
    else:
        data = _other_numbers(data, rng)
    return way, data[:20_000_000]


def _odd(rng: np.random.Generator) -> bytes:
    return str(rng.choice(ODD)).encode('utf-8', 'replace')


def _other_numbers(data: bytes, rng: np.random.Generator) -> bytes:
    """Put odd words where numbers are."""
    import re
    places = list(re.finditer(rb'-?\d+(\.\d+)?', data))
    if not places:
        return data + _odd(rng)
    for k in sorted(rng.integers(0, len(places), int(rng.choice([1, 2, 10]))), reverse=True):
        place = places[k]
        data = data[:place.start()] + _odd(rng) + data[place.end():]
    return data


def _damage(name: str):
    """Return what damages a file, or one of those in a folder."""
    def prepare(folder: Path, rng: np.random.Generator) -> None:
        path = folder / name
        if path.is_dir():
            inside = sorted(one for one in path.iterdir())
            path = inside[int(rng.integers(len(inside)))]
        if path.suffix == '.db3' and rng.random() < 0.5:
            _damage_table(path, rng)
            return
        path.write_bytes(damaged(path.read_bytes(), rng)[1])
    return prepare


def _damage_table(path: Path, rng: np.random.Generator) -> None:
    """Put something odd into a table."""
    table, column = [('topics', 'name'), ('topics', 'type'), ('messages', 'data'),
                     ('messages', 'timestamp'), ('messages', 'topic_id'), ('topics', 'id'),
                     ('topics', 'offered_qos_profiles'), ('schema', 'schema_version'),
                     ('topics', 'serialization_format')][int(rng.integers(9))]
    with sqlite3.connect(path) as connection:
        try:
            connection.execute(f'UPDATE {table} SET {column} = ?',
                               [(str(rng.choice(ODD)), None, 2**62, bytes(7), -1.5)[
                                   int(rng.integers(5))]])
        except sqlite3.Error:
            connection.execute(f'DELETE FROM {table}')
    connection.close()


#: Options with values, for odd ones.
OPTIONS = {
    'calibrate tracks.csv --image-size 640 480 --lens none': (
        '--aspect-ratio', '--aspect-ratio-sigma', '--skew', '--skew-sigma', '--max-keyframes',
        '--views', '--translation-frames', '--parallel-objects', '--motion', '--lens', '--focal',
        '--shutter', '--line-delay', '--mode', '--object', '--mask', '--output', '--json',
        '--report', '--ply', '--camera-name', '--topic', '--jobs', '--output-dir',
        '--principal-point-sigma', '--model', '--init', '--camera', '--clicks', '--trust-facts',
        '--engine', '--start', '--duration', '--every', '--seed', '--flatness', '--poses',
        '--poses-format', '--colmap', '--transforms', '--robot', '--robot-kind', '--robot-sigma',
        '--robot-unit', '--robot-frame', '--mount-fact', '--mount-output', '--camera-frame',
        '--cameras', '--baseline'),
    'calibrate tracks.csv --image-size 640 480 --lens none --motion planar --robot robot.csv': (
        '--robot', '--robot-kind', '--robot-sigma', '--robot-unit', '--robot-frame',
        '--mount-fact', '--mount-output', '--camera-frame'),
    'calibrate left right --cameras left,right': (
        '--cameras', '--baseline', '--mask', '--motion', '--lens', '--output', '--json'),
    'track object --camera object.camera.yaml --model model.cao --init object.pos': (
        '--output', '--overlay', '--init', '--clicks', '--camera', '--model', '--method',
        '--motion', '--plane-axis', '--camera-model', '--topic', '--model-scale',
        '--init-sigma', '--start', '--duration', '--every', '--seed'),
    'model images --camera camera.yaml --vertices picked.yaml --baseline 0.1': (
        '--images', '--length', '--between', '--baseline', '--region', '--vertices', '--obj',
        '--topic', '--output'),
    'convert camera.yaml out.xml': ('--to', '--camera', '--camera-name', '--image-size', '--topic',
                                    '--storage', '--input-topic', '--compressed', '--frame-id'),
    'convert images out_bag': ('--to', '--topic', '--storage', '--compressed', '--frame-id',
                               '--image-size', '--camera-name'),
    'compare camera.yaml opencv.yaml': ('--result-a', '--result-b', '--camera-a', '--camera-b',
                                        '--image-size', '--json')}
VALUES = (*ODD, '/dev/null', '/dev/zero', '/dev/full', '/', '.', '..', '', ' ', 'images', 'bag',
          'nowhere/x', 'tracks.csv', 'out.yaml', '1', '2', '0.5', '3 3', 'a' * 300, '-', '--',
          'chessboard:4x3:0.1', 'chessboard:0x3:0.1', 'charuco:5x4:0.1:9', 'tsai:2x2:1:1:1',
          'chessboard:1000000x1000000:1', 'chessboard:4x3:1e-300', '1 2 3 4 5 6', '0 1', '1 0',
          'robot.csv', 'robot.csv --mount-fact x=0.1:0.01', '/odom', '/tf:a:b', 'x=0.1:0.01',
          'roll=0:0', 'q=1:1', 'x=1e999:0', '0.01:1', 'absolute', 'left,right', 'left,left',
          'out.urdf', 'mesh.obj', 'result.json', os.fsdecode(b'\xff\xfe'), '1e-300 1e300')


def draw(rng: np.random.Generator) -> Case:
    """Draw a case."""
    from bench.hostile import hostile_calls
    kind = rng.choice(['file', 'options', 'call', 'disk'], p=[0.6, 0.2, 0.15, 0.05])
    if kind == 'call':
        name, call = hostile_calls.draw(rng)
        return Case(f'call: {name}', call=call)
    if kind == 'options':
        command = str(rng.choice(list(OPTIONS)))
        arguments = command.split()
        for _ in range(int(rng.choice([1, 1, 2, 4]))):
            option = str(rng.choice(OPTIONS[command]))
            value = str(VALUES[int(rng.integers(len(VALUES)))]).replace('\x00', '\x01')
            arguments += [option, *(value.split(' ') if rng.random() < 0.7 else [value])]
        return Case(f'options: {arguments[0]}', tuple(arguments))
    name, command = READERS[int(rng.integers(len(READERS)))]
    arguments = tuple(command.replace('@', name).split())
    if kind == 'disk':
        return Case('full disk', arguments, file_bytes=int(rng.choice([0, 10, 1000, 20_000])))
    return Case(f'file: {name}', arguments, _damage(name))


def whole(path: Path) -> bool:
    """Tell whether an output is all there, as far as its kind tells."""
    if path.is_dir():
        with open_source(path) as source:
            return sum(1 for _ in source) > 0
    if path.suffix == '.mp4':
        return cv2.VideoCapture(str(path)).read()[0]
    if not path.is_file():
        return True
    data = path.read_bytes()
    if path.suffix == '.json':
        json.loads(data)
    if path.suffix == '.ply':
        header, _, body = data.partition(b'end_header\n')
        size = 0
        for element in header.split(b'element ')[1:]:
            uchars = element.count(b'property uchar')
            size += int(element.split()[1]) * (4 * element.count(b'property ') - 3 * uchars)
        return len(body) == size
    ends = {'.html': b'</html>', '.xml': b'</opencv_storage>\n', '.cameramodel': b'}\n'}
    return data.endswith(ends.get(path.suffix, b'' if path.suffix in ('.bin',) else b'\n'))
