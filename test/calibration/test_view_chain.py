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
"""Normal equations of long recordings, level by level, are those of one dense matrix."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.information import inverse_information, RANK_TOLERANCE
from selfcal_ros.geometry import schur_complement
from selfcal_ros.geometry.chain_inverse import carried_blocks, ChainInverse
from selfcal_ros.geometry.chain_matrix import ChainMatrix
from selfcal_ros.geometry.levenberg_marquardt import DampedFactor
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.geometry.selection_matrix import selection_matrix
from selfcal_ros.geometry.view_chain import chain_of_views
from selfcal_ros.synthetic.special_scenes import drive

VIEWS, SHARED, OF_VIEW = 120, 5, 6


def recording(closed, seed=0):
    """Point and view of observations of a path, with a few points from both its ends."""
    rng = np.random.default_rng(seed)
    rows = []
    for point in range(1500):
        first = rng.integers(0, VIEWS - 6)
        seen = np.clip(first + np.r_[0, 1, rng.integers(0, 10, 6)], 0, VIEWS - 1)
        if closed and point % 97 == 0:
            seen = np.r_[rng.integers(0, 8, 3), VIEWS - 1 - rng.integers(0, 8, 3)]
        rows += [(point, view) for view in np.unique(seen)]
    return np.array(rows).T


def systems(monkeypatch, closed, seed=0):
    """Return the same normal equations level by level, and dense."""
    point, view = recording(closed, seed)
    rng = np.random.default_rng(seed + 100)
    columns = [rng.standard_normal((len(point), 2, k)) for k in (SHARED, OF_VIEW, 3)]
    residual = rng.standard_normal((len(point), 2))
    chained = PointBlocks(point, view).unreduced(*columns, residual).reduced()
    with monkeypatch.context() as patch:
        patch.setattr(schur_complement, 'chain_of_views', lambda *_: None)
        dense = PointBlocks(point, view).unreduced(*columns, residual).reduced()
    assert isinstance(chained.matrix, ChainMatrix) and isinstance(dense.matrix, np.ndarray)
    return chained, dense


def held(seed=0):
    """Selections of unknowns: some fixed, some tied to those of far views, some balanced."""
    count = SHARED + VIEWS * OF_VIEW
    free, tied = np.ones(count, bool), np.arange(count)
    free[SHARED:SHARED + OF_VIEW] = False
    tied[SHARED + OF_VIEW * 40 + 3] = SHARED + OF_VIEW * 41 + 3
    tied[SHARED + OF_VIEW * 70 + 2] = SHARED + OF_VIEW * 110 + 2
    balanced = tuple((SHARED + OF_VIEW * np.arange(1, VIEWS) + 5).tolist())
    return [selection_matrix(free), selection_matrix(free, tied),
            selection_matrix(free, tied, balanced)]


@pytest.mark.parametrize('closed', [False, True])
def test_levels_share_points_with_neighbours_alone(closed):
    point, view = recording(closed)

    chain = chain_of_views(point, view, VIEWS)

    assert sorted(chain.order) == list(range(VIEWS)) and chain.levels > 4
    level = chain.level[view]
    spread = np.array([np.ptp(level[point == one]) for one in range(point.max() + 1)])
    assert spread.max() == 1


def test_few_views_and_views_that_all_see_the_same_are_no_chain():
    point, view = np.divmod(np.arange(50 * 40), 40)
    assert chain_of_views(point, view, 40) is None
    point, view = np.divmod(np.arange(50 * 200), 200)
    assert chain_of_views(point, view, 200) is None


def test_views_without_common_points_are_no_chain():
    point, view = recording(False)
    assert chain_of_views(np.r_[point, point + point.max() + 1], np.r_[view, view + VIEWS],
                          2 * VIEWS) is None


@pytest.mark.parametrize('closed', [False, True])
def test_a_further_unknown_of_every_view_is_asked_without_the_whole_matrix(monkeypatch, closed):
    rng = np.random.default_rng(6)
    further = rng.standard_normal((len(recording(closed)[0]), 2))
    for system in systems(monkeypatch, closed):
        J = system.jac_rest
        whole = system.blocks.unreduced_rows(np.concatenate([J, further[:, :, None]], axis=2),
                                             OF_VIEW + 1, system.jac_point,
                                             system.residual).reduced()
        places = SHARED + OF_VIEW + (OF_VIEW + 1) * np.arange(VIEWS)
        rest = np.setdiff1d(np.arange(len(whole.matrix)), places)
        wanted = whole.columns(places)
        coupling, own, gradient = system.of_views(further)

        scale = np.abs(wanted).max()
        np.testing.assert_allclose(coupling, wanted[rest], atol=1e-12 * scale)
        np.testing.assert_allclose(own, wanted[places], atol=1e-12 * scale)
        np.testing.assert_allclose(gradient, whole.gradient[places], atol=1e-12 * scale)


@pytest.mark.parametrize('closed', [False, True])
def test_the_matrix_is_the_dense_one(monkeypatch, closed):
    chained, dense = systems(monkeypatch, closed)
    rng = np.random.default_rng(1)
    for system in (chained, dense):
        system.add_diagonal(np.arange(40), np.arange(40.0))
        # what couples neighbouring views, and all of them with what they share
        block = np.array([[1.0, 0.5, 0.1], [0.5, 2.0, 0.2], [0.1, 0.2, 3.0]])
        system.add_block(np.array([0, SHARED + 2, SHARED + OF_VIEW + 2]), block)
    step = rng.standard_normal(len(dense.matrix))
    scale = np.abs(dense.matrix).max()

    np.testing.assert_allclose(np.asarray(chained.matrix), dense.matrix, atol=1e-12 * scale)
    np.testing.assert_allclose(chained.matrix.diagonal(), dense.matrix.diagonal(), rtol=1e-9)
    np.testing.assert_allclose(chained.gradient, dense.gradient, atol=1e-9)
    np.testing.assert_allclose(chained.point_steps(step), dense.point_steps(step), rtol=1e-9,
                               atol=1e-9)
    np.testing.assert_allclose(chained.columns(np.array([1, 77])), dense.matrix[:, [1, 77]],
                               atol=1e-12 * scale)
    rows = rng.standard_normal((2, len(step)))
    np.testing.assert_allclose(chained.influence(rows), dense.influence(rows), atol=1e-9)


def test_points_are_eliminated_whatever_views_they_are_seen_in():
    """By the Schur complement of the whole matrix of normal equations."""
    rng, views = np.random.default_rng(7), 40
    point = np.repeat(np.arange(300), 5)
    # half of them by neighbours, half by any views
    near = rng.integers(0, views - 5, 150)[:, None] + np.arange(5)
    far = np.argsort(rng.random((150, views)), axis=1)[:, :5]
    view = np.sort(np.concatenate([near, far]), axis=1).ravel()
    columns = [rng.standard_normal((len(point), 2, k)) for k in (SHARED, OF_VIEW, 3)]
    residual = rng.standard_normal((len(point), 2))

    system = PointBlocks(point, view).unreduced(*columns, residual).reduced()

    assert isinstance(system.matrix, np.ndarray)
    n = SHARED + views * OF_VIEW
    J = np.zeros((len(point), 2, n + 3 * 300))
    J[:, :, :SHARED] = columns[0]
    for k, (one, at) in enumerate(zip(point, view)):
        J[k, :, SHARED + OF_VIEW * at:SHARED + OF_VIEW * (at + 1)] = columns[1][k]
        J[k, :, n + 3 * one:n + 3 * (one + 1)] = columns[2][k]
    J = J.reshape(-1, J.shape[2])
    whole = J.T @ J
    follows = np.linalg.solve(whole[n:, n:], whole[n:, :n])
    np.testing.assert_allclose(system.matrix, whole[:n, :n] - whole[:n, n:] @ follows, atol=1e-8)
    slope = J.T @ residual.ravel()
    np.testing.assert_allclose(system.gradient, slope[:n] - follows.T @ slope[n:], atol=1e-8)


def test_a_block_between_far_views_makes_the_matrix_dense(monkeypatch):
    chained, dense = systems(monkeypatch, False)
    at = np.array([SHARED, SHARED + 60 * OF_VIEW])
    for system in (chained, dense):
        system.add_block(at, np.ones((2, 2)))

    assert isinstance(chained.matrix, np.ndarray)
    np.testing.assert_allclose(chained.matrix, dense.matrix, atol=1e-9)


@pytest.mark.parametrize('selection', held(), ids=['fixed', 'tied', 'balanced'])
@pytest.mark.parametrize('closed', [False, True])
def test_steps_and_inverse_are_those_of_the_dense_matrix(monkeypatch, closed, selection):
    chained, dense = systems(monkeypatch, closed)
    right = np.random.default_rng(2).standard_normal(len(dense.matrix))
    for damping in (0.0, 1e-4, 1.0):
        factors = [DampedFactor(system.matrix, system.diagonal, damping, selection)
                   for system in (chained, dense)]
        assert all(factor.usable for factor in factors)
        one, other = (factor.solve(right) for factor in factors)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())

    inverse, expected = (inverse_information(system.matrix, selection, system.diagonal)
                         for system in (chained, dense))

    assert isinstance(inverse, ChainInverse)
    limit = 1e-9 * np.abs(expected).max()
    np.testing.assert_allclose(np.asarray(inverse), expected, atol=limit)
    np.testing.assert_allclose(inverse.diagonal(), expected.diagonal(), rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(inverse[:SHARED], expected[:SHARED], atol=limit)
    np.testing.assert_allclose(inverse[7], expected[7], atol=limit)
    np.testing.assert_allclose((2 * inverse)[3, 3], 2 * expected[3, 3], rtol=1e-9)
    at = np.ix_([1, 400], [2, 3, 17])
    np.testing.assert_allclose(inverse[at], expected[at], atol=limit)
    np.testing.assert_allclose(-inverse @ right, -expected @ right, rtol=1e-9, atol=limit)


@pytest.mark.parametrize('selection', held(), ids=['fixed', 'tied', 'balanced'])
def test_covariances_of_poses_are_those_of_the_dense_matrix(monkeypatch, selection):
    chained, dense = systems(monkeypatch, True)
    inverse, expected = (inverse_information(system.matrix, selection, system.diagonal)
                         for system in (chained, dense))
    rng = np.random.default_rng(5)
    rows = np.zeros((VIEWS, 4, len(dense.matrix)))
    # of its own view, of what all share, and of the views that set the world and its unit
    common = [*range(SHARED), *range(SHARED, SHARED + 9), *range(SHARED + 300, SHARED + 312)]
    rows[:, :, common] = rng.standard_normal((VIEWS, 4, len(common)))
    for view in range(VIEWS):
        own = slice(SHARED + OF_VIEW * view, SHARED + OF_VIEW * (view + 1))
        rows[view, :, own] += rng.standard_normal((4, OF_VIEW))

    found = carried_blocks(csr_array(rows.reshape(4 * VIEWS, -1)), inverse, 4)

    wanted = rows @ expected @ np.swapaxes(rows, 1, 2)
    np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(wanted).max())
    independent = np.asarray(inverse.of_independent())
    np.testing.assert_allclose(selection @ independent @ selection.T.toarray(), expected,
                               atol=1e-9 * np.abs(expected).max())


def test_the_scale_is_held_where_it_moves_most(monkeypatch):
    """Held in one level or in all: steps differ along the scale alone."""
    chained, _ = systems(monkeypatch, False)
    direction = np.random.default_rng(3).standard_normal(len(chained.matrix))
    before = np.asarray(chained.matrix)

    chained.add_gauge(7.0, direction / np.linalg.norm(direction))

    added = np.asarray(chained.matrix) - before
    values, vectors = np.linalg.eigh(added)
    assert values[-1] == pytest.approx(7.0) and np.abs(values[:-1]).max() < 1e-9
    rows = max(chained.matrix.rows, key=lambda rows: np.sum(direction[rows]**2))
    along = direction[rows] / np.linalg.norm(direction[rows])
    assert abs(vectors[rows, -1] @ along) == pytest.approx(1.0)


def test_a_direction_without_information_comes_out_very_large(monkeypatch):
    chained, _ = systems(monkeypatch, False)
    matrix, row = chained.matrix, SHARED + 50 * OF_VIEW
    for blocks in (matrix.own, matrix.border, matrix.below):
        for k, block in enumerate(blocks):
            block[np.isin(matrix.rows[k + (blocks is matrix.below)], [row])] = 0
            if blocks is not matrix.border:
                block[:, np.isin(matrix.rows[k], [row])] = 0
    selection = selection_matrix(np.ones(len(matrix), bool))

    variance = inverse_information(matrix, selection, chained.diagonal).diagonal()

    others = np.delete(variance, row)
    assert 0.1 / RANK_TOLERANCE < variance[row] * chained.diagonal[row]
    assert others.max() < 1e-6 * variance[row]


@pytest.mark.long
def test_a_drive_is_calibrated_the_same(monkeypatch):
    """Level by level or at once: the same camera and the same sigmas."""
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    scene = drive(np.random.default_rng(4), 0.1, 80, 1000, 6)
    _, view = np.unique(scene.tracks.frame, return_inverse=True)
    assert chain_of_views(scene.tracks.track, view, 80) is not None
    chained = calibrate(scene.tracks, facts=facts)
    monkeypatch.setattr(schur_complement, 'chain_of_views', lambda *_: None)

    dense = calibrate(scene.tracks, facts=facts)

    for one, other in zip(chained.parameter_names, dense.parameter_names):
        sigma = dense.sigma[other]
        assert chained.sigma[one] == pytest.approx(sigma, rel=1e-3)
    np.testing.assert_allclose(chained.camera.K, dense.camera.K, atol=0.02 * max(
        dense.sigma.values()))
    assert len(chained.reconstruction.frames) == len(dense.reconstruction.frames) == 80
