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
"""A short look at bad inputs, in this process; the bench runs thousands of them."""

from bench.hostile import hostile_calls
from bench.hostile.hostile_cases import damaged, draw, READERS
import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, Tracks
from selfcal_ros.errors import SelfcalError
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.report.camera_files.formats import read_camera, write_camera
from selfcal_ros.values.output_files import atomic_write
from test_support.command_line import selfcal


def test_messages_and_arguments_of_any_values():
    for seed in range(150):
        name, call = hostile_calls.draw(np.random.default_rng((1, seed)))
        if name in ('image', 'compressed', 'camera_info', 'cloud'):
            try:
                call()
            except SelfcalError as error:
                assert str(error).endswith('.')


@pytest.mark.parametrize('kind, name', [
    ('ros', 'c.yaml'), ('opencv', 'c.xml'), ('mrcal', 'c.cameramodel'), ('colmap', 'c.txt'),
    ('colmap', 'c.bin'), ('kalibr', 'camchain.yaml'), ('opencv', 'o.yaml')])
def test_damaged_camera_files_are_a_camera_or_a_sentence(tmp_path, kind, name):
    camera = Camera([[200, 0, 80], [0, 200, 60], [0, 0, 1]], (-0.1, 0.01, 0, 0, 0), 160, 120)
    path = tmp_path / name
    write_camera(path, kind, camera)
    good = path.read_bytes()
    for seed in range(40):
        path.write_bytes(damaged(good, np.random.default_rng((2, seed)))[1])
        try:
            read_camera(path)
        except SelfcalError as error:
            assert str(error).endswith(('.', '`')) and '\n' not in str(error)


def test_cases_are_drawn_of_every_kind():
    kinds = {draw(np.random.default_rng((3, seed))).kind for seed in range(1500)}
    assert {f'file: {name}' for name, _ in READERS} < kinds
    assert {'full disk', 'options: track', 'call: degenerate'} < kinds


def test_equations_without_a_solution_are_a_refusal(monkeypatch):
    def singular(*_, **__):
        return np.linalg.solve(np.zeros((2, 2)), np.ones(2))

    monkeypatch.setattr('selfcal_ros.calibration.calibrate.build_view_graph', singular)
    result = calibrate(Tracks([0, 1, 2], [0, 0, 0], 50 * np.eye(3, 2), (640, 480)))
    assert not result and result.kind == 'equations_singular'


def test_a_full_disk_leaves_no_part_of_a_bag_or_a_file(tmp_path):
    resource = pytest.importorskip('resource')
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    frames = [Frame(k, k, np.zeros((60, 80), np.uint8)) for k in range(30)]
    for storage in ('mcap', 'sqlite3'):
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, before[1]))
        try:
            with pytest.raises(SelfcalError, match='cannot be written'):
                write_image_bag(tmp_path / 'bag', frames, storage=storage)
            with pytest.raises(SelfcalError, match='cannot be written'):
                atomic_write(tmp_path / 'file', bytes(40_000))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert not list(tmp_path.iterdir())


def test_clicks_are_no_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert selfcal('track', 'nowhere.mcap', '--camera', 'no.yaml', '--model', 'no.cao', '--init',
                   'x.init', '--clicks', *'1234') == 2
    assert 'no.yaml cannot be read' in capsys.readouterr().err
