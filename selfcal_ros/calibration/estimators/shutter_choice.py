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
Are the lines read all at once, or one after the other?

A score test at the optimum of a global shutter: one Gauss-Newton step gives the line delay and
its sigma. Where it differs from zero beyond chance it is estimated, and everything that follows
is decided with it. Lines are rows. Of an image that is taller than wide they may be columns: it
was turned upright after it was read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.clock import Clock, was_turned_upright
from selfcal_ros.calibration.bundle.lens import MATRIX_NAMES
from selfcal_ros.calibration.bundle.priors import Prior
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, Observations,
                                                       RobustFit, with_all_directions,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.shutter import (FAR_APART, LINE_DELAY, motion_by_powers,
                                                    pace_doubt)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.reconstruction import RowMotion
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.calibration.uncertainty.cluster_covariance import (
    cluster_robust_covariance, shared_sigma)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.values.tracks import Tracks

#: A line delay is estimated where it differs from zero by so many sigmas.
CERTAIN_SIGMAS = 4.0
#: Beyond so many, the sigmas of the camera allow for it.
DOUBTFUL_SIGMAS = 2.5
#: Fewer views tell too little of how the camera moves at each of them.
MIN_VIEWS = 6
#: Where the motion at the views is less certain than this share, their neighbours are too far.
MAX_DOUBT = 0.3
#: Where fewer of the neighbours of views were followed, they are not used.
MOST_FOLLOWED = 0.3
#: A start under a rolling shutter may leave so many times the noise of pairs of images, and so
#: much of the image's longer side.
ROLLING_NOISE, ROLLING_FRACTION = 20.0, 0.01
#: Sigma of the readout time, in intervals between frames, beyond which it is open.
OPEN_INTERVALS = 0.25


def clock_of(tracks: Tracks, frames: np.ndarray, size: tuple[int, int], facts: CameraFacts,
             ) -> Clock | None:
    """
    Tell when the views were taken, in units of the usual interval between them.

    Parameters
    ----------
    tracks : Tracks
    frames : ndarray of int, shape (V,)
        Of the views.
    size : (int, int)
        Width and height of the image.
    facts : CameraFacts

    Returns
    -------
    Clock or None
        None with a global shutter, and with too few views.

    Raises
    ------
    ArgumentError
        If a line delay is stated of frames without stamps.

    """
    stamps = tracks.stamps_ns or {}
    if len(frames) < MIN_VIEWS or facts.shutter == 'global':
        return None
    taken = np.array([stamps.get(int(frame), 0) for frame in frames])
    stamped = bool((np.diff(taken) > 0).all())
    times = (taken - taken[0]) * 1e-9 if stamped else np.asarray(frames - frames[0], float)
    interval = float(np.median(np.diff(times)))
    if stamped and tracks.neighbours is not None and np.isfinite(tracks.neighbours).any():
        # a video: the interval is that between its images, not between the views
        interval = float(np.nanmedian(np.abs(tracks.neighbours[:, :, 2])))
    known = None
    if facts.line_delay_s is not None:
        if not stamped:
            raise ArgumentError('A line delay in seconds needs frames with stamps; leave it out, '
                                'and it is estimated.')
        scale = size[1] / interval
        known = Prior(facts.line_delay_s * scale, facts.line_delay_sigma_s * scale)
    return Clock(times / interval, size[1], interval, stamped, known)


def timed(observations: Observations, tracks: Tracks, frames: np.ndarray, size: tuple[int, int],
          facts: CameraFacts) -> Observations:
    """Add when the views were taken, and where points were just before and after."""
    clock = clock_of(tracks, frames, size, facts)
    beside = observations.neighbours
    if clock is None or beside is None or np.isfinite(beside).all(axis=2).mean() < MOST_FOLLOWED:
        beside = None
    else:
        beside = beside * [1, 1, 1 / clock.unit]
    return replace(observations, clock=clock, neighbours=beside)


@dataclass(frozen=True)
class DelayTest:
    """
    What one Gauss-Newton step says of the line delay.

    Attributes
    ----------
    value, sigma : float
        Dependence of the errors included.
    shift : ndarray, shape (k,)
        How the unknowns of the lens move with it.

    """

    value: float
    sigma: float
    shift: np.ndarray

    @property
    def surely(self) -> float:
        """How many sigmas the line delay is from zero."""
        return abs(self.value) / max(self.sigma, 1e-300)

    def differs(self, sigmas: float) -> bool:
        """Tell whether the line delay is farther from zero than so many sigmas."""
        return self.surely > sigmas


