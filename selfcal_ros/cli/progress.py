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
"""A progress bar on a terminal, nothing anywhere else."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tqdm import tqdm


class ProgressBar:
    """
    Shows how far long work has come; a context manager.

    Parameters
    ----------
    wanted : bool
        Shown only if this is true and standard error is a terminal.

    """

    def __init__(self, wanted: bool = True):
        self._shown = wanted and sys.stderr.isatty()
        self._bar: tqdm | None = None
        self._text = ''

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._bar is not None:
            self._bar.close()

    def __call__(self, text: str, done: float, total: float | None = None) -> None:
        """Show that so much of a total is done."""
        if not self._shown:
            return
        if self._bar is None or text != self._text:
            from tqdm import tqdm
            if self._bar is not None:
                self._bar.close()
            self._text = text
            self._bar = tqdm(desc=text, total=total, leave=False, file=sys.stderr,
                             dynamic_ncols=True)
        self._bar.update(done - self._bar.n)
