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
Sort tracks by what explains the whole of them: the still scene, a body, a jump, or nothing.

The robust adjustment rejects observations one by one. Of a moving thing it keeps those that agree
with some point by chance, mostly along epipolar lines, and these bias the camera. So tracks are
rejected as a whole, and then explained: as rigid bodies first, then as jumps from one still point
to another, as on a repeated pattern.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.motion import NEARLY_PLANAR
from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.initialisation.problem import observations_of
from selfcal_ros.calibration.moving.jumped_tracks import enough_jump, find_jumps
from selfcal_ros.calibration.moving.rigid_bodies import find_bodies, RigidBody
from selfcal_ros.calibration.moving.track_judgement import (freedom_of, judge_tracks,
                                                            TrackTest)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.values.track_labels import (JUMPED, MOVING, STATIC, TrackLabels, UNCLEAR,
                                             UNEXPLAINED)
from selfcal_ros.values.tracks import Tracks

#: A track that a body explains as well as a point that stands still counts with neither, unless
#: the squares differ by more than this, in sigma².
CLEAR = 12.0
#: Rejected tracks stand out when they are so many, with this share of the observations; short
#: ones go with a single gross error.
FEW_TRACKS, FEW, LONG = 4, 0.04, 5
#: So do tracks that were kept, but that no still point explains as a whole, beyond this share.
#: Gross errors, heavy tails and bends of the path leave up to 0.08.
UNEXPLAINED_SHARE = 0.09
#: Tracks whose upper quartile leaves more than this, in sigma a degree of freedom, drift with
#: their patches. Then still ones fail as wholes, too, and the share of rejected ones that stands
#: out is this: a rendered still scene reaches 0.04.
DRIFTS, FEW_DRIFTING = 1.25, 0.08
#: A zoom has to explain more than these shares of what stands still, and of what moves, without
#: it. True zooms and second cameras explain 0.99 and 0.9 and more; false zooms 0.68 to 0.88, or
#: more if they are small, and 0.28 to 0.59.
ALL, MOST_MOVING = 0.95, 0.75
#: Where no body is found, what nothing explains counts as such, if it is more than this share.
MUCH = 0.15
#: A fit of all tracks that leaves less than this share of what another leaves of its still tracks
#: alone explains more: what moves adds to the noise, and never takes from it.
LESS_OF_ALL = 0.8
#: What no still point explains hides a body where fewer tracks stand out, if one is seen in so
#: many views: in three, views that are off by themselves pass for one.
BODY_VIEWS = 4
#: Turns of sorting and fitting, unless fewer than this share of the labels change.
ROUNDS, SETTLED = 6, 0.002
#: More tracks than this share that nothing explains are told.
MANY = 0.05


@dataclass(frozen=True)
class SortedTracks:
    """
    Tracks by what they are.

    Attributes
    ----------
    labels : TrackLabels
    static : Tracks
        Observations of still points; both parts of tracks that jumped, the later one under a
        new identity.
    length : ndarray of int, shape (P,)
        Observations of each track of the labels.
    contradicting : int
        Observations that nothing explains.
    still_share : float
        Of the observations that are explained, those of still points; in the view with fewest.

    """

    labels: TrackLabels
    static: Tracks
    length: np.ndarray
    contradicting: int
    still_share: float


