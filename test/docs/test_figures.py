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
"""The figures of the documents can be drawn again, and name files that exist."""

from importlib.util import module_from_spec, spec_from_file_location
import os
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from matplotlib.figure import Figure
import pytest

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / 'docs' / 'images'
NAMES = re.findall(r"^    '(\w+)': \(", (ROOT / 'docs' / 'make_figures.py').read_text('utf-8'),
                   re.M)


def _draw(folder, *names):
    done = subprocess.run(
        [sys.executable, 'docs/make_figures.py', '--output-dir', str(folder), *names], cwd=ROOT,
        env={**os.environ, 'PYTHONPATH': str(ROOT)}, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr


def test_every_figure_is_in_docs_and_on_a_page():
    pages = ''.join(path.read_text('utf-8') for path in (ROOT / 'docs').rglob('*.md'))
    assert len(NAMES) >= 6
    for name in NAMES:
        assert (IMAGES / f'{name}.svg').is_file()
        assert f'images/{name}.svg' in pages, f'no page shows {name}'


@pytest.fixture(scope='module')
def drawn(tmp_path_factory):
    """All figures, drawn once."""
    folder = tmp_path_factory.mktemp('drawn')
    _draw(folder)
    return folder


@pytest.mark.long
def test_all_can_be_drawn(drawn):
    for name in NAMES:
        old, new = (ElementTree.parse(folder / f'{name}.svg').getroot()
                    for folder in (IMAGES, drawn))
        assert old.get('viewBox') == new.get('viewBox'), f'{name}: docs/make_figures.py'


@pytest.mark.long
def test_the_same_is_drawn_twice(drawn, tmp_path):
    names = ('house', 'profile_likelihood')
    _draw(tmp_path, *names)
    for name in names:
        assert (drawn / f'{name}.svg').read_bytes() == (tmp_path / f'{name}.svg').read_bytes()


def _loaded(path):
    spec = spec_from_file_location(f'loaded_{path.stem}', path)
    # dataclasses look their module up there
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_house_has_the_storeys_that_the_test_of_layers_holds():
    storeys = _loaded(ROOT / 'test' / 'test_layers.py').STOREY
    boxes = _loaded(ROOT / 'docs' / 'diagrams.py').house(Figure()).boxes
    assert set(boxes) == set(storeys) - {'errors', 'version'} | {'adapters'}
    height = {name: boxes[name][1] for name in boxes if name != 'adapters'}
    for one in height:
        for other in height:
            assert (height[one] > height[other]) == (storeys[one] > storeys[other]), (one, other)


def test_every_file_and_folder_of_a_diagram_exists():
    text = (ROOT / 'docs' / 'diagrams.py').read_text(encoding='utf-8')
    text = text.split('def house')[1].replace('\\n', ' ')
    named = set(re.findall(r'(?<![\w.])[\w/]+(?:\.py|/)(?!\w)', text))
    assert len(named) > 20
    parts = [ROOT, ROOT / 'selfcal_ros', ROOT / 'selfcal_ros' / 'calibration',
             ROOT / 'selfcal_ros' / 'rorapid']
    assert not [name for name in named if not any((part / name).exists() for part in parts)]
