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
"""What is said of many recordings: words that fit, whatever came of them."""

from dataclasses import replace
import json
import re

import numpy as np
import pytest
from selfcal_ros.calibration.estimators.joint import combine
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.many_inputs import CameraSummary, Outcome, Summary
from selfcal_ros.report.many_inputs_report import (is_settled, rows_of, summary_to_dict,
                                                   verdict_of, write_summary_page)
from selfcal_ros.report.parameter_history import parameter_history, picture

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')


def calibration(focal, sigma):
    """Return a calibration of which only the focal length differs."""
    C = np.zeros((len(PARAMETER_NAMES),) * 2)
    C[:2, :2] = sigma**2
    C[2, 2] = C[3, 3] = 0.04
    status = {name: 'estimated' if name in ('fx', 'fy', 'cx', 'cy') else 'held'
              for name in PARAMETER_NAMES}
    return Calibration(Camera.from_parameters([focal, focal, 320, 240, 0, 0, 0, 0, 0], 640, 480),
                       C, status, {}, 'planar', FACTS, (1, 2, 3), 0.1, 0.1, 100, 1, None)


def summary(focals, sigma, clock=True, others=()):
    """Return the summary of a camera that was calibrated with these focal lengths."""
    results = [calibration(focal, sigma) for focal in focals]
    outcomes = [Outcome(f'/bags/<b>{k}.mcap', '/cam', (640, 480), result,
                        start_ns=1_700_000_000 * 10**9 + k * 86_400 * 10**9 if clock else None)
                for k, result in enumerate(results)]
    outcomes += [Outcome(f'/bags/{k}', '/cam', (640, 480), other)
                 for k, other in enumerate(others)]
    joint = combine(results) if results else None
    return CameraSummary('/cam', (640, 480), tuple(outcomes), joint, tuple(range(len(results))))


@pytest.mark.parametrize('focals, sigma, settled, words', [
    ([520.1, 519.8, 520.3, 519.9], 0.3, True, 'The recordings agree (chi2'),
    ([520, 520, 520, 520, 526], 0.3, False, '1 recording contradicts the others and is left out'),
    ([520, 522, 524, 526, 528], 0.3, False, 'The recordings disagree'),
    ([520, 520.05, 520.1, 520.15], 0.01, True, 'which nobody will notice'),
    ([520.1, 519.8, 520.3, 519.9], 0.25, True, 'leaves out what all recordings share'),
    ([520], 0.3, True, 'With one recording nothing can be compared'),
    ([], 0.3, False, 'None of 0 recordings calibrates'),
])
def test_the_verdict_fits(focals, sigma, settled, words):
    camera = summary(focals, sigma)
    assert words in verdict_of(camera) and is_settled(camera) == settled
    if focals:
        assert 'fx = fy = 52' in verdict_of(camera)


def test_rows_say_what_became_of_each():
    camera = summary([520, 520, 520, 520, 526], 0.3,
                     others=[NotCalibrated('there is no parallax.')])
    rows = rows_of(camera)
    assert [row.good for row in rows] == [True] * 4 + [False] * 2
    assert rows[4].status == 'contradicts the others' and float(rows[4].deviation) > 5
    # 1 % of the focal length, 400 px from the middle
    assert float(rows[4].max_difference_px) == pytest.approx(6 / 520 * 400, rel=0.3)
    assert rows[5].status == 'not calibrated: there is no parallax.'
    assert rows[0].values == ('520.00 ± 0.30', '520.00 ± 0.30', '320.00 ± 0.20', '240.00 ± 0.20')
    assert rows[1].start == '2023-11-15 22:13:20'


def test_a_recording_of_another_lens_is_drawn_by_the_names_of_its_parameters():
    fisheye = Camera.from_parameters([500, 500, 320, 240, 0, 9, 9, 9, 9], 640, 480, 'equidistant')
    other = replace(calibration(500, 0.3), camera=fisheye, status={}, facts=replace(
        FACTS, distortion='equidistant'))
    found = summary([520.1, 519.8], 0.3, clock=False, others=[other])
    joint = replace(found.joint.calibration, status={**found.joint.calibration.status,
                                                     'k2': 'estimated', 'p1': 'estimated'})
    figure = parameter_history(replace(found, joint=replace(found.joint, calibration=joint)))

    drawn = {axis.get_ylabel().split()[0]: np.concatenate([
        line.get_ydata() for line in axis.lines if line.get_marker() == 'o'])
        for axis in figure.axes}
    np.testing.assert_equal(drawn['fx'], [520.1, 519.8, 500])
    np.testing.assert_equal(drawn['k2'], [0, 0, 9])
    # the seventh number of a fisheye is another one
    np.testing.assert_equal(drawn['p1'], [0, 0, np.nan])


@pytest.mark.parametrize('clock', [True, False])
def test_page_picture_and_json(tmp_path, clock):
    everything = Summary((summary([520, 521, 519], 1.0, clock),),
                         (Outcome('x.mcap', error='x.mcap <script> is empty.'),), 3.0)
    page = write_summary_page(tmp_path / 'page.html', everything).read_text(encoding='utf-8')
    assert '<script' not in page and '&lt;script&gt; is empty.' in page
    assert '&lt;b&gt;0.mcap' in page and '<b>' not in page
    assert 'http://' not in page and 'https://' not in page
    # one sentence stands out, and equal focal lengths share a column
    assert re.search(r'<p class="verdict">3 of 3 recordings calibrate; [^<]*px\.</p>', page)
    assert '<p class="quality">The recordings agree' in page and 'fx = fy ± σ, px' in page
    camera = everything.cameras[0]
    assert picture(parameter_history(camera), 'svg') == picture(parameter_history(camera), 'svg')
    content = json.loads(json.dumps(summary_to_dict(everything), allow_nan=False))
    assert content['cameras'][0]['agree'] is True
    assert [one['used'] for one in content['cameras'][0]['recordings']] == [True] * 3
    assert content['failures'][0]['error'] == 'x.mcap <script> is empty.'
    assert parameter_history(summary([], 1.0)) is None
