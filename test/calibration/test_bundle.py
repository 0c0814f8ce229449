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
"""The bundle adjustment: derivatives, elimination, optimum and covariance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.information import eliminated, inverse_information
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry import schur_complement
from selfcal_ros.geometry.levenberg_marquardt import DampedFactor
from selfcal_ros.geometry.projective import tangent_basis
from selfcal_ros.geometry.rotation import align_z
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.synthetic.scenes import sequence_si


def true_state(sequence):
    """Return state, view and point of a sequence at its truth, in the bundle's world frame."""
    mount = align_z(sequence.axis)
    poses = sequence.cam_from_world
    # the first view's camera is at the origin of the bundle's world, turned by the mount
    first = np.vstack([poses[0], [0, 0, 0, 1]])
    world_from_new = np.linalg.inv(first) @ np.block(
        [[mount, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
    points = np.linalg.solve(world_from_new, np.vstack([sequence.points.T,
                                                        np.ones(len(sequence.points))])).T
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return SceneState(Lens.of(sequence.camera), AxisPath.of_poses(mount, poses @ world_from_new),
                      points)


def problem(noise_px=0.0, motion=MotionModel(), facts=CameraFacts(distortion='plumb_bob'),
            seed=1, **options):
    """Return a bundle over sequence SI and the true state."""
    sequence = sequence_si(np.random.default_rng(seed), noise_px, **options)
    tracks = sequence.tracks
    bundle = Bundle(SceneModel(motion), tracks.frame, tracks.track, tracks.xy,
                    priors=priors_from_facts(facts), sigma_px=max(noise_px, 0.1))
    return bundle, true_state(sequence)


def test_truth_has_no_residual():
    bundle, state = problem(distortion=(-0.1, 0.05, 0.001, -0.002), aspect_ratio=1.1, skew=5)

    assert np.abs(bundle.residuals(state)).max() < 1e-9


def test_elimination_solves_the_whole_system():
    """The reduced step and the points' steps are those of the dense normal equations."""
    bundle, state = problem(0.1)
    line = bundle.linearise(state)
    blocks, n = bundle.blocks, len(bundle.view)
    system = blocks.unreduced(line.shared, line.view, line.eliminated, line.residual).reduced()
    rest, unknowns = len(bundle.unknowns), bundle.unknowns
    J = np.zeros((n, 2, rest + 3 * blocks.point_count))
    J[:, :, unknowns.shared] = line.shared
    for k in range(n):
        J[k][:, unknowns.by_view[bundle.view[k]]] = line.view[k]
        J[k, :, rest + 3 * bundle.part[k]:][:, :3] = line.eliminated[k]
    J = J.reshape(2 * n, -1)
    H, g = J.T @ J, J.T @ line.residual.ravel()
    schur = H[:rest, :rest] - H[:rest, rest:] @ np.linalg.solve(H[rest:, rest:], H[rest:, :rest])

    np.testing.assert_allclose(system.matrix, schur, atol=1e-6 * np.abs(H).max())
    step = np.random.default_rng(0).standard_normal(rest)
    points = -np.linalg.solve(H[rest:, rest:], g[rest:] + H[rest:, :rest] @ step)
    np.testing.assert_allclose(system.point_steps(step).ravel(), points, rtol=1e-5, atol=1e-8)
    change = system.predict(step, system.point_steps(step))
    np.testing.assert_allclose(change.ravel(), J @ np.r_[step, points], rtol=1e-5, atol=1e-6)


def test_points_seen_on_several_laps_are_eliminated_in_any_groups(monkeypatch):
    """Three laps of 100 views: the same matrix as in one order of the points, for less work."""
    rng = np.random.default_rng(4)
    point, view = [], []
    for one in range(900):
        begin, length = rng.integers(100), rng.integers(2, 9)
        for lap in np.flatnonzero(rng.random(3) < 0.6):
            point.append(np.full(length, one))
            view.append(np.unique(100 * lap + (begin + np.arange(length)) % 100))
    point, view = np.unique(np.column_stack([np.concatenate(point), np.concatenate(view)]),
                            axis=0).T
    point = np.unique(point, return_inverse=True)[1]
    columns = [rng.standard_normal((len(point), 2, k)) for k in (4, 3, 3)]
    residual = rng.standard_normal((len(point), 2))

    def system():
        blocks = PointBlocks(point, view)
        return blocks, blocks.unreduced(*columns, residual).reduced(1e-3)

    # with or without levels of views
    monkeypatch.setattr(schur_complement, 'chain_of_views', lambda *_: None)
    blocks, by_laps = system()
    monkeypatch.setattr(schur_complement, 'MANY_VIEWS', 10**6)
    plain_blocks, plain = system()
    scale = np.abs(plain.matrix).max()
    np.testing.assert_allclose(by_laps.matrix, plain.matrix, atol=1e-12 * scale)
    np.testing.assert_allclose(by_laps.gradient, plain.gradient, atol=1e-12 * scale)
    step = rng.standard_normal(len(plain.matrix))
    np.testing.assert_allclose(by_laps.point_steps(step), plain.point_steps(step), rtol=1e-6,
                               atol=1e-9)
    work, plain_work = (sum(group.products for group in one.groups)
                        for one in (blocks, plain_blocks))
    assert work < 0.6 * plain_work


def test_views_that_share_no_window_are_grouped_right():
    """Groups of points over windows of views add up to the same matrix in any order."""
    rng = np.random.default_rng(3)
    point = np.repeat(np.arange(600), 3)
    view = (np.arange(600) // 60)[:, None] + np.array([0, 1, 3])
    blocks = PointBlocks(point, view.ravel())
    n = len(point)
    shared, own, points = (rng.standard_normal((n, 2, k)) for k in (4, 2, 3))
    system = blocks.unreduced(shared, own, points, rng.standard_normal((n, 2))).reduced()

    np.testing.assert_allclose(system.matrix, system.matrix.T, atol=1e-9)
    assert np.linalg.eigvalsh(system.matrix).min() > -1e-9
    # views 0 and 9 share no point
    a, b = slice(4, 6), slice(4 + 2 * 9, 6 + 2 * 9)
    assert np.abs(system.matrix[a, a]).max() > 0
    off = blocks.unreduced(np.zeros((n, 2, 0)), own, points,
                           np.zeros((n, 2))).reduced().matrix[:2, 18:20]
    np.testing.assert_allclose(off, 0, atol=1e-12)
    assert b.stop <= len(system.matrix)


def test_further_unknowns_beside_a_system_are_as_if_they_had_been_in_it():
    rng = np.random.default_rng(5)
    point = np.repeat(np.arange(40), 4)
    view = (np.arange(40) // 5)[:, None] + np.array([0, 1, 2, 4])
    blocks, n = PointBlocks(point, view.ravel()), 160
    shared, more, own, points = (rng.standard_normal((n, 2, k)) for k in (3, 2, 4, 3))
    residual = rng.standard_normal((n, 2))
    system = blocks.unreduced(shared, own, points, residual).reduced()
    whole = blocks.unreduced(np.concatenate([shared, more], axis=2), own, points,
                             residual).reduced()
    further, rest = [3, 4], np.r_[:3, 5:len(whole.matrix)]
    beside = system.beside(more)

    np.testing.assert_allclose(beside.coupling, whole.matrix[np.ix_(rest, further)], atol=1e-9)
    np.testing.assert_allclose(beside.own, whole.matrix[np.ix_(further, further)], atol=1e-9)
    np.testing.assert_allclose(beside.gradient, whole.gradient[further], atol=1e-9)
    step = rng.standard_normal(len(whole.matrix))
    np.testing.assert_allclose(system.point_steps(
        step[rest], system.half_b + beside.through @ step[further]), whole.point_steps(step),
        atol=1e-9)
    rows = rng.standard_normal((2, len(whole.matrix)))
    np.testing.assert_allclose(system.influence(rows[:, rest])
                               + beside.influence(system, rows[:, further]),
                               whole.influence(rows), atol=1e-9)


def test_it_returns_to_the_truth_from_afar():
    facts = CameraFacts(aspect_ratio=1.0, distortion='none')
    bundle, truth = problem(0.0, facts=facts)
    lens, path = truth.lens, truth.path
    away = replace(truth, lens=lens.with_values({'f': 0.8 * lens['f'], 'cx': 1.05 * lens['cx'],
                                                 'cy': 0.95 * lens['cy']}),
                   path=replace(path, angle=1.2 * path.angle))

    found = bundle.optimise(away, 100, 1e-12)

    np.testing.assert_allclose(found.lens.values, truth.lens.values, atol=1e-3)


def test_covariance_is_that_of_many_runs():
    """Spread over seeded runs against the stated covariance: chi-square of all parameters."""
    facts = CameraFacts(aspect_ratio=1.0, distortion='none')
    chosen = problem(0.2, facts=facts)[1].lens.places(('f', 'cx', 'cy', 'skew'))
    distances = []
    for seed in range(60):
        bundle, truth = problem(0.2, facts=facts, seed=seed)
        bundle = bundle.with_sigma(0.2)
        found = bundle.optimise(truth, 50, 1e-6)
        covariance = bundle.information(found).lens_covariance
        error = (found.lens.values - truth.lens.values)[chosen]
        distances.append(error @ np.linalg.solve(covariance[np.ix_(chosen, chosen)], error))

    # mean of chi-square with four degrees of freedom over 60 runs: 4 ± 0.37
    assert 4 - 4 * 0.37 < np.mean(distances) < 4 + 4 * 0.37


def test_noise_is_estimated_without_bias():
    estimates = []
    for seed in range(20):
        bundle, truth = problem(0.3, facts=CameraFacts(1.0, distortion='none'), seed=seed)
        found = bundle.optimise(truth, 50, 1e-6)
        estimates.append(bundle.noise_rms(found))

    # 145 degrees of freedom: 6 % a run
    assert np.mean(estimates) == pytest.approx(0.3, rel=4 * 0.06 / np.sqrt(20))


def test_a_soft_fact_weighs_as_much_as_its_sigma():
    """A fact far from the data pulls, one with a large sigma does not."""
    wrong = {}
    for sigma in (0.001, 1.0):
        facts = CameraFacts(aspect_ratio=1.0, principal_point=(390.0, 300.0),
                            principal_point_sigma_px=1000 * sigma, skew=0.0, distortion='none')
        bundle, truth = problem(0.0, facts=facts)
        wrong[sigma] = abs(bundle.optimise(truth, 100, 1e-10).lens['cx'] - 400)

    assert wrong[0.001] > 1
    assert wrong[1.0] < 0.1


def test_tangent_basis_is_orthonormal():
    points = np.random.default_rng(0).standard_normal((50, 4))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points[0] = [0, 0, 0, 1]
    points[1] = [0, 0, 0, -1]
    B = tangent_basis(points)

    np.testing.assert_allclose(np.swapaxes(B, 1, 2) @ B, np.tile(np.eye(3), (50, 1, 1)),
                               atol=1e-12)
    np.testing.assert_allclose(np.einsum('pi,pij->pj', points, B), 0, atol=1e-12)


def test_points_settle_without_moving_the_cameras():
    """From far off, each alone: the cost of the truth is reached again."""
    bundle, state = problem(0.1, distortion=(-0.1, 0.05, 0, 0))
    rng = np.random.default_rng(5)
    points = state.points + 0.05 * rng.standard_normal(state.points.shape)
    off = replace(state, points=points / np.linalg.norm(points, axis=1, keepdims=True))

    found = bundle.refine_points(off, 10)

    assert bundle.cost(off) > 100 * bundle.cost(state)
    assert bundle.cost(found) < bundle.cost(state)
    np.testing.assert_array_equal(found.path.cam_from_world(), state.path.cam_from_world())
    np.testing.assert_array_equal(found.lens.values, state.lens.values)


@pytest.mark.parametrize('size', [7, 1100])
def test_a_matrix_is_inverted_in_place_beside_what_is_held(size):
    # rows of such different size, and what is held may have any
    rng = np.random.default_rng(4)
    A = rng.standard_normal((size + 5, size)) * np.exp(rng.normal(0, 3, size))
    held = rng.choice(size, 2, replace=False)
    A[:, held[0]] *= 1e9
    matrix = A.T @ A
    free = np.setdiff1d(np.arange(size), held)
    before, selection = matrix.copy(), csr_array(np.eye(size)[:, free])
    found = inverse_information(matrix, selection, np.diag(matrix))
    scale = np.sqrt(np.outer(*2 * [np.diag(matrix)[free]]))
    wanted = np.linalg.inv(matrix[np.ix_(free, free)] / scale) / scale

    np.testing.assert_array_equal(matrix, before)
    assert not found[held].any() and not found[:, held].any()
    root = np.sqrt(np.outer(*2 * [np.diag(wanted)]))
    np.testing.assert_allclose(found[np.ix_(free, free)] / root, wanted / root, atol=1e-7)
    right = rng.standard_normal((size, 3)) * np.sqrt(np.diag(matrix))[:, None]
    size_of = np.abs(found) @ np.abs(right)
    apart = eliminated(matrix, selection, right, np.diag(matrix)) - found @ right
    assert np.abs(apart / np.maximum(size_of, 1e-300)).max() < 1e-7

    # the same where the memory of the matrix may be taken
    diagonal = np.diag(matrix).copy()
    np.testing.assert_array_equal(
        eliminated(matrix.copy(), selection, right, diagonal, overwrite=True),
        eliminated(matrix, selection, right, diagonal))
    one, other = (DampedFactor(matrix.copy(), diagonal, 1e-3, selection, overwrite)
                  for overwrite in (False, True))
    np.testing.assert_array_equal(one.solve(right), other.solve(right))
    taken = inverse_information(matrix, selection, diagonal, overwrite=True)
    np.testing.assert_array_equal(taken, found)
    assert np.shares_memory(taken, matrix)


def test_a_direction_without_information_has_a_very_large_variance():
    matrix = np.array([[2.0, 2.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 5.0]])
    found = inverse_information(matrix, csr_array(np.eye(3)))
    assert found[2, 2] == pytest.approx(0.2) and found[0, 0] > 1e10
    assert found[0, 0] + 2 * found[0, 1] + found[1, 1] == pytest.approx(0.5, rel=1e-2)

    # what its factor leaves of the matrix is enough
    taken = inverse_information(matrix.copy(), csr_array(np.eye(3)), overwrite=True)
    np.testing.assert_array_equal(taken, found)
