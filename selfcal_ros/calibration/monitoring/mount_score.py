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
What a few successive keyframes, and poses of the body beside them, say of the mount in force.

The window's own poses of the camera, with the lens in force, are held against those of the body.
The score tells how far the camera is turned, and moved, from where it was mounted. The unit of the
window, its place in the robot's world and the errors of its images are eliminated. What a motion
does not show carries no information: in a plane the height, on a straight way the roll, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.priors import all_fixed
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.tolerances import TO_MEASURE
from selfcal_ros.calibration.initialisation.view_graph import MIN_NOISE_PX, ViewGraph
from selfcal_ros.calibration.monitoring.window_fit import WindowFit
from selfcal_ros.calibration.mount import Mount, MountFacts, TURN as TURNS
from selfcal_ros.calibration.mounting.adjustment import Adjustment
from selfcal_ros.calibration.mounting.body_track import BodyAt, BodyTrack
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses, poses_of_fit
from selfcal_ros.calibration.mounting.model import COUNT, OFFSET, State, T, TURN
from selfcal_ros.calibration.mounting.pose_errors import PoseErrors
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.distributions import chi2_isf
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import nearest_rotation, rotation_vector
from selfcal_ros.geometry.scaled_inverse import unit_diagonal
from selfcal_ros.values.body_poses import BodyPoses

#: The parameters of a score: a small turn about the body's axes, the place, the clocks.
PARAMETERS = np.r_[TURN, T, OFFSET]
#: Windows with fewer poses of the body say too little.
MIN_POSES = 5
#: A knock turns the camera by so much at most, radians; a place that is open lies within this of
#: where it is supposed, metres, and clocks within this, seconds.
FARTHEST_RAD, VAGUE_M, VAGUE_S = 0.2, 0.5, 0.5
#: Directions with less than this share of the information are not shown at all.
OPEN = 1e-9
#: With fewer degrees of freedom misfits do not tell their variance.
LEAST_FREEDOM = 3
#: Poses whose misfit has less than this chance are left out, and a window with more than this
#: share of them is of another motion.
WRONG, MOST_WRONG = 1e-4, 0.4


@dataclass(frozen=True)
class MountScore:
    """
    Information of one window about the mount.

    Attributes
    ----------
    frames : tuple of int
        Keyframes of the window.
    information : ndarray, shape (7, 7)
        Of `PARAMETERS`; singular where the motion leaves something open.
    shift : ndarray, shape (7,)
        Information times the step from the mount in force to the one that the window shows.

    """

    frames: tuple[int, ...]
    information: np.ndarray
    shift: np.ndarray


def is_watchable(mount: object) -> bool:
    """Tell whether a mount is known well enough to be watched: all of its turns are."""
    return (isinstance(mount, Mount) and bool(np.isfinite(mount.T_body_camera[:3, :3]).all())
            and len(mount.pose_sigmas) == 6
            and all(mount.status[name] != 'unobservable' for name in TURNS))


def mount_score(graph: ViewGraph, window: WindowFit, camera: Camera, mount: Mount,
                poses: BodyPoses, facts: MountFacts = MountFacts(),
                variance_inflation: float = 1.0) -> MountScore | NoEstimate:
    """
    Score a window of keyframes against a mount.

    Parameters
    ----------
    graph : ViewGraph
    window : WindowFit
        Of the same keyframes.
    camera : Camera
        In force.
    mount : Mount
        In force; `is_watchable`.
    poses : BodyPoses
        Of the body, as long as the window lasts.
    facts : MountFacts
        By which the mount was estimated: of them the scale of the poses counts.
    variance_inflation : float
        Variance of what images say over that with independent errors.

    Returns
    -------
    MountScore or NoEstimate
        The latter where the window says nothing.

    """
    frames = np.asarray(graph.frames)
    track = BodyTrack(poses, frames, graph.tracks.stamps_ns)
    offset = mount.time_offset_s if np.isfinite(mount.time_offset_s) else 0.0
    rows = np.flatnonzero(track.known(offset, 0.02 if track.timed else 0.0))
    if len(rows) < MIN_POSES:
        return NoEstimate('window_without_body', poses=len(rows))
    track = track.anchored(offset)
    path = poses_of_fit(frames, _with_lens(window, camera), variance_inflation).chosen(rows)
    metre = facts.scale[0] if facts.scale is not None else 1.0
    start = _start(mount, path, track.at(offset, rows), offset, metre)
    if start is None:
        return NoEstimate('window_body_otherwise', share=1.0)
    errors = PoseErrors.known(np.asarray(mount.pose_sigmas), track, offset, rows)
    adjustment = Adjustment(path, track, rows, _nearby(mount, start, facts))
    state, _ = adjustment.descend(start, errors)
    return _score(frames, mount, start, state, adjustment, errors)


