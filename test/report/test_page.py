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

import base64
import contextlib
from dataclasses import replace
import hashlib
from html.parser import HTMLParser
import json
import re
import types

import cv2
import numpy as np
import pytest
from selfcal_ros.calibration.result import HINT, Identifiability, NotCalibrated
from selfcal_ros.errors import InputError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.report.inline_svg import VARIABLES
from selfcal_ros.report.keyframe_pictures import pictures_and_colours
from selfcal_ros.report.page import page_html, write_page
from selfcal_ros.report.phrases import facts_lines, parameter_rows, verdict, with_sigma
from selfcal_ros.report.projection_uncertainty import projection_uncertainty
from selfcal_ros.report.scene import scene_of
from selfcal_ros.report.summary import distortion, matrix, px_text, quality

#: Of a covariance of all parameters.
COVARIANCE_SHAPE = (len(PARAMETER_NAMES),) * 2

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
        if self.open and self.open[-1] not in ('style', 'script'):
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
    assert page.tags.count('figure') == 10 and page.tags.count('img') == 0
    assert [p.name for p in tmp_path.iterdir()] == ['report.html']


def test_the_page_needs_no_network_and_runs_its_own_script_alone(html):
    page = Reader(html)
    assert not {'link', 'iframe', 'object', 'base', 'form'} & set(page.tags)
    for name, value in page.attributes:
        assert not name.startswith('on')
        assert name != 'src' or value.startswith('data:image/')
        assert name not in ('href', 'xlink:href') or value.startswith(('#', 'data:image/png'))
    script, = re.findall(r'<script>(.*?)</script>', html, re.DOTALL)
    assert page.tags.count('script') == 1
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert ('content', "default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
            f"script-src 'sha256-{digest}'") in page.attributes


def test_what_rests_on_a_fact_is_among_the_notes(calibration, sequence, without_figures):
    known = Identifiability({'fx': 1.0}, {'aspect ratio': {'fx': 1.0, 'fy': np.inf}},
                            {'fx': 2.0}, 0.03)
    html = page_html(replace(calibration, identifiability=known), '', tracks=sequence.tracks)
    assert 'Without the stated aspect ratio, the images would not determine fy.' in html


def test_without_a_scene_there_is_no_script(calibration, sequence, without_figures):
    html = page_html(replace(calibration, motion='rotation'), '', tracks=sequence.tracks)
    assert '<script' not in html and 'script-src' not in html and '<canvas' not in html


def test_identifiers_of_figures_do_not_mix(html):
    page = Reader(html)
    names = [value for name, value in page.attributes if name == 'id']
    assert len(names) == len(set(names))
    for name, value in page.attributes:
        if value and name != 'd':
            used = re.findall(r'url\(#([^)]+)\)', value)
            used += [value[1:]] if name.endswith('href') and value.startswith('#') else []
            assert set(used) <= set(names)


def test_figures_take_the_colours_of_the_page(html):
    css = html[html.index('<style>'):html.index('</style>')]
    drawn = ''.join(re.findall(r'<svg class="plot".*?</svg>', html, re.DOTALL))
    assert drawn and not re.search('|'.join(VARIABLES), drawn, re.IGNORECASE)
    for name in re.findall(r'var\((--[a-z]+)\)', drawn + css):
        # in light, in dark, and in print
        assert css.count(f'{name}:') >= (1 if name == '--grade' else 3), name


def test_the_scene_is_that_of_the_calibration(calibration, sequence):
    colours = {3: (1, 2, 3)}
    scene = scene_of(calibration, sequence.tracks, colours)
    assert scene.colours[scene.tracks == 3].tolist() == [[1, 2, 3]]
    data = json.loads(scene.as_json())
    cameras, points = (np.frombuffer(base64.b64decode(data[name]), '<f4').reshape(-1, n)
                       for name, n in (('cameras', 12), ('points', 3)))
    assert len(cameras) == 6 and len(points) == len(scene.points) > 200
    # what the viewer gets projects to where the points were seen
    R = cameras[:, 3:].reshape(-1, 3, 3).astype(float)
    X = np.einsum('vij,vpj->vpi', R, points[None] - cameras[:, None, :3].astype(float))
    seen = calibration.camera.pixels(X[..., :2] / X[..., 2:])
    assert np.abs(seen - sequence.true_pixels[:, scene.tracks]).max() < 1e-2
    # the first camera looks ahead, and up is up
    assert cameras[0, 9] > 0.5 and (R[:, 1, 2] < 0).all()


