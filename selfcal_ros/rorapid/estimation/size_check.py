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
Is the object as large as its model? Only what is known of its distance tells.

With one camera a model that is too large by a share s gives poses that are too far by s, and the
same image. So the first distance that is found is held against what the start said of it. Both are
known with a sigma.
"""

from __future__ import annotations

import math

#: Standard deviations by which the two may differ, where the start says how well it knows ...
_SIGMAS = 3.0
#: ... and the share by which they may where it does not say: guesses are no better.
_GUESSED = 0.15


class SizeCheck:
    """
    Holds the distance of an object against its start.

    Parameters
    ----------
    distance_m : float
        That the start says.
    sigma_m : float or None
        Its standard deviation, if it was measured.

    Attributes
    ----------
    share : float
        By how much the object was found farther than it should be, 0 where that may be.
    share_sigma : float
        Its standard deviation: of the start, if it was measured, and of the pose.

    """

    def __init__(self, distance_m: float, sigma_m: float | None):
        """Wait for the first pose."""
        self._distance, self._sigma = distance_m, sigma_m
        self.share = self.share_sigma = 0.0

    def measure(self, distance_m: float, sigma_m: float) -> None:
        """Take the distance that was found, with its standard deviation."""
        share = math.log(distance_m / self._distance)
        self.share_sigma = math.hypot(self._sigma or 0.0, sigma_m) / self._distance
        most = max(_SIGMAS * self.share_sigma, _GUESSED if self._sigma is None else 0.0)
        self.share = share if abs(share) > most else 0.0

    def text(self) -> str:
        """Return a sentence, empty where all is well."""
        if not self.share:
            return ''
        sigma = '' if self._sigma is None else f' ± {100 * self.share_sigma:.1f}'
        side, size = ('farther', 'large') if self.share > 0 else ('nearer', 'small')
        amount = 100 * abs(math.expm1(self.share))
        return (f'The object is {amount:.1f}{sigma} % {side} than the start says: the model is as '
                f'much too {size}, or the start is wrong; images alone cannot tell.')
