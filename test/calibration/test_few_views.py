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
"""Four general views, and equal objects in one image: truth within sigma, or a refusal."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.estimators import motion_calibration
from selfcal_ros.calibration.estimators.few_views import spread_views
from selfcal_ros.calibration.initialisation import multi_start
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.few_view_scenes import cut_camera, equal_objects, general_views

NO_FACT = CameraFacts(distortion='none')
SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
OUTSIDE = cut_camera(900.0, 1.0, (580.0, -390.0))
OBJECT_CAMERA = cut_camera(1100.0, 1.0, (20.0, -10.0), (1280, 960))
TURNED = ((0, 0, 0), (10, -40, 5), (25, 35, 10), (-30, 20, 5))
PARALLEL = ((0, 0, 0), (0, 0, 0), (25, 35, 10))


def assert_near(result, camera, sigmas=4.0):
    assert result, result
    error = result.camera.parameters[:4] - camera.parameters[:4]
    sigma = np.sqrt(np.diag(result.covariance))[:4]
    assert np.abs(error / sigma).max() < sigmas
    assert sigma[0] < 0.05 * camera.K[0, 0]


@pytest.mark.parametrize('camera', [cut_camera(), cut_camera(600.0, 1.5), OUTSIDE],
                         ids=['usual', 'aspect', 'outside'])
def test_four_general_views_suffice_without_a_fact_of_the_pixels(camera):
    tracks = general_views(np.random.default_rng(1), camera).tracks
    result = calibrate(tracks, motion='general', facts=NO_FACT, views=4)
    assert_near(result, camera)
    assert len(result.frames) == 4


def test_the_modulus_constraint_finds_a_principal_point_that_the_sweep_does_not():
    tracks = general_views(np.random.default_rng(7), OUTSIDE).tracks
    # half of the tracks may find it, too
    with mock.patch.object(multi_start, 'MODULUS_MAX_VIEWS', 0), \
            mock.patch.object(motion_calibration, 'calibrate_coherent_tracks', return_value=None):
        # a focal length that is asked whether it varies is searched for once more
        assert not calibrate(tracks, motion='general', facts=replace(NO_FACT, focal='constant'))
    assert_near(calibrate(tracks, motion='general', facts=NO_FACT), OUTSIDE)


def test_views_are_chosen_that_differ_and_share_points():
    camera = cut_camera()
    # two views of each place: the second of a place adds nothing
    turns = np.repeat(rotation_matrix(np.radians(
        [[0, 0, 0], [0, 18, 0], [16, 0, 0], [0, 0, 20]])), 2, axis=0)
    tracks = general_views(np.random.default_rng(4), camera, 8, turns=turns).tracks
    chosen = spread_views(tracks, 4)
    assert len(chosen.frames) == 4 and len(set(chosen.frames // 2)) >= 3
    assert spread_views(tracks, 20) is tracks
    assert_near(calibrate(tracks, motion='general', facts=SQUARE, views=4), camera)


@pytest.mark.parametrize('options', [
    {'turns': rotation_matrix(np.radians([[0, 0, 0], [0, 15, 0], [0, -12, 0], [0, 25, 0]]))},
    {'turns': np.array([np.eye(3)] * 4)}, {'views': 2}, {'points': 8}],
    ids=['one axis', 'no rotation', 'two views', 'eight points'])
def test_four_views_that_do_not_suffice_are_refused(options):
    tracks = general_views(np.random.default_rng(0), cut_camera(), **options).tracks
    result = calibrate(tracks, motion='general', facts=NO_FACT, views=4)
    assert not result and result.reason


def test_a_number_of_views_does_not_hide_why_a_recording_is_refused():
    tracks = general_views(np.random.default_rng(0), cut_camera(), points=5).tracks
    with_views, without = (calibrate(tracks, motion='general', facts=SQUARE, views=views)
                           for views in (4, None))
    assert not without and with_views.kind == without.kind


@pytest.mark.parametrize('motion, views', [('general', 3), ('planar', 4), ('auto', 6)])
def test_a_number_of_views_that_does_not_suit_is_refused(motion, views):
    tracks = general_views(np.random.default_rng(0), cut_camera()).tracks
    with pytest.raises(ArgumentError, match='number of views'):
        calibrate(tracks, motion=motion, views=views)


@pytest.mark.parametrize('turns', [PARALLEL, TURNED, (*TURNED, (40, -10, 20), (-15, -25, -60)),
                                   ((0, 0, 0), (0, 70, 0), (0, 150, 0), (0, -60, 0))],
                         ids=['two parallel', 'turned', 'six', 'on a table'])
def test_equal_objects_in_one_image_calibrate_its_camera(turns):
    tracks = equal_objects(np.random.default_rng(2), OBJECT_CAMERA, turns)
    result = calibrate(tracks, motion='repeated', facts=SQUARE)
    assert_near(result, OBJECT_CAMERA)
    assert result.findings[0].kind == 'objects_as_views'


def test_objects_stated_to_stand_parallel_make_it_more_certain():
    tracks = equal_objects(np.random.default_rng(2), OBJECT_CAMERA, PARALLEL)
    found = calibrate(tracks, motion='repeated', facts=SQUARE)
    stated = calibrate(tracks, motion='repeated', facts=SQUARE, parallel_objects=(0, 1))
    assert_near(stated, OBJECT_CAMERA)
    assert stated.sigma['fx'] < 0.5 * found.sigma['fx']
    wrong = calibrate(tracks, motion='repeated', facts=SQUARE, parallel_objects=(0, 2))
    assert wrong.kind == 'objects_insufficient' and wrong.values['why'].kind == 'frames_turned'
    # as it was called before
    before = calibrate(tracks, motion='repeated', facts=SQUARE, translation_frames=(0, 1))
    assert np.array_equal(before.covariance, stated.covariance)


@pytest.mark.parametrize('how', [{'motion': 'translation'}, {'motion': 'auto'},
                                 {'motion': 'repeated', 'translation_frames': (0, 1)}])
def test_parallel_objects_are_for_objects_and_stated_once(how):
    tracks = equal_objects(np.random.default_rng(2), OBJECT_CAMERA, PARALLEL)
    with pytest.raises(ArgumentError, match='Parallel objects'):
        calibrate(tracks, parallel_objects=(0, 1), **how)


@pytest.mark.long
@pytest.mark.parametrize('options', [
    {'turns_deg': np.zeros((4, 3))}, {'turns_deg': TURNED[:2]},
    {'turns_deg': TURNED, 'farness': 80.0}, {'turns_deg': TURNED, 'points': 9}],
    ids=['all parallel', 'two', 'far', 'few points'])
def test_objects_that_do_not_suffice_are_refused(options):
    tracks = equal_objects(np.random.default_rng(0), OBJECT_CAMERA, **options)
    result = calibrate(tracks, motion='repeated', facts=SQUARE)
    assert result.kind == 'objects_insufficient' and 'every object' in result.reason