@dataclass(frozen=True)
class ShutterDecision:
    """
    How the rows are read.

    Attributes
    ----------
    fit : RobustFit
        With a line delay where that is estimated.
    findings : tuple of Finding
        What keeps it from being estimated, where the images ask for it.
    shift : ndarray, shape (k,), optional
        What a line delay that is doubtful would do to the lens.

    """

    fit: RobustFit
    findings: tuple[Finding, ...] = ()
    shift: np.ndarray | None = None

    def widened(self, model: ModelDecision) -> ModelDecision:
        """Let the covariance hold what a line delay that was not estimated may do."""
        if self.shift is None:
            return model
        return replace(model, delay_excess=self.covariance(
            len(model.fit.state.lens), model.fit.bundle.unknowns.free))

    def covariance(self, size: int, free: np.ndarray) -> np.ndarray:
        """Return what a line delay that was not estimated may do to the lens, (k, k)."""
        shift, count = np.zeros(size), len(MATRIX_NAMES)
        if self.shift is not None:
            shift[:count] = self.shift[:count] * free[:count]
        return np.outer(shift, shift)


def score_line_delay(fit: RobustFit, size: tuple[int, int]) -> DelayTest:
    """
    Estimate the line delay by one Gauss-Newton step from an optimum.

    Parameters
    ----------
    fit : RobustFit
        With a global shutter, or at an optimum with a line delay.
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    DelayTest

    """
    observations = fit.observations
    if observations.shutter is None:
        observations = observations.read_in_rows().displaced(fit.state)
    bundle = bundle_of(observations, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)
    linearisation = bundle.linearise(fit.state)
    information, pull = (bundle.information(fit.state, linearisation),
                         bundle.loss_factors(linearisation)[1])
    place = bundle.unknowns.places((LINE_DELAY,))[0]
    step = -pull * (information.covariance @ information.system.gradient) / information.factor
    clusters = cluster_robust_covariance(information, observations.point, observations.xy, size)
    sigma = float(np.sqrt(information.covariance[place, place])) * clusters.sigma_inflation
    return DelayTest(fit.state.line_delay + float(step[place]), sigma,
                     step[bundle.unknowns.lens])


def choose_shutter(fit: RobustFit, observations: Observations, facts: CameraFacts,
                   size: tuple[int, int]) -> ShutterDecision:
    """
    Estimate the line delay where the images show one, or where rows are said to be read in turn.

    Parameters
    ----------
    fit : RobustFit
        With a global shutter.
    observations : Observations
        All that it was to explain, its outliers included.
    facts : CameraFacts
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    ShutterDecision

    """
    if observations.clock is None:
        return ShutterDecision(fit)
    clocks = possible_clocks(observations.clock, size)
    if facts.shutter == 'rolling' or facts.line_delay_s is not None:
        return ShutterDecision(_best_timed(fit, observations, clocks))
    tests = [score_line_delay(by_clock(fit, clock), size) for clock in clocks]
    tested = max(tests, key=lambda test: test.surely)
    if not tested.differs(CERTAIN_SIGMAS):
        return ShutterDecision(fit, shift=tested.shift if tested.differs(DOUBTFUL_SIGMAS)
                               else None)
    rolling = _best_timed(fit, observations, [clock for clock, test in zip(clocks, tests)
                                              if test.differs(CERTAIN_SIGMAS)])
    if not score_line_delay(rolling, size).differs(CERTAIN_SIGMAS):
        return ShutterDecision(fit, shift=tested.shift)
    if observations.neighbours is not None or doubt_of_pace(rolling) < MAX_DOUBT:
        return ShutterDecision(rolling)
    return ShutterDecision(fit, (Finding('rolling_shutter_suspected', sigmas=tested.surely),),
                           tested.shift)


def possible_clocks(clock: Clock, size: tuple[int, int]) -> list[Clock]:
    """Return the clocks by which an image may have been read."""
    return [clock, clock.by_columns(size[0])] if was_turned_upright(size) else [clock]