def test_a_scene_needs_depth(calibration, sequence):
    assert scene_of(replace(calibration, motion='rotation'), sequence.tracks) is None
    shape = calibration.reconstruction
    one = replace(shape, frames=shape.frames[:1], cam_from_world=shape.cam_from_world[:1])
    assert scene_of(replace(calibration, reconstruction=one), sequence.tracks) is None
    known = scene_of(replace(calibration, motion='known-object'), sequence.tracks)
    assert known.unit == 'm' and not known.path


def test_pictures_show_used_and_rejected_tracks(calibration, sequence):
    class Source(contextlib.nullcontext):
        kind = 'images'

        def only(self, wanted):
            assert set(wanted) == set(range(6)), 'there is no need to read others'
            for index in sorted(wanted):
                yield types.SimpleNamespace(index=index, bgr=None, image=np.full(
                    sequence.tracks.image_size[::-1], 40 * index, np.uint8))

        def __enter__(self):
            return self

    xy = sequence.tracks.xy.copy()
    astray = sequence.tracks.track == 7
    xy[astray] += 30
    tracks = replace(sequence.tracks, xy=xy)
    result = replace(calibration, observation_count=len(tracks) - 6)
    pictures, colours = pictures_and_colours(result, tracks, Source)
    # four over the recording, and the two that fit worst
    assert {2, 3, 4, 5} <= {p.frame for p in pictures} and sum(p.is_worst for p in pictures) == 2
    assert [bool(p.rectified) for p in pictures] == [True] + [False] * (len(pictures) - 1)
    assert len(colours) == 300 and colours[0] == (100, 100, 100)
    for picture in pictures:
        assert picture.rejected_count >= 1 and picture.used_count > 250
        steps = np.array(re.findall(r'M(\S+) (\S+)L(\S+) (\S+?)(?=M|$)', picture.arrows), float)
        mean = np.linalg.norm(steps[:, 2:] - steps[:, :2], axis=1).mean()
        # of noise of 0.1 px a coordinate
        assert len(steps) == picture.used_count
        assert mean / picture.enlarged == pytest.approx(0.1 * np.sqrt(np.pi / 2), rel=0.15)
        place = xy[astray & (tracks.frame == picture.frame)][0]
        assert 'M{:.1f} {:.1f}h0'.format(*place) in picture.rejected
        image = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert max(image.shape) <= 1080 and abs(int(image.mean()) - 40 * picture.frame) < 2
    without, nothing = pictures_and_colours(NotCalibrated('No.'), tracks, Source)
    assert [p.frame for p in without] == [2, 3, 4, 5] and nothing == {}
    assert all(p.used_count == 300 and not p.rejected and not p.horizon for p in without)
    page = page_html(NotCalibrated('No.'), '', tracks=tracks, open_frames=Source)
    assert page.count('data:image/jpeg;base64,') == 4 and 'points that were followed' in page
    assert 'id="arrows"' not in page and 'Rectified' not in page


def test_images_that_are_gone_do_not_cost_the_report(calibration, sequence):
    def gone():
        raise InputError('drive.mcap does not exist.')
    assert pictures_and_colours(calibration, sequence.tracks, gone) == ([], {})


def test_hostile_names_are_shown_as_they_are(calibration, without_figures):
    hostile = (Finding('note', text=HOSTILE),)
    for result in (replace(calibration, findings=hostile, software=HOSTILE,
                           held_by={'skew': HOSTILE}),
                   NotCalibrated(HOSTILE, HOSTILE, frames=(1,), status={HOSTILE: HOSTILE})):
        page = Reader(page_html(result, HOSTILE, HOSTILE, notes=(HOSTILE,)))
        assert 'script' not in page.tags and 'img' not in page.tags
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


