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
Objects filmed by hand, before a wall of tags that tells where the camera is.

The sequence is ViSP's `rbt`: a painted cube and a dragon of plastic, given as meshes. The wall
gives the camera's motion; where the objects stand before it is only known to some millimetres. So
one rigid offset is fitted to the images whose truth was verified; what is left is judged there.
In the fast images the wall itself is not rigid (their shutter). There the outline of the pose is
held against the edges of the colour image, and against itself moved aside.
"""

from __future__ import annotations

from dataclasses import dataclass
import json
import time

from bench.inputs import data_folder
from bench.tables import Report
from bench.tracking import tracking_runs, visp_peer
from bench.tracking.tracking_runs import Track
import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.tracker import TrackerState
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.wireframe import WireframeModel

#: Images whose truth was verified.
VERIFIED = slice(0, 9)
#: The file of the dragon is turned about x against the frame of its poses.
TURNED = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
#: Largest rms against the wall: millimetres, degrees.
MOST = {'cube': (2.0, 0.5), 'dragon': (4.0, 1.0)}
#: Median distance of a pose's outline from the edges of the image, pixels.
ON_PX = 3.0
#: The outline moved aside by so much shows what chance gives, pixels.
ASIDE_PX = 12
#: Thresholds of the edges that count, per colour.
CANNY = 60, 150
#: Search lines and their length for OpenCV's trackers.
SEARCH_LINES, SEARCH_PX = 100, 20


@dataclass(frozen=True)
class Sequence:
    """
    One object in the sequence.

    Attributes
    ----------
    model : WireframeModel
    camera : Camera
    images : list of ndarray
        BGR.
    truth : ndarray, shape (N, 4, 4)
        Object to camera, up to one rigid offset.

    """

    model: WireframeModel
    camera: Camera
    images: list
    truth: np.ndarray


def run(report: Report, options) -> None:
    """Print the tables."""
    report.section('Recorded by hand: a painted cube and a dragon, given as meshes',
                   f'rms against the wall in images {VERIFIED.start} to {VERIFIED.stop - 1}, '
                   'after one rigid offset. Outline: median distance',
                   'of the outline from edges of the image, worst image; and that of the outline '
                   f'{ASIDE_PX} px aside, median.')
    if data_folder('visp_rbt') is None:
        report.say('left out: the recorded sets are not there')
        return
    rows, visp = [], visp_peer.build()
    for name in MOST:
        sequence = read_sequence(name)
        for step in (1, 3):
            track = follow(sequence, step)
            found, states = (track.rotations, track.translations), track.states
            numbers = np.arange(0, len(sequence.images), step)
            away, turned = off_the_wall(sequence, numbers, *found)
            near, aside = outline_distances(sequence, numbers, *found, states)
            followed = sum(state in (TrackerState.TRACKING, TrackerState.DEGRADED)
                           for state in states)
            what = f'{name}, every image' if step == 1 else f'{name}, every third'
            rows.append((what, f'{away:.2f}', f'{turned:.2f}', f'{followed} of {len(numbers)}',
                         f'{near:.1f}', f'{aside:.1f}',
                         f'{1000 * np.median(track.seconds):.1f}'))
            report.judge(away <= MOST[name][0] and turned <= MOST[name][1],
                         f'{what}: {away:.2f} mm, {turned:.2f}°, required {MOST[name][0]:g} mm, '
                         f'{MOST[name][1]:g}°')
            report.judge(followed == len(numbers) and near <= ON_PX,
                         f'{what}: on the object in {followed} of {len(numbers)} images, outline '
                         f'within {near:.1f} px at the worst, required {ON_PX:g} px')
        rows += peers(sequence, name, visp)
    report.say('')
    report.table(('object', 'mm', '°', 'followed', 'outline px', 'aside px', 'ms'), rows)


def read_sequence(name: str) -> Sequence:
    """Read one object's model, images and poses."""
    folder = data_folder('visp_rbt')
    data = json.loads((folder / 'truth.json').read_text(encoding='utf-8'))
    camera = Camera(np.array(data['K']), (), *data['image_size'])
    model = read_model(folder / 'models' / f'{name}.obj')
    if name == 'dragon':
        model = MeshModel.build(model.vertices @ TURNED.T, model.triangles, name)
    wall = np.array([frame['T_cam_wall'] for frame in data['frames']])
    start = np.array(data['T_cam_object_frame0'][name])
    images = [cv2.imread(str(folder / 'images' / frame['image'])) for frame in data['frames']]
    return Sequence(model, camera, images, wall @ np.linalg.inv(wall[0]) @ start)


def follow(sequence: Sequence, step: int) -> Track:
    """Follow the object in every so many images, from the start that came with the sequence."""
    return tracking_runs.follow(sequence.images[::step], sequence.model, sequence.camera,
                                (sequence.truth[0, :3, :3], sequence.truth[0, :3, 3]))


