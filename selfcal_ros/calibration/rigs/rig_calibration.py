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
From the tracks of several cameras that move together to all their lenses and poses.

Every camera is calibrated by itself; one that cannot be is placed by the points that it shares
with another. The paths are laid over each other, then one adjustment of all cameras on one path
ends it: u = lens[camera](T_camera_rig[camera] · T_rig_world[view] · X).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations
import logging

import numpy as np

from selfcal_ros.calibration.blas_threads import on_one_thread
from selfcal_ros.calibration.bundle.motion import GENERAL, NEARLY_PLANAR
from selfcal_ros.calibration.bundle.plane_of_motion import choose_motion
from selfcal_ros.calibration.bundle.rig import RigPriors
from selfcal_ros.calibration.bundle.rig_model import RigState
from selfcal_ros.calibration.bundle.robust_fit import fit_robustly
from selfcal_ros.calibration.calibrate import calibrate
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.calibration.rigs.judgement import judge, RigOptimum
from selfcal_ros.calibration.rigs.result import RigCalibration
from selfcal_ros.calibration.rigs.start import (best_start, observations_of, places, priors_of,
                                                seen_ahead, with_all_points)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.tracks import Tracks
from selfcal_ros.version import SOFTWARE

_LOGGER = logging.getLogger(__name__)

#: Motions of one camera that show how a rig moves.
IN_A_PLANE, MOVING = ('planar', 'circular'), ('planar', 'circular', 'general', 'translation')
#: Refusals for want of a fact that several cameras may do without.
WITHOUT_FACTS = ('fact_missing', 'horizon_level')
#: Instants at which all cameras must have images, at least.
MIN_INSTANTS = 4
#: With fewer observations that agree an instant has a pose by chance, and may be anywhere. It
#: would stretch the path, which is the unit of all places.
LEAST_OF_INSTANT = 10


