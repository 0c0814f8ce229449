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
"""Rigs that are not rigid all the time: a late camera, a knocked one, and neither."""

from dataclasses import fields, replace
from time import perf_counter

import numpy as np
import pytest
from selfcal_ros import calibrate_rig, CameraFacts
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.rig import Rig
from selfcal_ros.calibration.bundle.rig_model import RigState
from selfcal_ros.calibration.rigs.start import observations_of, seen_ahead, with_all_points
from selfcal_ros.calibration.rigs.steadiness import every_knock
from selfcal_ros.calibration.uncertainty.suppositions import JointInformation
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.paths import drive_path
from selfcal_ros.synthetic.rig_scenes import (driven_path, hand_path, knocked_path, late_path,
                                              rig_scene)
from selfcal_ros.synthetic.scenes import pitched_mount, planar_poses

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
#: Of what tells that a rig was not rigid, beside a result or instead of one.
TOLD = {'rig_clocks_differ', 'rig_pose_changed', 'rig_clocks_apart', 'rig_knocked'}


def _told(result):
    return [one for one in result.findings if one.kind in TOLD]


def _off(result, scene, T):
    """Errors of the second camera's pose over their sigmas; T (4, 4) is the truth in metres."""
    pose = result.poses['right']
    place = pose.T_rig_camera[:3, 3] - T[:3, 3] * result.scale / scene.step_m
    turn = rotation_vector(pose.T_rig_camera[:3, :3] @ T[:3, :3].T)
    return np.abs(np.r_[place, turn] / list(pose.sigma.values()))


@pytest.mark.long
@pytest.mark.parametrize('share', [0.01, -0.01])
def test_a_late_camera_is_told_with_its_time_and_is_in_the_sigmas(share):
    rng = np.random.default_rng(0)
    path = hand_path(rng, 14)
    scene = rig_scene(rng, path, False, points=200, of_second=late_path(path, share))
    result = calibrate_rig(scene.tracks, facts=FACTS)
    told, = _told(result)
    assert told.kind == 'rig_clocks_differ' and told.values['camera'] == 'right'
    assert np.isclose(told.values['apart']['share'], share, rtol=0.2)
    assert ('later' if share > 0 else 'earlier') in told.sentence and ' % ' in told.sentence
    assert _off(result, scene, scene.T_rig_camera['right']).max() < 3.5
    if share > 0:
        # stamps are better than counting, and milliseconds than shares
        stamps = {k: 250_000_000 * k for k in range(len(path))}
        timed = {name: replace(one, stamps_ns=stamps) for name, one in scene.tracks.items()}
        again, = _told(calibrate_rig(timed, facts=FACTS, alone=result.alone))
        late_ms = float(again.sentence.split(' ms ')[0].split()[-1])
        assert np.isclose(late_ms, 1e3 * 0.25 * share, rtol=0.2)


@pytest.mark.long
@pytest.mark.parametrize('seed, share', [(3, 0.03), (4, 0.22)])
def test_a_late_camera_on_an_s_is_not_called_knocked(seed, share):
    """Left at one rate and right at another, lateness is one pose before the bend, one after."""
    rng = np.random.default_rng(seed)
    places, heading = drive_path(22)
    path = planar_poses(pitched_mount(np.radians(20.0)), heading, places)
    scene = rig_scene(rng, path, True, points=300, of_second=late_path(path, share),
                      noise_px=0.05)
    result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS)
    kinds = {one.kind for one in _told(result)} if result else {result.kind}
    assert kinds and not kinds & {'rig_knocked', 'rig_pose_changed'}


@pytest.mark.long
def test_a_refusal_names_the_late_camera():
    rng = np.random.default_rng(0)
    path = hand_path(rng, 14)
    scene = rig_scene(rng, path, True, points=200, of_second=late_path(path, 0.03))
    result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS)
    assert not result and result.kind == 'rig_clocks_apart' and 'right' in str(result)


@pytest.mark.long
@pytest.mark.parametrize('overlap', [True, False])
def test_a_knock_is_told_with_its_frame_and_both_poses_are_in_the_sigmas(overlap):
    rng = np.random.default_rng(0)
    path, turn = driven_path(24), np.radians([0.2, 0.3, -0.2])
    scene = rig_scene(rng, path, overlap, points=200, of_second=knocked_path(path, turn, 12))
    result = calibrate_rig(scene.tracks, shared_tracks=overlap, facts=FACTS)
    told, = _told(result)
    assert told.kind == 'rig_pose_changed' and told.values['frame'] == 12
    before = scene.T_rig_camera['right']
    knock = np.eye(4)
    knock[:3, :3] = rotation_matrix(turn)
    # the scene turns before the rig as the camera turns against it
    for T in (before, np.linalg.inv(knock) @ before):
        off = _off(result, scene, T)
        assert off[np.isfinite(off)].max() < 3.5


