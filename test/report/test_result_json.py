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

import numpy as np
import pytest
from selfcal_ros.calibration.result import (Calibration, FixedPoints, NotCalibrated,
                                            Reconstruction)
from selfcal_ros.geometry.camera import Camera, CameraFacts, PARAMETER_NAMES
from selfcal_ros.report.result_json import result_to_dict, write_result_json

CONTRACT = {'status', 'reason', 'motion', 'camera', 'sigma', 'covariance', 'parameters', 'frames',
            'reprojection_rms_px', 'facts', 'software'}


def calibration(**changed):
    """Return a calibration whose numbers are of NumPy's types."""
    covariance = np.diag(np.arange(1., 10) ** 2)
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
        'outlier_count': 7, 'notes': ('a note',), 'software': 'selfcal_ros 0.1.0',
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
    assert document.keys() == result_to_dict(calibration()).keys()


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_what_is_not_finite_becomes_null(tmp_path, value):
    covariance = np.eye(9)
    covariance[3, 3] = value
    status = dict.fromkeys(PARAMETER_NAMES, 'estimated') | {'cy': 'unobservable'}
    result = calibration(covariance=covariance, status=status, noise_sigma_px=value)
    document = strict(write_result_json(tmp_path / 'result.json', result))
    assert document['covariance'][3][3] is None and document['sigma']['cy'] is None
    assert document['noise_sigma_px'] is None and document['sigma']['fx'] == 1
