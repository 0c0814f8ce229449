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
"""Text of model files: read with care, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from selfcal_ros.errors import InputError
from selfcal_ros.values.foreign_files import read_limited

#: No model file may be longer.
LARGEST_FILE_BYTES = 8_000_000


def read_text(path: Path) -> str:
    """
    Return the text of a model file.

    Raises
    ------
    InputError
        If there is no such file, it is too long or no text.

    """
    try:
        return read_limited(path, LARGEST_FILE_BYTES, 'The model').decode('utf-8-sig')
    except UnicodeDecodeError:
        raise InputError(f'The model {path} is not a text file in UTF-8.') from None
