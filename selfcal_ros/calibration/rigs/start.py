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
"""What all cameras of a rig saw, and where their joint adjustment starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import itertools

import numpy as np

from selfcal_ros.calibration.bundle.centres import all_rays, points_from_centres
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Priors, priors_from_facts, with_fixed
from selfcal_ros.calibration.bundle.rig import Rig, RigPriors
from selfcal_ros.calibration.bundle.rig_model import RigState
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations
from selfcal_ros.calibration.bundle.tolerances import TO_GO_ON
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.rigs.alignment import align
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.resection import decompose, resect
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.geometry.space_resection import pose_of_rays
from selfcal_ros.values.tracks import of_longest, Tracks

#: Tracks per instant and camera that the estimate uses, and that starts are compared on.
TRACKS_PER_VIEW, START_TRACKS_PER_VIEW = 400, 60
#: A start is optimised so often at most.
START_ITERATIONS = 40
#: Shared points that a camera needs which cannot be calibrated by itself.
MIN_SHARED = 30


@dataclass(frozen=True)
class RigObservations:
    """
    All observations by index, and whose they are.

    Attributes
    ----------
    observations : Observations
        Their tracks are numbers of `track`.
    frames : ndarray of int, shape (V,)
        Frame of each view.
    cameras : tuple of str
    seconds : ndarray, shape (V,), optional
        When each view was taken, by the stamps of the first camera that has them.

    """

    observations: Observations
    frames: np.ndarray
    cameras: tuple[str, ...]
    seconds: np.ndarray | None = None


def observations_of(tracks: Mapping[str, Tracks], used: Mapping[str, np.ndarray | None],
                    frames: np.ndarray, shared: bool) -> RigObservations:
    """
    Put the observations of all cameras together.

    Parameters
    ----------
    tracks : mapping of str to Tracks
    used : mapping of str to ndarray of int or None
        Tracks of each camera that its own calibration has kept; None: all.
    frames : ndarray of int, shape (V,)
    shared : bool
        Equal numbers in two cameras are the same point.

    Returns
    -------
    RigObservations

    """
    seen_by_two = _shared_tracks(tracks) if shared else np.empty(0, int)
    parts = []
    for k, (name, one) in enumerate(tracks.items()):
        kept, of_camera = np.isin(one.frame, frames), used[name]
        if of_camera is not None:
            kept &= np.isin(one.track, of_camera) | np.isin(one.track, seen_by_two)
        identity = one.track if shared else one.track * len(tracks) + k
        parts.append((one.frame[kept], identity[kept], one.xy[kept],
                      np.full(int(kept.sum()), k)))
    frame, track, xy, camera = (np.concatenate(columns) for columns in zip(*parts))
    view = np.searchsorted(frames, frame)
    names, point = np.unique(track, return_inverse=True)
    order = np.lexsort((camera, view, point))
    everything = Observations(view[order], point[order], xy[order], names, camera=camera[order])
    most = of_longest(everything.view, everything.point, TRACKS_PER_VIEW * len(tracks))
    return RigObservations(everything.select(most)[0], frames, tuple(tracks),
                           _seconds(tracks, frames))


def _seconds(tracks: Mapping[str, Tracks], frames: np.ndarray) -> np.ndarray | None:
    """Return when frames (V,) were taken, from the first of them; None: no camera tells."""
    for one in tracks.values():
        if one.stamps_ns is not None and all(int(frame) in one.stamps_ns for frame in frames):
            stamps = np.array([one.stamps_ns[int(frame)] for frame in frames])
            if (np.diff(stamps) > 0).all():
                seconds: np.ndarray = (stamps - stamps[0]) / 1e9
                return seconds
    return None


def _shared_tracks(tracks: Mapping[str, Tracks]) -> np.ndarray:
    """Return the tracks that more than one camera has."""
    names, count = np.unique(np.concatenate([np.unique(one.track) for one in tracks.values()]),
                             return_counts=True)
    return names[count > 1]


def priors_of(calibration: Calibration, facts: CameraFacts) -> Priors:
    """Return what is stated of a camera, and the lens that a calibration has chosen."""
    chosen = replace(facts, distortion=calibration.facts.distortion)
    return replace(priors_from_facts(chosen), population=calibration.population)


@dataclass(frozen=True)
class Placed:
    """
    A camera with its lens, before the reference camera.

    Attributes
    ----------
    camera : Camera
    pose : ndarray, shape (3, 4)
        [R | p] in the reference camera.
    scale : float
        Length of the reference's path over that of this camera's own; NaN: not known.

    """

    camera: Camera
    pose: np.ndarray
    scale: float = np.nan

    def before_first(self, other: Placed) -> Placed:
        """Return another, which is placed before this camera in its own unit, like this one."""
        R, p = self.pose[:, :3], self.pose[:, 3]
        return Placed(other.camera, np.column_stack(
            [R @ other.pose[:, :3], self.scale * R @ other.pose[:, 3] + p]))


def places(reference: str, known: Mapping[str, Calibration], moving: Sequence[str],
           tracks: Mapping[str, Tracks], shared: bool) -> dict[str, list[Placed]]:
    """
    Return what the places of all cameras may be.

    Paths lay a camera over the reference. So do points that both see, or that it shares with a
    camera that is placed so.

    Parameters
    ----------
    reference : str
    known : mapping of str to Calibration
        Of the cameras that could be calibrated by themselves.
    moving : sequence of str
        Those of them that know their path.
    tracks : mapping of str to Tracks
    shared : bool
        Equal numbers in two cameras are the same point.

    Returns
    -------
    dict of str to list of Placed
        Empty for a camera that nothing places.

    """
    anchor = known[reference]
    found = {name: [Placed(anchor.camera, np.eye(3, 4))] if name == reference else
             places_by_path(anchor, known[name]) if name in moving else [] for name in tracks}
    if not shared:
        return found
    cameras = {name: one.camera for name, one in known.items()}
    for name in tracks.keys() - {reference}:
        found[name] += place_by_points(anchor, tracks[name], cameras.get(name))
    for name in [name for name in tracks if not found[name]]:
        found[name] = [
            way.before_first(one) for donor in moving if donor != reference
            for way in found[donor] if np.isfinite(way.scale)
            for one in place_by_points(known[donor], tracks[name], cameras.get(name))]
    while True:
        # by the points of cameras that were placed so themselves, one after the other
        more = {name: [one for donor, ways in found.items() if donor != reference
                       for way in ways[:1]
                       for one in place_by_points(
                           _with_points_of(anchor, {name: tracks[name] for name in (
                               reference, donor)}, way), tracks[name], cameras.get(name))]
                for name in tracks if not found[name]}
        if not any(more.values()):
            return found
        found.update({name: ways for name, ways in more.items() if ways})


def _with_points_of(anchor: Calibration, tracks: Mapping[str, Tracks], placed: Placed,
                    ) -> Calibration:
    """Return a calibration whose reconstruction has what a second camera sees from its place."""
    seen = observations_of(tracks, dict.fromkeys(tracks), anchor.reconstructed.frames, True)
    state = start_state(seen, anchor, [Placed(anchor.camera, np.eye(3, 4)), placed])
    return anchor if state is None else replace(anchor, reconstruction=Reconstruction(
        seen.frames, state.path.cam_from_world(), seen.observations.track, state.points))


def places_by_path(reference: Calibration, other: Calibration) -> list[Placed]:
    """Return where the paths of two cameras put the other; see `align`."""
    common, i, k = np.intersect1d(reference.reconstructed.frames, other.reconstructed.frames,
                                  return_indices=True)
    found = align(reference.reconstructed.cam_from_world[i],
                  other.reconstructed.cam_from_world[k]) if len(common) else []
    return [Placed(other.camera, one.pose, one.scale) for one in found]


def place_by_points(reference: Calibration, seen: Tracks, camera: Camera | None) -> list[Placed]:
    """
    Return a camera that the points of a reconstruction are seen by.

    All points before the reference camera, at whatever instant, are one object to a camera that
    moves with it. A camera whose lens is not known may have that of the reference, or be one that
    the points show.
    """
    path = reference.reconstructed
    rows = np.isin(seen.frame, path.frames) & np.isin(seen.track, path.tracks)
    if rows.sum() < MIN_SHARED:
        return []
    by_track = np.argsort(path.tracks)
    X = path.points[by_track[np.searchsorted(path.tracks[by_track], seen.track[rows])]]
    poses = path.cam_from_world[np.searchsorted(path.frames, seen.frame[rows])]
    before = np.column_stack([np.einsum('nij,nj->ni', poses, X), X[:, 3]])
    xy, lens = seen.xy[rows], camera or reference.camera
    placed = []
    alike = pose_of_rays(before, all_rays(lens, xy))
    if not isinstance(alike, NoEstimate):
        R, t = alike.pose[:, :3], alike.pose[:, 3]
        placed.append(Placed(lens, np.column_stack([R.T, -R.T @ t])))
    if camera is not None:
        return placed
    found = resect(before, xy, huber_sigmas=2.0)
    parts = found if isinstance(found, NoEstimate) else decompose(found.P)
    if not isinstance(parts, NoEstimate):
        # the lens is bent like the other's, for a start
        placed.append(Placed(Camera(parts.K, lens.distortion, *(seen.image_size or (0, 0)),
                                    lens.model), np.column_stack([parts.R.T, parts.centre])))
    return placed


def start_state(observations: RigObservations, reference: Calibration, placed: Sequence[Placed],
                ) -> RigState | None:
    """
    Put the rig on the path of the reference camera, and intersect all points.

    Parameters
    ----------
    observations : RigObservations
    reference : Calibration
    placed : sequence of Placed
        All cameras before the reference, the reference among them.

    Returns
    -------
    RigState or None
        None where a pixel has no ray.

    """
    R_0, p_0 = placed[0].pose[:, :3], placed[0].pose[:, 3]
    poses = np.stack([np.column_stack([R_0.T @ one.pose[:, :3],
                                       R_0.T @ (one.pose[:, 3] - p_0)]) for one in placed])
    rig = Rig.of_cameras(observations.cameras, [Lens.of(one.camera) for one in placed], poses)
    path = reference.reconstructed
    of_reference = path.cam_from_world[np.searchsorted(path.frames, observations.frames)]
    first = R_0.T @ (of_reference - np.concatenate([np.zeros((3, 3)), p_0[:, None]], axis=1))
    # the world's origin is where the rig is first
    origin = -first[0, :, :3].T @ first[0, :, 3]
    first[:, :, 3] += first[:, :, :3] @ origin
    start = RigState(rig, AxisPath.of_poses(first[0, :, :3], first))
    return with_all_points(start, observations.observations)


def with_all_points(state: RigState, observations: Observations) -> RigState | None:
    """Intersect the points of all observations from the cameras of a state."""
    rays = _rays(state, observations)
    return None if rays is None else replace(state, points=points_from_centres(*rays))


def seen_ahead(state: RigState, observations: Observations) -> RigState:
    """
    Return a state with its points before the cameras: else its mirror image.

    That explains the same, with all translations the other way. Points pass through infinity
    where a start is far off.
    """
    rays = _rays(state, observations)
    if rays is None:
        return state
    stations, directions, centres = rays
    X, weight = state.points[stations.point, :3], state.points[:, 3]
    toward = np.einsum('ni,ni->n', directions, (
        X - weight[stations.point, None] * centres[stations.view]))
    # far points, whose side is noise, weigh little
    side = np.sign(stations.sum_over_points(np.sign(toward))) @ weight
    return state if side >= 0 else state.scaled(-1.0)


def _rays(state: RigState, observations: Observations,
          ) -> tuple[PointBlocks, np.ndarray, np.ndarray] | None:
    """Return the cameras at all instants as views, the world directions (N, 3), and centres."""
    camera, view, rig, path = observations.camera, observations.view, state.lens, state.path
    assert camera is not None, 'observations of a rig'
    rays = np.empty((len(view), 3))
    for k in range(len(rig.cameras)):
        rows = camera == k
        rays[rows] = all_rays(rig.lens(k).camera(), observations.xy[rows]) @ rig.rotations[k].T
    if not np.isfinite(rays).all():
        return None
    # every camera at every instant is a station of its own
    count = len(rig.cameras)
    stations = PointBlocks(observations.point, view * count + camera)
    turns = path.rotations()
    directions = np.einsum('nji,nj->ni', turns[view], rays @ path.mount)
    places = np.stack([rig.place(k) for k in range(count)]) @ path.mount
    centres = np.einsum('vji,vcj->vci', turns, places[None] - path.translation[:, None])
    return stations, directions, centres.reshape(-1, 3)


def best_start(found: RigObservations, reference: Calibration,
               choices: Sequence[Sequence[Placed]], priors: RigPriors, motion: MotionModel,
               sigma_px: float) -> RigState | None:
    """
    Choose among what the cameras' places may be, by how well a share of the tracks fits.

    Parameters
    ----------
    found : RigObservations
    reference : Calibration
    choices : sequence of sequences of Placed
        Of every camera.
    priors : RigPriors
    motion : MotionModel
    sigma_px : float

    Returns
    -------
    RigState or None

    """
    cameras = len(found.cameras)
    few = found.observations.longest(START_TRACKS_PER_VIEW * cameras)
    best, least = None, np.inf
    for placed in itertools.product(*choices):
        start = start_state(replace(found, observations=few), reference, placed)
        if start is None:
            continue
        bundle = bundle_of(few, motion, priors, sigma_px)
        state = bundle.refine_points(with_fixed(start, priors))
        # far from the optimum what fits would be taken for outliers
        state = bundle.optimise(state, iterations=START_ITERATIONS, tolerance=TO_GO_ON)
        assert isinstance(state, RigState), 'as it began'
        # wrong tracks may cost less where everything else is bent to them; they are few
        left = bundle.noise_sigma(state)
        if left < least:
            best, least = seen_ahead(state, few), left
    return None if best is None else with_all_points(best, found.observations)
