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
Whether a rig was rigid all the time: cameras that were late, and cameras that were knocked.

A camera that is late by τ sees the rig where it is τ later. Its image moves by τ times the flow,

    du/dτ = du/d(pose) · d(pose)/dt,

where the path between the instants is taken to be smooth. A camera that was knocked has one pose
up to some instant and another from then on. Either is tested by one step of the estimate that has
it. What it would move is added to the covariance, and of two causes the better one is told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from selfcal_ros.calibration.bundle.path import VIEW_NAMES
from selfcal_ros.calibration.bundle.rig import POSE_NAMES, Rig
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.rigs.start import RigObservations
from selfcal_ros.calibration.uncertainty.suppositions import (added_covariance,
                                                              joint_information,
                                                              JointInformation, likely_size,
                                                              Supposition, Tested)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.distributions import chi2_sf
from selfcal_ros.geometry.no_estimate import NoEstimate

#: Offsets over the usual time between instants: each is as likely beforehand.
OFFSETS = np.geomspace(1e-4, 1e-1, 13)
#: A cause is told of where without it the images would be an accident so rarely.
ACCIDENT = 1e-6
#: A knock that moves no point by a tenth of a pixel is no knock to speak of, though it may show
#: beyond chance, as where positions were moved along their tracks. Radians; steps of the path.
LEAST_TURN_RAD, LEAST_PLACE = 1e-4, 2e-3
#: Fewer instants make no smooth path.
MIN_INSTANTS = 5
_OFFSET, _KNOCK = 'one clock', 'no knock'


@dataclass(frozen=True)
class Unsteady:
    """
    What made a rig other than rigid, beyond doubt.

    Attributes
    ----------
    camera, first : str
        The one moved to the other, or was triggered apart from it.
    explained : float
        Share of the sum of squared residuals that is gone without it.
    frame : int, optional
        The first after a knock.
    offset : float
        Otherwise: how much later the camera was than the first, over the usual time between
        instants.
    interval_s : float, optional
        That time, where it is known.

    """

    camera: str
    first: str
    explained: float
    frame: int | None = None
    offset: float = 0.0
    interval_s: float | None = None

    def finding(self) -> Finding:
        """Tell of it beside a result."""
        if self.frame is not None:
            return Finding('rig_pose_changed', camera=self.camera, first=self.first,
                           frame=self.frame)
        return Finding('rig_clocks_differ', camera=self.camera, first=self.first,
                       apart=self._apart())

    def refusal(self, left_px: float, noise_px: float, motion: str) -> NoEstimate:
        """Refuse because of it: together the cameras leave more than each does alone."""
        if self.frame is not None:
            return NoEstimate('rig_knocked', camera=self.camera, first=self.first,
                              frame=self.frame, left_px=left_px, noise_px=noise_px,
                              motion=motion)
        return NoEstimate('rig_clocks_apart', camera=self.camera, first=self.first,
                          apart=self._apart(), left_px=left_px,
                          noise_px=noise_px, motion=motion)

    def _apart(self) -> dict[str, float | None]:
        """How far apart the cameras were triggered, for the words."""
        return {'share': self.offset, 'interval_s': self.interval_s}


