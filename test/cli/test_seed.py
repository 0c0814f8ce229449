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
"""--seed: all that is drawn at random is drawn from it, and the file of the result tells it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.calibration import calibrate as estimate
from selfcal_ros.features import extraction
from test_support.command_line import selfcal, SIZE


@pytest.fixture
def drawn(monkeypatch):
    """Record the generators that the steps of a calibration are given."""
    given = []
    for module, name in ((extraction, 'extract_tracks'), (estimate, 'calibrate')):
        def spy(*arguments, step=getattr(module, name), rng=None, **more):
            given.append(rng and rng.bit_generator.state['state'])
            return step(*arguments, rng=rng, **more)
        monkeypatch.setattr(module, name, spy)
    return given


def test_the_same_seed_gives_the_same_bytes_from_images(drawn):
    noise = np.random.default_rng(0).integers(0, 256, (160, 200), np.uint8)
    wall = cv2.GaussianBlur(noise, (5, 5), 0)
    Path('images').mkdir()
    for k in range(4):
        cv2.imwrite(f'images/{k}.png', wall[:120, :160])
    # nothing moves, which is no calibration: what is drawn is drawn all the same
    command = ['calibrate', 'images', '--max-keyframes', '3', '-q', '--seed', '7', '--json']
    for name in ('a.json', 'b.json'):
        assert selfcal(*command, name) == 1
    assert Path('a.json').read_bytes() == Path('b.json').read_bytes()
    assert json.loads(Path('a.json').read_text(encoding='utf-8'))['seed'] == 7
    of_seven = np.random.default_rng(7).bit_generator.state['state']
    assert drawn == [of_seven] * 4


def test_a_result_tells_its_seed_and_an_impossible_one_is_a_sentence(driven, capsys, drawn):
    assert selfcal('calibrate', driven[0], *SIZE, '-q', '--json', 'r.json') == 0
    assert json.loads(Path('r.json').read_text(encoding='utf-8'))['seed'] == 0
    # the fixed one of before there was a choice
    assert drawn == [None]
    for seed in ('-1', '1.5', 'x', '9' * 5000, '4294967296'):
        assert selfcal('calibrate', driven[0], f'--seed={seed}') == 2
        assert 'no whole number from 0' in capsys.readouterr().err