@pytest.mark.long
def test_a_knock_of_less_than_a_tenth_of_a_pixel_is_in_the_sigmas_alone():
    rng = np.random.default_rng(0)
    path = driven_path(24)
    scene = rig_scene(rng, path, True, points=300, noise_px=0.02,
                      of_second=knocked_path(path, np.array([0.0, 8e-5, 0.0]), 12))
    result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS)
    assert result and not _told(result)


@pytest.mark.long
def test_a_refusal_names_the_knocked_camera_and_the_frame():
    rng = np.random.default_rng(0)
    path = driven_path(24)
    scene = rig_scene(rng, path, True, points=200,
                      of_second=knocked_path(path, np.radians([1.2, 1.0, -1.2]), 12))
    result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS)
    assert not result and result.kind == 'rig_knocked' and 'before frame 12' in str(result)


@pytest.mark.long
@pytest.mark.parametrize('overlap', [True, False])
def test_a_rigid_rig_is_not_suspected(overlap):
    rng = np.random.default_rng(4)
    scene = rig_scene(rng, hand_path(rng, 14), overlap, points=200)
    result = calibrate_rig(scene.tracks, shared_tracks=overlap, facts=FACTS)
    assert not _told(result)
    assert _off(result, scene, scene.T_rig_camera['right']).max() < 3.5


@pytest.mark.long
def test_a_rig_is_not_given_inside_out():
    scene = rig_scene(np.random.default_rng(9), driven_path(24), True, points=300)
    result = calibrate_rig(scene.tracks, shared_tracks=True, facts=FACTS)
    assert _off(result, scene, scene.T_rig_camera['right']).max() < 3.5


@pytest.mark.parametrize('overlap', [True, False])
def test_the_mirror_image_of_a_rig_is_turned_back(overlap):
    scene = rig_scene(np.random.default_rng(1), driven_path(12), overlap, points=60)
    frames = np.arange(12)
    found = observations_of(scene.tracks, dict.fromkeys(scene.tracks), frames, overlap)
    rig = Rig.of_cameras(found.cameras, [Lens.of(one) for one in scene.cameras.values()],
                         np.stack([T[:3] for T in scene.T_rig_camera.values()]))
    truth = with_all_points(RigState(rig, AxisPath.of_poses(
        scene.rig_from_world[0, :, :3], scene.rig_from_world)), found.observations)
    assert seen_ahead(truth, found.observations) is truth
    back = seen_ahead(truth.scaled(-1.0), found.observations)
    assert np.allclose(back.path.cam_from_world(), truth.path.cam_from_world())
    assert np.allclose(back.lens.values, truth.lens.values)


def joint_of(rng, views, cameras=2):
    """Make up what images say of cameras that move at every instant."""
    size = 6 * cameras * views
    root = rng.standard_normal((size, size + 20))
    places = rng.permutation(size).reshape(views, 6 * cameras)
    return JointInformation((), rng.standard_normal(size), root @ root.T / size,
                            rng.uniform(2, 3, size), rng.standard_normal((7, size)),
                            {'knocks': places}, 1.3, 0.8)


def knocks_one_by_one(joint, places):
    for view in range(1, len(places)):
        basis = np.zeros((len(joint.score), 6))
        basis[places[view:], np.arange(6)] = 1
        yield joint.test_along(basis, 'no knock', ('x', 'y', 'z', 'roll', 'pitch', 'yaw'))


def test_knocks_at_all_instants_are_tested_in_one_pass():
    joint = joint_of(np.random.default_rng(3), 9)
    for places in np.split(joint.places['knocks'], 2, axis=1):
        one_by_one = list(knocks_one_by_one(joint, places))
        together = every_knock(joint, places)
        assert len(together) == len(one_by_one) == 8
        for one, other in zip(together, one_by_one):
            for field in fields(one):
                if field.name not in ('name', 'unknowns'):
                    np.testing.assert_allclose(getattr(one, field.name),
                                               getattr(other, field.name), rtol=1e-9)
    # the work grows with the square of the instants, and not with the cube
    joint = joint_of(np.random.default_rng(4), 150, 1)
    places, took = joint.places['knocks'], []
    for way in (knocks_one_by_one, every_knock):
        begin = perf_counter()
        list(way(joint, places))
        took.append(perf_counter() - begin)
    assert took[1] < 0.5 * took[0]
