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
"""Several objects, or starts, in one image: searched at once as if each were alone."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from selfcal_ros.geometry.small_system import inverted, solved
from selfcal_ros.rorapid.estimation.edge_fit import PosePrior, SearchRound
from selfcal_ros.rorapid.estimation.joint_fit import fit_together, FitTask
from selfcal_ros.rorapid.estimation.joint_search import together
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerOptions
from selfcal_ros.synthetic.several_objects import objects_beside

SHAPES, VIEWS = ('cube', 'spool', 'l_block'), 3
#: Settings that all differ, but for what must be alike to be searched at once.
OPTIONS = (TrackerOptions(), TrackerOptions(rounds=3, steps=2),
           TrackerOptions(search_least_px=5, control_points_per_line=4))


@lru_cache(maxsize=None)
def scene():
    made = objects_beside(SHAPES, VIEWS, supersampling=1, seed=3)
    return made.objects, made.frames()


def trackers(options=OPTIONS):
    found = []
    for one, chosen in zip(scene()[0], options):
        tracker = RorapidTracker(one.model, one.camera, chosen, np.random.default_rng(0))
        tracker.start(one.rotations[0], one.translations[0])
        found.append(tracker)
    return found


def as_alone(options):
    alone, beside = trackers(options), trackers(options)
    for image in scene()[1]:
        for one, frame in zip(alone, together([each.tracking(image) for each in beside])):
            expected = one.track(image)
            assert frame.state is expected.state
            assert np.allclose(frame.rotation, expected.rotation, 0, 1e-8)
            assert np.allclose(frame.translation, expected.translation, 0, 1e-9)
            assert np.allclose(frame.covariance, expected.covariance, 1e-6, 0)
            assert np.array_equal(frame.found, expected.found)


@pytest.mark.long
def test_objects_with_lines_and_curves_and_settings_of_their_own_are_found_as_if_alone():
    as_alone(OPTIONS)


@pytest.mark.long
@pytest.mark.parametrize('options', (
    (TrackerOptions(), TrackerOptions(camera_model='zoom'), TrackerOptions(method='rapid')),
    (TrackerOptions(candidates=1), TrackerOptions(line_delay_s=2e-5),
     TrackerOptions(motion='translation'))), ids=('models', 'motions'))
def test_what_cannot_be_searched_at_once_is_searched_by_itself(options):
    as_alone(options)


def test_a_search_that_fails_takes_no_other_along():
    first, second, _ = trackers()
    image, error = scene()[1][0], []
    together([first.tracking(image), second.tracking(image)])

    def caught(searching):
        try:
            return (yield from searching)
        except ValueError as problem:
            error.append(problem)
            return None

    def broken(searching):
        task = next(searching)
        return (yield task._replace(prior=replace(task.prior, information=np.eye(5))))

    frame, nothing = together([first.tracking(image), caught(broken(second.tracking(image)))])
    assert nothing is None and len(error) == 1
    assert frame and frame.share_found > 0.5


def test_starts_are_drawn_in_as_each_by_itself():
    tracker, one = trackers()[2], scene()[0][2]
    method, image = tracker._method, scene()[1][0]
    projection, edges = method.projection, method._edges
    centred = one.translations[0] + one.rotations[0] @ tracker.centre
    states = [projection.moved(projection.from_pose(one.rotations[0], centred),
                               np.random.default_rng(k).normal(0, 0.004, 6)) for k in range(4)]
    prior = PosePrior.of(states[0], 1e-3 * np.eye(6))
    tasks = []
    for k, state in enumerate(states):
        view = method.control.view(state)
        tasks.append(FitTask(edges, prior, SearchRound(
            state, view, 8 + 4 * k, edges.limits(8 + 4 * k, k % 2 == 0, True),
            np.ones(len(view.ids)))))
    at_once = fit_together(image, tasks)
    assert fit_together(image, []) == [] and method.search.ranked(image, [], np.eye(6)) == []
    for task, fit in zip(tasks, at_once):
        single, = fit_together(image, [task])
        # grey levels have single precision, and profiles of another length round otherwise
        assert np.allclose(fit.state.rotation, single.state.rotation, 0, 1e-6)
        assert np.allclose(fit.solved, single.solved, 1e-3, 1e-3 * np.abs(fit.solved).max())
        assert np.array_equal(fit.profiles, single.profiles)
        assert np.allclose(fit.residual, single.residual, 0, 1e-3, equal_nan=True)


def test_small_systems_are_solved_as_numpy_does():
    rng = np.random.default_rng(5)
    A, b = rng.normal(size=(6, 6)), rng.normal(size=(6, 3))
    assert np.allclose(solved(A, b), np.linalg.solve(A, b), 1e-12)
    assert np.allclose(inverted(A) @ A, np.eye(6), 0, 1e-10)
    with pytest.raises(np.linalg.LinAlgError):
        solved(np.zeros((2, 2)), np.ones(2))
