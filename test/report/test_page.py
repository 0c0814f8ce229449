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
"""The page: self-contained, escaped, and with the verdict in front."""

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import CameraFacts
from selfcal_ros.report.page import page_html, write_page
from selfcal_ros.report.wording import facts_lines, parameter_rows, verdict, with_sigma

HOSTILE = '<script>alert(1)</script>"\'><img src=x onerror=alert(2)> {{ 7 * 7 }} \u202e'
VOID = {'meta', 'img', 'br', 'link', 'hr', 'input'}


class Reader(HTMLParser):
    """Collect tags and attributes; refuse tags that do not match."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.open, self.words = [], [], [], []
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += attributes
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != 'style':
            self.words.append(data)

    @property
    def text(self):
        return ' '.join(' '.join(self.words).split())


def test_a_calibration(tmp_path, calibration, sequence):
    path = write_page(tmp_path / 'report.html', calibration, 'as printed', 'drive.mcap',
                      tracks=sequence.tracks, camera_name='front', notes=('One image was bad.',))
    page = Reader(path.read_text(encoding='utf-8'))
    text = page.text
    assert 'Calibrated from planar motion: fx = fy = 900.0 ± 2.0 px' in text
    for words in ('drive.mcap', 'as printed', 'One image was bad.', 'A note with <b>markup</b>.',
                  'skew = 0', 'distortion = radial2', 'camera_info/front.yaml',
                  'camera_name: front', 'selfcal_ros 0.0'):
        assert words in text, words
    assert page.tags.count('img') == page.tags.count('figure') == 6
    assert [p.name for p in tmp_path.iterdir()] == ['report.html']


def test_the_page_needs_no_network_and_runs_nothing(calibration, sequence):
    page = Reader(page_html(calibration, 'text', tracks=sequence.tracks))
    assert not {'script', 'link', 'iframe', 'object', 'base', 'form'} & set(page.tags)
    for name, value in page.attributes:
        assert not name.startswith('on')
        assert name != 'src' or value.startswith('data:image/svg+xml;base64,')
        assert name != 'href'
    assert ('content', "default-src 'none'; style-src 'unsafe-inline'; img-src data:") \
        in page.attributes


def test_hostile_names_are_shown_as_they_are(calibration):
    for result in (replace(calibration, notes=(HOSTILE,), software=HOSTILE,
                           held_by={'skew': HOSTILE}),
                   NotCalibrated(HOSTILE, HOSTILE, frames=(1,), status={HOSTILE: HOSTILE})):
        page = Reader(page_html(result, HOSTILE, HOSTILE, notes=(HOSTILE,)))
        assert 'script' not in page.tags
        assert not any(name.startswith('on') for name, _ in page.attributes)
        assert page.text.count('{{ 7 * 7 }}') >= 4


def test_without_a_calibration(tmp_path):
    result = NotCalibrated('The camera did not rotate.', 'Drive curves.', 'translation',
                           (1, 2, 3), CameraFacts(skew=0), {'fx': 'unobservable'}, 'selfcal 1')
    page = Reader(write_page(tmp_path / 'r.html', result, 'text').read_text(encoding='utf-8'))
    assert page.text.startswith('Not calibrated')
    for words in ('The camera did not rotate.', 'Drive curves.', 'translation', 'unobservable'):
        assert words in page.text
    assert 'Use it' not in page.text and 'figure' not in page.tags


def test_own_figures_are_put_in(calibration):
    assert '<svg id="mine"></svg>' in page_html(calibration, '', '', ('<svg id="mine"></svg>',))


def test_a_missing_folder_is_an_input_error(tmp_path, calibration):
    with pytest.raises(InputError):
        write_page(tmp_path / 'nowhere' / 'report.html', calibration, '')


@pytest.mark.parametrize('value, sigma, expected', [
    (519.93827, 0.02845, ('519.938', '0.028')), (519.9, 2.72, ('519.9', '2.7')),
    (12345.6, 52.3, ('12346', '52')), (1.0, 0.0, ('1', '')), (-0.1101, 0.0996, ('-0.11', '0.10')),
    (519.9, 9.96, ('520', '10')), (3.0, np.inf, ('3', 'unknown')),
    (4321.0, 432.1, ('4321', '432'))])
def test_digits_follow_sigma(value, sigma, expected):
    assert with_sigma(value, sigma) == expected


def test_what_is_not_determined_is_not_given_a_sigma(calibration):
    status = {**calibration.status, 'cy': 'unobservable'}
    weak = replace(calibration, status=status)
    assert 'do not determine cy' in verdict(weak) and 'cy =' not in verdict(weak)
    row = next(row for row in parameter_rows(weak) if row.name == 'cy')
    assert row.status == 'unobservable' and row.sigma == 'not determined'


def test_field_of_view_and_its_sigma(calibration):
    rows = [row for row in parameter_rows(replace(
        calibration, camera=type(calibration.camera)(calibration.camera.K, width=800, height=600),
        covariance=np.diag([4.0] + [0] * 8))) if row.name == 'FoV']
    # 2 atan(400 / 900), and its slope 2 · 400 / (900² + 400²) per pixel
    assert float(rows[0].value) == pytest.approx(np.degrees(2 * np.arctan(400 / 900)), abs=0.05)
    assert float(rows[0].sigma) == pytest.approx(
        np.degrees(2 * 2 * 400 / (900**2 + 400**2)), rel=0.05)


def test_facts_with_their_spread():
    lines = facts_lines(CameraFacts(aspect_ratio=1, aspect_ratio_sigma=0.01, skew=0,
                                    principal_point=(320, 240), principal_point_sigma_px=5))
    assert lines == ['aspect ratio fy / fx = 1 (σ = 0.01)', 'skew = 0 px (exact)',
                     'principal point = (320, 240) px (σ = 5 px)', 'distortion model: auto']
