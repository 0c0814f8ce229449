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
"""Objects that nobody says a start of: before a plain (black) background, a wall, or a desk."""

from __future__ import annotations

from bench.tables import Report
from bench.tracking.tracking_meshes import CAMERA, SMOOTH
from bench.tracking.tracking_objects import NEW_OBJECTS
from bench.tracking.tracking_runs import cube_sequence, CubeSequence
import numpy as np
from scipy.spatial import cKDTree
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.rorapid.tracked_frame import TrackedFrame
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.synthetic.mesh_scenes import MeshRenderer
from selfcal_ros.synthetic.objects import object_poses, tracked_object
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.wireframe import WireframeModel

#: Sequences of each kind, and images of each.
SEEDS, IMAGES = (501, 502, 503), 20
#: The recorded cube is sought anew after so many images.
BETWEEN = 24
#: A pose is right within so many degrees; one that takes the model onto itself is right, too.
_TURN_DEG, _ITSELF = 3.0, 0.02


def run(report: Report, options) -> None:
    """Print the tables; with --runs so many sequences of each kind."""
    seeds = SEEDS[:options.runs or len(SEEDS)]
    report.section('Starts without a pose')
    rows, wrong = [], 0
    for name in (*NEW_OBJECTS, 'l_block', 'step_block', 'cube'):
        for wall in (False, True):
            found = [polyhedron(name, wall, seed) for seed in seeds]
            rows.append((name, 'wall' if wall else 'plain', *summary(found)))
            wrong += sum(one[1] for one in found)
    for name in SMOOTH:
        for what in ('plain', 'blobs', 'textured'):
            found = [mesh(name, what, 0.7 + 0.2 * k) for k in range(len(seeds))]
            rows.append((name, what, *summary(found)))
            wrong += sum(one[1] for one in found)
    sequence = cube_sequence()
    if sequence is not None:
        found = [recorded(sequence, first)
                 for first in range(0, len(sequence.images) - IMAGES, BETWEEN)]
        rows.append(('recorded cube', 'desk', *summary(found)))
        wrong += sum(one[1] for one in found)
    report.table(('object', 'before', 'found', 'in image', 'wrong poses'), rows)
    report.say('')
    report.judge(not wrong, f'{wrong} wrong poses')


def summary(found: list) -> tuple[str, str, int]:
    """How many were found, in which image, and how many poses were wrong."""
    first = [image for image, _ in found if image is not None]
    return (f'{len(first)} of {len(found)}', ', '.join(map(str, first)),
            sum(wrong for _, wrong in found))


def follow(model, camera, images, is_right) -> tuple[int | None, int]:
    """Image of the first right pose, and how many were wrong."""
    tracker = RorapidTracker(model, camera, rng=np.random.default_rng(0))
    tracker.seek()
    first, wrong = None, 0
    for k, image in enumerate(images):
        frame = tracker.track(image)
        if frame and is_right(frame, k):
            first = k + 1 if first is None else first
        wrong += bool(frame) and not is_right(frame, k)
    return first, wrong


def fits(model: WireframeModel, frame: TrackedFrame, rotation, translation) -> bool:
    """Whether a frame has the vertices where a pose has them, which of them ever."""
    placed = (model.vertices @ frame.rotation.T + frame.translation - translation) @ rotation
    return bool(cKDTree(model.vertices).query(placed)[0].max() < _ITSELF * model.diameter_m)


def polyhedron(name: str, wall: bool, seed: int) -> tuple[int | None, int]:
    """Seek a rendered polyhedron."""
    made = tracked_object(IMAGES, NEW_OBJECTS[name](seed) if name in NEW_OBJECTS else name,
                          seed=seed, supersampling=2, speed=0.8, background=wall)
    renderer = made.renderer()
    images = [made.frame(k, renderer) for k in range(IMAGES)]
    return follow(made.model, made.camera, images, lambda frame, k: fits(
        made.model, frame, made.rotations[k], made.translations[k]))


def recorded(sequence: CubeSequence, first: int) -> tuple[int | None, int]:
    """Seek the painted cube on a desk, from an image of the recording on."""
    track = sequence.reference
    return follow(
        sequence.model, sequence.camera, sequence.images[first:first + IMAGES],
        lambda frame, k: fits(sequence.model, frame, track.rotations[first + k],
                              track.translations[first + k]))


def mesh(name: str, what: str, speed: float) -> tuple[int | None, int]:
    """Seek a smooth part."""
    vertices, faces = SMOOTH[name]()
    model = MeshModel.build(vertices, faces, name)
    drawn = MeshRenderer(vertices, faces, CAMERA,
                         np.random.default_rng(1) if what == 'blobs' else None,
                         textured=what == 'textured')
    poses = object_poses('general', IMAGES, model.diameter_m, speed=speed)
    images = [drawn.render(pose, np.random.default_rng(k), 1.0) for k, pose in enumerate(poses)]

    def is_right(frame, k: int) -> bool:
        turn = rotation_vector(frame.rotation @ poses[k][:, :3].T)
        return bool(np.degrees(np.linalg.norm(turn)) < 3 * _TURN_DEG)

    return follow(model, CAMERA, images, is_right)
