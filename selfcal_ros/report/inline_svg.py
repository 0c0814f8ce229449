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
Figures as part of a page: its fonts, and its colours in light, in dark and in print.

Matplotlib writes colours and identifiers that suit a document of its own. Here the colours become
variables of the page, and the identifiers get a prefix, so that figures do not mix.
"""

from __future__ import annotations

import re

from markupsafe import Markup

from selfcal_ros.report import style

#: Variables of the page's style sheet, by the colours that figures are drawn in.
VARIABLES = {style.INK: '--ink', style.GREY: '--faint', style.PALE: '--rule',
             style.PAPER: '--card', style.BLUE: '--blue', style.ORANGE: '--orange',
             style.GREEN: '--green', style.RED: '--red', style.PURPLE: '--purple'}

_COLOUR = re.compile('|'.join(map(re.escape, VARIABLES)), re.IGNORECASE)
_IDENTIFIER = re.compile(r'(\bid="|url\(#|href="#)')
_STYLE_SHEET = re.compile(r'<style[^>]*>.*?</style>|<metadata>.*?</metadata>', re.DOTALL)


def inline_svg(document: bytes, prefix: str, label: str) -> Markup:
    """
    Turn an SVG document of Matplotlib into an element of a page.

    Parameters
    ----------
    document : bytes
        From `Drawing.svgs`, so of this program alone.
    prefix : str
        Of all identifiers; a word that no other figure of the page has.
    label : str
        What a screen reader says.

    Returns
    -------
    Markup
        An `svg` element that scales with its column.

    """
    text = document.decode('utf-8')
    text = _STYLE_SHEET.sub('', text[text.index('<svg'):])
    opening, _, rest = text.partition('>')
    found = re.search(r'viewBox="([-0-9. ]+)"', opening)
    if found is None:
        raise ValueError('the drawing has no viewBox')
    box = found.group(1)
    rest = _COLOUR.sub(lambda colour: f'var({VARIABLES[colour.group().lower()]})', rest)
    rest = _IDENTIFIER.sub(rf'\g<1>{prefix}-', rest)
    # the page's reader of HTML knows the prefix without its declaration
    head = Markup('<svg class="plot" role="img" aria-label="{}" viewBox="{}">').format(label, box)
    return head + Markup(rest.strip())
