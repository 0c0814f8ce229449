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
Which motion would help, and by how much: from the Fisher information, not from a fixed text.

Motions that the robot could add are simulated with the camera, the depths, the noise and the
step length at hand; the information on the internal parameters that each would bring is added to
what there is. They are compared at the same number of views.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.information import eliminated
from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.motion import GENERAL, MotionModel, PLANAR
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.observability import observability_limits
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.chain_matrix import ChainMatrix
from selfcal_ros.geometry.levenberg_marquardt import restricted
from selfcal_ros.geometry.rotation import (align_z, rotation_matrix, rotation_vector,
                                           swing_twist, twist_matrix)
from selfcal_ros.geometry.scaled_inverse import scaled_pseudo_inverse

#: Views and points of a motion that is simulated.
VIEWS, POINTS = 12, 150
#: Turns have one axis where they leave it by no more than this share of themselves.
ONE_AXIS = 0.03

#: A motion by name, its path, and the factor of the depths.
_Candidate = tuple[str, AxisPath, float]


@dataclass(frozen=True)
class Suggestion:
    """
    What a motion would bring.

    Attributes
    ----------
    motion : str
        What to do: one of `selfcal_ros.findings.phrase.MOTIONS`.
    sigma : dict of str to float
        Standard deviations that are to be expected with it.
    worst_share : float
        Largest of them, as a fraction of what makes the parameter unobservable.

    """

    motion: str
    sigma: dict[str, float]
    worst_share: float


def suggest_motions(fit: RobustFit, size: tuple[int, int], names: tuple[str, ...],
                    fraction: float = 1.0,
                    rng: np.random.Generator | None = None) -> list[Suggestion]:
    """
    Rank motions by how well they would determine some parameters.

    Parameters
    ----------
    fit : RobustFit
        The optimum at hand; where it leaves parameters open, they are taken as they came out.
    size : (int, int)
        Width and height of the image.
    names : tuple of str
        The parameters that matter, among `Camera.parameter_names`.
    fraction : float
        Of all observations that the fit uses.
    rng : numpy.random.Generator, optional
        A fixed seed by default: the same images give the same advice.

    Returns
    -------
    list of Suggestion
        The most helpful first; empty where none can be simulated.

    """
    rng = np.random.default_rng(0) if rng is None else rng
    state, bundle = fit.state, fit.bundle
    depths = _depths(fit)
    if depths is None or not names:
        return []
    # what the images say counts so many times, and what is stated once
    at_hand = _information(bundle.with_sigma(bundle.sigma_px * fraction**0.5), state)
    state = _plausible(state, bundle, size)
    limits = observability_limits(state.camera(*size))
    every = state.camera().parameter_names
    place = [every.index(name) for name in names]
    free = bundle.unknowns.free_lens

    def rank(candidates: Iterable[_Candidate], motion: MotionModel) -> list[Suggestion]:
        found = []
        for name, path, near in candidates:
            seen = _simulate(state, path, near * depths, size, bundle, motion, rng)
            if seen is None:
                continue
            total = at_hand + _information(*seen, with_facts=False)
            covariance = np.zeros((len(state.lens),) * 2)
            covariance[np.ix_(free, free)] = scaled_pseudo_inverse(total, 1e-12)
            variance = np.diag(to_parameters(covariance, state.lens))
            sigma = np.sqrt(np.maximum(variance, 0))
            found.append(Suggestion(name, dict(zip(every, sigma.tolist())),
                                    float(np.max(sigma[place] / limits[place]))))
        return sorted(found, key=lambda one: one.worst_share)

    zoom = fit.motion.zoom and replace(fit.motion.zoom, instants=tuple(range(VIEWS)))
    level = state.path if fit.motion.keeps_plane else _about_one_axis(state.path)
    if level is not None and (fit.motion.keeps_plane or fit.motion.fixed_pivot):
        # who turned on the spot about one axis may be a vehicle
        motion = fit.motion if fit.motion.keeps_plane else PLANAR
        found = rank(_in_the_plane(level), replace(motion, parallel=(), zoom=zoom))
        if found and found[0].worst_share < 1:
            return found
    return rank(_anyhow(state.path), replace(GENERAL, zoom=zoom))


