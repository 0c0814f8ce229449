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
"""
What `ament_*` finds, where these linters are installed: in a ROS 2 workspace.

Left out, each for a reason: D417 wants a sentence for each parameter, also where name and type
say it all (numpydoc does not); D401 takes nouns before properties and attributes for verbs.
"""

from pathlib import Path
import shutil

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: As packages are copied: without what builds leave behind.
PARTS = [str(ROOT / name) for name in ('selfcal_ros', 'msg_adapters', 'launch', 'bench', 'test',
                                       'setup.py')]


@pytest.mark.linter
@pytest.mark.copyright
def test_every_file_has_a_licence():
    main = pytest.importorskip('ament_copyright.main').main
    assert main(argv=PARTS) == 0


@pytest.mark.linter
@pytest.mark.flake8
def test_flake8_with_the_plug_ins_of_ament():
    module = pytest.importorskip('ament_flake8.main')
    # what the package's own configuration leaves to ament's
    status, errors = module.main_with_errors(argv=['--config', str(ROOT / '.flake8'), *PARTS])
    assert status == 0, '\n'.join(errors)


@pytest.mark.linter
@pytest.mark.pep257
def test_docstrings():
    main = pytest.importorskip('ament_pep257.main').main
    assert main(argv=[*PARTS, '--add-ignore', 'D401', 'D417']) == 0


@pytest.mark.linter
@pytest.mark.xmllint
def test_xml_is_well_formed_and_package_xml_fits_its_schema():
    main = pytest.importorskip('ament_xmllint.main').main
    if not shutil.which('xmllint'):
        pytest.skip('xmllint is not installed')
    assert main(argv=[str(ROOT / 'package.xml'), str(ROOT / 'config' / 'fastdds.xml')]) == 0
