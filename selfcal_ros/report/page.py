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
"""The result as one self-contained HTML page."""

from __future__ import annotations

from html import escape
from pathlib import Path

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.report.files import atomic_write

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font-family: sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }}
pre {{ background: #f4f4f4; padding: 1em; overflow-x: auto; }}
footer {{ color: #666; margin-top: 2em; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{source}</p>
<pre>{text}</pre>
{figures}
<footer>{software}</footer>
</body>
</html>
"""


def write_page(path, result: Calibration | NotCalibrated, text: str, source: str = '',
               figures: tuple[str, ...] = ()) -> Path:
    """
    Write the page; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
    result : Calibration or NotCalibrated
    text : str
        The result as it is printed on a terminal.
    source : str
        What was calibrated from.
    figures : tuple of str
        SVG elements, from this program alone: they are put in as they are.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    title = 'Camera calibration' if result else 'Not calibrated'
    return atomic_write(path, _PAGE.format(
        title=title, source=escape(source), text=escape(text), figures='\n'.join(figures),
        software=escape(result.software)))