def best_motion(suggestions: list[Suggestion], names: tuple[str, ...],
                is_open: bool = False) -> tuple[Finding, ...]:
    """
    Tell the best one; nothing where none would determine the parameters.

    Where the camera is open so far, a sigma of the future would be that of no camera.
    """
    if not suggestions or not suggestions[0].worst_share < 1:
        return ()
    best = suggestions[0]
    if is_open:
        return (Finding('motion_needed', images=VIEWS, motion=best.motion, names=list(names)),)
    return (Finding('motion_suggestion', images=VIEWS, motion=best.motion,
                    sigma={name: best.sigma[name] for name in names}),)


def _information(bundle: Bundle[SceneState], state: SceneState, with_facts: bool = True,
                 ) -> np.ndarray:
    """Information on the free internal parameters: poses, axis and points eliminated."""
    system = bundle.normal_equations(state, robust=False)
    if not with_facts:
        bundle.add_priors(system, state, weight=-1.0)
    E = bundle.unknowns.selection
    inner = len(bundle.unknowns.free_lens)
    if isinstance(system.matrix, ChainMatrix):
        lens, rest = bundle.unknowns.free_lens, csr_array(E[:, inner:])
        coupling = system.columns(lens)
        follows = eliminated(system.matrix, rest, coupling, system.diagonal)
        found: np.ndarray = coupling[lens] - coupling.T @ follows
        return found
    matrix = restricted(system.matrix, E)
    inverse = scaled_pseudo_inverse(matrix[inner:, inner:], 1e-11)
    cross = matrix[:inner, inner:]
    left: np.ndarray = matrix[:inner, :inner] - cross @ inverse @ cross.T
    return left


def _plausible(state: SceneState, bundle: Bundle[SceneState], size: tuple[int, int]) -> SceneState:
    """Put what the images leave open at what most cameras have, so as to simulate one."""
    camera = state.camera(*size)
    covariance = to_parameters(bundle.covariance(state), state.lens)
    unknown = bundle.unknowns.free[bundle.unknowns.lens] & (
        np.sqrt(np.diag(covariance)) > observability_limits(camera))
    known = {'f': max(size), 'aspect': 1.0, 'cx': (size[0] - 1) / 2, 'cy': (size[1] - 1) / 2}
    return replace(state, lens=state.lens.with_values({
        name: known.get(name, 0.0)
        for name, is_open in zip(state.lens.names, unknown) if is_open}))


def _depths(fit: RobustFit) -> np.ndarray | None:
    """Distances along the optical axis of the observed points, or None."""
    state, view, point = fit.state, fit.bundle.view, fit.bundle.part
    local = np.einsum('nij,nj->ni', state.path.cam_from_world()[view], state.points[point])
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = local[:, 2] / state.points[point, 3]
    depth = depth[np.isfinite(depth) & (depth > 0)]
    return np.quantile(depth, np.linspace(0.1, 0.9, 17)) if len(depth) > 10 else None


def _about_one_axis(path: AxisPath) -> AxisPath | None:
    """Return the path with its common axis upright; None where its turns have several axes."""
    R = path.cam_from_world()[:, :, :3]
    _, size, axes = np.linalg.svd(rotation_vector(R @ R[0].T))
    if size[1] > ONE_AXIS * size[0]:
        return None
    mount = align_z(axes[0])
    poses = path.cam_from_world()
    upright = np.concatenate([R @ R[0].T @ mount, poses[:, :, 3:]], axis=2)
    return AxisPath.of_poses(mount, upright)


