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
"""A part of a recording: --start, --duration and --every on every kind of input."""

import cv2
import numpy as np
import pytest
from selfcal_ros.cli.main import main
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
from selfcal_ros.pipeline.excerpt import Excerpt, Reading
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.sources import open_source

#: Two seconds at 10 Hz; each image tells its number by its brightness.
COUNT, RATE_HZ = 20, 10


def _image(index):
    return np.full((64, 80), 10 + 10 * index, np.uint8)


@pytest.fixture(scope='module', params=['bag', 'jpeg', 'folder', 'video'])
def recording(request, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / 'drive'
    if request.param == 'folder':
        path.mkdir()
        for index in range(COUNT):
            cv2.imwrite(str(path / f'{index}.png'), _image(index))
        return path, 30
    if request.param == 'video':
        path = path.with_suffix('.avi')
        video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), RATE_HZ, (80, 64))
        for index in range(COUNT):
            video.write(cv2.cvtColor(_image(index), cv2.COLOR_GRAY2BGR))
        video.release()
        return path, RATE_HZ
    write_image_bag(path, (Frame(index, 10 ** 18 + index * 10 ** 9 // RATE_HZ, _image(index))
                           for index in range(COUNT)),
                    compressed='jpeg' if request.param == 'jpeg' else None)
    return path, RATE_HZ


def _numbers(frames):
    """Return the numbers that the images show, which must be those that they claim."""
    found = [(frame.index, round((frame.image.mean() - 10) / 10)) for frame in frames]
    assert all(claimed == shown for claimed, shown in found)
    return [claimed for claimed, _ in found]


@pytest.mark.parametrize('start, count, every, expected', [
    (0, None, 1, range(COUNT)), (5, None, 1, range(5, COUNT)), (0, 7, 1, range(7)),
    (3, 9, 4, (3, 7, 11)), (15, 100, 2, (15, 17, 19)), (COUNT - 1, 1, 5, (COUNT - 1,))])
def test_what_is_asked_for_is_read(recording, start, count, every, expected):
    path, rate_hz = recording
    excerpt = Excerpt(start / rate_hz, None if count is None else count / rate_hz, every)
    with open_source(path, excerpt=excerpt) as source:
        assert _numbers(source) == _numbers(source) == list(expected)
        assert abs(source.count - len(expected)) <= 1 and source.image_size == (80, 64)
        # what was not chosen is not there, and the rest is not read in between
        assert _numbers(source.only([18, 7, 3, 500])) == [k for k in (3, 7, 18) if k in expected]
        assert not list(source.only([]))


def test_one_stamp_far_ahead_ends_nothing():
    stamps = 10**18 + 10**9 // RATE_HZ * np.arange(60)
    stamps[4] += 3600 * 10**9
    reading, used = Reading(Excerpt(0, 1.0)), []
    for index, stamp in enumerate(stamps):
        if reading.uses(index, int(stamp)):
            used.append(index)
        elif reading.is_over(index):
            break
    assert used == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    # images may be a second out of order, and ten in a row are beyond that
    assert index == 30


@pytest.mark.parametrize('half, rows, columns', [
    ('left', slice(0, 65), slice(0, 81)), ('right', slice(0, 65), slice(82, 163)),
    ('top', slice(0, 32), slice(0, 163)), ('bottom', slice(33, 65), slice(0, 163))])
def test_half_of_each_image_is_read_in_grey_and_in_colour(tmp_path, half, rows, columns):
    image = np.random.default_rng(0).integers(0, 255, (65, 163, 3), np.uint8)
    for index in range(2):
        cv2.imwrite(str(tmp_path / f'{index}.png'), image)
    with open_source(tmp_path, colour=True, excerpt=Excerpt(half=half)) as source:
        frame = list(source)[1]
        assert source.image_size == frame.image.shape[::-1]
        assert f'{half} half' in source.description
    with open_source(tmp_path) as source:
        whole = next(iter(source)).image
    assert np.array_equal(frame.bgr, image[rows, columns])
    assert np.array_equal(frame.image, whole[rows, columns])


@pytest.mark.parametrize('start_s', [2.05, 3.5, 1e6])
def test_a_start_beyond_the_end_is_one_sentence(recording, start_s):
    path, rate_hz = recording
    with pytest.raises(InputError, match=r'lasts [01]\.[0-9] s, so there is no image') as caught:
        with open_source(path, excerpt=Excerpt(start_s=start_s)) as source:
            list(source)
    assert str(caught.value).endswith('begin earlier.')


@pytest.mark.parametrize('arguments', [
    {'start_s': -1.0}, {'start_s': float('nan')}, {'duration_s': 0.0},
    {'duration_s': float('inf')}, {'every': 0}])
def test_impossible_numbers_are_refused(arguments):
    with pytest.raises(ArgumentError, match='must be'):
        Excerpt(**arguments)


def test_a_half_that_there_is_not_is_refused():
    with pytest.raises(ArgumentError, match='one of left, right, top, bottom'):
        Excerpt(half='middle')


def test_the_command_takes_the_part(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'tracks.csv').write_text('frame,track,x,y\n0,0,1,1\n1,0,2,2\n')
    assert main(['calibrate', 'tracks.csv', '--start', '1']) == 2
    assert 'is a table of tracks' in capsys.readouterr().err
    assert main(['calibrate', 'tracks.csv', '--half', 'left']) == 2
    assert 'is a table of tracks' in capsys.readouterr().err
    assert main(['calibrate', 'tracks.csv', '--every', '0']) == 2
    write_image_bag('whole', (Frame(k, k * 10 ** 8, _image(k)) for k in range(COUNT)))
    assert main(['calibrate', 'whole', '--start', '7']) == 2
    assert 'lasts 1.9 s' in capsys.readouterr().err
    assert main(['convert', 'whole', 'part', '--start', '0.5', '--duration', '1',
                 '--every', '3']) == 0
    with open_source('part') as source:
        assert [round((frame.image.mean() - 10) / 10) for frame in source] == [5, 8, 11, 14]
    assert CalibrationSettings().excerpt.is_whole
