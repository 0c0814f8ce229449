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
"""Derivatives of every block, and of every product of blocks, against differences."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.lens import Lens, MATRIX_NAMES, Projection
from selfcal_ros.calibration.bundle.motion import (GENERAL, MotionModel, NEARLY_PLANAR, PLANAR,
                                                   ROTATION)
from selfcal_ros.calibration.bundle.object_bend import Bend
from selfcal_ros.calibration.bundle.object_model import KnownEdges, KnownPoints
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses, VIEW_NAMES as POSE_NAMES
from selfcal_ros.calibration.bundle.path import AxisPath, path_prior, SHARED_NAMES, VIEW_NAMES
from selfcal_ros.calibration.bundle.priors import Prior, Priors
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.shutter import RowShifts
from selfcal_ros.calibration.bundle.state import ObjectState, SceneState
from selfcal_ros.calibration.bundle.zoom import Zoom, ZoomModel
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.catalogue import lens_model
from selfcal_ros.geometry.rotation import rotation_matrix

#: Derivatives agree with differences to this fraction of the largest.
AGREE = 1e-6
COEFFICIENTS = {
    'plumb_bob': [-0.12, 0.05, 0.002, -0.003, 0.01],
    'rational_polynomial': [0.3, 0.05, 0.002, -0.003, 0.01, 0.4, 0.1, 0.01],
    'equidistant': [-0.03, 0.01, -0.01, 0.002]}
LENSES = {name: Lens(np.r_[620.0, 1.03, 322.0, 236.0, 1.5, values], lens_model(name))
          for name, values in COEFFICIENTS.items()}
LENS = LENSES['plumb_bob']
VIEWS, POINTS = 4, 12


def difference(function, size, scale=1.0):
    """Differentiate a function of a step (size,) by fourth-order differences, last axis."""
    columns = []
    for k in range(size):
        h = 1e-4 * (scale if np.isscalar(scale) else scale[k])
        step = np.zeros(size)
        step[k] = h
        columns.append((8 * (function(step) - function(-step))
                        - function(2 * step) + function(-2 * step)) / (12 * h))
    return np.stack(columns, axis=-1)


def agrees(analytic, numeric):
    return np.abs(analytic - numeric).max() < AGREE * max(np.abs(numeric).max(), 1e-3)


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.fixture
def path(rng):
    mount = rotation_matrix(np.array([1.2, 0.3, -0.2]))
    return AxisPath(mount, rng.normal(0, 0.2, VIEWS), rng.normal(0, 0.05, (VIEWS, 2)),
                    rng.normal(0, 0.3, (VIEWS, 3)))


def lens_scale(lens):
    """A change of f of one pixel, of the aspect ratio of a thousandth, ... have like effects."""
    return np.array([100.0, 0.1, 100, 100, 100, *[1.0] * (len(lens) - len(MATRIX_NAMES))])


@pytest.mark.parametrize('name', LENSES)
def test_a_lens_that_is_possible_is_a_camera(name):
    """A fit must not end at one that is none: a fisheye with k1 = 84, k2 = -86853 was reached."""
    rng, count = np.random.default_rng(0), len(LENSES[name].distortion)
    possible = 0
    for spread in np.logspace(-2, 5, 200):
        values = np.r_[620.0, 1.03, 322.0, 236.0, 1.5, spread * rng.normal(size=count)]
        lens = Lens(values, LENSES[name].model)
        if lens.is_possible:
            assert lens.camera(640, 480).lens is lens.model
            possible += 1
    assert possible >= 20
    assert not Lens(-values, lens.model).is_possible


@pytest.mark.parametrize('name', LENSES)
def test_lens_by_points_and_by_its_unknowns(name, rng):
    lens, X = LENSES[name], rng.normal(size=(20, 3)) * [0.4, 0.3, 0.2] + [0, 0, 1.5]
    if not lens.model.is_perspective:
        # also at right angles to the axis, and behind
        X[10:] -= [0, 0, 1.6]
    here = Projection(lens, X)
    assert agrees(here.by_points(), difference(lambda step: Projection(lens, X + step).uv, 3))
    assert agrees(here.by_intrinsics(),
                  difference(lambda step: Projection(lens.moved(step), X).uv, len(lens),
                             lens_scale(lens)))
    camera, scale = lens.camera(), lens_scale(lens)
    scale[1] = scale[0]     # fy in place of the aspect ratio
    assert agrees(here.by_parameters(),
                  difference(lambda step: Projection(Lens.of(Camera.from_parameters(
                      camera.parameters + step, model=camera.model)), X).uv, len(lens), scale))


def test_path_by_its_axis_and_by_its_views(path, rng):
    view, Y = np.arange(VIEWS), rng.normal(size=(VIEWS, 4))
    J = np.tile(np.eye(3), (VIEWS, 1, 1))

    def placed(shared, steps):
        """Points of each view's camera, turned back by the mount at hand."""
        moved = path.moved(shared, steps)
        turned = np.einsum('vij,vj->vi', moved.rotations(), Y[:, :3])
        X = turned + moved.translation * Y[:, 3:]
        return X @ moved.mount.T @ path.mount

    none, still = np.zeros((VIEWS, len(VIEW_NAMES))), np.zeros(2)
    turned = np.einsum('vij,vj->vi', path.rotations(), Y[:, :3])
    axis = np.empty((VIEWS, 3, 2))
    path.by_axis(J, placed(still, none), axis)
    assert agrees(axis, difference(lambda step: placed(step, none), len(SHARED_NAMES)))
    assert agrees(path.by_views(J, turned, Y[:, 3:], view),
                  difference(lambda step: placed(still, none + step), len(VIEW_NAMES)))


