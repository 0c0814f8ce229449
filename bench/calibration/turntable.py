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
"""A fixed camera before a wall and a turntable that a tenth of the points lie on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bench.inputs import data_folder, image_files, truth_of
from bench.tables import Report
import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic import worlds
from selfcal_ros.synthetic.paths import look_at
from selfcal_ros.synthetic.recordings import Recording
from selfcal_ros.synthetic.render import Surface

K = np.array([[620.0, 0, 328], [0, 620, 235], [0, 0, 1]])
SIZE, VIEWS, PERIOD_NS = (640, 480), 80, 33_000_000
#: Half the side of the disc, metres, and the part of the image (x, y, width, height) that it keeps
#: to: only this is rendered for every image.
HALF_M, PART = 0.14, (180, 170, 320, 180)
SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
#: Refusals that name the disc, or the circle, and the fact that is missing.
NAMED = ('flat_turntable', 'circle_undetermined')
LARGEST_ERROR, LARGEST_SIGMAS = 0.01, 3.0


def rendered(kind: str, step_deg: float, seed: int) -> Recording:
    """Build a disc that turns in a still room: 'flat', with a 'rim' or with an 'object'."""
    rng = np.random.default_rng([seed, 1])
    fixed = look_at([-0.75, 0.0, 0.42], [0.0, 0.03, 0.05])
    turn = Rotation.from_rotvec(
        np.radians(step_deg) * np.arange(VIEWS)[:, None] * [0, 0, 1]).as_matrix()
    poses = np.concatenate([fixed[:, :3] @ turn,
                            np.broadcast_to(fixed[:, 3:], (VIEWS, 3, 1))], axis=2)
    fine = worlds.Style(texel_m=0.0008, smallest_m=0.004, largest_m=0.05)
    coarse = worlds.Style(texel_m=0.003, smallest_m=0.015, largest_m=0.3)
    room = worlds.room(rng, [-1.5, -1.5, -0.3], [1.2, 1.5, 1.5], coarse, coarse)
    surfaces = [Surface(s.origin, s.edge_u, s.edge_v, s.texture, 1) for s in room]
    side = 2 * HALF_M
    surfaces.append(worlds.rectangle(rng, [-HALF_M, -HALF_M, 0.0], [side, 0, 0], [0, side, 0],
                                     fine, 120.0))
    if kind == 'rim':
        surfaces += worlds.box(rng, [0, 0, -0.03], [side, side, 0.029], 0.0, fine)
    elif kind == 'object':
        surfaces += worlds.scatter(rng, 4, 0.8 * HALF_M, fine, largest_m=0.12)
    return Recording('turntable', Camera(K, (), *SIZE), poses, PERIOD_NS * np.arange(VIEWS),
                     surfaces, static_pose=fixed, seed=seed)


def images_of(recording: Recording) -> Iterator[tuple[int, np.ndarray, int]]:
    """Render the room once, and what moves for every image."""
    room = replace(recording, noise_sigma=0.0,
                   surfaces=[one for one in recording.surfaces if one.body == 1])
    wall = room.frame(0, room.renderer(2)).astype(float)
    left, top, width, height = PART
    part = replace(recording, camera=Camera(K - [[0, 0, left], [0, 0, top], [0, 0, 0]], (), width,
                                            height))
    renderer, rng = part.renderer(2), np.random.default_rng(recording.seed)
    for k in range(VIEWS):
        noisy = np.clip(wall + rng.normal(0, 1, wall.shape), 0, 255)
        image = np.rint(noisy).astype(np.uint8)
        image[top:top + height, left:left + width] = part.frame(k, renderer)
        yield k, image, PERIOD_NS * k


def pasted(name: str) -> Iterator[tuple[int, np.ndarray, int]] | None:
    """Cut a recorded turntable out of its plain background, and put it before a textured wall."""
    folder = data_folder(name)
    if folder is None:
        return None
    rng, wall = np.random.default_rng(0), None
    for k, path in enumerate(image_files(folder)):
        image = cv2.imread(str(path))
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if wall is None:
            height, width = grey.shape
            style = worlds.Style(texel_m=0.001, smallest_m=0.004, largest_m=0.1)
            wall = cv2.resize(worlds.texture(rng, width / 1000, height / 1000, style, 120.0),
                              (width, height))
        blue, red = image[..., 0].astype(int), image[..., 2].astype(int)
        thing = (grey > 25) & (red > blue - 5) if name == 'vgg_dino' else grey > 30
        filled = cv2.morphologyEx(thing.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5)))
        filled = cv2.morphologyEx(filled, cv2.MORPH_CLOSE, np.ones((21, 21)))
        _, label, measures, _ = cv2.connectedComponentsWithStats(filled)
        largest = label == 1 + np.argmax(measures[1:, cv2.CC_STAT_AREA])
        share = cv2.GaussianBlur(largest.astype(np.float32), (5, 5), 1.0)
        behind = wall + rng.normal(0, 1, grey.shape)
        whole = np.clip(share * grey + (1 - share) * behind, 0, 255)
        yield k, np.rint(whole).astype(np.uint8), k


def run(report: Report, options) -> None:
    """Print what becomes of each, with square pixels and with the principal point as well."""
    report.section('turntable', f'{VIEWS} images of a still room and a disc that turns, true '
                   f'focal length {K[0, 0]:g} px; two recorded turntables pasted before a wall.',
                   f'Required: within {LARGEST_ERROR:.0%} and {LARGEST_SIGMAS:g} sigmas, or '
                   'refused with the fact that is missing.')
    rows = []
    for kind in ('flat', 'rim', 'object'):
        for step_deg in (1.0, 4.5):
            rows += judged(report, f'{kind}, {step_deg:g} deg',
                           images_of(rendered(kind, step_deg, 3)), K)
    for name in ('mb_temple_ring', 'vgg_dino'):
        images = pasted(name)
        folder = data_folder(name)
        if images is None or folder is None:
            report.say(f'Left out: ../shared/data/{name} is not there.')
            continue
        # of the dinosaur no calibration is known
        rows += judged(report, f'{name}, pasted', images, truth_of(folder).get('K'))
    report.table(('what', 'facts', 'mode', 'images', 'tracks', 'still', 'fx error', 'sigma',
                  'sigmas off', 'verdict'), rows)


def judged(report: Report, what: str, images, truth) -> list[tuple]:
    """Calibrate with and without the principal point; return the rows of the table."""
    found = extract_tracks(images)
    still = [one.values['share'] for one in found.findings
             if one.kind in ('fixed_camera', 'fixed_camera_features')]
    head = (found.mode, len(found.keyframes), len(np.unique(found.tracks.track)),
            f'{still[0]:.0%}' if still else 'none')
    rows = []
    for facts in (SQUARE, None if truth is None else CameraFacts(
            aspect_ratio=float(truth[1, 1] / truth[0, 0]), skew=0.0,
            principal_point=(float(truth[0, 2]), float(truth[1, 2])))):
        if facts is None:
            continue
        said = 'square' if facts is SQUARE else 'and centre'
        result = calibrate(found.tracks, facts=facts)
        if not result:
            report.judge(result.kind in NAMED or truth is None, f'{what}, {said}: {result.kind}')
            rows.append((what, said, *head, '', '', '', result.kind))
            continue
        focal, sigma = result.camera.K[0, 0], result.sigma['fx']
        if truth is None:
            rows.append((what, said, *head, '', f'{sigma / focal:.2%}', '', 'truth not known'))
            continue
        error = focal - truth[0, 0]
        held = abs(error) <= min(LARGEST_ERROR * focal, LARGEST_SIGMAS * sigma)
        report.judge(held, f'{what}, {said}: {error / focal:+.2%}, {error / sigma:+.1f} sigmas')
        rows.append((what, said, *head, f'{error / focal:+.2%}', f'{sigma / focal:.2%}',
                     f'{error / sigma:+.1f}', 'held' if held else 'missed'))
    return rows
