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
"""YAML of other programs, read safely: plain scalars, matrices of rows, cols and data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.report.not_a_camera import refuse_other_kinds
from selfcal_ros.values.foreign_files import load_foreign_yaml, read_limited, SAFE_LOADER

#: A camera file is far smaller; whatever is larger is something else.
MAX_BYTES = 1_000_000


#: What to give in place of a file that is none.
KNOWN = 'give one of ROS, OpenCV, Kalibr, COLMAP or mrcal, or result.json'


class _Loader(SAFE_LOADER):  # type: ignore[misc]
    """Safe YAML in which every scalar is the string that was written."""


_Loader.yaml_implicit_resolvers = {}
_Loader.add_constructor('tag:yaml.org,2002:opencv-matrix',
                        lambda loader, node: loader.construct_mapping(node, deep=True))


def read_bytes(path: str | Path, limit: int = MAX_BYTES) -> bytes:
    """
    Read a file of so many bytes at most.

    Raises
    ------
    InputError
        If it cannot be read, is of another kind or far too large for a camera file.

    """
    refuse_other_kinds(path)
    return read_limited(path, limit)


def decoded(raw: bytes, source: str | Path) -> str:
    """Return the text of a file; InputError if it is none."""
    try:
        return raw.decode('utf-8-sig')
    except UnicodeDecodeError:
        raise InputError(f'{source} is no camera file: it is not text; {KNOWN}.') from None


def load_yaml(text: str, source: str) -> dict[str, Any]:
    """
    Parse a YAML document of keys, in which every scalar stays the string that was written.

    Raises
    ------
    InputError
        If it is no YAML or holds no keys; the sentence starts with `source`.

    """
    # a plain scan without Python objects, so that the name 00123 stays what it is
    document = load_foreign_yaml(text, source, _Loader)
    if not isinstance(document, dict):
        raise InputError(f'{source} is no camera file: it holds no keys; {KNOWN}.')
    return document


def number_text(value: float) -> str:
    """Write a float that comes back bit-exact, from PyYAML, too."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition('e')
    # YAML 1.1 takes 1e-05 for a string
    return f'{mantissa}.0e{exponent}' if mark and '.' not in mantissa else text


def positive_integer(value: Any, where: str) -> int:
    """Read an image size; InputError, which starts with `where`, if it is none."""
    try:
        number = int(value)
    except (TypeError, ValueError, ArithmeticError):
        number = 0
    if isinstance(value, (float, bool)) and number != value:
        number = 0
    if not 0 < number < 2 ** 31:
        raise InputError(f'{where} must be a positive integer.')
    return number


def numbers(values: Any, source: str, key: str) -> np.ndarray:
    """Read a list of finite numbers, shape (N,); InputError if it is none."""
    if not isinstance(values, list) or (len(values) == 1 and isinstance(values[0], str)
                                        and len(values[0].split()) > 1):
        raise InputError(f'{source}: the data of {key} must be a list with commas, like '
                         '[1.0, 2.0].')
    try:
        found = np.array([float(value) for value in values])
    except (TypeError, ValueError, ArithmeticError):
        raise InputError(f'{source}: {key} holds something that is not a number; check its '
                         'commas.') from None
    if not np.isfinite(found).all():
        raise InputError(f'{source}: {key} holds a number that is not finite.')
    return found


def matrix(document: dict[str, Any], key: str, shape: tuple[int | None, int | None],
           source: str) -> np.ndarray:
    """
    Return a matrix {rows, cols, data} of the document.

    Parameters
    ----------
    document : dict
    key : str
    shape : (int or None, int or None)
        What it must be; None: any length.
    source : str
        Starts the sentence of an error.

    """
    entry = document[key]
    if not (isinstance(entry, dict) and {'rows', 'cols', 'data'} <= entry.keys()):
        raise InputError(f'{source}: {key} must have rows, cols and data.')
    values = numbers(entry['data'], source, key)
    try:
        found = int(entry['rows']), int(entry['cols'])
    except (TypeError, ValueError, ArithmeticError):
        raise InputError(f'{source}: rows and cols of {key} must be integers.') from None
    fits = all(wanted in (None, size) for wanted, size in zip(shape, found))
    if not fits or min(found) < 0 or values.size != found[0] * found[1]:
        wanted = 'x'.join('n' if size is None else str(size) for size in shape)
        raise InputError(f'{source}: {key} must be {wanted}, but says {found[0]}x{found[1]} and '
                         f'has {values.size} values.')
    return values.reshape(found)