@on_one_thread
def calibrate_rig(tracks: Mapping[str, Tracks], *, shared_tracks: bool = False,
                  motion: str = 'auto',
                  facts: CameraFacts | Mapping[str, CameraFacts] | None = None,
                  baseline: tuple[float, float] | None = None,
                  rng: np.random.Generator | None = None,
                  alone: Mapping[str, Calibration | NotCalibrated] | None = None,
                  progress: Callable[[str, int, int | None], object] | None = None,
                  ) -> RigCalibration | NotCalibrated:
    """
    Calibrate cameras that move together, of which nothing need be known.

    Parameters
    ----------
    tracks : mapping of str to Tracks
        Of every camera, by its name. Equal frames are of the same instant.
    shared_tracks : bool
        Equal numbers of tracks in two cameras are the same scene point. By default the cameras
        share none, and need not see the same things.
    motion : {'auto', 'planar', 'general'}
        How the rig moved; see `selfcal_ros.calibrate`.
    facts : CameraFacts or mapping of str to CameraFacts, optional
        What is known of the cameras, of all alike or by name.
    baseline : (float, float), optional
        Distance of the first two cameras and its sigma, metres. Without it lengths are in the
        unit of the path.
    rng : numpy.random.Generator, optional
        For RANSAC.
    alone : mapping of str to Calibration or NotCalibrated, optional
        What `selfcal_ros.calibrate` says of cameras by themselves, where that is known already.
    progress : callable, optional
        Called as progress(text, done, total) when a camera begins, and when the rig does.

    Returns
    -------
    RigCalibration or NotCalibrated

    Raises
    ------
    ArgumentError
        If there are fewer than two cameras, or two have the same observations. If the baseline is
        no length, or a calibration in `alone` is of images that the tracks lack.

    References
    ----------
    M. N. Armstrong (1996), Self-Calibration from Image Sequences, 3.1.5: the stereo head.

    Examples
    --------
    Two cameras 11 cm apart, carried about by hand:

    >>> import numpy as np
    >>> from selfcal_ros import calibrate_rig, CameraFacts
    >>> from selfcal_ros.synthetic.rig_scenes import hand_path, rig_scene
    >>> rng = np.random.default_rng(3)
    >>> scene = rig_scene(rng, hand_path(rng, 6), overlap=True, points=60)
    >>> square = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
    >>> result = calibrate_rig(scene.tracks, shared_tracks=True, facts=square,
    ...                        baseline=(0.112, 0.001))
    >>> pose = result.poses['right']
    >>> print(result.unit, pose.T_rig_camera[0, 3].round(2), pose.status['x'])
    m 0.11 estimated

    """
    if len(tracks) < 2:
        raise ArgumentError('A rig has two or more cameras; calibrate a single one by itself.')
    if baseline is not None and not (0 < baseline[0] < np.inf and 0 <= baseline[1] < np.inf):
        raise ArgumentError('The baseline must be a length in metres above zero, with a sigma; '
                            f'got {baseline[0]:g} and {baseline[1]:g}.')
    for first, second in combinations(tracks, 2):
        if _are_equal(tracks[first], tracks[second]):
            raise ArgumentError(f'Cameras {first} and {second} have the same images; give each '
                                'camera its own.')
    of_camera = _facts_by_name(tracks, facts)
    single, known = dict(alone or {}), {}
    for name, one in tracks.items():
        if name not in single:
            _tell(progress, f'estimating {name}')
            single[name] = calibrate(one, motion=motion, facts=of_camera[name], rng=rng)
        found = single[name]
        if isinstance(found, Calibration) and not np.isin(found.frames, one.frames).all():
            raise ArgumentError(f'The calibration of {name} alone is of images that its tracks '
                                'lack; calibrate it from these tracks.')
        if isinstance(found, NotCalibrated) and found.kind in WITHOUT_FACTS:
            # square pixels are for the start alone
            _tell(progress, f'estimating {name} with square pixels, for a start')
            found = calibrate(one, motion=motion, rng=rng,
                              facts=replace(of_camera[name], aspect_ratio=1.0, skew=0.0))
        if isinstance(found, Calibration):
            known[name] = found
    _tell(progress, 'estimating the rig')
    result: RigCalibration | NoEstimate
    try:
        result = _calibrated(tracks, of_camera, single, known, shared_tracks, baseline)
    except np.linalg.LinAlgError:
        _LOGGER.debug('equations without a solution', exc_info=True)
        result = NoEstimate('equations_singular')
    if isinstance(result, RigCalibration):
        return result
    return NotCalibrated.of(result, frames=np.unique(np.concatenate(
        [one.frames for one in tracks.values()])), facts=next(iter(of_camera.values())),
        software=SOFTWARE)


def _are_equal(one: Tracks, other: Tracks) -> bool:
    """Tell whether two cameras saw exactly the same, as only the same images show it."""
    return len(one) > 0 and np.array_equal(one.frame, other.frame) and np.array_equal(
        one.xy, other.xy)


def _tell(progress: Callable[[str, int, int | None], object] | None, text: str) -> None:
    """Tell that a stage begins, which cannot know how far it is."""
    if progress is not None:
        progress(text, 0, None)


def _facts_by_name(tracks: Mapping[str, Tracks],
                   facts: CameraFacts | Mapping[str, CameraFacts] | None,
                   ) -> dict[str, CameraFacts]:
    """Return the facts of every camera."""
    if facts is None or isinstance(facts, CameraFacts):
        return dict.fromkeys(tracks, facts or CameraFacts())
    return {name: facts.get(name, CameraFacts()) for name in tracks}


