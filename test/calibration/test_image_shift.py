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
"""Images that a stabiliser shifts, each by itself."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.bundle.image_shift import SHIFT_NAMES, shifts
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.zoom_selection import undisturbed
from selfcal_ros.synthetic.rolling_scenes import drive, hand, record
from selfcal_ros.synthetic.scenes import sequence_si

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
VIEWS, STEP_S = 20, 0.5


def turn(rng):
    """Turn a camera about its centre."""
    return hand(rng, shift_m=0.0)


def shifted(kind, seed, sigma_px, readout_s=0.0, **world):
    """Views of a camera, each shifted by itself; the tracks, the camera and the shifts."""
    rng = np.random.default_rng([seed, 31])
    sequence = record(rng, kind(rng), readout_s, STEP_S * np.arange(VIEWS), **world)
    moved = rng.normal(0, sigma_px, (VIEWS, 2))
    tracks = sequence.tracks
    return replace(tracks, xy=tracks.xy + moved[tracks.frame]), sequence.camera, moved


def kinds(result):
    return [finding.kind for finding in result.findings]


def assert_true(result, camera, most_focal):
    """The camera is within four sigmas, and the focal length within this share."""
    places = {'fx': (0, 0), 'cx': (0, 2), 'cy': (1, 2)}
    away = {name: result.camera.K[place] - camera.K[place] for name, place in places.items()}
    assert all(abs(off) < 4 * result.sigma[name] for name, off in away.items()), away
    assert abs(away['fx']) < most_focal * camera.K[0, 0]


@pytest.mark.long
@pytest.mark.parametrize('kind, sigma_px', [
    (hand, 1.5), (turn, 1.5), (drive, 15.0), (turn, 15.0)])
def test_the_camera_of_shifted_images_is_found_and_the_shifts_are_told(kind, sigma_px):
    # before, they were refused for a lens that no model has, or 36 sigmas off
    tracks, camera, moved = shifted(kind, 3, sigma_px)
    result = calibrate(tracks, facts=SQUARE)
    told = next(one for one in result.findings if one.kind == 'images_shifted')

    assert_true(result, camera, 0.0015)
    assert result.noise_sigma_px < 0.22
    assert told.values['shift_px'] == pytest.approx(np.sqrt(2) * sigma_px, rel=0.4)
    # one more image would be off by as much
    assert 0.6 * sigma_px < result.sigma['cx'] < 2 * sigma_px
    # no motion makes that smaller
    assert 'motion_suggestion' not in kinds(result)


@pytest.mark.long
def test_a_fisheye_may_be_stabilised():
    fisheye = Camera([[300, 0, 325], [0, 300, 242], [0, 0, 1]], [-0.02, 0.003, 0, 0], 640, 480,
                     model='equidistant')
    tracks, camera, _ = shifted(hand, 5, 3.0, camera=fisheye)
    result = calibrate(tracks, facts=SQUARE)

    assert_true(result, camera, 0.001)
    assert 'images_shifted' in kinds(result) and result.camera.model == 'equidistant'


@pytest.mark.long
def test_rows_may_be_read_in_turn_of_shifted_images():
    tracks, camera, _ = shifted(drive, 1, 3.0, readout_s=0.02)
    result = calibrate(tracks, facts=SQUARE)

    assert_true(result, camera, 0.002)
    assert {'images_shifted', 'rolling_shutter'} < set(kinds(result))


@pytest.mark.long
@pytest.mark.parametrize('kind, readout_s', [(hand, 0.0), (drive, 0.02), (turn, 0.02)])
def test_images_that_stand_still_are_not_shifted(kind, readout_s):
    tracks, camera, _ = shifted(kind, 2, 0.0, readout_s=readout_s, points=150)
    result = calibrate(tracks, facts=SQUARE)

    assert_true(result, camera, 0.0015)
    assert 'images_shifted' not in kinds(result)
    assert result.sigma['cx'] < 2


def test_three_images_that_are_torn_are_no_stabilisers():
    tracks, camera, _ = shifted(hand, 4, 0.0)
    below = np.isin(tracks.frame, [4, 9, 15]) & (tracks.xy[:, 1] > 200)
    result = calibrate(replace(tracks, xy=tracks.xy + np.where(below[:, None], [37.0, 0.0], 0)),
                       facts=SQUARE)

    assert_true(result, camera, 0.01)
    assert 'images_shifted' not in kinds(result)


def test_points_and_shifts_of_a_state_explain_what_is_seen():
    scene = sequence_si(np.random.default_rng(6), noise_px=0.0)
    observed = Observations.of(scene.tracks, scene.tracks.frames)
    moved = np.random.default_rng(7).normal(0, 4, (len(scene.tracks.frames), 2))
    seen = replace(observed, xy=observed.xy + moved[observed.view])
    still = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, distortion='none'))
    bundle = bundle_of(seen, replace(GENERAL, shift=shifts(4.0)),
                       priors_from_facts(CameraFacts(distortion='none')), 1.0)
    state = with_all_points(_state_of(still, moved), seen)

    # the same as of images that stand still
    assert np.abs(bundle.residuals(state)).max() < 1e-4
    unknowns = bundle.unknowns
    assert unknowns.view_names[-2:] == SHIFT_NAMES
    # and a step in a shift moves what its view sees by as much
    step = np.zeros(len(unknowns))
    step[unknowns.of_views('shift_u')[1]] = 0.5
    later = bundle.model.moved(state, step, np.zeros((len(state.points), 3)), unknowns)
    change = bundle.residuals(later) - bundle.residuals(state)
    np.testing.assert_allclose(change, np.where(seen.view[:, None] == 1, [0.5, 0], 0), atol=1e-9)


def _state_of(result, moved):
    return SceneState(Lens.of(result.camera),
                      AxisPath.of_poses(np.eye(3), result.reconstruction.cam_from_world),
                      shift=moved)


def zooming(kind, seed, sigma_px, growth, **world):
    """Views of a lens that zooms, each shifted by itself: tracks, and the camera in the middle."""
    tracks, camera, moved = shifted(kind, seed, sigma_px, **world)
    centre, scale = camera.K[:2, 2], 1 + growth * np.linspace(-0.5, 0.5, VIEWS)
    shift = moved[tracks.frame]
    still = tracks.xy - shift
    zoomed = centre + (still - centre) * scale[tracks.frame, None]
    return replace(tracks, xy=zoomed + shift), camera


@pytest.mark.long
def test_the_lens_of_shifted_images_may_zoom():
    # they were taken for rows read in turn, with a sigma four times as large
    tracks, camera = zooming(drive, 1, 2.0, 0.04, points=150)
    result = calibrate(tracks, facts=SQUARE)

    assert_true(result, camera, 0.006)
    assert result.sigma['fx'] < 0.001 * camera.K[0, 0]
    assert {'images_shifted', 'focal_drifts'} <= set(kinds(result))
    assert result.focal.fx[-1] / result.focal.fx[0] == pytest.approx(1.02 / 0.98, rel=0.005)


def test_a_fit_without_shifts_and_rows_begins_without_them():
    # they were held where another fit had them, as if they were known: 12 sigmas over the image
    camera = sequence_si(np.random.default_rng(0)).camera
    path = AxisPath.at_origin(np.eye(3), np.zeros(2))
    state = SceneState(Lens.of(camera), path, line_delay=0.1, row_motion=np.ones((2, 6)),
                       shift=np.ones((2, 2)))
    bare = undisturbed(state)
    assert (bare.line_delay, bare.row_motion, bare.shift) == (0.0, None, None)
