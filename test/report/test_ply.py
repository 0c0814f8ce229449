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
"""PLY files: what was written is what a reader of the format finds."""

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.report.ply import point_colours, write_ply
from selfcal_ros.values.tracks import Tracks

POINTS = np.array([[0, 1, 2], [3.5, -4, 5], [1e6, 0, -1]])
COLOURS = np.array([[255, 0, 10], [1, 2, 3], [0, 0, 0]], np.uint8)


def read(path):
    """Read a binary little-endian PLY of vertices by its header."""
    header, _, body = path.read_bytes().partition(b'end_header\n')
    lines = header.decode('ascii').splitlines()
    assert lines[:2] == ['ply', 'format binary_little_endian 1.0']
    count = next(int(line.split()[2]) for line in lines if line.startswith('element vertex'))
    kinds = {'float': '<f4', 'uchar': 'u1'}
    layout = [(line.split()[2], kinds[line.split()[1]]) for line in lines
              if line.startswith('property')]
    records = np.frombuffer(body, layout)
    assert len(records) == count
    return records, [line for line in lines if line.startswith('comment')]


def test_points_and_colours_survive(tmp_path):
    path = write_ply(tmp_path / 'a.ply', POINTS, COLOURS, ['unit: one\nstep', 'by ü'])
    records, comments = read(path)
    assert np.allclose(np.column_stack([records[n] for n in 'xyz']), POINTS)
    assert np.array_equal(np.column_stack([records[n] for n in ('red', 'green', 'blue')]), COLOURS)
    assert comments == ['comment unit: one step', 'comment by ?']


def test_no_colours_and_no_points_are_files_too(tmp_path):
    assert read(write_ply(tmp_path / 'a.ply', POINTS))[0].dtype.names == ('x', 'y', 'z')
    assert not len(read(write_ply(tmp_path / 'b.ply', np.zeros((0, 3))))[0])


def test_wrong_shapes_and_places_are_refused(tmp_path):
    with pytest.raises(ArgumentError):
        write_ply(tmp_path / 'a.ply', POINTS[:, :2])
    with pytest.raises(ArgumentError):
        write_ply(tmp_path / 'a.ply', POINTS, COLOURS[:2])
    with pytest.raises(InputError):
        write_ply(tmp_path / 'nowhere' / 'a.ply', POINTS)
    assert not list(tmp_path.iterdir())


def test_colours_are_those_of_the_images():
    grey = np.zeros((10, 20), np.uint8)
    grey[3, 4] = 100
    bgr = np.zeros((10, 20, 3), np.uint8)
    bgr[3, 5] = 10, 20, 50
    tracks = Tracks([0, 1, 0], [7, 7, 9], [[4.2, 3.3], [4.6, 2.8], [30.0, 3.0]])
    frames = [Frame(0, 0, grey), Frame(1, 1, grey, bgr=bgr), Frame(2, 2, grey)]
    colours = point_colours(tracks, np.array([9, 7]), frames)
    assert colours.tolist() == [[128, 128, 128], [75, 60, 55]]
