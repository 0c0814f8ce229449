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
"""Cameras that move together: derivatives of the rig block, the start, truth and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.bundle import scene_model
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Priors, priors_from_facts
from selfcal_ros.calibration.bundle.rig import Rig, RigPriors
from selfcal_ros.calibration.bundle.rig_model import RigState
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, RobustFit
from selfcal_ros.calibration.bundle.scene_model import rescaled
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.rigs.alignment import align
from selfcal_ros.calibration.rigs.judgement import judge, RigOptimum
from selfcal_ros.calibration.rigs.rig_calibration import calibrate_rig
from selfcal_ros.calibration.rigs.start import (observations_of, place_by_points,
                                                with_all_points)
from selfcal_ros.calibration.uncertainty.distortion_misfit import displacement_modes
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.catalogue import lens_model
from selfcal_ros.geometry.lenses.plumb_bob import tangential
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.rig_scenes import driven_path, hand_path, RIG_CAMERAS, rig_scene

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
VIEWS, POINTS = 4, 9


@pytest.fixture
def problem():
    """A rig of a perspective and a fisheye camera, and a state away from its optimum."""
    rng = np.random.default_rng(0)
    lenses = [Lens(np.array([500, 1.01, 320, 240, 1.0, -0.1, 0.02, 0.001, 0.002, 0.01]),
                   lens_model('plumb_bob')),
              Lens(np.array([300, 1.0, 330, 250, 0.0, 0.01, 0.002, 0.001, 0.002]),
                   lens_model('equidistant'))]
    poses = np.stack([np.eye(3, 4), np.column_stack([rotation_matrix(np.array([0.1, 0.2, 0.1])),
                                                     [0.5, 0.1, 0.2]])])
    rig = Rig.of_cameras(('left', 'right'), lenses, poses)
    path = AxisPath(rotation_matrix(0.1 * rng.normal(size=3)), 0.1 * rng.normal(size=VIEWS),
                    0.1 * rng.normal(size=(VIEWS, 2)), 0.2 * rng.normal(size=(VIEWS, 3)))
    points = np.column_stack([rng.uniform(-1, 1, (POINTS, 2)), rng.uniform(4, 6, POINTS),
                              np.ones(POINTS)])
    points[:, :3] = points[:, :3] @ path.mount
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points[:3] *= -1
    point, view, camera = (index.ravel() for index in np.meshgrid(
        np.arange(POINTS), np.arange(VIEWS), [0, 1], indexing='ij'))
    priors = RigPriors.of_cameras({name: Priors({}, lens.model)
                                   for name, lens in zip(rig.cameras, lenses)})
    seen = Observations(view, point, rng.uniform(0, 400, (len(view), 2)), np.arange(POINTS),
                        camera=camera)
    return bundle_of(seen, GENERAL, priors, 1.0), RigState(rig, path, points)


def test_derivatives_of_the_rig(problem):
    bundle, state = problem
    at, size, h = bundle.linearise(state), len(bundle.unknowns), 1e-5

    def difference(step, points=None):
        ahead, back = (bundle.predict(bundle.moved(
            state, sign * step, None if points is None else sign * points)).residual
            for sign in (1, -1))
        return (ahead - back) / (2 * h)

    for k in np.flatnonzero(bundle.unknowns.free):
        view, own = divmod(k - bundle.unknowns.shared.stop, 6)
        analytic = at.shared[:, :, k] if view < 0 else np.where(
            (bundle.blocks.view == view)[:, None], at.view[:, :, own], 0)
        numeric = difference(h * np.eye(size)[k])
        assert np.abs(analytic - numeric).max() < 1e-6 * max(np.abs(numeric).max(), 1)
    for k in range(3):
        numeric = difference(np.zeros(size), np.tile(h * np.eye(3)[k], (POINTS, 1)))
        assert np.abs(at.eliminated[:, :, k] - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_points_that_a_view_sees_twice_are_eliminated_as_the_dense_equations_say(problem):
    bundle, state = problem
    at, size = bundle.linearise(state), len(bundle.unknowns)
    rows = np.zeros((len(bundle.view), 2, size + 3 * POINTS))
    rows[:, :, bundle.unknowns.shared] = at.shared
    for n, (view, point) in enumerate(zip(bundle.view, bundle.part)):
        rows[n][:, bundle.unknowns.by_view[view]] = at.view[n]
        rows[n, :, size + 3 * point:size + 3 * point + 3] = at.eliminated[n]
    N = np.einsum('nij,nik->jk', rows, rows)
    dense = N[:size, :size] - N[:size, size:] @ np.linalg.solve(N[size:, size:], N[size:, :size])
    reduced = bundle.blocks.unreduced(at.shared, at.view, at.eliminated,
                                      at.residual).reduced().matrix
    assert np.abs(reduced - dense).max() < 1e-9 * np.abs(dense).max()


def _first_from(found, second):
    """Return poses (V, 3, 4) of the first camera from those of the second in its own world."""
    turned = found.rotation @ second[:, :, :3] @ found.turn.T
    centres = np.einsum('vji,vj->vi', second[:, :, :3], -second[:, :, 3])
    placed = found.scale * centres @ found.turn.T + found.shift
    placed -= np.einsum('vji,j->vi', turned, found.place)
    return np.concatenate([turned, -turned @ placed[:, :, None]], axis=2)


@pytest.mark.parametrize('in_plane', [False, True])
def test_paths_are_laid_over_each_other(in_plane):
    rng = np.random.default_rng(1)
    turns = 0.3 * rng.normal(size=(10, 3)) * ([0, 0, 1] if in_plane else 1)
    centres = np.cumsum(rng.normal(size=(10, 3)) * ([1, 1, 0] if in_plane else 1), axis=0)
    mount, R = rotation_matrix(np.array([[0.7, 0.2, 0.1], [0.3, 1.2, -0.5]]))
    place, scale = np.array([0.3, 0.2, -0.4]), 2.3
    turned = mount @ rotation_matrix(turns)
    first = np.concatenate([turned, -turned @ centres[:, :, None]], axis=2)
    world, shift = rotation_matrix(rng.normal(size=3)), rng.normal(size=3)
    turned = R.T @ turned
    moved = turned @ shift + (first[:, :, 3] - place) @ R
    second = np.concatenate([turned @ world, moved[:, :, None] / scale], axis=2)
    found = align(first, second)[0]
    assert np.allclose(found.rotation, R) and np.isclose(found.scale, scale)
    off = found.place - place
    # what lies along the one axis of all turns stays open
    along = mount[:, 2] if in_plane else np.zeros(3)
    assert np.allclose(off - along * (along @ off), 0)
    assert np.allclose(_first_from(found, second), first)


def _errors(result, scene):
    """Errors over sigmas of focal lengths and poses that are estimated."""
    pose = result.poses['right']
    T = scene.T_rig_camera['right'].copy()
    T[:3, 3] *= 1 if result.unit == 'm' else result.scale / scene.step_m
    place = pose.T_rig_camera[:3, 3] - T[:3, 3]
    turn = rotation_vector(pose.T_rig_camera[:3, :3] @ T[:3, :3].T)
    focal = [(result.cameras[name].camera.K[0, 0] - camera.K[0, 0])
             / result.cameras[name].sigma['fx'] for name, camera in scene.cameras.items()]
    return np.r_[focal, np.r_[place, turn] / list(pose.sigma.values())]


@pytest.mark.long
def test_a_baseline_without_a_sigma_is_told_to_be_exact():
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 8),
                      overlap=True, points=120)
    for sigma, told in ((0.0, True), (0.001, False)):
        result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS,
                               baseline=(scene.baseline_m, sigma))
        found = [one.sentence for one in result.findings if one.kind == 'rig_baseline_exact']
        assert bool(found) == told and all('exactly' in one for one in found)


def test_cameras_side_by_side_are_found_with_their_scale():
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 8),
                      overlap=True, points=120)
    result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS,
                           baseline=(scene.baseline_m, 0.0005))
    assert result.unit == 'm' and np.isclose(result.scale, scene.step_m, rtol=0.02)
    assert np.abs(_errors(result, scene)).max() < 3.5
    pose = result.poses['right']
    assert np.isclose(pose.baseline, scene.baseline_m) and pose.sigma['x'] < 0.001
    assert set(pose.status.values()) == {'estimated'} and pose.shared_points > 100
    for name, one in result.cameras.items():
        assert one.sigma['fx'] < result.alone[name].sigma['fx']
    assert result.parameter_names[0] == 'left.fx' and result.parameter_names[-1] == 'right.yaw'
    assert result.covariance.shape == (len(result.parameter_names),) * 2
    # a camera that refuses by itself is placed by what both see
    nothing = NotCalibrated.of(NoEstimate('no_parallax', parallax_ratio=1.0))
    again = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS,
                          alone={**result.alone, 'right': nothing})
    assert np.abs(_errors(again, scene)).max() < 3.5
    assert again.unit == 'path' and np.isclose(again.poses['right'].baseline * result.scale,
                                               scene.baseline_m, rtol=0.01)
    # without what both see it is not, and the reason is its own
    refused = calibrate_rig(scene.tracks, facts=FACTS, alone={**result.alone, 'right': nothing})
    assert not refused and refused.kind == 'rig_camera_refused' and 'rotated' in str(refused)


@pytest.mark.long
def test_lenses_beside_their_model_widen_the_sigmas_of_a_rig():
    rng = np.random.default_rng(3)
    scene = rig_scene(rng, hand_path(rng, 6), overlap=True, points=70)
    tracks = {}
    for name, one in scene.tracks.items():
        size = scene.cameras[name].width, scene.cameras[name].height
        modes = displacement_modes(one.xy, size)
        tracks[name] = replace(one, xy=one.xy + modes @ rng.normal(0, 0.3, modes.shape[2]))
    result = calibrate_rig(tracks, shared_tracks=True, facts=FACTS)
    assert 'lens_deviates' in [one.kind for one in result.findings]
    assert np.abs(_errors(result, scene)).max() < 3.5
    assert result.reprojection_rms_px / np.sqrt(2) < 0.8 * result.noise_sigma_px


@pytest.mark.long
def test_a_drive_without_overlap_leaves_the_height_open_and_says_so():
    scene = rig_scene(np.random.default_rng(5), driven_path(10), overlap=False, points=100)
    result = calibrate_rig(scene.tracks, facts=FACTS)
    pose = result.poses['right']
    assert result.unit == 'path' and result.motion == 'planar'
    # the camera looks down: up is a mixture of its y and z
    assert pose.status == {'x': 'estimated', 'y': 'unobservable', 'z': 'unobservable',
                           'roll': 'estimated', 'pitch': 'estimated', 'yaw': 'estimated'}
    assert np.isnan(pose.T_rig_camera[1:3, 3]).all() and np.isinf(pose.sigma['y'])
    errors = _errors(result, scene)
    assert np.abs(errors[np.isfinite(errors)]).max() < 3.5
    # but of y and z one mixture is known, that across the vertical
    place = scene.T_rig_camera['right'][:3, 3] * result.scale / scene.step_m
    assert len(pose.places) == 2
    for one in pose.places:
        assert abs(one.direction @ place - one.value) < 3.5 * one.sigma
    assert pose.remark.kind == 'rig_height_open' and 'ramp' in pose.remark.sentence
    assert pose.remark.sentence in result.notes


def test_a_rig_needs_two_cameras_and_a_length():
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 4),
                      overlap=True, points=20)
    with pytest.raises(ArgumentError, match='two or more'):
        calibrate_rig({'left': scene.tracks['left']})
    with pytest.raises(ArgumentError, match='length'):
        calibrate_rig(scene.tracks, baseline=(0.0, 0.1))
    with pytest.raises(ArgumentError, match='left and right have the same images'):
        calibrate_rig(dict.fromkeys(RIG_CAMERAS, scene.tracks['left']))
    nothing = NotCalibrated.of(NoEstimate('no_parallax', parallax_ratio=1.0))
    refused = calibrate_rig(scene.tracks, facts=FACTS, alone=dict.fromkeys(RIG_CAMERAS, nothing))
    assert not refused and refused.kind == 'rig_cameras_refused' and 'left' in str(refused)


@pytest.mark.long
def test_too_few_common_instants_are_refused_whatever_points_are_shared():
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 8),
                      overlap=True, points=60)
    left = scene.tracks['left'].in_frames(range(5))
    right = scene.tracks['right'].in_frames(range(4, 8))
    refused = calibrate_rig({'left': left, 'right': right}, shared_tracks=True, facts=FACTS)
    assert not refused and refused.kind == 'rig_not_simultaneous'
    alone = {'left': calibrate(scene.tracks['left'], facts=FACTS)}
    with pytest.raises(ArgumentError, match='left alone is of images that its tracks lack'):
        calibrate_rig({'left': left, 'right': scene.tracks['right']}, facts=FACTS, alone=alone)


@pytest.mark.long
def test_each_camera_of_a_rig_tells_its_own_outliers():
    scene = rig_scene(np.random.default_rng(3), hand_path(np.random.default_rng(3), 8),
                      overlap=True, points=80)
    left = scene.tracks['left']
    xy = left.xy.copy()
    xy[::40] += [25.0, -18.0]
    result = calibrate_rig({**scene.tracks, 'left': replace(left, xy=xy)}, shared_tracks=True,
                           facts=FACTS)
    wrong = len(xy[::40])
    assert wrong <= result.cameras['left'].outlier_count < wrong + 6
    assert result.cameras['right'].outlier_count < 4


@pytest.mark.long
def test_the_sigmas_of_a_rig_hold_decentring_that_no_fisheye_model_has():
    rng = np.random.default_rng(1)
    cameras = {name: Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (0.02, -0.01, 0.002, 0.0), 640,
                            480, 'equidistant')
               for name, f, cx, cy in (('left', 260.0, 322, 236), ('right', 255.0, 315, 243))}
    scene = rig_scene(rng, hand_path(rng, 12), True, cameras, points=300)
    tracks = {}
    for name, one in scene.tracks.items():
        p1, p2 = 1e-3 * rng.normal(size=2)
        K = cameras[name].K
        x, y = ((one.xy - K[:2, 2]) / K[0, 0]).T
        tracks[name] = replace(one, xy=one.xy + K[0, 0] * np.column_stack(
            tangential(p1, p2, x, y, x * x + y * y)))
    result = calibrate_rig(tracks, shared_tracks=True, facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='equidistant'))
    for name, found in result.cameras.items():
        off = (found.camera.parameters - cameras[name].parameters)[[0, 2, 3]]
        assert np.abs(off / [found.sigma[one] for one in ('fx', 'cx', 'cy')]).max() < 3
    assert 'fisheye_decentred' in [one.kind for one in result.findings]


@pytest.mark.long
def test_a_plane_leaves_the_height_of_a_camera_open_that_shares_no_points():
    rng = np.random.default_rng(2)
    scene = rig_scene(rng, driven_path(16), False, points=200)
    result = calibrate_rig(scene.tracks, facts=FACTS)
    pose, T = result.poses['right'], scene.T_rig_camera['right']
    # the camera looks down by 20 degrees
    height = np.array([0, np.cos(np.radians(20)), np.sin(np.radians(20))])
    assert pose.status['y'] == pose.status['z'] == 'unobservable' and np.isnan(
        pose.T_rig_camera[1:3, 3]).all()
    assert len(pose.places) == 2
    for one in pose.places:
        assert abs(one.direction @ height) < 0.05
        assert abs(one.direction @ T[:3, 3] / scene.step_m - one.value) < 3.5 * one.sigma


@pytest.mark.long
def test_an_instant_that_few_points_tie_does_not_stretch_the_path():
    rng = np.random.default_rng(5)
    scene = rig_scene(rng, hand_path(rng, 10), True, points=200)
    alone = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS).alone
    tracks = {}
    for name, one in scene.tracks.items():
        rows = np.flatnonzero(one.frame == 4)
        wrong, xy = rows[2:15], one.xy.copy()
        xy[wrong] = rng.uniform([0, 0], [640, 480], (len(wrong), 2))
        keep = ~np.isin(np.arange(len(one.frame)), rows[15:])
        tracks[name] = replace(one, frame=one.frame[keep], track=one.track[keep], xy=xy[keep])
    result = calibrate_rig(tracks, shared_tracks=True, facts=FACTS, alone=alone,
                           baseline=(scene.baseline_m, 0.0005))
    assert 4 not in result.frames and len(result.frames) == 9
    assert np.abs(_errors(result, scene)).max() < 3.5


@pytest.mark.long
def test_points_place_a_fisheye_by_its_own_lens():
    rng = np.random.default_rng(1)
    cameras = {name: Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (0.02, -0.01, 0.002, 0.0), 640,
                            480, 'equidistant')
               for name, f, cx, cy in (('left', 260.0, 322, 236), ('right', 255.0, 315, 243))}
    scene = rig_scene(rng, hand_path(rng, 10), True, cameras, points=200)
    left = calibrate(scene.tracks['left'], facts=replace(FACTS, distortion='equidistant'))
    T, path = scene.T_rig_camera['right'], left.reconstructed.cam_from_world
    centres = np.einsum('vji,vj->vi', path[:, :, :3], -path[:, :, 3])
    metres = scene.step_m / np.sqrt(np.mean(np.sum(np.diff(centres, axis=0)**2, axis=1)))
    # the other's lens is 7 px beside it each way, which counts as a turn, and 2 % longer
    for lens, turn, metre in ((cameras['right'], 0.005, 0.02), (None, 0.06, 0.15)):
        place = place_by_points(left, scene.tracks['right'], lens)[0]
        assert np.linalg.norm(rotation_vector(place.pose[:, :3] @ T[:3, :3].T)) < turn
        assert np.abs(metres * place.pose[:, 3] - T[:3, 3]).max() < metre


def rig_optimum(shared, views):
    """Return what `judge` takes: the optimum of a rig, from the truth."""
    rng = np.random.default_rng(0)
    scene = rig_scene(rng, hand_path(rng, views), shared, points=150)
    names = list(scene.tracks)
    found = observations_of(scene.tracks, dict.fromkeys(names), np.arange(views), shared)
    rig = Rig.of_cameras(names, [Lens.of(scene.cameras[name]) for name in names],
                         np.stack([scene.T_rig_camera[name][:3] for name in names]))
    path = AxisPath.of_poses(np.eye(3), scene.rig_from_world)
    state = rescaled(with_all_points(RigState(rig, path, np.zeros((0, 4))), found.observations))
    bundle = bundle_of(found.observations, GENERAL, RigPriors.of_cameras(
        {name: priors_from_facts(FACTS) for name in names}), 0.3)
    state = bundle.optimise(bundle.refine_points(state))
    bundle = bundle.with_sigma(bundle.noise_rms(state))
    sizes = {name: (one.width, one.height) for name, one in scene.cameras.items()}
    return RigOptimum(RobustFit(bundle, state, found.observations, 0), found,
                      dict.fromkeys(names, FACTS), sizes, 'general', bundle.sigma_px, shared)


@pytest.mark.parametrize('shared, views', [(True, 8), (False, 12)])
def test_sigmas_of_places_in_steps_do_not_depend_on_what_the_adjustment_holds(
        shared, views, monkeypatch):
    optimum, usual = rig_optimum(shared, views), scene_model.scale_gauge

    def by_first_half(path, unknowns):
        direction = usual(path, unknowns).copy()
        direction[unknowns.of_views('x', 'y', 'height')[len(path) // 2:]] = 0
        return direction / np.linalg.norm(direction)

    def place_sigmas():
        pose = judge(replace(optimum, fit=replace(optimum.fit)), {}, None).poses['right']
        return np.sqrt(np.diag(pose.covariance)[:3])

    held = place_sigmas()
    monkeypatch.setattr(scene_model, 'scale_gauge', by_first_half)
    np.testing.assert_allclose(place_sigmas(), held, rtol=5e-3)
