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
"""The card of a notebook: K with sigmas, the verdict's colour, findings; escaped, no figures."""

from dataclasses import replace
from html.parser import HTMLParser
import subprocess
import sys

from selfcal_ros.calibration.card import MOST_FINDINGS, VERDICTS
from selfcal_ros.calibration.result import HINT, NotCalibrated
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate

HOSTILE = '<script>alert(1)</script>"\'><img src=x onerror=alert(2)>'


class Reader(HTMLParser):
    """Collect tags, and text that a person sees; refuse tags that do not match."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.open, self.text = set(), [], ''
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.open.append(tag)
        assert {name for name, _ in attributes} <= {'style'}

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_a_calibration_shows_what_it_found(calibration):
    html = calibration._repr_html_()
    card = Reader(html)
    for words in ('Calibrated', 'planar motion · 6 views · 800 × 600 px', '900.0 ± 2.0',
                  '400.0 ± 1.0', '300.0 ± 3.0', 'plumb_bob: k1 = -0.1000 ± 0.0010', 'p1 = 0',
                  'A note with <b>markup</b>.'):
        assert words in card.text, words
    assert VERDICTS['good'][1] in html and len(html) < 4000
    assert card.tags <= {'div', 'b', 'small', 'i', 'table', 'tbody', 'tr', 'td', 'ul', 'li'}


def test_a_calibration_prints_in_a_few_lines(calibration):
    text = str(calibration)
    for words in ('Calibrated: planar motion, 6 views, 800 × 600 px', 'fx 900.0 ± 2.0',
                  'cx 400.0 ± 1.0', 'cy 300.0 ± 3.0', 'plumb_bob: k1 -0.1000 ± 0.0010',
                  'A note with <b>markup</b>.'):
        assert words in text, words
    assert len(text) < 600
    short = repr(calibration)
    assert short.startswith('<Calibration: planar motion') and 'fx 900.0 ± 2.0' in short
    assert '\n' not in short and len(short) < 120
    open_cy = replace(calibration, status={**calibration.status, 'cy': 'unobservable'})
    assert 'cy 300 (not determined)' in str(open_cy)


def test_the_colour_is_the_verdict(calibration):
    # 3 % of the focal length is no green
    coarse = replace(calibration, covariance=calibration.covariance * (0.03 * 900 / 2)**2)
    weak = replace(calibration, status={**calibration.status, 'cy': 'unobservable'})
    hint = NotCalibrated.of(NoEstimate(HINT, turned_deg=5.6, focal_px=620.0, sigma_px=30.0,
                                       hint=coarse))
    bad = NotCalibrated('The camera did not rotate.', 'Drive curves.', 'translation')
    for result, grade in ((calibration, 'good'), (coarse, 'coarse'), (weak, 'partial'),
                          (hint, 'hint'), (bad, 'bad')):
        html = result._repr_html_()
        assert result.grade == grade and VERDICTS[grade][1] in html and VERDICTS[grade][0] in html
    assert 'not determined' in weak._repr_html_()
    text = Reader(bad._repr_html_()).text
    assert 'did not rotate' in text and 'What helps: Drive curves.' in text
    colours = [VERDICTS[grade][1] for grade in ('good', 'coarse', 'hint', 'bad')]
    assert colours[1] == colours[2] and len(set(colours)) == 3


def test_hostile_text_stays_text_and_many_findings_are_counted(calibration):
    found = tuple(Finding('note', text=f'{HOSTILE} {k}') for k in range(MOST_FINDINGS + 3))
    for result in (replace(calibration, findings=found), NotCalibrated(HOSTILE, HOSTILE)):
        card = Reader(result._repr_html_())
        assert HOSTILE in card.text and not {'script', 'img'} & card.tags
    assert 'and 3 more' in replace(calibration, findings=found)._repr_html_()


def test_no_figures_are_loaded_for_it():
    code = ('import sys; from selfcal_ros import NotCalibrated; NotCalibrated("x")._repr_html_(); '
            'print("matplotlib" in sys.modules, "cv2" in sys.modules)')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ['False', 'False']
