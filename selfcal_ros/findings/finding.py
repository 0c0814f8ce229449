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
"""A finding: its kind, its values, and on demand its words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from selfcal_ros.findings.closed_forms import CLOSED_FORMS
from selfcal_ros.findings.mounting import MOUNTING
from selfcal_ros.findings.phrase import Phrase, put_in_words
from selfcal_ros.findings.refusals import REFUSALS
from selfcal_ros.findings.remarks import REMARKS

#: The registry: every kind of finding that the package makes, with its words.
KINDS: dict[str, Phrase] = {**REFUSALS, **MOUNTING, **CLOSED_FORMS, **REMARKS}


@dataclass(frozen=True, init=False)
class Finding:
    """
    Something found out about the data or the result.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    **values
        What the words of this kind name, and more that programs can use. Numbers carry their
        units in their names.

    Raises
    ------
    ValueError
        If there are no words for the kind.

    """

    kind: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __init__(self, kind: str, /, **values: Any):
        if kind not in KINDS:
            raise ValueError(f'{kind!r} is no kind of finding: give it words in '
                             'selfcal_ros/findings.')
        object.__setattr__(self, 'kind', kind)
        object.__setattr__(self, 'values', values)

    @property
    def sentence(self) -> str:
        """What was found, in words; of one of several cameras, with its name before it."""
        phrase = KINDS[self.kind].sentence
        said = put_in_words(phrase, self.values)
        named = 'camera' in self.values and '{camera' not in phrase
        return f'{self.values["camera"]}: {said}' if named else said

    @property
    def advice(self) -> str:
        """What to do about it, in words."""
        return put_in_words(KINDS[self.kind].advice, self.values)

    @property
    def clause(self) -> str:
        """The sentence as a part of another: in lower case, without its full stop."""
        text = self.sentence.removesuffix('.')
        return text[:1].lower() + text[1:]

    def of_camera(self, name: str) -> Finding:
        """Return the same, found in the images of one of several cameras."""
        return Finding(self.kind, **{**self.values, 'camera': name})

    def __str__(self) -> str:
        """Say it."""
        return self.sentence

    def as_dict(self) -> dict[str, Any]:
        """Kind and values in one dict, findings within it too."""
        return {'kind': self.kind,
                **{name: value.as_dict() if isinstance(value, Finding) else value
                   for name, value in self.values.items()}}

    @staticmethod
    def from_dict(content: Mapping[str, Any]) -> Finding:
        """
        Turn what `as_dict` gives back into a finding.

        Raises
        ------
        KeyError, ValueError
            If there is no kind, or an unknown one.

        """
        values = {name: Finding.from_dict(value)
                  if isinstance(value, Mapping) and value.get('kind') in KINDS else value
                  for name, value in content.items() if name != 'kind'}
        return Finding(content['kind'], **values)


def sentences(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Put findings in words, a sentence each."""
    return tuple(finding.sentence for finding in findings)
