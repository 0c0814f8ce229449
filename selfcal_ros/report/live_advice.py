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
"""What to do next, for a person who steers the robot and looks at the live page."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

#: Degrees to turn to each side.
TURN_DEG = 30.0
#: A focal length known to this share of itself is good for everything.
PRECISE = 0.001
#: Points in the image that are few, and share of the image that is enough.
FEW_POINTS, COVERED = 40, 0.6
#: Degrees a second that are a turn.
TURNING = 3.0


class Kind(Enum):
    """What a page may show beside the words."""

    WAIT = 'wait'
    TROUBLE = 'trouble'
    MOVE = 'move'
    LEFT = 'left'
    RIGHT = 'right'
    DONE = 'done'


@dataclass(frozen=True)
class Advice:
    """
    One thing to do.

    Attributes
    ----------
    kind : Kind
    do : str
        A few words.
    why : str
        A sentence.

    """

    kind: Kind
    do: str
    why: str


@dataclass(frozen=True)
class LiveStatus:
    """
    What the advice rests on.

    Attributes
    ----------
    is_alive : bool
        Whether a calibrator speaks.
    text : str
        What it says of itself.
    has_changed : bool
        Whether it says that the camera is another by now.
    no_images : str
        What the tracker says where none come.
    has_tracks : bool
    points : int
        In the newest image.
    is_still : bool
        Whether the image stands still.
    left, right : float
        Degrees turned so far.
    rate : float
        Degrees a second now, positive to the left.
    coverage : float
        Share of the image that was covered.
    empty : str
        Its emptiest part.
    sigma_share : float or None
        Standard deviation of the focal length over the focal length; None: not calibrated.
    saved : str
        The file, where it holds the calibration in force.

    """

    is_alive: bool
    text: str
    has_changed: bool
    no_images: str
    has_tracks: bool
    points: int
    is_still: bool
    left: float
    right: float
    rate: float
    coverage: float
    empty: str
    sigma_share: float | None
    saved: str = ''


def advise(scene: LiveStatus) -> Advice:
    """Say what helps most now."""
    return _alarm(scene) or _reached(scene) or _trouble(scene) or _motion(scene)


def _alarm(scene: LiveStatus) -> Advice | None:
    """Name what makes the numbers worthless."""
    if not scene.is_alive:
        return Advice(Kind.TROUBLE, 'Start the nodes',
                      'No calibrator speaks on /diagnostics: ros2 launch selfcal_ros '
                      'agv.launch.py image:=/camera/image_raw.')
    if scene.has_changed:
        return Advice(Kind.TROUBLE, 'The camera has changed', sentence(scene.text))
    return None


def _trouble(scene: LiveStatus) -> Advice | None:
    """Name what keeps the estimate from getting better."""
    if scene.no_images:
        return Advice(Kind.TROUBLE, 'Look after the images', sentence(scene.no_images))
    if not scene.has_tracks:
        return Advice(Kind.TROUBLE, 'Start the tracker', 'No tracks come from feature_tracker.')
    if scene.points < FEW_POINTS:
        return Advice(Kind.TROUBLE, 'Show it more',
                      f'Only {scene.points} points are in the image: turn to where there is '
                      'texture, or make more light.')
    return None


def _reached(scene: LiveStatus) -> Advice | None:
    if scene.sigma_share is None or scene.sigma_share > PRECISE:
        return None
    if scene.saved:
        return Advice(Kind.DONE, 'It is saved', f'The focal length is known to {_percent(scene)}, '
                      f'and {scene.saved} holds it. You may stop here.')
    return Advice(Kind.DONE, 'Save it', f'The focal length is known to {_percent(scene)}; more '
                  'views change little.')


def _motion(scene: LiveStatus) -> Advice:
    """Name the motion that is missing."""
    side = Kind.LEFT if scene.left <= scene.right else Kind.RIGHT
    if min(scene.left, scene.right) < TURN_DEG:
        why = (f'So far {scene.left:.0f}° to the left and {scene.right:.0f}° to the right; '
               f'{TURN_DEG:.0f}° to each side are wanted.')
        going = Kind.LEFT if scene.rate > 0 else Kind.RIGHT
        done = scene.left if going is Kind.LEFT else scene.right
        if abs(scene.rate) > TURNING and done < TURN_DEG:
            return Advice(going, f'Go on turning {going.value}', why)
        return Advice(side, f'Turn {side.value} now', why)
    if scene.is_still:
        return Advice(Kind.MOVE, 'Move on', 'The image stands still, which tells nothing new.')
    if scene.coverage < COVERED:
        return Advice(Kind.MOVE, f'Fill the {scene.empty}',
                      f'{100 * scene.coverage:.0f} % of the image were covered by points so far; '
                      f'least the {scene.empty}.')
    if scene.sigma_share is None:
        return Advice(Kind.MOVE, 'Go on', sentence(scene.text))
    return Advice(Kind.MOVE, 'Go on', f'The focal length is known to {_percent(scene)}, and more '
                  'turns make it better.')


def _percent(scene: LiveStatus) -> str:
    assert scene.sigma_share is not None
    return f'{100 * scene.sigma_share:.2g} %'


def sentence(text: str) -> str:
    """Return a clause as a sentence."""
    text = text.strip()
    return text[:1].upper() + text[1:] + ('' if text.endswith('.') else '.') if text else ''
