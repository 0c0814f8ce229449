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
"""result.json against its contract, for both outcomes."""

import json
from pathlib import Path

import numpy as np
import pytest
from selfcal_ros.calibration.reconstruction import Measured, Reconstruction, StructureSample
from selfcal_ros.calibration.result import (Calibration, FixedPoints, FocalCourse, HINT,
                                            Identifiability, NotCalibrated)
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.report.result_json import (result_from_dict, result_to_dict, SCHEMA,
                                            write_result_json)
from selfcal_ros.values.track_labels import STILL_IN_IMAGE, TrackLabels

DOCS = Path(__file__).resolve().parents[2] / 'docs'
CONTRACT = {'status', 'reason', 'motion', 'camera', 'sigma', 'covariance', 'parameters', 'frames',
            'reprojection_rms_px', 'facts', 'software'}


def calibration(**changed):
    """Return a calibration whose numbers are of NumPy's types."""
    covariance = np.diag(np.arange(1., len(PARAMETER_NAMES) + 1) ** 2)
    covariance[0, 2] = covariance[2, 0] = 0.5
    fields = {
        'camera': Camera([[520, 0.1, 319], [0, 519, 239], [0, 0, 1]], [-0.1, 0.05, 0, 0, 0],
                         640, 480),
        'covariance': covariance,
        'status': dict.fromkeys(PARAMETER_NAMES, 'estimated') | {'p1': 'held'},
        'held_by': {'p1': 'distortion=radial2'}, 'motion': 'planar',
        'facts': CameraFacts(aspect_ratio=1.0, principal_point=(320, 240)),
        'frames': tuple(np.arange(5)), 'reprojection_rms_px': np.float32(0.25),
        'noise_sigma_px': np.float64(0.2), 'observation_count': np.int64(1000),
        'outlier_count': 7, 'findings': (Finding('note', text='a note'),),
        'software': 'selfcal_ros 0.1.0',
        'reconstruction': Reconstruction(np.arange(5), np.zeros((5, 3, 4)), np.arange(2),
                                         np.zeros((2, 4))),
        'fixed_points': FixedPoints(np.array([0, 1., 2]), np.array([1., 0, 3]),
                                    np.array([1 + 2j, 3, -1j]))}
    return Calibration(**{**fields, **changed})


def strict(path):
    """Load JSON that must not hold NaN or infinities."""
    def refuse(name):
        raise AssertionError(name)
    return json.loads(path.read_text(), parse_constant=refuse)


def test_calibrated(tmp_path):
    result = calibration()
    path = write_result_json(tmp_path / 'result.json', result)
    document = strict(path)
    assert document == result_to_dict(result)
    assert CONTRACT <= document.keys() and document['status'] == 'calibrated'
    assert document['camera'] == {
        'width': 640, 'height': 480, 'fx': 520.0, 'fy': 519.0, 'cx': 319.0, 'cy': 239.0,
        'skew': 0.1, 'distortion_model': 'plumb_bob', 'd': [-0.1, 0.05, 0, 0, 0]}
    assert document['lens'] == {'model': 'plumb_bob', 'coefficients': {
        'k1': -0.1, 'k2': 0.05, 'p1': 0, 'p2': 0, 'k3': 0}}
    assert list(document['sigma']) == list(PARAMETER_NAMES)
    assert document['sigma']['fx'] == 1 and document['sigma']['p2'] == 9
    assert np.array_equal(document['covariance'], result.covariance)
    assert document['parameters']['p1'] == 'held'
    assert document['frames'] == {'count': 5, 'used': [0, 1, 2, 3, 4]}
    assert document['reprojection_rms_px'] == 0.25 and document['observations'] == 1000
    assert document['facts']['principal_point'] == [320, 240]
    assert document['fixed_points']['circular_point'] == [[1, 2], [3, 0], [0, -1]]
    assert document['held_by'] == {'p1': 'distortion=radial2'} and document['notes'] == ['a note']


def test_not_calibrated(tmp_path):
    result = NotCalibrated('There is no rotation.', 'Turn by 30 degrees.', 'translation',
                           (1, 2), status={'fx': 'unobservable'})
    document = strict(write_result_json(tmp_path / 'result.json', result))
    assert document['status'] == 'not_calibrated' and document['motion'] == 'translation'
    assert document['reason'] == 'There is no rotation.'
    assert document['advice'] == 'Turn by 30 degrees.'
    assert all(document[key] is None for key in ('camera', 'sigma', 'covariance',
                                                 'reprojection_rms_px'))
    assert document['parameters'] == {'fx': 'unobservable'} and document['frames']['count'] == 2
    assert document.keys() == result_to_dict(calibration(findings=())).keys()