def off_the_wall(sequence: Sequence, numbers, rotations, translations) -> tuple[float, float]:
    """Millimetres and degrees, rms, in the verified images, after one rigid offset."""
    use = (numbers >= VERIFIED.start) & (numbers < VERIFIED.stop)
    true = sequence.truth[numbers[use]]
    turns = np.swapaxes(true[:, :3, :3], 1, 2) @ rotations[use]
    offset = Rotation.from_matrix(turns).mean().as_matrix()
    turned = rotation_vector(np.swapaxes(turns, 1, 2) @ offset)
    shifts = np.einsum('nji,nj->ni', true[:, :3, :3], translations[use] - true[:, :3, 3])
    away = shifts - shifts.mean(axis=0)
    return (1000 * float(np.sqrt((away**2).sum(axis=1).mean())),
            float(np.rad2deg(np.sqrt((turned**2).sum(axis=1).mean()))))


def outline_distances(sequence: Sequence, numbers, rotations, translations, states):
    """Worst median distance of outlines from edges, and the median of outlines moved aside."""
    near, aside = [0.0], []
    for number, rotation, translation, state in zip(numbers, rotations, translations, states):
        if state not in (TrackerState.TRACKING, TrackerState.DEGRADED):
            continue
        image = sequence.images[number]
        edges = np.zeros(image.shape[:2], np.uint8)
        for channel in cv2.split(cv2.GaussianBlur(image, (0, 0), 1.0)):
            edges |= cv2.Canny(channel, *CANNY)
        distance = cv2.distanceTransform(255 - edges, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        outline = outline_of(sequence, rotation, translation)
        near.append(float(np.median(distance[outline > 0])))
        aside += [float(np.median(distance[np.roll(outline, shift, axis) > 0]))
                  for shift in (-ASIDE_PX, ASIDE_PX) for axis in (0, 1)]
    return max(near), float(np.median(aside)) if aside else np.nan


def outline_of(sequence: Sequence, rotation, translation) -> np.ndarray:
    """Draw the outline of the object at a pose: (H, W) of uint8, 255 on it."""
    model, camera = sequence.model, sequence.camera
    pixels = camera.project(model.vertices @ rotation.T + translation)
    mask = np.zeros((camera.height, camera.width), np.uint8)
    for corners in np.rint(pixels[model.triangles] * 16).astype(np.int32):
        cv2.fillConvexPoly(mask, corners, 255, cv2.LINE_8, 4)
    return cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8))


def peers(sequence: Sequence, name: str, visp) -> list[tuple]:
    """Rows of others: OpenCV's `rapid` where contrib is installed, ViSP where it is (the cube)."""
    rows = []
    for method in ('Rapid', 'OLSTracker') if hasattr(cv2, 'rapid') else ():
        rows.append(judged(sequence, f'{name}, OpenCV {method}', *opencv_rapid(sequence, method)))
    for kind in ('edges', 'both') if visp and not isinstance(sequence.model, MeshModel) else ():
        grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in sequence.images]
        found = visp_peer.track(visp, grey, kind, sequence.model, sequence.camera,
                                (sequence.truth[0, :3, :3], sequence.truth[0, :3, 3]))
        what = 'edges' if kind == 'edges' else 'edges + KLT'
        rows.append(judged(sequence, f'{name}, ViSP {what}', *found))
    return rows


def opencv_rapid(sequence: Sequence, method: str):
    """Rotations, translations and seconds of one of OpenCV's trackers, until it fails."""
    model = sequence.model
    tracker = getattr(cv2.rapid, method).create(model.vertices.astype(np.float32),
                                                model.triangles.astype(np.int32))
    turn, shift = cv2.Rodrigues(sequence.truth[0, :3, :3])[0], sequence.truth[0, :3, 3:].copy()
    rotations, translations, seconds = [], [], []
    for image in sequence.images:
        began = time.thread_time()
        try:
            _, turn, shift = tracker.compute(image, SEARCH_LINES, SEARCH_PX, sequence.camera.K,
                                             turn, shift)
        except cv2.error:
            break
        seconds.append(time.thread_time() - began)
        rotations.append(cv2.Rodrigues(turn)[0])
        translations.append(shift[:, 0].copy())
    return np.array(rotations), np.array(translations), np.array(seconds)


def judged(sequence: Sequence, what: str, rotations, translations, seconds) -> tuple:
    """Return the row of a tracker that never says that it is lost."""
    numbers, count = np.arange(len(rotations)), len(sequence.images)
    if len(rotations) < VERIFIED.stop:
        return what, '', '', f'{len(rotations)} of {count}', '', '', ''
    away, turned = off_the_wall(sequence, numbers, rotations, translations)
    near, aside = outline_distances(sequence, numbers, rotations, translations,
                                    [TrackerState.TRACKING] * len(rotations))
    return (what, f'{away:.2f}', f'{turned:.2f}', f'{len(rotations)} of {count}', f'{near:.1f}',
            f'{aside:.1f}', f'{1000 * np.median(seconds):.1f}')
