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
"""What the live page shows: how the calibration comes about, as values that JSON can hold."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import math
from typing import Any, TypeVar

import numpy as np

from selfcal_ros.report.live_advice import Advice, advise, LiveStatus, sentence

#: Cells of the map of the image.
COLUMNS, ROWS = 8, 6
#: A cell that was seen in so many views is covered.
VIEWS_A_CELL = 4
#: A view counts when its points have moved by this share of the image's diagonal.
STEP = 0.02
#: Fewer points than this tell no turn.
LEAST_POINTS = 12
#: Focal length over width where it is not known: 64 degrees across.
USUAL_FOCAL = 0.8
#: Slower turns than this, in degrees a second, are the trembling of tracks.
LEAST_RATE = 0.5
#: Whoever has said nothing for so long is gone.
GONE_S = 4.0
#: Estimates that the chart remembers.
MOST_ESTIMATES = 400
#: How values of a changed camera begin in the diagnostics.
CHANGE = 'change of '
#: How those of a calibration file of an earlier run begin, while it is in force.
FILE, WRITTEN = 'file ', 'file written'
WARNING = 1
_COUNTS = ('frames', 'keyframes', 'points', 'estimates')

#: Stands in for a number that is not there.
_Default = TypeVar('_Default', float, None)


class LiveState:
    """
    Gathers what the nodes say, and tells it in one dictionary.

    Times are seconds of one steady clock. Nothing here grows without bound.
    """

    def __init__(self) -> None:
        self._calibrator = self._camera = ''
        self._status: tuple[int, str, dict[str, str]] = (0, '', {})
        self._images: tuple[int, str] = (0, '')
        self._heard_s = self._images_s = self._tracks_s = -math.inf
        self._began_s: float | None = None
        self._size: tuple[int, int] | None = None
        self._clear()

    def _clear(self) -> None:
        self._seen = np.zeros((ROWS, COLUMNS), int)
        self._view: tuple[np.ndarray, np.ndarray] | None = None
        self._last: tuple[float, np.ndarray, np.ndarray] | None = None
        self._turned = {'left': 0.0, 'right': 0.0}
        self._rate = 0.0
        self._moved_s = -math.inf
        self._points = 0
        self._history: deque[dict[str, float]] = deque(maxlen=MOST_ESTIMATES)

    def take_status(self, calibrator: str, camera: str, level: int, text: str,
                    values: Mapping[str, str], now_s: float) -> None:
        """
        Take what a calibrator says of itself once a second.

        Parameters
        ----------
        calibrator, camera : str
            Names.
        level : int
            0 ok, 1 warning, 2 error, 3 stale.
        text : str
        values : mapping of str
            Of its diagnostic status.
        now_s : float

        """
        old = self._status[2]
        # a calibrator that was reset has forgotten what it saw, and one that was restarted, too
        if calibrator != self._calibrator or _number(values, 'frames', 0) < _number(
                old, 'frames', 0) or values.get('resets') != old.get('resets', '0'):
            self._clear()
        self._calibrator, self._camera = calibrator, camera
        self._status, self._heard_s = (level, text, dict(values)), now_s
        self._began_s = now_s if self._began_s is None else self._began_s
        point = self._point(now_s)
        if point is not None and (not self._history or any(
                point[name] != self._history[-1][name] for name in point if name != 't')):
            self._history.append(point)

    def take_images(self, level: int, text: str, now_s: float) -> None:
        """Take what a tracker says of its images once a second."""
        self._images, self._images_s = (level, text), now_s

    def take_tracks(self, ids: np.ndarray, xy: np.ndarray, size: tuple[int, int] | None,
                    now_s: float) -> None:
        """
        Take the points of one image.

        Parameters
        ----------
        ids : ndarray of int, shape (N,)
        xy : ndarray, shape (N, 2)
            Pixels.
        size : (int, int) or None
            Width and height; None where there are no points.
        now_s : float

        """
        self._tracks_s, self._points = now_s, len(ids)
        if size is None:
            return
        if size != self._size:
            self._clear()
            self._size, self._points = size, len(ids)
        if self._view is None or _moved(self._view, ids, xy) > STEP * math.hypot(*size):
            self._view = ids, xy
            column, row = np.floor(xy / np.divide(size, (COLUMNS, ROWS))).astype(int).T
            touched = np.zeros_like(self._seen)
            touched[np.clip(row, 0, ROWS - 1), np.clip(column, 0, COLUMNS - 1)] = 1
            self._seen += touched
        if self._last is not None and now_s > self._last[0]:
            self._turn(ids, xy, size, now_s)
        self._last = now_s, ids, xy

    def _turn(self, ids: np.ndarray, xy: np.ndarray, size: tuple[int, int],
              now_s: float) -> None:
        """Add the turn since the last image."""
        assert self._last is not None
        then_s, old_ids, old_xy = self._last
        focal = (_number(self._status[2], 'fx', 0.0)
                 or _number(self._status[2], f'{FILE}fx', 0.0) or USUAL_FOCAL * size[0])
        degrees = turn_deg((old_ids, old_xy), (ids, xy), focal, size[0])
        elapsed = now_s - then_s
        # after a pause the tracks in common are few, and chosen by what survives
        if degrees is None or elapsed > 2.0:
            self._rate = 0.0
            return
        self._rate = degrees / elapsed
        if abs(self._rate) > LEAST_RATE:
            self._turned['left' if degrees > 0 else 'right'] += abs(degrees)
        if abs(self._rate) > LEAST_RATE or _moved((old_ids, old_xy), ids, xy) > 0.5:
            self._moved_s = now_s

    def _point(self, now_s: float) -> dict[str, float] | None:
        """Return the sigmas of now for the chart; None without a calibration."""
        values = self._status[2]
        fx, sigma = _number(values, 'fx', 0.0), _number(values, 'fx sigma', math.nan)
        if not fx > 0 or not sigma > 0 or self._began_s is None:
            return None
        return {'t': round(now_s - self._began_s, 1), 'focal': 100 * sigma / fx,
                'centre': max(_number(values, 'cx sigma', 0.0),
                              _number(values, 'cy sigma', 0.0))}

    @property
    def coverage(self) -> float:
        """Share of the image that was covered by views."""
        return float((self._seen >= VIEWS_A_CELL).mean())

    def advice(self, now_s: float) -> Advice:
        """Say what to do next."""
        _, text, values = self._status
        fx, sigma = _number(values, 'fx', 0.0), _number(values, 'fx sigma', math.inf)
        level, images = self._images if now_s - self._images_s < GONE_S else (0, '')
        return advise(LiveStatus(
            is_alive=now_s - self._heard_s < GONE_S, text=text,
            has_changed=any(name.startswith(CHANGE) for name in values),
            no_images=images if level > WARNING else '',
            has_tracks=now_s - self._tracks_s < GONE_S, points=self._points,
            is_still=now_s - self._moved_s > 2.0,
            left=self._turned['left'], right=self._turned['right'], rate=self._rate,
            coverage=self.coverage, empty=self._emptiest(),
            sigma_share=sigma / fx if fx > 0 else None,
            saved=values.get('calibration file', '') if self._is_saved else ''))

    def _note(self, now_s: float) -> str:
        """Return what the tracker warns of, without being stopped by it."""
        level, text = self._images
        is_new = now_s - self._images_s < GONE_S
        return sentence(text) if level == WARNING and is_new else ''

    def _emptiest(self) -> str:
        """Name the third of the image that was seen least."""
        thirds = np.array([[cell.mean() for cell in np.array_split(row, 3, axis=1)]
                           for row in np.array_split(self._seen, 3)])
        row, column = np.unravel_index(int(thirds.argmin()), thirds.shape)
        words = (('top', 'middle', 'bottom')[row], ('left', 'middle', 'right')[column])
        return 'middle' if words == ('middle', 'middle') else ' '.join(
            word for word in words if word != 'middle')

    @property
    def _is_saved(self) -> bool:
        """Whether the file holds the calibration in force."""
        return self._status[2].get('saved') == 'True'

    def _source(self) -> str:
        """Tell where the numbers that are shown come from: '' where there are none."""
        values = self._status[2]
        if any(name.endswith(' sigma') and not name.startswith((CHANGE, FILE))
               for name in values):
            return 'estimate'
        return 'file' if WRITTEN in values else ''

    def _parameters(self) -> list[dict[str, Any]]:
        """Return the camera in force; a sigma that a file does not tell is None."""
        values = self._status[2]
        if self._source() == 'file':
            names = [name.removeprefix(FILE) for name in values
                     if name.startswith(FILE) and name != WRITTEN and not name.endswith(' sigma')]
            prefix = FILE
        else:
            names = [name.removesuffix(' sigma') for name in values
                     if name.endswith(' sigma') and not name.startswith((CHANGE, FILE))]
            prefix = ''
        return [{'name': name, 'value': _number(values, f'{prefix}{name}', None),
                 'sigma': _number(values, f'{prefix}{name} sigma', None)} for name in names]

    def _kept(self) -> str:
        """Say which file holds the numbers that are shown, or does not."""
        values = self._status[2]
        path, saved_at = values.get('calibration file', ''), values.get('saved at', '')
        source = self._source()
        if source == 'file':
            return (f'These numbers are of an earlier run, written {values[WRITTEN]}. The first '
                    'calibration of this run replaces them.')
        if not path:
            return ''
        if not source:
            return (f'{path} holds the calibration that was saved at {saved_at}.' if saved_at
                    else '')
        if self._is_saved:
            return f'Saved in {path} at {saved_at}.'
        if saved_at:
            return (f'{path} holds the numbers of {saved_at}. Those here are newer: save them, '
                    'too.')
        return f'Not saved yet. The button writes {path}.'

    def as_dict(self, now_s: float) -> dict[str, Any]:
        """Return everything that the page shows."""
        level, text, values = self._status
        advice = self.advice(now_s)
        is_alive = now_s - self._heard_s < GONE_S
        return {
            'calibrator': self._calibrator, 'camera': self._camera, 'alive': is_alive,
            'text': sentence(text), 'is_well': level < WARNING, 'note': self._note(now_s),
            'size': self._size, **{name: int(_number(values, name, 0)) for name in _COUNTS},
            'estimating': values.get('estimating') == 'True',
            'motion': values.get('motion', ''),
            'rms_px': _number(values, 'reprojection_rms_px', None),
            'parameters': self._parameters(), 'source': self._source(), 'kept': self._kept(),
            'is_saved': self._is_saved,
            'history': list(self._history),
            'now': round(now_s - (now_s if self._began_s is None else self._began_s), 1),
            'coverage': {'columns': COLUMNS, 'rows': ROWS, 'share': round(self.coverage, 3),
                         'cells': np.minimum(self._seen / VIEWS_A_CELL, 1).ravel().tolist()},
            'turned': {name: round(value, 1) for name, value in self._turned.items()},
            'advice': {'do': advice.do, 'why': advice.why, 'kind': advice.kind.value},
        }


def turn_deg(old: tuple[np.ndarray, np.ndarray], new: tuple[np.ndarray, np.ndarray],
             focal: float, width: int) -> float | None:
    """
    Return by how much a level camera has turned to the left between two images.

    A turn moves points by the same angle everywhere, driving on moves them away from the middle:
    both are fitted, with little weight for what fits neither.

    Parameters
    ----------
    old, new : (ndarray, ndarray)
        Identities, shape (N,), and pixels, shape (N, 2).
    focal : float
        Pixels; a guess does.
    width : int
        Of the image.

    Returns
    -------
    float or None
        Degrees; None where too few points are in both images.

    """
    _, a, b = np.intersect1d(old[0], new[0], return_indices=True)
    if len(a) < LEAST_POINTS:
        return None
    before, after = ((xy[k, 0] - width / 2) / focal for xy, k in ((old[1], a), (new[1], b)))
    # d tan(angle) = (1 + tan^2) d angle; away from the middle: in proportion to tan
    design = np.column_stack([1 + before ** 2, before])
    weight = np.ones(len(a))
    shift = after - before
    for _ in range(4):
        root = np.sqrt(weight)
        fitted = np.linalg.lstsq(design * root[:, None], shift * root, rcond=None)[0]
        error = np.abs(shift - design @ fitted)
        weight = 1 / (1 + (error / max(float(np.median(error)), 1e-6)) ** 2)
    return math.degrees(float(fitted[0]))


def _moved(view: tuple[np.ndarray, np.ndarray], ids: np.ndarray, xy: np.ndarray) -> float:
    """Return the median way of the points since a view, in pixels; infinite where few are left."""
    _, a, b = np.intersect1d(view[0], ids, return_indices=True)
    if len(a) < LEAST_POINTS:
        return math.inf
    return float(np.median(np.linalg.norm(xy[b] - view[1][a], axis=1)))


def _number(values: Mapping[str, str], name: str, default: _Default) -> float | _Default:
    """Read a number of a diagnostic status; what is none, or not finite, is the default."""
    try:
        value = float(values.get(name, ''))
    except ValueError:
        return default
    return value if math.isfinite(value) else default
