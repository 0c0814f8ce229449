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
"""A table of a page: what is better read than seen."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PageTable:
    """
    Rows of words and numbers under one title.

    Attributes
    ----------
    name : str
        An anchor of the page; a word that no figure has.
    title, caption : str
    columns : tuple of str
    rows : tuple of tuple of str
        As long as the columns.
    section : str
        Part of the page, as of a `Drawing`.
    words : tuple of int
        Columns of words, which break into lines.

    """

    name: str
    title: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    section: str = 'fit'
    words: tuple[int, ...] = ()
