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
What the documents name exists: files, commands, options, topics, parameters and words of code.

Documents are those beside README.md, docs/ (but for api.md, made from docstrings), bench/,
bags/ and examples/. A name counts where it is set as code.
"""

import argparse
import ast
from dataclasses import fields
from functools import cache
from importlib.util import find_spec
from pathlib import Path
import re

import pytest
from selfcal_ros.cli import main as command_line
from selfcal_ros.nodes.interfaces import INTERFACES
from test_support.syntax_trees import trees_in

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted(
    path for path in [*(ROOT / 'docs').rglob('*.md'), *(ROOT / 'bench').rglob('*.md'),
                      *(ROOT / 'examples').glob('*.md'), *(ROOT / 'bags').glob('*.md'),
                      *ROOT.glob('*.md')]
    if path.name != 'api.md')
SOURCES = ('selfcal_ros', 'msg_adapters', 'launch', 'config', 'bench', 'test', 'test_support',
           'docs', 'examples', 'scripts', 'bags')
#: Names of other people's programs, message fields and libraries that the documents use.
FOREIGN = {
    # ROS and its packages
    'camera_info_manager', 'camera_calibration', 'camera_calibration_parsers',
    'camera_info_url', 'image_pipeline', 'image_proc',
    'image_geometry', 'nav2_lifecycle_manager', 'python3-opencv', 'rviz2',
    'rectify_node', 'launch_ros', 'set_camera_info', 'ament_copyright', 'ament_xmllint',
    'ament_flake8', 'ament_pep257', 'cv_bridge', 'ros2', 'rosdep', 'colcon', 'binning_x',
    'binning_y', 'roi', 'tf2_msgs', 'rclpy', 'rosbags', 'rosbag2',
    # other programs
    'pycolmap', 'calibrateCamera', 'calibrateCameraRO', 'VideoCapture', 'chrt', 'dask', 'radtan',
    'cv2', 'pip', 'fov', 'make', 'mypy', 'flake8', 'pytest', 'mkdocs', 'pre_commit', 'matplotlib',
    # names that a reader replaces by his own
    'my_bag',
    # environment
    'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS', 'ROS_LOCALHOST_ONLY',
    'ROS_AUTOMATIC_DISCOVERY_RANGE', 'OMP_NUM_THREADS', 'AMENT_PREFIX_PATH', 'ROS_HOME',
}
#: What others' commands take; a line of code that starts with them is not ours.
OTHERS_COMMANDS = ('ros2 bag', 'ros2 topic', 'ros2 pkg', 'pip', 'dask', 'rosdep', 'colcon', 'git',
                   'export', 'ros2 run image_proc', 'python -m venv', 'pre-commit', 'ruff',
                   'evo_traj', 'colmap', 'ns-train', 'bloom-release', 'twine', 'sudo')
OTHERS_OPTIONS = {'--ros-args', '--share', '--once', '--symlink-install', '--from-paths',
                  '--strict', '--update', '--max-worker-restart', '--dist'}


def _text(path):
    """Read a page without the tables that a program writes into it."""
    text = path.read_text(encoding='utf-8')
    return re.sub(r'<!-- (\w+:\w+) -->.*?<!-- /\1 -->', '', text, flags=re.S)


def _code(text):
    """List what is set as code: words between backticks, and lines of blocks."""
    lines, inside, blocks, prose = text.splitlines(), False, [], []
    for line in lines:
        if line.strip().startswith('```'):
            inside = not inside
        elif inside or (line.startswith('    ') and not re.match(r'\s*([-*]|\d+\.) ', line)):
            blocks.append(line.strip())
        else:
            prose.append(line)
    return re.findall(r'`([^`\n]+)`', '\n'.join(prose)), blocks


@cache
def _files():
    """List the files of the project, without what builds leave behind."""
    found = [path for folder in SOURCES for path in (ROOT / folder).rglob('*') if path.is_file()]
    found += [path for path in ROOT.iterdir() if path.is_file()]
    found += [path for folder in ('.ci', '.github') for path in (ROOT / folder).rglob('*')]
    return ['/' + path.relative_to(ROOT).as_posix() for path in found
            if '__pycache__' not in path.parts]


@cache
def _words():
    """Collect every word of the sources."""
    words = set()
    for name in _files():
        if name.endswith(('.py', '.yaml', '.yml', '.xml', '.toml', '.cfg', '.rviz', '.json', '.j2',
                          'Makefile', '.js', '.cpp')) and not name.startswith('/test/docs/'):
            words |= set(re.findall(r'[A-Za-z_]\w*', (ROOT / name[1:]).read_text('utf-8')))
    return words


@cache
def _options():
    """Collect the options of every program of ours: of `selfcal` by verb, of others by name."""
    options = {}
    for verb in command_line.VERBS:
        parser = command_line.build_parser(verb)
        chosen = next(action for action in parser._actions
                      if isinstance(action, argparse._SubParsersAction)).choices[verb]
        options[verb] = set(chosen._option_string_actions) | {'--version'}
    for name in _files():
        if name.startswith(('/bench/', '/docs/', '/bags/', '/examples/', '/selfcal_ros/nodes/',
                            '/test/')) and name.endswith('.py'):
            options[name] = set(re.findall(r"add_argument\(\s*'(--[\w-]+)'",
                                           (ROOT / name[1:]).read_text('utf-8')))
    return options


@cache
def _parameters():
    """Collect the parameters of the nodes, and the arguments of the launch files."""
    tables = pytest.importorskip('selfcal_ros.nodes.parameters')
    found = {field.name for table in vars(tables).values() if isinstance(table, type)
             and hasattr(table, '__dataclass_fields__') for field in fields(table)}
    for path in (ROOT / 'launch').glob('*.py'):
        for node in ast.walk(ast.parse(path.read_text('utf-8'))):
            if isinstance(node, ast.Dict):
                found |= {key.value for key in node.keys if isinstance(key, ast.Constant)}
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == 'DeclareLaunchArgument':
                found |= {getattr(node.args[0], "value", None)}
    return found


def _topics():
    return {end.name for ends in INTERFACES.values() for end in ends}


def _named(pattern, pick=0, blocks=True):
    """Pair every name that a document sets as code, also in blocks, with the document."""
    return sorted({(str(path.relative_to(ROOT)), found[pick])
                   for path in DOCUMENTS for group in _code(_text(path))[:2 if blocks else 1]
                   for piece in group for found in re.finditer(pattern, piece)})


def _check(names, exists):
    missing = [f'{document}: {name}' for document, name in names if not exists(name)]
    assert not missing, '\n'.join(missing)


def test_every_file_exists():
    names = _named(r'(?<![\w.~$/*])[\w./-]*\w\.(?:py|xml|rviz|cpp|cff|toml|cfg|rst)\b')
    names = [(document, name.removeprefix('./')) for document, name in names
             if not re.match(r'camera\.(?:xml|launch\.py)|\w+/\w+\.xml', name)]
    assert len(names) > 20
    _check(names, lambda name: any(
        file.endswith('/' + name.removeprefix('../').lstrip('/')) for file in _files()))


def test_every_folder_exists():
    names = _named(r'^(?:docs|bench|test|selfcal_ros|config|launch|examples|bags|'
                   r'msg_adapters)/(?:[\w/]*/)?$')
    _check(names, lambda name: (ROOT / name).is_dir())


def test_every_option_of_selfcal_exists():
    options = _options()
    known = set().union(*options.values()) | OTHERS_OPTIONS
    missing = []
    for path in DOCUMENTS:
        inline, blocks = _code(_text(path))
        for piece in inline + blocks:
            line = re.sub(r'\s#.*', '', piece)
            if line.startswith(OTHERS_COMMANDS):
                continue
            verb = re.match(r'selfcal (\w+)', line)
            if verb:
                assert verb[1] in options, f'{path}: {line}'
            allowed = options[verb[1]] if verb else known
            missing += [f'{path.name}: {option} in {line!r}'
                        for option in re.findall(r'(?<![\w-])--[a-z][\w-]*', line)
                        if option not in allowed]
    assert not missing


def test_every_option_outside_of_code_exists_too():
    known = set().union(*_options().values()) | OTHERS_OPTIONS
    for path in DOCUMENTS:
        prose = re.sub(r'`[^`\n]*`|^    .*$', '', _text(path), flags=re.M)
        for option in re.findall(r'(?<![\w-])--[a-z][\w-]+', prose):
            assert option in known, f'{path}: {option}'


def test_every_option_of_selfcal_is_on_a_page():
    written = '\n'.join(_text(path) for path in DOCUMENTS if path.name != 'troubleshooting.md')
    named = set(re.findall(r'(?<![\w-])--[a-z][\w-]*', written))
    options = {option for verb in command_line.VERBS for option in _options()[verb]
               if option.startswith('--')}
    assert not options - named - {'--help', '--version'}


def test_every_topic_and_service_exists():
    names = [(document, name) for document, name in _named(r'^~/\w[\w/]*$')]
    assert len(names) > 5
    _check(names, _topics().__contains__)


def test_every_parameter_that_is_set_exists():
    names = _named(r'(?:ros2 param set /\w+ |-p )(\w+)', 1)
    names += _named(r'^ros2 launch .*?\.py((?: \w+:=\S+)+)', 1)
    pairs = [(document, word) for document, text in names
             for word in re.findall(r'(\w+):=', text) or [text]]
    assert len(pairs) > 5
    _check(pairs, _parameters().__contains__)


def test_every_executable_launch_file_and_target_exists():
    executables = {path.name for path in (ROOT / 'scripts').iterdir()}
    _check(_named(r'ros2 run selfcal_ros (\w+)', 1), executables.__contains__)
    _check(_named(r'ros2 launch selfcal_ros ([\w.]+)', 1),
           lambda name: (ROOT / 'launch' / name).exists())
    targets = set(re.findall(r'^([\w-]+):', (ROOT / 'Makefile').read_text('utf-8'), re.M))
    _check(_named(r'^make ([a-z][\w-]*)', 1), targets.__contains__)


def test_every_bench_and_module_that_is_run_exists():
    from bench.__main__ import BENCHES
    named = [(document, name) for document, text in _named(r'python -m bench((?: [a-z]\w*)+)', 1)
             for name in text.split()]
    assert len(named) > 3
    _check(named, BENCHES.__contains__)
    modules = [(document, name) for document, name in _named(r'python -m ([\w.]+)', 1)
               if name.startswith(('selfcal_ros', 'bench'))]
    _check(modules, lambda name: find_spec(name) is not None)


def test_every_kind_of_finding_exists():
    from selfcal_ros.findings.finding import KINDS
    _check(_kinds(), KINDS.__contains__)


def _kinds():
    """List what documents call a kind: `kind` before it, as in JSON or in a sentence."""
    pairs = []
    for path in DOCUMENTS:
        pairs += [(path.name, name) for name in re.findall(
            r'(?:\bkinds? |"kind": ")`?([a-z]+(?:_[a-z]+)+)[`"]', _text(path))]
    return pairs


def test_every_work_that_is_cited_is_in_the_references():
    entries = re.split(r'^- ', (ROOT / 'docs' / 'references.md').read_text('utf-8'), flags=re.M)
    cited = set()
    for name in _files():
        if name.endswith(('.py', '.md')) and not name.startswith(('/test', '/docs/references')):
            text = re.sub(r'\s+#?\s*', ' ', (ROOT / name[1:]).read_text('utf-8'))
            cited |= {(name, *found) for found in re.findall(
                r'\b([A-Z][a-zšćé]+)(?: et al\.)?,? \(?((?:19[5-9]|20[012])\d)\b', text)
                if found[0] not in ('Oxford', 'Copyright', 'Measured')}
    assert len({one[1:] for one in cited}) > 15
    _check([(name, f'{author} {year}') for name, author, year in sorted(cited)],
           lambda work: any(all(word in entry for word in work.split()) for entry in entries))


def test_every_word_of_code_exists():
    names = [(document, name) for document, name in _named(
        r'(?<![\w/.~$:<-])[A-Za-z]\w*(?:_\w+|[a-z][A-Z]\w+)(?![\w/:.-])', blocks=False)]
    assert len(names) > 100
    known = _words() | FOREIGN
    data = {path.name for path in (ROOT.parent / 'shared' / 'data').glob('*')}
    _check(names, lambda name: name in known | data)


def test_what_is_said_to_be_in_a_file_is_there():
    pairs = [(path.name, *found) for path in DOCUMENTS for found in re.findall(
        r'`(\w+)`\s+(?:of|in)\s+`([\w/]+\.py)`', _text(path))]
    assert len(pairs) > 5
    for document, word, file in pairs:
        texts = [(ROOT / name[1:]).read_text('utf-8') for name in _files()
                 if name.endswith('/' + file)]
        assert any(re.search(rf'\b{word}\b', text) for text in texts), (document, word, file)


def test_every_member_of_a_module_exists():
    homes = {}
    for path, tree in trees_in(ROOT / 'selfcal_ros', ROOT / 'msg_adapters').items():
        homes.setdefault(path.stem, set()).update(
            getattr(node, 'id' if isinstance(node, ast.Name) else 'name', None)
            for node in ast.walk(tree))
    missing = []
    for document, name in _named(r'^(?:[a-z_]+\.)*([a-z_]+\.\w+)(?=\(|$)', 1):
        module, member = name.split('.')
        if module in homes and '.' + member not in ('.py', '.md', '.json', '.yaml', '.html') \
                and member not in homes[module] | {Path(member).stem} and member not in homes:
            missing.append(f'{document}: {name}')
    assert not missing