def _in_the_plane(path: AxisPath) -> Iterator[_Candidate]:
    """Yield motions of a vehicle: name, path, factor of the depths."""
    step = path.step_length()
    forward = np.einsum('vij,vj->vi', twist_matrix(path.angle[:-1])[:, :2, :2],
                        np.diff(path.centres()[:, :2], axis=0)).mean(axis=0)
    ahead = np.arctan2(*forward[::-1]) if np.linalg.norm(forward) > 1e-9 else 0.0
    along = np.linspace(0, 1, VIEWS)
    for name, heading, near in (
            ('s_20', np.interp(along, [0, 0.5, 1], [0, 20, 0]), 1.0),
            ('s_45', np.interp(along, [0, 0.5, 1], [0, 45, 0]), 1.0),
            ('curve_60', 60 * along, 1.0),
            ('straight_near', 0 * along, 1 / 3),
            ('s_20_near', np.interp(along, [0, 0.5, 1], [0, 20, 0]), 1 / 3)):
        heading = np.radians(heading)
        centres = step * np.cumsum(np.column_stack(
            [np.cos(heading + ahead), np.sin(heading + ahead), 0 * heading]), axis=0)
        yield (name, AxisPath.at_origin(path.mount, -heading).placed_at(centres - centres[0]),
               near)


def _anyhow(path: AxisPath) -> Iterator[_Candidate]:
    """Yield motions of an arm or a hand: name, path, factor of the depths."""
    reach = float(np.sqrt(np.mean(np.var(path.centres(), axis=0)))) or 1.0
    phase = np.linspace(0, 2 * np.pi, VIEWS, endpoint=False)
    turn = np.sin(phase)
    aside = reach * np.column_stack([np.sin(2 * phase), np.cos(phase), 0.5 * np.sin(phase + 1)])
    for name, axes in (
            ('pitch', [[1, 0, 0]]),
            ('yaw', [[0, 1, 0]]),
            ('roll', [[0, 0, 1]]),
            ('pitch_yaw', [[1, 0, 0], [0, 1, 0]]),
            ('pitch_roll', [[1, 0, 0], [0, 0, 1]]),
            ('translation', [[0, 0, 0]])):
        axis = np.array(axes, float)[np.arange(VIEWS) * len(axes) // VIEWS]
        R = rotation_matrix(np.radians(20) * turn[:, None] * axis)
        turned = AxisPath.at_origin(path.mount, *swing_twist(path.mount.T @ R @ path.mount))
        yield name, turned.placed_at(aside - aside[0]), 1.0


def _simulate(state: SceneState, path: AxisPath, depths: np.ndarray, size: tuple[int, int],
              bundle: Bundle[SceneState], motion: MotionModel, rng: np.random.Generator,
              ) -> tuple[Bundle[SceneState], SceneState] | None:
    """Set up the adjustment of simulated views of points before them, at its optimum."""
    camera = state.camera(*size)
    xy = rng.uniform((0, 0), size, (POINTS, 2))
    rays = camera.rays(xy)
    if camera.lens.is_perspective:
        # depths are along the axis
        rays = rays / rays[:, 2:]
    local = rays * rng.choice(depths, POINTS)[:, None]
    anchor = rng.integers(0, len(path), POINTS)
    poses = path.cam_from_world()
    points = np.einsum('pji,pj->pi', poses[anchor, :, :3], local - poses[anchor, :, 3])
    seen = np.einsum('vij,pj->pvi', poses[:, :, :3], points) + poses[:, :, 3]
    pixels = camera.project(seen.reshape(-1, 3))
    pixels = pixels.reshape(POINTS, len(path), 2)
    with np.errstate(invalid='ignore'):
        inside = ((pixels >= 0) & (pixels < size)).all(axis=2)
    inside = np.asarray(inside)
    inside[inside.sum(axis=1) < 2] = False
    point, view = np.nonzero(inside)
    if len(np.unique(view)) < len(path):
        return None
    kept, index = np.unique(point, return_inverse=True)
    homogeneous = np.column_stack([points[kept], np.ones(len(kept))])
    homogeneous /= np.linalg.norm(homogeneous, axis=1, keepdims=True)
    made = Bundle(SceneModel(motion), view, index, pixels[inside], priors=bundle.priors,
                  sigma_px=bundle.sigma_px)
    return made, replace(state, path=path, points=homogeneous, zoom=None, row_motion=None,
                         shift=None)