def test_findings_are_there_where_there_are_any_and_come_back(tmp_path):
    plain = strict(write_result_json(tmp_path / 'a.json', calibration(findings=())))
    assert plain['schema'] == SCHEMA and not plain.keys() & {'kind', 'findings'}

    found = (Finding('errors_within_track', ratio=np.float64(1.5)),
             Finding('views_left_out', count=2, why=NoEstimate('view_on_line', frame=3)),
             Finding('object_misfits_frames', frames=(2, 7)))
    document = strict(write_result_json(tmp_path / 'b.json', calibration(findings=found)))
    assert document['findings'] == [
        {'kind': 'errors_within_track', 'ratio': 1.5},
        {'kind': 'views_left_out', 'count': 2, 'why': {'kind': 'view_on_line', 'frame': 3}},
        {'kind': 'object_misfits_frames', 'frames': [2, 7]}]
    assert document['notes'][1] == '2 views were left out: frame 3 has all points on one line.'
    assert 'kind' not in document
    assert result_from_dict(document).notes == tuple(document['notes'])


def test_a_refusal_tells_its_kind_and_the_numbers_that_decided(tmp_path):
    more = Finding('motion_suggestion', images=12, motion='s_45', sigma={'fx': 1.25})
    refusal = NoEstimate('rotation_too_small', turned_deg=1.5, missing=('fx', 'cx'),
                         status={'fx': 'unobservable'}, motion='planar', further=(more,))
    result = NotCalibrated.of(refusal, frames=(1, 2))
    document = strict(write_result_json(tmp_path / 'result.json', result))
    assert document['kind'] == result.kind == 'rotation_too_small'
    assert document['findings'] == [
        {'kind': 'rotation_too_small', 'turned_deg': 1.5, 'missing': ['fx', 'cx']},
        {'kind': 'motion_suggestion', 'images': 12, 'motion': 's_45', 'sigma': {'fx': 1.25}}]
    assert document['motion'] == 'planar' and document['parameters'] == {'fx': 'unobservable'}
    assert document['advice'].endswith(more.sentence)
    again = result_from_dict(document)
    assert (again.kind, again.reason, again.findings) == (result.kind, result.reason, (more,))
    assert again.values['missing'] == ['fx', 'cx']


def test_files_without_a_schema_and_kinds_of_later_ones_are_read():
    old = result_to_dict(calibration())
    del old['schema'], old['findings']
    assert result_from_dict(old).findings == (Finding('note', text='a note'),)

    later = result_to_dict(calibration())
    later['findings'] = [{'kind': 'of_tomorrow', 'number': 1}]
    assert result_from_dict(later).notes == ('a note',)

    refused = result_to_dict(NotCalibrated('There is no rotation.', 'Turn.'))
    del refused['schema']
    assert result_from_dict(refused).reason == 'There is no rotation.'
    assert result_from_dict(refused | {'kind': 'of_tomorrow'}).kind == 'of_tomorrow'


def everything():
    """Return a calibration that has all that a file can hold."""
    infinite = {'skew': {'fx': np.inf, 'fy': 1.5}}
    board = Finding('board_flat', bend_mm={'value': 0.1, 'sigma': 0.1}, limit_mm=0.4,
                    unknowns_m=[1e-4, 0.0, -1e-5], sigmas_m=[1e-4] * 3)
    followed = Finding('segments_followed', images=2000, followed=61, count=1, when=['1 to 3 s'],
                       segments=[{'first': 30, 'last': 90}])
    return calibration(
        findings=(board, followed),
        identifiability=Identifiability({'fx': 0.9}, infinite, {'fx': 2.0, 'cx': -1.0}, 0.02),
        measured=StructureSample(Measured(1.5, 0.01), (3, 4), (5, 6), Measured(80.0, 0.2),
                                 (3, 5, 6)),
        focal=FocalCourse(np.array([0, 1]), np.array([520.0, 521.0]), np.array([1.0, np.inf])),
        shutter=RowReadout(2e-5, 1e-6, 'estimated', 0.3, 0.01, 480),
        labels=TrackLabels(np.array([3, 7, 8, 9]), np.array([0, 4, 5, 6]), 2, aside=True),
        mount=NoEstimate('no_mount_fits', count=30))


