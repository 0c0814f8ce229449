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
"""A model of the wrong size: one camera cannot know, two views a known step apart do."""

from dataclasses import replace

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.estimation.model_size import size_of_model
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.synthetic.objects import tracked_object

NOTHING = np.zeros((6, 6))


@pytest.fixture(scope='module')
def seen():
    """Two poses of one object, as two cameras would see it, and the motion between them."""
    made = tracked_object(16, 'box', seed=41, supersampling=2)
    renderer = made.renderer()
    turn = made.rotations[15] @ made.rotations[0].T
    motion = np.column_stack([turn, made.translations[15] - turn @ made.translations[0]])
    return made, [made.frame(k, renderer) for k in (0, 15)], motion


def poses(seen, scale):
    """Track the object with a model that is too large, from near the truth in each image."""
    made, images, _ = seen
    model = replace(made.model, vertices=scale * made.model.vertices)
    for k, image in zip((0, 15), images):
        tracker = RorapidTracker(model, made.camera)
        tracker.start(made.rotations[k], made.translations[k])
        yield tracker.track(image)


@pytest.mark.parametrize('scale', (1.0, 1.1))
def test_a_known_step_tells_the_size_and_one_camera_does_not(seen, scale):
    first, second = poses(seen, scale)
    # one camera: the image fits as well, and the object is farther by as much
    assert first and not first.doubt and first.rms_px < 0.3
    assert np.allclose(first.translation, scale * seen[0].translations[0], rtol=5e-3,
                       atol=1e-4)
    size = size_of_model((first.rotation, first.translation), (second.rotation,
                         second.translation), seen[2],
                         (first.covariance, second.covariance, NOTHING))
    assert abs(size.share - (scale - 1)) < 4 * size.sigma
    if abs(scale - 1) > 0.05:
        assert size.wrong and ('too large' if scale > 1 else 'too small') in size.text()
    elif scale == 1:
        assert not size.wrong and 'as large as the object' in size.text()


def test_the_stated_sigma_is_that_of_the_size():
    rng = np.random.default_rng(0)
    turn, step = rotation_matrix(np.array([0.1, -0.3, 0.2])), np.array([0.2, 0.05, -0.1])
    spread = np.diag([1e-3, 1e-3, 4e-3, 0, 0, 0])**2
    known = np.diag([2e-3, 2e-3, 2e-3, 1e-3, 1e-3, 1e-3])**2
    place, found = np.array([0.1, -0.2, 1.5]), []
    for _ in range(400):
        one = 1.05 * place + rng.normal(size=3) * np.sqrt(np.diag(spread)[:3])
        two = 1.05 * (turn @ place + step) + rng.normal(size=3) * np.sqrt(np.diag(spread)[:3])
        off = rng.normal(size=6) * np.sqrt(np.diag(known))
        said = np.column_stack([rotation_matrix(off[3:]) @ turn, step + off[:3]])
        found.append(size_of_model((np.eye(3), one), (turn, two), said, (spread, spread, known)))
    pulls = np.array([(size.share - 0.05) / size.sigma for size in found])
    assert abs(pulls.mean()) < 0.2 and 0.85 < pulls.std() < 1.2


def test_without_a_step_nothing_is_known():
    pose = np.eye(3), np.array([0, 0, 1.0])
    standing = size_of_model(pose, pose, np.eye(3, 4), (np.eye(6), np.eye(6), NOTHING))
    assert np.isinf(standing.sigma) and not standing.wrong
    with pytest.raises(ArgumentError, match='array of finite numbers'):
        size_of_model(pose, pose, np.eye(3), (np.eye(6), np.eye(6), NOTHING))
