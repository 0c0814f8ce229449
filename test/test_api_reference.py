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
"""The references of the Python interface and of the command line name what there is."""

from enum import Enum
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
import inspect
from pathlib import Path
import re

import pytest

import selfcal_ros

DOCS = Path(__file__).resolve().parents[1] / 'docs'


def script(name):
    """Return a script of the documents as a module."""
    spec = spec_from_file_location(name, DOCS / f'{name}.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def make_api():
    return script('make_api')


def test_the_man_page_is_what_the_parsers_say():
    written = (DOCS / 'selfcal.1').read_text(encoding='utf-8')
    assert written == script('make_man').page(), 'run: PYTHONPATH=. python docs/make_man.py'


def test_the_reference_is_what_the_docstrings_say(make_api):
    written = (DOCS / 'api.md').read_text(encoding='utf-8')
    assert written == make_api.page(), 'run: PYTHONPATH=. python docs/make_api.py'


def headings(text):
    return re.findall(r'^#{2,3} (\S+)$', text, re.M)


def test_the_reference_has_every_public_name_and_says_something_of_each(make_api, tmp_path):
    assert make_api.main(['--output', str(tmp_path / 'api.md')]) == 0
    text = (tmp_path / 'api.md').read_text(encoding='utf-8')
    for name in selfcal_ros.__all__:
        assert name.startswith('__') or name in headings(text)
    for entry in re.split(r'^### ', text, flags=re.M)[1:]:
        said = entry.split('```', 2)[2]
        assert len(said.strip()) > 15, f'{entry.splitlines()[0]} has no docstring'
    assert '0x' not in text and str(Path.home()) not in text


def test_every_parameter_of_the_interface_has_a_type(make_api):
    assert '](#' in make_api.page()
    for name in make_api.MODULES:
        module = import_module(name)
        for public in make_api.public_names(module):
            value = getattr(module, public)
            members = vars(value).values() if inspect.isclass(value) else [value]
            if inspect.isclass(value) and issubclass(value, (Enum, Exception)):
                continue
            for one in [value, *members]:
                one = one.fget if isinstance(one, property) else getattr(one, '__func__', one)
                if one is not value and (not inspect.isfunction(one) or not one.__doc__
                                         or one.__name__.startswith('_')):
                    continue
                signature = inspect.signature(one)
                bare = [p.name for p in signature.parameters.values()
                        if p.annotation is p.empty and p.name not in ('self', 'cls')]
                assert not bare, f'{name}.{public}: {bare} of {one.__name__} have no type'
                assert inspect.isclass(one) or signature.return_annotation is not signature.empty


def test_signatures_show_types(make_api):
    def short(path: str | Path, *rest: int, deep: bool = False) -> list[str]:
        pass
    assert make_api._signature('short', short) in (
        'short(path: str | pathlib.Path, *rest: int, deep: bool = False) -> list[str]',
        'short(path: str | Path, *rest: int, deep: bool = False) -> list[str]')
    text = make_api.page()
    assert '    tracks: Tracks,\n    *,\n    motion: str = \'auto\',\n' in text
    assert ') -> Calibration | NotCalibrated' in text and '<factory>' not in text
    assert '**`sigma: dict[str, float]`**' in text
    # what a reader sees in docs
    assert ') -> Calibration | NotCalibrated' in (DOCS / 'api.md').read_text(encoding='utf-8')


def test_the_page_in_docs_names_what_there_is(make_api):
    written = (DOCS / 'api.md').read_text(encoding='utf-8')
    assert headings(written) == headings(make_api.page()), 'run: python docs/make_api.py'
