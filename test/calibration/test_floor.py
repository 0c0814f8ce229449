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
"""The floor in view gives the height of the camera; what is not the floor gives none."""

from dataclasses import replace

from bench.mounts import mount_worlds as worlds
import numpy as np
import pytest
from selfcal_ros import calibrate
from selfcal_ros.calibration.mount import Floor, Mount, mount_rotation, NAMES
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.floor import floor_below, with_floor
from selfcal_ros.calibration.structure.metric_structure import middle_steps
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.report.mounts.record import mount_from_dict, mount_to_dict
from selfcal_ros.report.mounts.words import mount_lines
from selfcal_ros.values.tracks import Tracks

VIEWS, WIDTH, HEIGHT = 24, 640, 480
K = np.array([[380.0, 0, 320], [0, 380, 240], [0, 0, 1]])
#: Pixels; of the camera above the floor, metres; of the metre, as a share.
NOISE_PX, UP_M, METRE_SIGMA = 0.2, 0.9, 1e-3


def seen(rng, points, unit=0.37):
    """
    Return what the images of a drive through points say, with points adjusted one by one.

    The world of the reconstruction has a unit of its own, and z against the motion's axis.
    """
    rotation, position = worlds.drive(0.4 * np.arange(VIEWS))
    M = mount_rotation(0, np.radians(25), 0)
    R = np.swapaxes(rotation @ M, 1, 2)
    centre = position + [0, 0, UP_M]
    poses = np.concatenate([R, -np.einsum('vij,vj->vi', R, centre)[:, :, None]], axis=2)
    X = np.einsum('vij,pj->vpi', R, points) + poses[:, None, :, 3]
    with np.errstate(divide='ignore', invalid='ignore'):
        xy = X[..., :2] / X[..., 2:] * 380 + [320, 240]
    inside = (X[..., 2] > 0.3) & (xy > 0).all(-1) & (xy < [WIDTH, HEIGHT]).all(-1)
    # tracks are lost after a while
    inside &= np.cumsum(inside, axis=0) <= 8
    inside &= inside.sum(axis=0) >= 3
    view, point = np.nonzero(inside)
    xy = xy[view, point] + rng.normal(0, NOISE_PX, (len(view), 2))
    # Gauss-Newton from the truth: the least squares of each point, its cameras exact
    at = X[view, point]
    J = np.zeros((len(view), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 380 / at[:, 2]
    J[:, :, 2] = -380 * at[:, :2] / at[:, 2:]**2
    J = J @ R[view]
    off = xy - (at[:, :2] / at[:, 2:] * 380 + [320, 240])
    N, b = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(N, point, np.swapaxes(J, 1, 2) @ J)
    np.add.at(b, point, np.einsum('nij,ni->nj', J, off))
    known = np.unique(point)
    found = points[known] + np.linalg.solve(N[known], b[known][..., None])[..., 0]
    upside = np.diag([1.0, -1, -1])
    shape = Reconstruction(np.arange(VIEWS), np.concatenate(
        [R @ upside.T, poses[:, :, 3:] / unit], axis=2), known,
        np.column_stack([found @ upside.T / unit, np.ones(len(known))]))
    camera = Camera(K, (), WIDTH, HEIGHT)
    names = camera.parameter_names
    steps = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    metres = float(np.mean([steps[k] for k in middle_steps(centre)]))
    metres *= 1 + METRE_SIGMA * rng.standard_normal()
    covariance = np.diag([1e-4] * 8)
    covariance[6, 6] = (METRE_SIGMA * metres)**2
    status = dict.fromkeys(NAMES, 'estimated')
    pose = np.eye(4)
    mount = Mount('base_link', pose, covariance, status, metres, 0.0, {}, VIEWS, 0, 1e-3, 1e-3)
    calibration = Calibration(
        camera, np.zeros((len(names), len(names))), dict.fromkeys(names, 'held'), {}, 'planar',
        CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'), tuple(range(VIEWS)),
        NOISE_PX, NOISE_PX, len(view), 0, shape, mount=mount)
    return calibration, Tracks(view, point, xy, (WIDTH, HEIGHT))


def layer(rng, count, z, x=(-1, 9), y=(-3, 3)):
    return np.column_stack([rng.uniform(*x, count), rng.uniform(*y, count), np.full(count, z)])


def things(rng, count, top):
    """Return points on all sides of things that stand on the floor."""
    return np.column_stack([rng.uniform(-1, 10, count), rng.uniform(-4, 4, count),
                            rng.uniform(0.05, top, count)])


def test_the_height_is_that_of_the_truth_within_its_sigma():
    squares, sigmas = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        points = np.concatenate([layer(rng, 700, 0.0), things(rng, 500, 2.0)])
        floor = floor_below(*seen(rng, points))
        assert isinstance(floor, Floor), floor
        squares.append(((floor.height_m - UP_M) / floor.sigma_m)**2)
        sigmas.append(floor.sigma_m)
        assert abs(floor.height_m - UP_M) < 0.01 * UP_M
    # twelve squares of a normal error; beyond by chance once in a thousand
    assert 2.2 < sum(squares) < 33, squares
    assert max(sigmas) < 0.008 and min(sigmas) >= METRE_SIGMA * UP_M * 0.99


@pytest.mark.parametrize('what, kind', [
    ('shelf', 'floor_not_driven_over'), ('table', 'floor_not_lowest'), ('heap', 'floor_not_seen'),
    ('ramp', 'floor_not_level'), ('few', 'floor_not_seen')])
def test_what_is_not_the_floor_gives_no_height(what, kind):
    rng = np.random.default_rng(5)
    points = {
        # to the side, with nothing of the floor in view
        'shelf': lambda: layer(rng, 1500, 0.5, y=(2.2, 5)),
        'table': lambda: np.concatenate([layer(rng, 900, 0.4), layer(rng, 300, 0.0)]),
        'heap': lambda: things(rng, 1500, 0.85),
        'ramp': lambda: layer(rng, 1500, 0.0, x=(1.6, 2.4), y=(-1.5, 1.5)),
        'few': lambda: layer(rng, 40, 0.0)}[what]()
    if what == 'ramp':
        points[:, 2] = 0.028 * (points[:, 0] - 2)
    calibration, tracks = seen(rng, points)
    refused = floor_below(calibration, tracks)
    assert getattr(refused, 'kind', refused) == kind
    told = with_floor(calibration, tracks)
    assert refused.reason in ' '.join(mount_lines(told))
    stored = mount_to_dict(told.mount)['floor']
    assert stored['height_m'] is None and stored['kind'] == kind
    assert mount_from_dict(mount_to_dict(told.mount)).floor.kind == kind


def test_no_height_comes_from_a_torn_path():
    rng = np.random.default_rng(1)
    calibration, tracks = seen(rng, np.concatenate([layer(rng, 700, 0.0), things(rng, 300, 2.0)]))
    torn = replace(calibration, findings=(Finding('path_torn', frame=7, count=1,
                                                  kept_percent=3.0),))
    assert floor_below(torn, tracks).kind == 'floor_on_torn_path'


@pytest.mark.long
def test_a_camera_that_is_not_known_well_leaves_the_height_open_by_as_much():
    """Of a camera that looks down, focal length and height go together: 5 sigmas off."""
    rng = np.random.default_rng(2)
    views, up, f = 24, 1.5, 520.0
    rotation, position = worlds.drive(0.5 * np.arange(views))
    R = np.swapaxes(rotation @ mount_rotation(0.05, np.radians(75), 0.3), 1, 2)
    centre = position + [0, 0, up]
    spread = np.concatenate([layer(rng, 2500, 0.0, x=(-2, 8), y=(-3, 3)),
                             layer(rng, 500, 0.05, x=(-2, 8), y=(-3, 3))])
    X = np.einsum('vij,vpj->vpi', R, spread - centre[:, None])
    xy = f * X[..., :2] / X[..., 2:] + [320, 240]
    inside = (X[..., 2] > 0.3) & (xy > 0).all(-1) & (xy < [WIDTH, HEIGHT]).all(-1)
    inside &= inside.sum(axis=0) >= 3
    view, point = np.nonzero(inside)
    tracks = Tracks(view, point, xy[view, point] + rng.normal(0, 0.3, (len(view), 2)),
                    (WIDTH, HEIGHT))
    found = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'),
                      rng=rng)
    steps = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    metres = float(np.mean([steps[k] for k in middle_steps(centre)]))
    mount = Mount('base_link', np.eye(4), np.zeros((8, 8)), dict.fromkeys(NAMES, 'estimated'),
                  metres, 0.0, {}, views, 0, 1e-3, 1e-3)
    floor = floor_below(replace(found, mount=mount), tracks)
    focal = found.sigma['fx'] / found.camera.K[0, 0]
    assert focal > 1e-3
    assert 0.7 * focal < floor.sigma_m / floor.height_m < 1.5 * focal
    assert abs(floor.height_m - up) < 3.5 * floor.sigma_m


def test_a_height_is_told_and_stored():
    rng = np.random.default_rng(1)
    calibration, tracks = seen(rng, np.concatenate([layer(rng, 700, 0.0), things(rng, 300, 2.0)]))
    told = with_floor(calibration, tracks).mount
    assert mount_from_dict(mount_to_dict(told)).floor == told.floor
    assert ' m above the floor, of which it sees ' in ' '.join(
        mount_lines(with_floor(calibration, tracks)))