def _with_lens(window: WindowFit, camera: Camera) -> RobustFit:
    """Return the window's adjustment with the lens in force, and not with its own."""
    lens = Lens.of(camera)
    bundle = window.fit.bundle.with_priors(all_fixed(lens))
    state = bundle.optimise(replace(window.fit.state, lens=lens), iterations=15,
                            tolerance=TO_MEASURE)
    noise = max(bundle.noise_rms(state), MIN_NOISE_PX)
    return replace(window.fit, bundle=bundle.with_sigma(noise), state=state)


def _start(mount: Mount, camera: CameraPoses, body: BodyAt, offset: float,
           metre: float) -> State | None:
    """Place the window in the robot's world by the mount in force; None where nothing fits."""
    M, t = mount.T_body_camera[:3, :3], np.nan_to_num(mount.T_body_camera[:3, 3])
    # the mean of what each view says of the turn between the worlds
    told = body.rotation @ M @ np.swapaxes(camera.rotation, 1, 2)
    G = nearest_rotation(told.sum(axis=0))
    at = metre * body.position + body.rotation @ t
    there, ours = at - at.mean(axis=0), (camera.centre - camera.centre.mean(axis=0)) @ G.T
    scale = float(np.sum(there * ours) / np.sum(ours**2))
    if not scale > 0:
        return None
    place = at.mean(axis=0) - scale * camera.centre.mean(axis=0) @ G.T
    return State(t, M, float(np.log(scale)), offset, float(np.log(metre)), G, place,
                 np.zeros(camera.roots.shape[2]))


def _nearby(mount: Mount, start: State, facts: MountFacts) -> MountFacts:
    """Let the mount be any near that in force, its place and its clocks as they are known."""
    def about(name: str, value: float, vague: float) -> tuple[float, float]:
        return value, float(np.clip(mount.sigma[name], 1e-4, vague))
    places = {name: about(name, float(value), VAGUE_M)
              for name, value in zip('xyz', start.place)}
    angles = {name: (value, FARTHEST_RAD) for name, value in mount.angles.items()}
    return MountFacts(**places, **angles, time_offset=about('time_offset', start.offset, VAGUE_S),
                      scale=None if facts.scale is None else (facts.scale[0], 0.0))


def _score(frames: np.ndarray, mount: Mount, start: State, state: State,
           adjustment: Adjustment, errors: PoseErrors) -> MountScore | NoEstimate:
    """Tell what the poses say at an optimum, all but `PARAMETERS` eliminated."""
    keep = adjustment.distances(state, errors) < chi2_isf(WRONG, 6)
    if np.mean(~keep) > MOST_WRONG:
        return NoEstimate('window_body_otherwise', share=float(np.mean(~keep)))
    H, g, square = adjustment.of_poses(state, errors, keep)
    free = adjustment.free.copy()
    free[PARAMETERS] = True
    others = np.setdiff1d(np.flatnonzero(free), PARAMETERS)
    inner = H[np.ix_(others, others)]
    # what nothing shows is held by a hair
    inner = inner + 1e-9 * np.diag(np.diag(inner) + 1e-12)
    through = np.linalg.solve(inner, np.column_stack([H[np.ix_(others, PARAMETERS)], g[others]]))
    tied = H[np.ix_(PARAMETERS, others)]
    information = H[np.ix_(PARAMETERS, PARAMETERS)] - tied @ through[:, :-1]
    shift = g[PARAMETERS] - tied @ through[:, -1]
    step = np.concatenate([rotation_vector(state.turn @ mount.T_body_camera[:3, :3].T),
                           state.place - start.place, [state.offset - start.offset]])
    # poses that err by more than those of the calibration weigh less
    excess = max(1.0, variance_ratio(H, g, square, int(keep.sum()), adjustment.free))
    return MountScore(tuple(int(frame) for frame in frames), information / excess,
                      (shift + information @ step) / excess)


def variance_ratio(H: np.ndarray, g: np.ndarray, square: float, poses: int,
                   free: np.ndarray) -> float:
    """
    Return the variance of misfits over that stated.

    Facts and wide tails keep a state from where the misfits are least. There, one step on, the
    square has the degrees of freedom that the unknowns leave.

    Parameters
    ----------
    H : ndarray, shape (16 + k, 16 + k)
    g : ndarray, shape (16 + k,)
    square : float
        See `Adjustment.of_poses`.
    poses : int
        Misfits that count.
    free : ndarray of bool, shape (16 + k,)

    Returns
    -------
    float

    """
    scaled, scale = unit_diagonal(H[np.ix_(free, free)])
    values, vectors = np.linalg.eigh(scaled)
    told = values > OPEN
    pull = (vectors.T @ (g[free] / scale))[told]
    # the unknowns of the images are misfits, too
    freedom = 6 * poses + len(g) - COUNT - int(told.sum())
    return (square - float(np.sum(pull**2 / values[told]))) / max(freedom, LEAST_FREEDOM)
