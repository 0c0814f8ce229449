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
Write the reference of the Python interface from its docstrings: `python docs/make_api.py`.

What stands here is what QUALITY_DECLARATION.md promises to keep.
"""

from __future__ import annotations

import argparse
from enum import Enum
from importlib import import_module
import inspect
from pathlib import Path
import re
import sys

from selfcal_ros.values.output_files import atomic_write

HERE = Path(__file__).resolve().parent
#: Modules whose public names are the interface, in the order of the page, and what they are for.
MODULES = {
    'selfcal_ros': 'Calibration: tracks in, a camera with its covariance out.',
    'selfcal_ros.errors': 'What is raised. A failure of the data is a value, not an exception.',
    'selfcal_ros.pipeline.sources': 'Images of bags, folders and videos.',
    'selfcal_ros.pipeline.feature_session': 'Tracks of what these images show.',
    'selfcal_ros.report.camera_yaml': 'Camera files of ROS.',
    'selfcal_ros.rorapid.model': 'Models of objects to track.',
    'selfcal_ros.rorapid.tracker': 'The object tracker.',
    'msg_adapters.camera_info': 'CameraInfo and back.',
    'msg_adapters.image': 'Images and back, without cv_bridge.',
    'msg_adapters.tracks': 'Tracks as PointCloud2.',
    'msg_adapters.clouds': 'Point clouds.',
    'msg_adapters.poses': 'Poses and paths.',
    'msg_adapters.markers': 'Markers for viewers.',
    'msg_adapters.diagnostics': 'Diagnostics.',
    'msg_adapters.stamps': 'Times and headers.',
    'msg_adapters.message_types': 'Builders of messages, of rclpy or of rosbags.',
}
#: A longer signature has a line for every parameter.
WIDTH = 88
#: A longer default is cut.
LONGEST_DEFAULT = 40
_SECTION = re.compile(r'^([A-Z]\w+)\n-{3,}$', re.M)


def public_names(module) -> list[str]:
    """List what a module has for others: __all__, or what it defines without an underscore."""
    names = getattr(module, '__all__', None)
    if names is None:
        names = [name for name, value in vars(module).items()
                 if not name.startswith('_') and (inspect.isclass(value)
                                                  or inspect.isfunction(value))
                 and value.__module__ == module.__name__]
    return sorted((name for name in names if not name.startswith('_')
                   and callable(getattr(module, name))), key=str.lower)


def page() -> str:
    """Return the reference as Markdown."""
    parts = ['# Python interface\n', 'Made from the docstrings by `python docs/make_api.py`; do '
             'not edit. Pixels, frames and units are those of [conventions.md](conventions.md).\n']
    modules = {name: import_module(name) for name in MODULES}
    for name in modules:
        parts.append(f'- [`{name}`](#{name.replace(".", "")}): {MODULES[name]}')
    for name, module in modules.items():
        parts.append(f'\n## {name}\n\n{MODULES[name]}')
        parts += [_entry(public, getattr(module, public)) for public in public_names(module)]
    return '\n'.join(parts) + '\n'


def _entry(name: str, value) -> str:
    """Describe a class with its methods, or a function."""
    lines = [f'\n### {name}\n', '```python', _signature(name, value, WIDTH), '```', '',
             _text(value)]
    if inspect.isclass(value):
        for member, raw in sorted(vars(value).items()):
            inner = raw.fget if isinstance(raw, property) else getattr(raw, '__func__', raw)
            inner = getattr(inner, 'func', inner)
            if member.startswith('_') or not inspect.isfunction(inner) or not inner.__doc__:
                continue
            kind = isinstance(raw, property) or not inspect.isfunction(
                getattr(raw, '__func__', raw))
            title = _attribute(member, inner) if kind else _signature(member, inner)
            lines += ['', f'**`{title}`**', '', _text(inner)]
    return '\n'.join(lines)


def _signature(name: str, value, width: int = 0) -> str:
    """
    Write how something is called, with the types of its parameters and of what it returns.

    Where that is longer than a width, every parameter has a line; a width of 0 keeps one line.
    """
    if inspect.isclass(value) and issubclass(value, Enum):
        return name
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return name
    mine, last = [], None
    for one in signature.parameters.values():
        if one.name in ('self', 'cls'):
            continue
        if one.kind is one.KEYWORD_ONLY and last not in (one.KEYWORD_ONLY, one.VAR_POSITIONAL):
            mine.append('*')
        last = one.kind
        mine.append(_parameter(one))
    returned = signature.return_annotation
    end = ')' if inspect.isclass(value) or returned is signature.empty else (
        f') -> {_annotation(returned)}')
    line = f'{name}({", ".join(mine)}{end}'
    if width and len(line) > width:
        line = ',\n    '.join([f'{name}(\n    {mine[0]}', *mine[1:]]) + f',\n{end}'
    # addresses in reprs would differ from run to run
    return re.sub(r' at 0x[0-9a-f]+', '', line)


def _attribute(name: str, getter) -> str:
    """Write a property with its type."""
    returned = inspect.signature(getter).return_annotation
    return name if returned is inspect.Signature.empty else f'{name}: {_annotation(returned)}'


def _parameter(one: inspect.Parameter) -> str:
    """Write a parameter with its type and what it is by default."""
    stars = {one.VAR_POSITIONAL: '*', one.VAR_KEYWORD: '**'}.get(one.kind, '')
    if one.annotation is one.empty:
        return str(one)
    default = '' if one.default is one.empty else f' = {_default(one.default)}'
    return f'{stars}{one.name}: {_annotation(one.annotation)}{default}'


def _default(value) -> str:
    """Write a default; a long one, or one that is made anew for each, in short."""
    text = repr(value)
    if text == '<factory>':
        return '...'
    return text if len(text) <= LONGEST_DEFAULT else f'{type(value).__name__}(...)'


def _annotation(annotation) -> str:
    """Write a type as it stands in the source."""
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def _text(value) -> str:
    """Return a docstring as Markdown."""
    text = inspect.getdoc(value) or ''
    pieces = _SECTION.split(text)
    out = [pieces[0].strip().replace('<', '&lt;')]
    for title, body in zip(pieces[1::2], pieces[2::2]):
        out.append(f'\n*{title}*\n')
        out.append('```text\n' + body.strip('\n') + '\n```')
    return '\n'.join(out)


def main(argv: list[str] | None = None) -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, default=HERE / 'api.md')
    atomic_write(parser.parse_args(argv).output, page())
    return 0


if __name__ == '__main__':
    sys.exit(main())
