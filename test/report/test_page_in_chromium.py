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
"""The page in a real browser: no complaint, nothing sticks out, the scene turns."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from selfcal_ros.calibration.estimators.joint import combine
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.many_inputs import CameraSummary, Outcome, Summary
from selfcal_ros.report.many_inputs_report import write_summary_page
from selfcal_ros.report.page import write_page
from test_support.chromium import started_browser


@pytest.fixture(scope='module')
def browser():
    """Start the browser once."""
    yield from started_browser()


@pytest.fixture(scope='module')
def images(sequence):
    """Return what opens the images of the sequence: noise, of its size."""
    rng = np.random.default_rng(2)

    class Source:
        kind = 'images'

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def only(self, wanted):
            width, height = sequence.tracks.image_size
            for index in sorted(wanted):
                grey = cv2.resize(rng.integers(0, 255, (30, 40), dtype=np.uint8), (width, height))
                yield type('Frame', (), {'index': index, 'image': grey, 'bgr': None})
    return Source


@pytest.fixture(scope='module')
def report(tmp_path_factory, calibration, sequence, images):
    return write_page(tmp_path_factory.mktemp('page') / 'report.html', calibration, 'as printed',
                      'drive.mcap <b>' + 'long_name/' * 20, tracks=sequence.tracks,
                      camera_name='front', open_frames=images)


#: Elements that stick out of the window, and text in figures too small to read.
STICKING_OUT = """[...document.querySelectorAll('body *')].filter(e => {
    const box = e.getBoundingClientRect();
    return box.width && (box.right > innerWidth + 1 || box.left < -1)
           && !e.closest('pre, svg, .equals');
}).map(e => e.tagName + '.' + e.className)"""
SMALLEST_TEXT_PX = """Math.min(...[...document.querySelectorAll('svg.plot text')].filter(e =>
    e.getBoundingClientRect().width).map(e => parseFloat(getComputedStyle(e).fontSize)
    * Math.hypot(e.getScreenCTM().a, e.getScreenCTM().b)))"""


@pytest.mark.parametrize('width, scheme', [(1280, 'light'), (1280, 'dark'), (400, 'dark'),
                                           (320, 'light')])
def test_opens_without_a_complaint_and_fits(browser, report, width, scheme):
    assert report.stat().st_size < 5e6
    assert report.read_bytes().count(b'data:image/jpeg;base64,') in (6, 7, 8)
    page = browser.open(report, width, scheme=scheme)
    assert page.complaints == []
    assert [url.partition(':')[0] for url in page.requests if not url.startswith('data:')] \
        == ['file']
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    assert page.evaluate(STICKING_OUT) == []
    assert page.evaluate(SMALLEST_TEXT_PX) > (6 if width < 400 else 8)
    colours = page.evaluate('[getComputedStyle(document.body).color, '
                            'getComputedStyle(document.body).backgroundColor]')
    ink, ground = (sum(map(int, c[4:-1].split(',')[:3])) for c in colours)
    assert (ink > ground) == (scheme == 'dark') and abs(ink - ground) > 450
    image = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert image.shape[1] == width and image.std() > 10


#: Cells of the table of parameters whose words lie on those of another cell of their row.
OVERLAPPING = """[...document.querySelectorAll('.parameters tr')].flatMap(row => {
    const boxes = [...row.cells].filter(e => e.textContent.trim()).map(e => {
        const range = document.createRange(); range.selectNodeContents(e);
        return [e, range.getBoundingClientRect()]; }).filter(([e, b]) => b.width);
    return boxes.filter(([e, b], k) => boxes.slice(k + 1).some(([f, c]) =>
        b.left < c.right - 1 && c.left < b.right - 1 && b.top < c.bottom - 3
        && c.top < b.bottom - 3)).map(([e]) => row.textContent);
})"""


def test_no_words_of_a_parameter_lie_on_others(browser, calibration, tmp_path, without_figures):
    finding = Finding('fact_unchecked', fact='aspect ratio', error=0.1, unknown='aspect',
                      moves={'fy': 0.5}, name='fy', change=0.5, sigmas=5.0)
    path = write_page(tmp_path / 'report.html', replace(calibration, findings=(finding,)), '')
    assert 'if the aspect ratio is exact' in path.read_text('utf-8')
    for width in (1280, 400, 320):
        assert browser.open(path, width).evaluate(OVERLAPPING) == []


@pytest.mark.parametrize('width, scheme', [(1280, 'light'), (1280, 'dark'), (400, 'light')])
def test_the_page_of_many_recordings_looks_like_that_of_one(browser, report, calibration,
                                                            tmp_path, width, scheme):
    outcomes = tuple(Outcome(f'/drives/drive_{k:03d}.mcap', '/camera/image_raw', (640, 480), one,
                             start_ns=(1_700_000_000 + 86_400 * k) * 10 ** 9)
                     for k, one in enumerate([calibration] * 3 + [NotCalibrated('no turn.')]))
    camera = CameraSummary('/camera/image_raw', (640, 480), outcomes, combine([calibration] * 3),
                           (0, 1, 2))
    path = write_summary_page(tmp_path / 'many.html', Summary((camera,), (Outcome(
        'x', error='/drives/' + 'long_name/' * 20 + 'x.mcap is not an mcap file.'),)))
    page = browser.open(path, width, scheme=scheme)
    assert page.complaints == []
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    # a wide table scrolls in its frame
    assert page.evaluate(STICKING_OUT.replace("'pre, svg", "'.scroll, pre, svg")) == []
    if width == 1280:
        assert page.evaluate('[...document.querySelectorAll(".scroll")].every('
                             'e => e.scrollWidth <= e.clientWidth)')
    image = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert image.shape[1] == width and image.std() > 10
    # one stylesheet for both
    style = '["body", "header", "h1", ".verdict", "h2", ".card"].map(name => { const s = ' \
        'getComputedStyle(document.querySelector(name)); return [s.color, s.fontSize, ' \
        's.backgroundColor, s.borderRadius, s.fontFamily]; })'
    assert page.evaluate(style) == browser.open(report, width, scheme=scheme).evaluate(style)


def test_the_scene_turns_and_zooms(browser, report):
    page = browser.open(report, 1280)
    page.evaluate('document.querySelector("canvas").scrollIntoView({block: "center", '
                  'behavior: "instant"})')
    page.frames(30)     # longer than the pause after which a wheel means the picture

    def view():
        page.frames(3)
        return [float(v) for v in page.evaluate(
            'document.querySelector("canvas").dataset.view').split()]

    def picture():
        return page.evaluate('document.querySelector("canvas").toDataURL()')
    box = page.evaluate('(b => [b.left + b.width / 2, b.top + b.height / 2])'
                        '(document.querySelector("canvas").getBoundingClientRect())')
    before, seen = view(), picture()
    page.mouse('mousePressed', *box, button='left', buttons=1, clickCount=1)
    page.mouse('mouseMoved', box[0] + 80, box[1] + 16, button='left', buttons=1)
    page.mouse('mouseReleased', box[0] + 80, box[1] + 16, button='left', clickCount=1)
    turned = view()
    assert turned[0] == pytest.approx(before[0] - 0.5, abs=1e-3)
    assert turned[1] == pytest.approx(before[1] + 0.1, abs=1e-3)
    assert turned[2] == before[2] and picture() != seen
    page.mouse('mouseMoved', *box)
    page.evaluate('new Promise(done => setTimeout(done, 300))')
    page.mouse('mouseWheel', *box, deltaX=0, deltaY=-100)
    assert view()[2] == pytest.approx(turned[2] * np.exp(-0.2), rel=1e-3)
    page.evaluate('document.querySelector("canvas").focus()')
    page.send('Input.dispatchKeyEvent', type='keyDown', key='ArrowLeft')
    assert view()[0] == pytest.approx(turned[0] + 0.1, abs=1e-3)
    page.evaluate('document.querySelector("button[value=behind]").click()')
    assert view() == before
    page.send('Emulation.setTouchEmulationEnabled', enabled=True)
    page.send('Input.dispatchTouchEvent', type='touchStart',
              touchPoints=[{'x': box[0], 'y': box[1], 'id': 0}])
    page.send('Input.dispatchTouchEvent', type='touchMove',
              touchPoints=[{'x': box[0] + 160, 'y': box[1], 'id': 0}])
    page.send('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])
    assert view()[0] == pytest.approx(before[0] - 1, abs=0.15)
    assert page.complaints == []


SHOWN = '[...document.querySelectorAll("{}")].map(e => getComputedStyle(e).display != "none")'


def test_an_image_fills_the_window_until_one_goes_back(browser, report):
    page = browser.open(report, 1280)
    width = '(e => e.getBoundingClientRect().width)(document.querySelector("figure[id^=image]"))'
    before = page.evaluate(width)
    page.evaluate('document.querySelector("figure[id^=image] .enlarge").click()')
    page.frames(3)
    assert before < 700 and page.evaluate(width) >= 1270
    page.evaluate('document.querySelector("figure:target .close").click()')
    page.frames(3)
    assert page.evaluate(width) == before and page.complaints == []
    assert page.evaluate(SHOWN.format('.picture .residual, .picture .trail'))[:2] == [True, False]
    page.evaluate('document.querySelector("#arrows").click()')
    assert page.evaluate(SHOWN.format('.picture .residual, .picture .trail'))[:2] == [False, True]


def test_without_scripts_and_in_print_there_is_a_still_picture(browser, report):
    page = browser.open(report, 1280)
    assert page.evaluate(SHOWN.format('#viewer canvas, #viewer .still')) == [True, False]
    page.media('print', 'dark')
    assert page.evaluate(SHOWN.format('#viewer canvas, #viewer .still')) == [False, True]
    assert page.evaluate('getComputedStyle(document.body).color') == 'rgb(0, 0, 0)'
    pdf = page.pdf()
    assert pdf.startswith(b'%PDF') and 2 <= pdf.count(b'/Type /Page\n') <= 8
    silent = browser.open(report, 400, scripts=False)
    assert silent.evaluate(SHOWN.format('#viewer canvas, #viewer .still')) == [False, True]
    assert silent.complaints == []


def test_hostile_text_runs_nothing(browser, tmp_path, calibration, sequence):
    hostile = ('</pre></script><script>window.harm = 1</script>'
               '"\'><img src=x onerror="window.harm = 1"><svg onload="window.harm = 1">')
    path = write_page(tmp_path / 'r.html', calibration, hostile, hostile, tracks=sequence.tracks,
                      camera_name=hostile, notes=(hostile,))
    page = browser.open(path, 1280)
    assert page.evaluate('typeof window.harm') == 'undefined' and page.complaints == []
    # were something to get through, the policy of the page would stop it
    page.evaluate('document.body.insertAdjacentHTML("beforeend", '
                  '"<img src=x onerror=\'window.harm = 1\'>")')
    page.evaluate('new Promise(done => setTimeout(done, 200))')
    assert page.evaluate('typeof window.harm') == 'undefined' and page.complaints


def test_without_a_calibration(browser, tmp_path):
    result = NotCalibrated('The camera did not rotate.', 'Drive curves.', 'translation',
                           (1, 2, 3), CameraFacts(skew=0), {'fx': 'unobservable'}, 'selfcal 1')
    page = browser.open(write_page(tmp_path / 'r.html', result, 'text'), 400)
    assert page.complaints == [] and page.evaluate(STICKING_OUT) == []
    assert page.evaluate('document.querySelector("h1").innerText') == 'Not calibrated'