def by_clock(fit: RobustFit, clock: Clock) -> RobustFit:
    """Return the same fit of images that were read by another clock."""
    return replace(fit, observations=replace(fit.observations, clock=clock))


def _best_timed(fit: RobustFit, observations: Observations, clocks: list[Clock]) -> RobustFit:
    """Fit with a line delay by each of some clocks, and return what leaves least."""
    return min((_with_line_delay(by_clock(fit, clock), replace(observations, clock=clock))
                for clock in clocks), key=lambda one: one.bundle.sigma_px)


def may_be_rolling(problem: SelfCalibrationProblem, left_px: float) -> bool:
    """Tell whether a line delay may be what makes a start leave so much."""
    return (problem.observations.clock is not None and problem.motion.zoom is None
            and left_px < min(ROLLING_NOISE * problem.noise_px,
                              ROLLING_FRACTION * max(problem.size)))


def doubt_of_pace(fit: RobustFit) -> float:
    """Tell how far it is open how fast the camera moves at the views; see `pace_doubt`."""
    clock = fit.observations.clock
    return np.inf if clock is None else pace_doubt(fit.state, fit.bundle.blocks,
                                                   fit.observations.xy, clock)


def _with_line_delay(fit: RobustFit, observations: Observations) -> RobustFit:
    """Fit with a line delay; what was an outlier without need not be one."""
    observations = observations.surely_timed().read_in_rows()
    known = observations.shutter and observations.shutter.known
    state = (with_all_directions if fit.motion.fixed_centre else with_all_points)(
        fit.state, observations)
    if state is None:
        state, observations = fit.state, fit.observations.read_in_rows()
    if known:
        state = replace(state, line_delay=known.value)
    return fit_robustly(observations, state, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)


def readout_of(fit: RobustFit, sigma_inflation: float) -> RowReadout | None:
    """
    Return the rolling shutter of an optimum, sigmas widened by what errors share.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    sigma_inflation : float
        Sigma with shared errors over that with independent ones.

    Returns
    -------
    RowReadout or None
        None with a global shutter.

    """
    shutter, clock = fit.observations.shutter, fit.observations.clock
    if shutter is None or clock is None:
        return None
    if shutter.own is not None and shutter.own.near == FAR_APART and clock.known is None:
        # where views are so far apart, others hardly tell the line delay
        return None
    place = fit.bundle.unknowns.places((LINE_DELAY,))[0]
    value = fit.state.line_delay
    information = fit.information
    independent = float(np.sqrt(fit.covariance[place, place]))
    # how a camera shakes between images differs from view to view, and looks like rows
    of_views = shared_sigma(
        information.influence[:, place] / np.sqrt(information.freedom_fraction), independent,
        fit.observations.view)
    sigma = float(np.hypot(of_views, independent * np.sqrt(max(sigma_inflation**2 - 1, 0))))
    seconds = clock.unit / clock.lines if clock.is_stamped else None
    return RowReadout(None if seconds is None else value * seconds,
                      None if seconds is None else sigma * seconds,
                      'held' if shutter.is_held else 'estimated', value, sigma, clock.lines,
                      'rows' if clock.axis else 'columns')


def row_motion_of(fit: RobustFit, state: SceneState) -> RowMotion | None:
    """Tell how the camera moved while each view was read; None with a global shutter."""
    seen = fit.observations
    if seen.shutter is None or seen.clock is None:
        return None
    own = seen.shutter.own
    by_powers = motion_by_powers(state, fit.bundle.blocks, seen.xy, seen.clock,
                                 seen.neighbours if own is None else None, own)
    axes = by_powers.reshape(len(by_powers), 3, 2, 3) @ state.path.mount.T
    return RowMotion(axes.reshape(by_powers.shape), seen.clock.lines, seen.clock.axis)


def shutter_findings(readout: RowReadout | None) -> tuple[Finding, ...]:
    """Say what was found of the shutter."""
    if readout is None:
        return ()
    if readout.intervals_sigma > OPEN_INTERVALS:
        return (Finding('line_delay_open', lines=readout.lines, readout={
            'value': readout.intervals, 'sigma': readout.intervals_sigma}),)
    return (readout.finding(),)
