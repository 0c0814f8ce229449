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
"""Every test of the command line writes into a folder of its own; tracks of a drive for all."""

import numpy as np
import pytest
from selfcal_ros.cli import progress
from selfcal_ros.synthetic.special_scenes import drive


@pytest.fixture(scope='session')
def driven(tmp_path_factory):
    """Write the tracks of a drive; returns the file and the true camera."""
    sequence = drive(np.random.default_rng(3), noise_px=0.1, views=12, tracks=250)
    path = tmp_path_factory.mktemp('drive') / 'tracks.csv'
    sequence.tracks.to_csv(path)
    return path, sequence.camera


@pytest.fixture
def without_figures(monkeypatch):
    """Spare the time of figures where it matters only that a report is written."""
    monkeypatch.setattr('selfcal_ros.report.figures.draw_figures', lambda *_: [])


@pytest.fixture(autouse=True)
def in_tmp(tmp_path, monkeypatch):
    """Let default outputs land in the temporary folder, and slow machines say nothing of it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(progress, 'PATIENCE_S', 1e9)
