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
"""The page's parts: ranked notes, how it was made, figures that fill the window."""

from dataclasses import replace
import re

import pytest
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.findings.finding import Finding
from selfcal_ros.report.page import page_html
from selfcal_ros.report.phrases import parameter_rows
from selfcal_ros.report.provenance import Provenance
from selfcal_ros.report.ranked_notes import MOST_SHOWN, ranked_notes


def test_notes_stand_before_the_camera_and_the_rest_is_folded(html):
    notes = html[html.index('id="notes"'):html.index('id="camera"')]
    open_ones, folded = notes.split('<details>')
    shown = re.findall(r'<li.*?>(.*?)</li>', open_ones)
    assert len(shown) == MOST_SHOWN == 7
    # what puts the result in doubt, then what widens sigmas most
    assert shown[0] == str(Finding('image_size_not_stated'))
    assert open_ones.count('class="doubtful"') == 1 and 'doubtful' not in folded
    ratios = [float(re.search(r'sigmas are (\S+) times', one)[1]) for one in shown[1:]]
    assert ratios == sorted(ratios, reverse=True) and ratios[0] == 1.7
    assert 'How tracks came about.' in folded


def test_notes_are_ranked_by_what_they_do(calibration):
    found = (Finding('keyframes_chosen', keyframes=3, frames=9),
             Finding('fact_unchecked', fact='aspect ratio', error=0.1, unknown='aspect',
                     name='fy', change=1.0, sigmas=6.0),
             Finding('errors_within_region', ratio=1.2), Finding('errors_within_track', ratio=3.0))
    result = replace(calibration, findings=found)
    texts = [note.text for note in ranked_notes(result, ('From outside.', str(found[2])))]
    assert texts[:3] == [str(found[k]) for k in (1, 3, 2)] and len(texts) == len(set(texts))
    assert texts[-2:] == [str(found[0]), 'From outside.'] and 'field of view' in texts[3]
    assert [note.doubtful for note in ranked_notes(result)[:2]] == [True, False]
    assert ranked_notes(NotCalibrated('No.'), ('Why.',))[0].text == 'Why.'


def test_the_focal_length_has_its_relative_sigma(calibration):
    rows = {row.name: row for row in parameter_rows(calibration)}
    K = calibration.camera.K
    assert rows['fx'].share == f'{100 * 2.0 / K[0, 0]:.2g} %' and rows['cx'].share == ''


@pytest.mark.parametrize('shutter, unit, value, sigma', [
    (RowReadout(-20e-6, 1e-7, 'estimated', -0.288, 0.00144, 480), 'ms', -9.6, 0.048),
    (RowReadout(0.0, 0.0, 'held', 0.0, 0.0, 480), 'ms', 0.0, 0.0),
    (RowReadout(None, None, 'estimated', 0.25, 0.01, 480), 'between frames', 0.25, 0.01)])
def test_the_time_of_a_readout_has_its_unit(calibration, shutter, unit, value, sigma):
    row = parameter_rows(replace(calibration, shutter=shutter))[-1]
    assert row.name == 'readout' and row.meaning.endswith(unit)
    assert float(row.value) == value and float(row.sigma or 0) == sigma


def test_how_the_page_was_made(html):
    made = html[html.index('id="made"'):]
    for words in ('2026-01-02 03:04:05 UTC', 'selfcal calibrate &#39;my drive.mcap&#39;',
                  'selfcal_ros 0.0, NumPy 9.9', '>my drive.mcap<'):
        assert words in made, words
    size = float(re.search(r'this page: (\S+) MB', made)[1])
    assert abs(size - len(html.encode()) / 1e6) < 0.06


def test_the_time_can_be_given_and_names_stay_text(tmp_path, monkeypatch, sequence):
    monkeypatch.setenv('SOURCE_DATE_EPOCH', '86400')
    path = tmp_path / '<script>x.csv'
    path.write_bytes(bytes(250_000))
    made = Provenance.of_this_run(('selfcal', str(path)), (path, tmp_path, tmp_path / 'gone'))
    tracks = replace(sequence.tracks, stamps_ns={0: 10**18, 5: 10**18 + 2_500_000_000})
    rows = made.rows(tracks)
    assert rows[0] == ('made', '1970-01-02 00:00:00 UTC')
    assert rows[2][1].endswith('x.csv (0.2 MB)') and '(1 file, 0.2 MB)' in rows[3][1]
    assert rows[4][1].endswith('gone')
    path.write_bytes(bytes(4_700))
    assert made.rows(tracks)[2][1].endswith('x.csv (4.7 kB)')
    assert rows[5] == ('images taken', '2001-09-09 01:46:40 UTC, over 2.5 s')
    assert {'selfcal_ros', 'Python', 'NumPy'} <= set(made.versions)
    page = page_html(NotCalibrated('No.'), '', made=made)
    assert '<script>' not in page and '&lt;script&gt;x.csv' in page


def test_every_figure_can_fill_the_window_and_be_left(html):
    figures = re.findall(r'<figure id="([^"]+)" class="card">(.*?)</figure>', html, re.DOTALL)
    assert len(figures) >= 6
    for name, inside in figures:
        assert f'class="enlarge" href="#{name}"' in inside
        back = re.search(r'class="close" href="#([^"]+)"', inside)[1]
        assert f'<section id="{back}">' in html
    css = html[html.index('<style>'):html.index('</style>')]
    assert re.search(r'figure:target \{[^}]*position: fixed', css)
