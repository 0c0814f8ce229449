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
"""Real results are as docs/result.schema.json says."""

from dataclasses import replace
import json
from pathlib import Path
import re

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.result import FocalCourse, HINT, MOTIONS, NotCalibrated
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.report.result_json import result_from_dict, result_to_dict, SCHEMA
from selfcal_ros.synthetic.scenes import sequence_si
from selfcal_ros.synthetic.special_scenes import pure_rotation, pure_translation
from test_support.result_schema import problems

DOCS = Path(__file__).resolve().parents[2] / 'docs'
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')


@pytest.fixture(scope='module')
def schema():
    whole = json.loads((DOCS / 'result.schema.json').read_text(encoding='utf-8'))
    hint = whole['properties']['hint']['properties']
    for name, part in hint.items():
        # the only references: to properties of the whole
        assert part == {'$ref': f'#/properties/{name}'}
        hint[name] = whole['properties'][name]
    return whole


def written(result):
    """Return the result as a program reads it."""
    return json.loads(json.dumps(result_to_dict(result), allow_nan=False))


def test_calibrations_are_as_the_schema_says(schema):
    result = calibrate(sequence_si(np.random.default_rng(0), 0.1).tracks, facts=FACTS)
    assert result
    content = written(result)
    assert not problems(content, schema)
    assert content.keys() <= schema['properties'].keys(), 'a key that the schema does not know'
    course = FocalCourse(np.array([0, 1]), np.array([900.0, 910.0]), np.array([2.0, np.inf]))
    content = written(replace(result, focal=course))
    assert not problems(content, schema) and content['focal'][1]['fx'] == 910
    part = {'first': 30, 'last': 90, 'start_s': 1.0, 'end_s': 3.0, 'why': 'rolling',
            'status': 'refused', 'fx': None, 'sigma_fx': None, 'reason': 'No.'}
    followed = Finding('segments_followed', images=2000, followed=61, count=1, when=['1 to 3 s'],
                       segments=[part])
    content = written(replace(result, findings=(followed,)))
    assert not problems(content, schema) and content['segments'] == [part]
    assert content.keys() <= schema['properties'].keys()
    flat = Finding('board_flat', bend_mm={'value': 0.1, 'sigma': 0.1}, limit_mm=0.4,
                   unknowns_m=[1e-4, 0.0, -1e-5], sigmas_m=[1e-4] * 3)
    content = written(replace(result, findings=(flat,)))
    assert not problems(content, schema) and content['board']['limit_m'] == 4e-4


@pytest.mark.parametrize('scene', [pure_translation, pure_rotation])
def test_refusals_are_as_the_schema_says(schema, scene):
    result = calibrate(scene(np.random.default_rng(0), 0.1).tracks, facts=FACTS, motion='planar')
    assert not result and result.kind
    content = written(result)
    assert not problems(content, schema)
    assert content['kind'] == content['findings'][0]['kind'] == result.kind
    assert not problems(written(NotCalibrated('Of an older file.')), schema)


def test_a_hint_has_its_camera_where_nobody_takes_it_for_a_calibration(schema, calibration):
    refusal = NoEstimate(HINT, turned_deg=5.6, focal_px=620.0, sigma_px=30.0, hint=calibration,
                         status=calibration.status, motion='planar')
    content = written(NotCalibrated.of(refusal, frames=(1, 2)))
    assert not problems(content, schema) and content['status'] == 'hint'
    assert content['camera'] is None and content['sigma'] is None
    assert content['hint']['camera']['fx'] == calibration.camera.K[0, 0]
    assert content['hint']['sigma']['fx'] == calibration.sigma['fx']
    again = result_from_dict(content)
    assert not again and again.is_hint and again.hint.camera == calibration.camera
    assert again.values['focal_px'] == 620.0 and str(again).startswith('A hint, no calibration: ')
    assert 'hint' not in written(NotCalibrated('Of an older file.'))


def test_what_contradicts_the_schema_is_found(schema):
    content = written(calibrate(pure_rotation(np.random.default_rng(0), 0.1).tracks, facts=FACTS))
    for change in ({'status': 'perhaps'}, {'findings': []}, {'findings': [{}]}, {'notes': None},
                   {'camera': {'width': 640}}, {'schema': 1}, {'kind': 'Not a kind'},
                   {'frames': {'count': -1, 'used': []}}, {'parameters': {'fx': 'good'}}):
        assert problems({**content, **change}, schema), change
    assert problems({name: value for name, value in content.items() if name != 'facts'}, schema)


def test_version_motions_and_keys_are_those_of_the_code_and_of_the_page(schema):
    assert schema['properties']['schema']['const'] == SCHEMA
    assert schema['$id'] == f'urn:selfcal_ros:result:{SCHEMA}'
    assert tuple(schema['properties']['motion']['enum']) == MOTIONS
    page = (DOCS / 'result-json.md').read_text(encoding='utf-8')
    table = page[page.index('| key'):page.index('## Kinds')]
    listed = {name for row in table.splitlines() if row.startswith('| `')
              for name in re.findall(r'`(\w+)`', row.split('|')[1])}
    assert listed == schema['properties'].keys()