def stands_out(fit: RobustFit, tried: Observations, agreeing: Tracks, given: Tracks,
               test: TrackTest | None) -> bool:
    """
    Tell whether so many tracks were rejected or fit badly that they may be something else.

    Parameters
    ----------
    fit : RobustFit
    tried : Observations
        That it began with.
    agreeing, given : Tracks
        Observations of the fit's views that agree with the geometry of pairs, and all.
    test : TrackTest or None
        See `tested_as_still`.

    """
    found = fit.observations
    if found.shutter is not None and not found.moves_by_view:
        # at the ends of the path all but a few were left out, and none of them was rejected
        ends = given.frames[[0, -1]]
        given, agreeing = (some.select(~np.isin(some.frame, ends)) for some in (given, agreeing))
        tried, found = (some.select((some.view > 0) & (some.view < len(fit.state.path) - 1), 1)[0]
                        for some in (tried, found))
    names, length = np.unique(given.track, return_counts=True)
    if not len(names):
        return False
    kept = np.zeros(len(names), int)
    some, count = np.unique(agreeing.track, return_counts=True)
    kept[np.searchsorted(names, some)] = count
    kept[np.searchsorted(names, tried.track)] = 0
    kept[np.searchsorted(names, found.track)] = np.bincount(found.point)
    long = length >= LONG
    lost = long & (2 * kept < length)
    share = length[lost].sum() / max(length[long].sum(), 1)
    share *= lost.sum() >= FEW_TRACKS
    if share > FEW_DRIFTING:
        return True
    if test is None:
        return bool(share > FEW)
    if drifts(test):
        return False
    return bool(share > FEW or np.mean(~test.explained[test.tested]) > UNEXPLAINED_SHARE)


def hides_body(fit: RobustFit, observations: Observations, test: TrackTest,
               size: tuple[int, int]) -> bool:
    """
    Tell whether a rigid body is among the tracks that no still point explains, though few.

    Not asked where patches drift, nor on rough ground, where views are off by themselves.
    """
    motion = fit.motion
    if drifts(test) or motion.keeps_plane and motion.is_more_uneven_than(NEARLY_PLANAR):
        return False
    rest, _ = observations.select((test.tested & ~test.explained)[observations.point])
    bodies = find_bodies(rest, fit.state.camera(*size), fit.bundle.sigma_px,
                         np.random.default_rng(0), most=1)
    return any(len(body.views) >= BODY_VIEWS for body, _ in bodies)


def explained_share(fit: RobustFit, given: Tracks, identity: np.ndarray) -> float:
    """Share of some tracks that are still points by a fit; zero where none is judged."""
    observations = observed_like(fit, given, given.frames)
    test = tested_as_still(fit, observations)
    if test is None:
        return 0.0
    mine = np.isin(observations.track, identity) & test.tested
    return float(test.explained[mine].mean()) if mine.any() else 0.0


def explains_all(rival: RobustFit, still_px: float, given: Tracks, labels: TrackLabels) -> bool:
    """
    Tell whether a fit explains what another parts into still and moving, by the less noise.

    A model with more freedom may be the true one. Then all points that stand by the other stand by
    it, too, but for chance, and what seemed to move stands still. If things that move have bent
    it, it explains neither. The other may lack what both need, as rows that are read in turn. Then
    it leaves more of its still tracks, in pixels, than the rival leaves of all.
    """
    left_px = rival.bundle.noise_rms(rival.state)
    if left_px < LESS_OF_ALL * still_px:
        return True
    sigma_px = min(left_px, still_px)
    fine = replace(rival, bundle=rival.bundle.with_sigma(sigma_px))
    moving = labels.track[labels.label >= MOVING]
    if not len(moving) and labels.share('unexplained') > MUCH:
        moving = labels.track[labels.label == UNEXPLAINED]
    return (explained_share(fine, given, labels.track[labels.label == STATIC]) > ALL
            and (not len(moving) or explained_share(fine, given, moving) > MOST_MOVING))


def observed_like(fit: RobustFit, tracks: Tracks, frames: np.ndarray) -> Observations:
    """
    Index tracks as a fit does that is to judge them; frames (V,) are its views.

    Where their rows are read in turn, those are left out of which it is open when they were read.
    """
    observations = Observations.of(tracks, frames)
    if fit.observations.shutter is None:
        return observations
    return _read_like(fit, observations).surely_timed()


def _read_like(fit: RobustFit, observations: Observations) -> Observations:
    """Add when views were taken and how rows are read, and what was just before and after."""
    clock, beside = fit.observations.clock, observations.neighbours
    beside = (None if beside is None or clock is None or fit.observations.neighbours is None
              else beside * [1, 1, 1 / clock.unit])
    timed = replace(observations, clock=clock, neighbours=beside)
    return timed.read_like(fit.observations.shutter)