def test_a_hint_and_a_coarse_calibration_are_not_green(calibration, without_figures):
    coarse = replace(calibration, covariance=calibration.covariance * 100)
    assert (calibration.grade, coarse.grade) == ('good', 'coarse')
    refusal = NoEstimate(HINT, turned_deg=5.6, focal_px=620.0, sigma_px=30.0, hint=coarse)
    page = page_html(NotCalibrated.of(refusal), '')
    assert 'class="card hint"' in page and 'turned by 5.6 degrees' in page
    # its numbers are shown, and no file to use
    assert 'Camera matrix' in page and 'Use it' not in page and '20 degrees or more' in page


def test_own_figures_are_put_in(calibration, without_figures):
    assert '<svg id="mine"></svg>' in page_html(calibration, '', '', ('<svg id="mine"></svg>',))


def test_a_missing_folder_is_an_input_error(tmp_path, calibration, without_figures):
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


def test_coefficients_that_are_not_told_apart_need_no_fact(calibration):
    status = {**calibration.status, 'k1': 'unobservable', 'k2': 'unobservable'}
    sentence = verdict(replace(calibration, status=status))
    assert 'do not tell k1 and k2 apart' in sentence and 'fact' not in sentence


def test_field_of_view_and_its_sigma(calibration):
    rows = [row for row in parameter_rows(replace(
        calibration, camera=type(calibration.camera)(calibration.camera.K, width=800, height=600),
        covariance=np.diag([4.0] + [0] * (len(PARAMETER_NAMES) - 1)))) if row.name == 'FoV']
    # 2 atan(400 / 900), and its slope 2 · 400 / (900² + 400²) per pixel
    assert float(rows[0].value) == pytest.approx(np.degrees(2 * np.arctan(400 / 900)), abs=0.05)
    assert float(rows[0].sigma) == pytest.approx(
        np.degrees(2 * 2 * 400 / (900**2 + 400**2)), rel=0.05)


def test_facts_with_their_spread():
    lines = facts_lines(CameraFacts(aspect_ratio=1, aspect_ratio_sigma=0.01, skew=0,
                                    principal_point=(320, 240), principal_point_sigma_px=5))
    assert lines == ['aspect ratio fy / fx = 1 (σ = 0.01)', 'skew = 0 px (exact)',
                     'principal point = (320, 240) px (σ = 5 px)', 'lens model: auto']


def test_the_summary_says_where_numbers_are_from_and_how_good_they_are(calibration):
    status = {**calibration.status, 'cy': 'unobservable'}
    rows = matrix(replace(calibration, status=status))
    assert [[entry.origin for entry in row] for row in rows] == [
        ['images', 'fact', 'images'], ['definition', 'images', 'unknown'], ['definition'] * 3]
    assert (rows[0][0].value, rows[0][0].sigma) == ('900.0', '2.0')
    assert [entry.origin for entry in distortion(calibration)] == ['images'] * 2 + ['fact'] * 3
    assert (calibration.grade, replace(calibration, status=status).grade,
            NotCalibrated('No.').grade) == ('good', 'partial', 'bad')
    # half a pixel everywhere, as a rotation hides none of a change of scale alone
    one = replace(calibration, covariance=np.diag([4.0] + [0] * (len(PARAMETER_NAMES) - 1)))
    found = projection_uncertainty(one.camera, one.covariance)
    median, worst = np.median(found.sigma_px), found.sigma_px.max()
    assert 0 < median < worst < 2 * 400 / 900 * 1.2
    sentence = quality(one)
    assert f'± {worst:.1f} px at worst' in sentence or f'± {worst:.2f} px at worst' in sentence
    # a pixel is 10 m / 900 wide in the middle, and less beside it
    farthest_m = 10 * np.nanmax(found.direction_sigma_rad(one.camera))
    assert farthest_m < worst * 10 / 900
    assert f'{1000 * farthest_m:.1f} mm sideways at a range of 10 m' in sentence
    assert 'there is room' in sentence
    assert 'there is room' not in quality(replace(one, noise_sigma_px=1.0))
    assert quality(replace(one, covariance=np.full(COVARIANCE_SHAPE, np.inf))) == ''
    assert [px_text(value) for value in (0, 0.0123, 0.5, 12.3, np.inf, np.nan)] == [
        '0 px', '0.012 px', '0.50 px', '12 px', 'inf px', 'nan px']
