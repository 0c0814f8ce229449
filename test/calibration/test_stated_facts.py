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
"""What is supposed of the camera, against images that know better."""

from dataclasses import replace

import numpy as np
import pytest

from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.synthetic.few_view_scenes import general_views

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')
TOLD = ('fact_contradicted', 'fact_doubtful', 'fact_trusted')


def tracks_of(seed: int, aspect: float = 1.0, skew: float = 0.0, views: int = 6):
    """Show a cloud of points to a hand-held camera that may not be what is stated of it."""
    camera = Camera([[520, skew, 328], [0, 520 * aspect, 235], [0, 0, 1]], [-0.12, 0.05], 640, 480)
    return general_views(np.random.default_rng(seed), camera, views=views, points=60,
                         noise_px=0.2).tracks


def ask(tracks, **stated):
    """Calibrate hand-held tracks under facts."""
    return calibrate(tracks, motion='general', facts=replace(SQUARE, **stated))


def kinds(result) -> list:
    """List what was found of facts."""
    found = [one.kind for one in result.findings if one.kind in TOLD]
    return found if result else [result.kind, *found]


@pytest.mark.parametrize('wrong, fact, value', [
    ({'aspect': 1.03}, 'aspect ratio', 1.03), ({'skew': 3.0}, 'skew', 3.0)])
def test_a_wrong_fact_is_named_with_what_the_images_prefer(wrong, fact, value):
    result = ask(tracks_of(1, **wrong))

    assert not result and result.kind == 'fact_contradicted' and result.values['fact'] == fact
    preferred, = result.values['preferred']
    assert abs(preferred['value'] - value) < 4 * preferred['sigma'] < 0.3 * abs(value)
    assert f'stated {fact}' in result.reason


def test_principal_point_and_lens_are_facts_as_any_other():
    tracks = tracks_of(2)

    assert ask(tracks, principal_point=(319.5, 239.5)).values['fact'] == 'principal point'
    assert kinds(ask(tracks, principal_point=(328, 235))) == []
    assert ask(tracks, distortion='none').values['fact'] == 'lens model'


def test_true_facts_are_let_pass():
    assert [kinds(ask(tracks_of(seed))) for seed in range(3, 5)] == [[]] * 2


def test_declared_exact_it_is_kept_and_told():
    result = ask(tracks_of(1, aspect=1.03), trusted=True)

    assert result and 'fact_trusted' in kinds(result)
    assert np.isclose(result.camera.K[1, 1], result.camera.K[0, 0])


@pytest.mark.parametrize('sigma, found', [(0.003, ['fact_contradicted']), (0.03, [])])
def test_a_fact_with_a_sigma_is_held_against_it(sigma, found):
    result = ask(tracks_of(4, aspect=1.03), aspect_ratio_sigma=sigma)

    assert kinds(result) in (found, ['fact_doubtful'] if found else [])
    assert not result or abs(result.camera.K[1, 1] / 520 / 1.03 - 1) < 4 * result.sigma['fy'] / 520


def test_images_of_two_cameras_are_parted_and_one_of_them_is_calibrated():
    tracks = tracks_of(5, views=12)
    second = tracks.frame % 3 == 1
    xy = np.where(second[:, None], (tracks.xy - [328, 235]) * 1.06 + [334, 232], tracks.xy)
    result = ask(Tracks(tracks.frame, tracks.track, xy, tracks.image_size))

    assert result and result.findings[0].kind == 'other_camera_left_out'
    assert result.findings[0].values['left_out'] == [1, 4, 7, 10]
    assert abs(result.camera.K[0, 0] - 520) < 4 * result.sigma['fx']


def test_mirrored_images_are_named_before_anything_is_estimated():
    tracks = tracks_of(6, views=8)
    xy = tracks.xy.copy()
    flipped = np.isin(tracks.frame, (2, 3, 6))
    xy[flipped, 0] = tracks.image_size[0] - 1 - xy[flipped, 0]
    result = ask(Tracks(tracks.frame, tracks.track, xy, tracks.image_size))

    assert not result and result.kind == 'images_mirrored'
    assert result.values['mirrored'] == (2, 3, 6)