def test_every_key_comes_back():
    result = everything()
    document = json.loads(json.dumps(result_to_dict(result)))
    schema = json.loads((DOCS / 'result.schema.json').read_text(encoding='utf-8'))
    # of refusals, of rigs, and of the command line
    others = {'kind', 'hint', 'cameras', 'rig', 'unit', 'path_step', 'joint', 'seed'}
    assert document.keys() == schema['properties'].keys() - others
    again = result_from_dict(document)
    assert json.loads(json.dumps(result_to_dict(again))) == document

    assert again.frames == (0, 1, 2, 3, 4) and again.measured == result.measured
    assert again.identifiability == result.identifiability
    assert np.array_equal(again.fixed_points.circular_point, result.fixed_points.circular_point)
    assert np.array_equal(again.labels.label, result.labels.label)
    assert again.labels.of('moving 2').tolist() == [8]
    assert again.labels.of(STILL_IN_IMAGE).tolist() == [9]
    # as the docstring says
    assert again.reconstruction is again.residuals is again.population is None
    bare = result_from_dict(result_to_dict(calibration(fixed_points=None)))
    assert bare.fixed_points is bare.identifiability is bare.measured is bare.labels is None


def test_every_key_of_a_refusal_comes_back():
    hint = calibration(status=dict.fromkeys(PARAMETER_NAMES, 'estimated') | {
        'cx': 'unobservable'})
    refusal = NoEstimate(HINT, turned_deg=5.6, focal_px=620.0, sigma_px=30.0, hint=hint,
                         status=hint.status, motion='planar')
    result = NotCalibrated.of(refusal, frames=(1, 2), facts=hint.facts, software='selfcal_ros 0')
    document = json.loads(json.dumps(result_to_dict(result)))
    again = result_from_dict(document)
    assert json.loads(json.dumps(result_to_dict(again))) == document
    assert again == result and again.frames == (1, 2) and again.status == hint.status
    assert again.hint.camera == hint.camera and again.hint.status['cx'] == 'unobservable'
    assert np.array_equal(again.hint.covariance, hint.covariance)
    assert np.isnan(again.hint.reprojection_rms_px) and again.hint.facts == hint.facts


@pytest.mark.parametrize('named', [True, False])
def test_files_of_the_nine_parameters_before_k3_are_read(named):
    content = result_to_dict(calibration())
    del content['lens'], content['camera']['distortion_model']
    content['camera']['d'] = [-0.1, 0.05, 0, 0]
    content['covariance'] = [row[:9] for row in content['covariance'][:9]]
    content['parameter_names'] = content['parameter_names'][:9]
    if not named:
        del content['parameter_names']
    read = result_from_dict(content)
    assert read.camera.model == 'plumb_bob' and read.camera.distortion.tolist() == [
        -0.1, 0.05, 0, 0, 0]
    assert read.sigma['p2'] == 9 and read.sigma['k3'] == 0
    content['covariance'].append([0.0] * 9)
    with pytest.raises(ValueError, match='shape'):
        result_from_dict(content)


@pytest.mark.parametrize('camera', [
    Camera([[260, 0, 319], [0, 260, 239], [0, 0, 1]], [-0.03, 0.01, -0.01, 0.002], 640, 480,
           'equidistant'),
    Camera([[520, 0, 319], [0, 520, 239], [0, 0, 1]], [0.3, 0.1, 0, 0, 0.01, 0.5, 0.1, 0.01],
           640, 480, 'rational_polynomial')], ids=lambda camera: camera.model)
def test_every_family_comes_back(camera):
    names = camera.parameter_names
    document = json.loads(json.dumps(result_to_dict(calibration(
        camera=camera, covariance=np.diag(np.arange(1., len(names) + 1)**2),
        status=dict.fromkeys(names, 'estimated'), held_by={}))))
    assert document['lens']['model'] == camera.model
    assert list(document['sigma']) == list(names) == document['parameter_names']
    read = result_from_dict(document)
    assert read.camera.model == camera.model
    assert np.array_equal(read.camera.parameters, camera.parameters)
    assert read.sigma['k4'] == document['sigma']['k4'] > 0


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_what_is_not_finite_becomes_null(tmp_path, value):
    covariance = np.eye(len(PARAMETER_NAMES))
    covariance[3, 3] = value
    status = dict.fromkeys(PARAMETER_NAMES, 'estimated') | {'cy': 'unobservable'}
    result = calibration(covariance=covariance, status=status, noise_sigma_px=value)
    document = strict(write_result_json(tmp_path / 'result.json', result))
    assert document['covariance'][3][3] is None and document['sigma']['cy'] is None
    assert document['noise_sigma_px'] is None and document['sigma']['fx'] == 1