def _calibrated(tracks: Mapping[str, Tracks], facts: Mapping[str, CameraFacts],
                alone: Mapping[str, Calibration | NotCalibrated],
                known: Mapping[str, Calibration], shared: bool,
                baseline: tuple[float, float] | None) -> RigCalibration | NoEstimate:
    """Calibrate from what every camera says by itself, or with square pixels in `known`."""
    moving = [name for name, one in known.items()
              if one.motion in MOVING and one.focal is None and one.shutter is None]
    if not moving:
        return _none_moves(alone, known)
    # the one that knows the path best
    reference = min(moving, key=lambda name: known[name].focal_sigma_share)
    anchor = known[reference]
    frames = _common_frames(anchor, tracks)
    if len(frames) < MIN_INSTANTS:
        return NoEstimate('rig_not_simultaneous', camera=next(
            name for name in tracks if name != reference), instants=len(frames),
            least=MIN_INSTANTS)
    choices = places(reference, known, moving, tracks, shared)
    for name, found in choices.items():
        if not found:
            return _not_placed(name, alone[name], len(frames), shared)
    priors = RigPriors.of_cameras({
        name: priors_of(known.get(name, anchor), facts[name]) for name in tracks})
    used = {name: known[name].reconstructed.tracks if name in known else None for name in tracks}
    kind = NEARLY_PLANAR if anchor.motion in IN_A_PLANE else GENERAL
    noise_px = float(np.sqrt(np.mean([one.noise_sigma_px**2 for one in known.values()])))
    while True:
        everything = observations_of(tracks, used, frames, shared)
        start = best_start(everything, anchor, list(choices.values()), priors, kind, noise_px)
        if start is None:
            return NoEstimate('start_distortion_not_invertible')
        fit = fit_robustly(everything.observations, start, kind, priors, noise_px)
        assert isinstance(fit.state, RigState)
        ahead = seen_ahead(fit.state, fit.observations)
        if ahead is not fit.state:
            again = with_all_points(ahead, everything.observations)
            assert again is not None, 'the same lenses as before'
            fit = fit_robustly(everything.observations, again, kind, priors, noise_px)
        sure = np.bincount(fit.observations.view, minlength=len(frames)) >= LEAST_OF_INSTANT
        if sure.all() or sure.sum() < MIN_INSTANTS:
            break
        frames = frames[sure]
    optimum = RigOptimum(
        fit, everything,
        {name: replace(facts[name], distortion=known.get(name, anchor).facts.distortion)
         for name in tracks},
        {name: one.image_size or _size(known.get(name, anchor))
         for name, one in tracks.items()},
        anchor.motion, noise_px, shared)
    if kind is NEARLY_PLANAR:
        # errors that tracks and regions share must not pass for a motion out of the plane
        fit, _ = choose_motion(fit, optimum.clusters().variance_inflation)
        optimum = replace(optimum, fit=fit)
    return judge(optimum, alone, baseline)


def _none_moves(alone: Mapping[str, Calibration | NotCalibrated],
                known: Mapping[str, Calibration]) -> NoEstimate:
    """Refuse, since no camera tells how the rig moved."""
    if known:
        name, one = next(iter(known.items()))
        return NoEstimate('rig_path_unknown', camera=name, motion=one.motion)
    name, refusal = next((name, one) for name, one in alone.items()
                         if isinstance(one, NotCalibrated))
    return NoEstimate('rig_cameras_refused', camera=name, why=refusal.reason.rstrip('.'),
                      motion=refusal.motion, status=refusal.status,
                      alone={name: one.kind for name, one in alone.items()
                             if isinstance(one, NotCalibrated)})


def _not_placed(name: str, one: Calibration | NotCalibrated, instants: int, shared: bool,
                ) -> NoEstimate:
    """Refuse, since a camera has no start."""
    if isinstance(one, NotCalibrated):
        return NoEstimate('rig_camera_refused', camera=name, why=one.reason.rstrip('.'),
                          shared=shared)
    return NoEstimate('rig_not_simultaneous', camera=name, instants=instants,
                      least=MIN_INSTANTS)


def _common_frames(anchor: Calibration, tracks: Mapping[str, Tracks]) -> np.ndarray:
    """Return the frames of the path at which two cameras have images, (V,)."""
    frames = anchor.reconstructed.frames
    cameras = np.sum([np.isin(frames, one.frames) for one in tracks.values()], axis=0)
    common: np.ndarray = frames[cameras > 1]
    return common


def _size(calibration: Calibration) -> tuple[int, int]:
    """Return width and height of a camera's image."""
    return calibration.camera.width, calibration.camera.height