def steadiness(fit: RobustFit, seen: RigObservations, variance_inflation: float,
               ) -> tuple[np.ndarray, Unsteady | None]:
    """
    Ask the images of a rig whether it was rigid, and whether its images are of one instant.

    Parameters
    ----------
    fit : RobustFit
        Of a rig, at its optimum.
    seen : RigObservations
        Its frames count time where its seconds are not known.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    covariance : ndarray, shape (k, k)
        To add to that of the unknowns of the lens block.
    cause : Unsteady or None

    """
    rig, unknowns = fit.state.lens, fit.bundle.unknowns
    assert isinstance(rig, Rig)
    cameras = rig.cameras[1:]
    size = unknowns.lens.stop - unknowns.lens.start
    times = seen.frames if seen.seconds is None else seen.seconds
    if len(times) < MIN_INSTANTS:
        return np.zeros((size, size)), None
    rows = np.array([np.arange(size)[rig.of_pose(k)] for k in range(1, len(rig.cameras))])
    poses = fit.linearisation.shared[:, :, unknowns.lens][:, :, rows.ravel()]
    joint = joint_information(fit, [
        Supposition(_OFFSET, cameras, _flow(fit, times, len(cameras))),
        Supposition(_KNOCK, POSE_NAMES * len(cameras), poses, of_views=True)], variance_inflation)
    offset = joint.test(_OFFSET)
    beforehand = likely_size(offset.value, offset.information, OFFSETS)**2
    found, _ = offset.with_prior(beforehand)
    covariance = added_covariance(fit, offset, beforehand)

    knocks = [(tested, k, view) for k, own in enumerate(
        np.split(joint.places[_KNOCK], len(cameras), axis=1))
        for view, tested in enumerate(every_knock(joint, own), 1)]
    knock, k, view = min(knocks, key=lambda one: (one[0].p_value, -one[0].chi2))

    def explained(one: Tested) -> float:
        return one.chi2 * variance_inflation / max(2 * len(fit.observations.view), 1)

    # a knock has more unknowns, and an instant besides; on an S it does nearly what lateness does
    more = (len(POSE_NAMES) - len(cameras)) * np.log(max(fit.observations.view.size, 2))
    price = max(more, 0.0) + 2 * np.log(len(knocks))
    if knock.p_value * len(knocks) < ACCIDENT and knock.chi2 > offset.chi2 + price:
        step = np.zeros(size)
        step[rows[k]] = knock.value
        # the poses before and after it are both within the sigmas
        for moved in (knock.shift, knock.shift + step):
            moved = moved * unknowns.free[unknowns.lens]
            covariance += np.outer(moved, moved)
        if (np.abs(knock.value[3:]).max() < LEAST_TURN_RAD
                and np.abs(knock.value[:3]).max() < LEAST_PLACE):
            return covariance, None
        return covariance, Unsteady(cameras[k], rig.cameras[0], explained(knock),
                                    int(seen.frames[view]))
    variance = np.diag(offset.covariance)
    certain = [np.isfinite(square) and square > 0
               and chi2_sf(value**2 / square, 1) < ACCIDENT
               for value, square in zip(offset.value, variance)]
    if not any(certain):
        return covariance, None
    most = int(np.argmax(np.abs(found) * certain))
    return covariance, Unsteady(
        cameras[most], rig.cameras[0], explained(offset), offset=float(found[most]),
        interval_s=None if seen.seconds is None else float(np.median(np.diff(seen.seconds))))


def every_knock(joint: JointInformation, places: np.ndarray) -> list[Tested]:
    """
    Test whether a camera has another pose from an instant on, for all instants but the first.

    All sums over later instants grow by one instant at a time, from the last one backward.

    Parameters
    ----------
    joint : JointInformation
    places : ndarray of int, shape (V, 6)
        Where the unknowns of the camera stand in it, if it moves at each instant.

    Returns
    -------
    list of Tested
        V - 1 of them.

    """
    views, size = places.shape
    blocks = joint.information[np.ix_(places.ravel(), places.ravel())].reshape(
        views, size, views, size)
    each = np.arange(views)
    # what an instant shares with later ones, once above the diagonal and once below
    shared = np.einsum('vibj,vb->vij', blocks, np.triu(np.ones((views, views)), 1))
    added = blocks[each, :, each] + shared + np.swapaxes(shared, 1, 2)

    def from_then_on(values: np.ndarray) -> np.ndarray:
        sums: np.ndarray = np.cumsum(values[::-1], axis=0)[::-1]
        return sums[1:]

    of_lens = np.moveaxis(joint.lens[:, places], 0, 1)
    return [joint.test_of(J, u, raw, response, _KNOCK, POSE_NAMES) for J, u, raw, response in zip(
        from_then_on(added), from_then_on(joint.score[places]), from_then_on(joint.raw[places]),
        from_then_on(of_lens))]


def _flow(fit: RobustFit, times: np.ndarray, others: int) -> np.ndarray:
    """Differentiate the residuals by how late each camera but the first is, (N, 2, others)."""
    flow = np.einsum('nkj,nj->nk', fit.linearisation.view,
                     _velocities(fit, times)[fit.observations.view])
    camera = fit.observations.camera
    assert camera is not None, 'observations of a rig'
    return np.stack([flow * (camera == k)[:, None] for k in range(1, others + 1)], axis=2)


def _velocities(fit: RobustFit, times: np.ndarray) -> np.ndarray:
    """Differentiate the unknowns of the views by time, in usual intervals, (V, v)."""
    path, time = fit.state.path, times / np.median(np.diff(times))
    values = dict(zip(VIEW_NAMES, np.column_stack([
        np.unwrap(path.angle), path.translation[:, :2], path.tilt, path.translation[:, 2]]).T))
    moving = np.column_stack([values[name] for name in fit.bundle.unknowns.view_names])
    velocities: np.ndarray = CubicSpline(time, moving)(time, 1)
    return velocities
