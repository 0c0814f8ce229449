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
"""How the parameters of one camera went over its recordings: a figure."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
import io
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.pipeline.many_inputs import CameraSummary
from selfcal_ros.report.style import BLUE, counted_along_x, GREY, ORANGE, PALE, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_UNITS = {'fx': 'px', 'fy': 'px', 'cx': 'px', 'cy': 'px', 'skew': 'px'}
#: Names of recordings fit under the axis up to so many.
_MAX_NAMES = 12


def parameter_history(camera: CameraSummary) -> Figure | None:
    """
    Draw every estimated parameter over time, or over the recordings where they have no clock.

    Parameters
    ----------
    camera : CameraSummary

    Returns
    -------
    matplotlib.figure.Figure or None
        None if nothing is calibrated.

    """
    if camera.joint is None:
        return None
    results = {number: outcome.result for number, outcome in enumerate(camera.outcomes)
               if outcome.result}
    shown = list(results)
    places, timed = _places(camera, shown)
    joint = camera.joint.calibration
    names = [name for name in joint.parameter_names if joint.status.get(name) == 'estimated']
    if {'fx', 'fy'} <= set(names) and joint.facts.aspect_ratio is not None and (
            joint.facts.aspect_ratio_sigma == 0):
        names.remove('fy')
    used = np.array([_is_used(camera, number) for number in shown])
    with styled():
        figure = Figure(figsize=(9.2, 0.7 + 1.25 * len(names)), layout='constrained')
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for axis, name in zip(axes, names):
            k = joint.parameter_names.index(name)
            # a recording that is not in the joint estimate may have another lens
            value, sigma = np.array([_value(result, name) for result in results.values()]).T
            middle, spread = joint.camera.parameters[k], joint.sigma[name]
            axis.axhspan(middle - spread, middle + spread, color=PALE, zorder=0)
            axis.axhline(middle, color=GREY, linewidth=0.8, zorder=1)
            for chosen, colour, label in ((used, BLUE, 'used'),
                                          (~used, ORANGE, 'not in the joint estimate')):
                if chosen.any():
                    axis.errorbar(places[chosen], value[chosen], sigma[chosen], fmt='o',
                                  markersize=3, linewidth=0.9, color=colour, label=label)
            axis.set_ylabel(f'{name} / px' if name in _UNITS else name)
            axis.spines[['top', 'right']].set_visible(False)
        figure.align_ylabels(axes)
        if not used.all():
            axes[0].legend(loc='best')
        _label_places(axes[-1], camera, timed)
    return figure


def picture(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file of the given kind: 'svg' or 'png'."""
    stream = io.BytesIO()
    with styled():
        figure.savefig(stream, format=kind, facecolor='white',
                       metadata={'Date': None, 'Creator': None} if kind == 'svg' else None)
    return stream.getvalue()


def _value(result: Calibration, name: str) -> tuple[float, float]:
    """Return a parameter and its sigma, NaN where the lens has none of that name."""
    if name not in result.parameter_names:
        return np.nan, np.nan
    return (float(result.camera.parameters[result.parameter_names.index(name)]),
            result.sigma[name])


def _is_used(camera: CameraSummary, number: int) -> bool:
    """Tell whether a recording is in the joint estimate."""
    return (camera.joint is not None and number in camera.members
            and bool(camera.joint.used[camera.members.index(number)]))


def _places(camera: CameraSummary, shown: Sequence[int]) -> tuple[np.ndarray, bool]:
    """Return where to draw: times, or counts."""
    stated = [camera.outcomes[number].start_ns for number in shown]
    starts = [start for start in stated if start is not None]
    if len(starts) < len(stated) or len(set(starts)) < 2:
        return np.array(shown, float) + 1, False
    return np.array([datetime.fromtimestamp(start / 1e9, timezone.utc) for start in starts]), True


def _label_places(axis: Axes, camera: CameraSummary, timed: bool) -> None:
    """Say what the places are."""
    if timed:
        from matplotlib import dates
        locator = dates.AutoDateLocator(maxticks=10, tz=timezone.utc)
        axis.xaxis.set_major_locator(locator)
        axis.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator, tz=timezone.utc))
        axis.set_xlabel('time of recording / UTC')
    elif len(camera.outcomes) <= _MAX_NAMES:
        names = [outcome.path.rstrip('/').rpartition('/')[2][:24] for outcome in camera.outcomes]
        axis.set_xticks(range(1, len(names) + 1), names, rotation=20, ha='right')
    else:
        counted_along_x(axis, 'recording')