def tested_as_still(fit: RobustFit, observations: Observations) -> TrackTest | None:
    """Judge tracks as points that stand still; None where a view sees none, or no track lasts."""
    if len(np.unique(observations.view)) < len(fit.state.path):
        return None
    test = judge_tracks(fit.bundle, fit.state, observations)
    return test if test is not None and test.tested.any() else None


def drifts(test: TrackTest) -> bool:
    """Tell whether patches drift, so that still points fail as wholes, too."""
    left = test.length - test.lost
    judged = test.tested & (left >= VERIFYING_VIEWS)
    return bool(judged.any() and np.percentile(
        test.square[judged] / freedom_of(left[judged]), 75) > DRIFTS**2)


def sort_tracks(fit: RobustFit, tracks: Tracks, frames: np.ndarray, size: tuple[int, int],
                rng: np.random.Generator) -> tuple[SortedTracks, RobustFit] | None:
    """
    Sort tracks by what explains them, and fit the still ones, in turns.

    Parameters
    ----------
    fit : RobustFit
        Of what seemed to stand still.
    tracks : Tracks
        All that were given.
    frames : ndarray of int, shape (V,)
        Of the fit's views.
    size : (int, int)
        Width and height of the image.
    rng : numpy.random.Generator

    Returns
    -------
    SortedTracks
    RobustFit
        Of the still tracks.
        None where they do not stand by themselves.

    """
    tracks, untimed = _timed_alone(fit, tracks.in_frames(frames).with_at_least(2), frames)
    observations = observed_like(fit, tracks, frames)
    identity, point = observations.track, observations.point
    label = np.full(len(identity), -1)
    test = judge_tracks(fit.bundle, fit.state, observations)
    for _ in range(ROUNDS):
        if test is None:
            return None
        before = label
        label = np.where(np.where(test.tested, test.explained, test.lost == 0),
                         STATIC, UNEXPLAINED)
        changed = np.mean(before != label)
        if changed < SETTLED:
            break
        refitted = _fitted(fit, tracks.select(test.agrees & (label[point] == STATIC)), frames)
        if refitted is None:
            break
        fit = refitted
        test = judge_tracks(fit.bundle, fit.state, observations)
    if test is None:
        return None
    # a thing that moves is still in no two halves of a long track; short halves prove nothing
    doubtful = np.flatnonzero((label == UNEXPLAINED) & test.tested)
    cut = find_jumps(fit, observations, doubtful, VERIFYING_VIEWS)
    label[list(cut)] = JUMPED
    bodies = _bodies(fit, observations, test, label, size, rng)
    doubtful = np.flatnonzero((label == UNEXPLAINED) & test.tested)
    cut.update(find_jumps(fit, observations, doubtful, VERIFYING_VIEWS - 1))
    agrees = test.agrees & (label[point] == STATIC)
    parts = [tracks.select(agrees), untimed.select(
        np.isin(untimed.track, identity[label == STATIC]))]
    later = int(identity.max()) + 1
    for place, (rows, second) in cut.items():
        label[place] = JUMPED
        track = tracks.track[rows] * ~second + (later + place) * second
        parts.append(Tracks(tracks.frame[rows], track, tracks.xy[rows], neighbours=(
            None if tracks.neighbours is None else tracks.neighbours[rows])))
    static = _together(parts).with_at_least(2)
    final = _fitted(fit, static, frames)
    known = label[point] >= UNCLEAR
    return None if final is None else (SortedTracks(
        TrackLabels(identity, label, bodies), static, np.bincount(point, minlength=len(label)),
        int(np.sum(~known & ~test.agrees)), _still_share(observations, label)), final)


def _timed_alone(fit: RobustFit, tracks: Tracks, frames: np.ndarray) -> tuple[Tracks, Tracks]:
    """Split tracks into what can be judged by a fit, and what it leaves out as hardly timed."""
    if fit.observations.shutter is None:
        return tracks, tracks.select(np.zeros(len(tracks.frame), bool))
    timed = _read_like(fit, Observations.of(tracks, frames)).surely_timed_rows()
    return tracks.select(timed).with_at_least(2), tracks.select(~timed)