def test_object_poses_by_their_steps(rng):
    poses = np.concatenate([rotation_matrix(rng.normal(size=(VIEWS, 3))),
                            rng.normal(size=(VIEWS, 3, 1))], axis=2)
    block, view, X = ObjectPoses(poses), np.arange(VIEWS), rng.normal(size=(VIEWS, 3))

    def seen(step):
        moved = block.moved(np.zeros((VIEWS, len(POSE_NAMES))) + step)
        return moved.turned(X, view) + moved.translations(view)

    J = np.tile(np.eye(3), (VIEWS, 1, 1))
    assert agrees(ObjectPoses.by_steps(J, block.turned(X, view)),
                  difference(seen, len(POSE_NAMES)))


@pytest.mark.parametrize('motion', [NEARLY_PLANAR, MotionModel(0.1, 0.0), MotionModel(0.0, 0.2)])
def test_the_prior_of_the_path_by_its_unknowns(path, motion):
    unknowns = SceneModel(motion).unknowns(VIEWS, LENS.names)
    scale = path.step_length()

    def cost(step):
        moved = path.moved(step[unknowns.places(SHARED_NAMES)], step[unknowns.by_view],
                           unknowns.view_names)
        # the scale of the prior is that of the path at hand
        return np.array(path_prior(moved.scaled(1.0), replace(
            motion, height_sigma=motion.height_sigma * scale / moved.step_length()), unknowns)[0])

    _, gradient, _ = path_prior(path, motion, unknowns)
    assert agrees(gradient, difference(cost, len(unknowns)))


def scene(motion, path, rng, lens=LENS):
    """A product of lens, path and points, with noise."""
    points = np.column_stack([rng.normal(size=(POINTS, 3)), np.ones(POINTS)])
    local = points[:, :3] * [1.5, 1.2, 0.5] + [0, 0, 6]
    points[:, :3] = local @ path.mount
    if motion.fixed_centre:
        points[:, 3], path = 0, path.scaled(0)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    if motion.tilt_sigma_rad == 0:
        path = path.flat()
    zoom = motion.zoom and Zoom(0.1 * motion.zoom.course)
    state = SceneState(lens, path.aligned(motion), points, zoom)
    view, point = np.tile(np.arange(VIEWS), POINTS), np.repeat(np.arange(POINTS), VIEWS)
    bundle = Bundle(SceneModel(motion), view, point, np.zeros((len(view), 2)),
                    priors=Priors({'cx': Prior(300.0, 20.0)}, lens.model), sigma_px=1.0)
    bundle.xy = bundle.residuals(state) + rng.normal(0, 0.5, (len(view), 2))
    return bundle, state


