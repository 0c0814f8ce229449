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
"""What became of every track: of the still scene, moving by itself, or still in the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: What a track may be; rigid bodies follow, `moving 1` with the most tracks first.
STATIC, UNEXPLAINED, UNCLEAR, JUMPED, MOVING = range(5)
NAMES = ('static', 'unexplained', 'unclear', 'jumped')
#: And such as have no part in anything.
STILL_IN_IMAGE = 'still in the image'


@dataclass(frozen=True)
class TrackLabels:
    """
    What became of every track.

    Attributes
    ----------
    track : ndarray of int, shape (P,)
        Identities, ascending.
    label : ndarray of int, shape (P,)
        Index among `names`.
    bodies : int
        Things that move by themselves.
    aside : bool
        Whether there are tracks that stand still in the image, and were set aside: the last name.

    Examples
    --------
    >>> import numpy as np
    >>> from selfcal_ros.values.track_labels import TrackLabels
    >>> labels = TrackLabels(np.array([3, 7, 8]), np.array([0, 4, 4]), bodies=1)
    >>> labels.names[4], labels.of('moving 1').tolist(), labels.share('static')
    ('moving 1', [7, 8], 0.3333333333333333)

    """

    track: np.ndarray
    label: np.ndarray
    bodies: int = 0
    aside: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the labels."""
        return (*NAMES, *(f'moving {k + 1}' for k in range(self.bodies)),
                *((STILL_IN_IMAGE,) if self.aside else ()))

    def of(self, name: str) -> np.ndarray:
        """Return the identities of the tracks with a label."""
        wanted = self.names.index(name)
        chosen: np.ndarray = self.track[self.label == wanted]
        return chosen

    def with_still(self, track: np.ndarray) -> TrackLabels:
        """Return the labels with further tracks, that stand still in the image."""
        names = np.concatenate([self.track, track])
        label = np.concatenate([self.label, np.full(len(track), MOVING + self.bodies)])
        order = np.argsort(names, kind='stable')
        return TrackLabels(names[order], label[order], self.bodies, aside=True)

    def share(self, name: str) -> float:
        """Return the share of tracks with a label."""
        return len(self.of(name)) / max(len(self.track), 1)