def _together(parts: list[Tracks]) -> Tracks:
    """Join tracks of one recording, of which the first say what image and stamps they have."""
    first = parts[0]
    frame, track, xy = (np.concatenate([getattr(one, name) for one in parts])
                        for name in ('frame', 'track', 'xy'))
    beside = (None if first.neighbours is None else np.concatenate(
        [one.neighbours for one in parts if one.neighbours is not None]))
    return Tracks(frame, track, xy, first.image_size, first.stamps_ns, neighbours=beside)


def _still_share(observations: Observations, label: np.ndarray) -> float:
    """Share of the observations of still points, in the view where it is least, of all judged."""
    views = int(observations.view.max()) + 1
    judged = np.isin(label, (STATIC, JUMPED)) | (label >= MOVING) | (label == UNCLEAR)
    still = np.isin(label, (STATIC, JUMPED))
    seen = np.bincount(observations.view, judged[observations.point], views)
    share = np.bincount(observations.view, still[observations.point], views) / np.maximum(seen, 1)
    return float(share.min())


def moving_findings(labels: TrackLabels, length: np.ndarray,
                    least: float = FEW) -> tuple[Finding, ...]:
    """
    Tell what moves by itself and what jumps, on more than the least share of the tracks.

    Of what moves a share of the observations suffices: what keeps before a vehicle is seen all the
    time, in few tracks. What nothing explains is told where it is much; with a smaller least
    share, where it is all that there is, too.
    """
    found = []
    shares = [labels.share(f'moving {k + 1}') for k in range(labels.bodies)]
    seen = np.bincount(labels.label, length)
    if max(sum(shares), seen[MOVING:].sum() / max(seen.sum(), 1)) > least:
        found.append(Finding('tracks_moving', share=float(sum(shares)), bodies=labels.bodies,
                             shares=[float(share) for share in shares]))
    jumped, unexplained = labels.share('jumped'), labels.share('unexplained')
    if jumped > least or enough_jump(jumped, unexplained):
        found.append(Finding('tracks_jump', share=float(jumped)))
    if unexplained > (least if least < FEW and not found else MANY):
        found.append(Finding('tracks_unexplained_whole', share=float(unexplained)))
    return tuple(found)


def _fitted(fit: RobustFit, tracks: Tracks, frames: np.ndarray) -> RobustFit | None:
    """Fit other tracks from where a fit stands."""
    observations = observations_of(tracks, frames)
    if fit.observations.shutter is not None:
        observations = _read_like(fit, observations)
    if len(np.unique(observations.view)) < len(frames):
        return None
    state = with_all_points(fit.state, observations)
    if state is None:
        return None
    return fit_robustly(observations, state, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)


def _bodies(fit: RobustFit, observations: Observations, test: TrackTest, label: np.ndarray,
            size: tuple[int, int], rng: np.random.Generator) -> int:
    """Label the tracks of rigid bodies; returns how many there are."""
    rest, places = observations.select(
        (label == UNEXPLAINED)[observations.point] & test.tested[observations.point])
    if not len(places):
        return 0
    bodies: list[RigidBody] = []
    for body, members in find_bodies(rest, fit.state.camera(*size), fit.bundle.sigma_px, rng):
        label[places[members]] = MOVING + len(bodies)
        bodies.append(body)
    for body in bodies:
        _doubt(body, observations, test, label)
    return len(bodies)


def _doubt(body: RigidBody, observations: Observations, test: TrackTest,
           label: np.ndarray) -> None:
    """Take the tracks out that the body explains as well as the still scene does."""
    found = body.test(observations)
    if found is None:
        return
    own, seen = found
    whole = own.length == test.length[seen]
    alike = own.square + 16 * own.lost < test.square[seen] + 16 * test.lost[seen] + CLEAR
    either = seen[own.explained & whole & alike & (label[seen] == STATIC)]
    label[either] = UNCLEAR