def known(kind, rng, lens=LENS):
    """A product of lens, poses and known points or edges; edges are seen exactly."""
    X = rng.normal(size=(POINTS, 3)) * 0.3
    poses = np.concatenate([rotation_matrix(0.4 * rng.normal(size=(VIEWS, 3))),
                            (rng.normal(size=(VIEWS, 3)) * 0.1 + [0, 0, 2.5])[..., None]], axis=2)
    state, view = ObjectState(lens, ObjectPoses(poses)), np.repeat(np.arange(VIEWS), POINTS)
    points = np.tile(X, (VIEWS, 1))
    bundle = Bundle(KnownPoints(points), view, view, np.zeros((len(view), 2)),
                    priors=Priors(lens=lens.model), sigma_px=1.0)
    seen = bundle.residuals(state)
    if kind == 'bent board':
        bend = Bend(rng.normal(size=(len(view), 5, 3)), np.array([0.05, 0.04, 0.05, 0.03, 0.06]))
        state = replace(state, bend=0.02 * rng.normal(size=5))
        bundle = Bundle(KnownPoints(points, bend), view, view, bundle.xy,
                        priors=Priors(lens=lens.model), sigma_px=1.0)
    if kind != 'edges':
        bundle.xy = seen + rng.normal(0, 0.5, seen.shape)
        return bundle, state
    tangents = np.tile(rng.normal(size=(POINTS, 3)), (VIEWS, 1))
    # edgels lie elsewhere on their edges: so near that one step along the edge finds the foot
    shift = KnownPoints(points + 1e-5 * rng.normal(size=(len(points), 1)) * tangents)
    along = Bundle(shift, view, view, np.zeros((len(view), 2)), priors=Priors(lens=lens.model),
                   sigma_px=1.0)
    return Bundle(KnownEdges(points, tangents), view, view, along.residuals(state),
                  priors=Priors(lens=lens.model), sigma_px=1.0), state


def read_in_rows(bundle, rng):
    """The same product with rows that are read one after the other."""
    shifts = RowShifts(0.1, *rng.normal(0, 20, (2, len(bundle.view), 2)), Prior(0.05, 0.2))
    return Bundle(replace(bundle.model, shutter=shifts), bundle.view, bundle.part, bundle.xy,
                  priors=bundle.priors, sigma_px=1.0)


PRODUCTS = {
    'planar': PLANAR, 'nearly planar': NEARLY_PLANAR, 'general': GENERAL, 'rotation': ROTATION,
    'translation': replace(GENERAL, parallel=(0, 2, 3)), 'rolling shutter': GENERAL,
    'points': None, 'bent board': None, 'edges': None,
    'drift': replace(NEARLY_PLANAR, zoom=ZoomModel((0, 1, 4, 5), 0.0)),
    'walk': replace(GENERAL, zoom=ZoomModel((0, 1, 4, 5), 0.01)),
    'zoom': replace(PLANAR, zoom=ZoomModel((0, 1, 4, 5)))}


@pytest.mark.parametrize('lens', LENSES.values(), ids=LENSES)
@pytest.mark.parametrize('name', PRODUCTS)
def test_every_product_of_blocks_by_every_unknown(name, lens, path, rng):
    motion = PRODUCTS[name]
    bundle, state = (known(name, rng, lens) if motion is None
                     else scene(motion, path, rng, lens))
    if name == 'rolling shutter':
        bundle = read_in_rows(bundle, rng)
    line, unknowns = bundle.linearise(state), bundle.unknowns
    assert line.ahead.all()
    parts = (bundle.blocks.point_count, bundle.model.eliminated)
    size = len(unknowns)

    def residuals(step):
        moved = bundle.moved(state, step[:size], step[size:].reshape(parts))
        return bundle.predict(moved).residual

    analytic = np.zeros((*line.residual.shape, size + np.prod(parts)))
    analytic[:, :, unknowns.shared] = line.shared
    for k, (view, part) in enumerate(zip(bundle.view, bundle.part)):
        if unknowns.views:
            analytic[k][:, unknowns.by_view[view]] = line.view[k]
        place = size + part * parts[1] + np.arange(parts[1])
        analytic[k][:, place] = line.eliminated[k]
    # as the adjustment moves them: fixed ones not at all, parallel views together
    free = np.zeros((analytic.shape[2],) * 2)
    free[:size, :size] = (unknowns.selection @ unknowns.selection.T).toarray()
    free[size:, size:] = np.eye(free.shape[0] - size)
    scale = np.r_[lens_scale(lens), np.ones(free.shape[0] - len(lens))]

    assert agrees(analytic @ free, difference(lambda step: residuals(free @ step),
                                              free.shape[0], scale))


@pytest.mark.parametrize('name', ['nearly planar', 'rotation', 'points', 'bent board', 'edges'])
def test_the_gradient_is_that_of_the_cost(name, path, rng):
    motion = PRODUCTS[name]
    bundle, state = known(name, rng) if motion is None else scene(motion, path, rng)
    if name == 'edges':
        bundle.xy = bundle.xy + rng.normal(0, 0.05, bundle.xy.shape)
    elif name == 'nearly planar':
        state = replace(state, path=state.path.flat())
    state = replace(state, lens=state.lens.with_values({'f': 621.0, 'cx': 323.0}))
    lens = bundle.unknowns.lens

    def cost(step):
        whole = np.zeros(len(bundle.unknowns))
        whole[lens] = step
        return np.array(bundle.cost(bundle.moved(state, whole)))

    line = bundle.linearise(state)
    root = bundle.weighted_equations(state)[1]
    own = np.einsum('nmk,nm->k', line.shared * root[..., None], line.residual * root)
    own += bundle.prior_terms(state)[1][bundle.unknowns.shared]
    scale = lens_scale(LENS)
    numeric = difference(cost, len(LENS), scale)
    assert np.abs((own[lens] - numeric) * scale).max() < (
        1e-2 if name == 'edges' else 1e-5) * np.abs(numeric * scale).max()


def test_unknowns_are_found_by_name():
    unknowns, count = SceneModel(PLANAR).unknowns(3, LENS.names), len(LENS)
    assert unknowns.places(('cx', 'axis_y')).tolist() == [2, count + 1]
    # a plane that is exact has no tilts and no heights, and a camera that turns has no places
    assert unknowns.view_names == ('angle', 'x', 'y') and len(unknowns) == count + 2 + 3 * 3
    assert SceneModel(ROTATION).unknowns(3, ()).view_names == ('angle', 'tilt_x', 'tilt_y')
    assert SceneModel(GENERAL).unknowns(3, ()).view_names == VIEW_NAMES
    assert unknowns.free[unknowns.of_views('angle')[1:]].all()
    assert unknowns.count == count + 2 + 2 * 3
    assert LENS.names[:2] == ('f', 'aspect')
    with pytest.raises(ValueError):
        unknowns.places(('no such',))


def test_parallel_views_share_their_rotation():
    unknowns = SceneModel(replace(GENERAL, parallel=(1, 3))).unknowns(4, LENS.names)
    apart = SceneModel(GENERAL).unknowns(4, LENS.names)
    assert unknowns.count == apart.count - 3
    step = np.zeros(unknowns.count)
    step[:] = np.arange(unknowns.count)
    every = unknowns.selection @ step
    turns = unknowns.of_views('angle', 'tilt_x', 'tilt_y')
    np.testing.assert_array_equal(every[turns[1]], every[turns[3]])
