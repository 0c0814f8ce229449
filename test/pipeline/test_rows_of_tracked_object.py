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
"""Calibration from a tracked object whose images are read row by row."""

import numpy as np
import pytest

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.pipeline.edge_measurement import (
    CONIC_POINTS, LINE_POINTS, measure_edges, PosedImage)
from selfcal_ros.pipeline.object_motion import PosesInTime
from selfcal_ros.pipeline.tracked_calibration import calibrate_tracked_object
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.synthetic.objects import tracked_object
from selfcal_ros.synthetic.recordings import write_image_folder

ROWS, READOUT_S = 360, 0.02


def recording(readout_s):
    return tracked_object(4, 'cube', size=(480, ROWS), speed=3.0, readout_s=readout_s,
                          supersampling=2, seed=8)


def off_px(made, delay_s):
    """Median distance of the edges measured from where they were when the middle row was read."""
    path = PosesInTime()
    for stamp, R, t in zip(made.stamps_ns.tolist(), made.rotations, made.translations):
        path.add(stamp, (R, t))
    views = []
    for k in (1, 2):
        views.append(PosedImage(k, made.frame(k), made.rotations[k], made.translations[k],
                                path.move_a_second(int(made.stamps_ns[k])), delay_s))
    edges = measure_edges(VisibleModel(made.model, LINE_POINTS, CONIC_POINTS), made.camera,
                          views, 8)
    at = np.searchsorted([1, 2], edges.frame)
    poses = edges.cam_from_object[at]
    X = np.einsum('nij,nj->ni', poses[:, :, :3], edges.points) + poses[:, :, 3]
    return float(np.median(np.linalg.norm(edges.xy - made.camera.project(X), axis=1)))


def test_edges_are_put_to_where_they_were_when_the_middle_row_was_read():
    rolling, still = recording(READOUT_S), recording(0.0)
    noise_px = off_px(still, 0.0)
    assert off_px(rolling, 0.0) > 5 * noise_px
    assert off_px(rolling, READOUT_S / ROWS) < 1.5 * noise_px


def test_images_beside_each_other_tell_the_motion_and_one_alone_none():
    path = PosesInTime()
    for k, pose in enumerate([None, (np.eye(3), np.zeros(3)), (np.eye(3), np.array([0, 0, 0.1])),
                              None, None, (np.eye(3), np.ones(3))]):
        path.add(10**8 * k, pose)
    assert np.allclose(path.move_a_second(10**8), [0, 0, 0, 0, 0, 1.0])
    assert path.move_a_second(5 * 10**8) is None and path.interval_s == pytest.approx(0.1)


def test_rows_of_images_without_stamps_are_refused(tmp_path):
    made = recording(0.0)
    folder = write_image_folder(made, tmp_path / 'images')
    with pytest.raises(InputError, match='has no stamps'):
        calibrate_tracked_object(folder, made.model, CameraFacts(line_delay_s=5e-5),
                                 init='0 0 1 0 0 0', start=made.camera)


@pytest.mark.long
def test_how_fast_rows_are_read_is_found_and_undone(tmp_path):
    """Without stamps it is told in intervals between images."""
    made = tracked_object(14, 'cube', size=(480, ROWS), speed=3.0, readout_s=READOUT_S,
                          supersampling=2, seed=8)
    folder = write_image_folder(made, tmp_path / 'images')
    pose = (*made.translations[0], *rotation_vector(made.rotations[0]))
    result, _ = calibrate_tracked_object(
        folder, made.model, CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'),
        init=' '.join(map(str, pose)), start=made.camera)
    interval_s = 1e-9 * float(np.diff(made.stamps_ns)[0])
    found = result.shutter
    assert found.line_delay_s is None and found.status == 'estimated'
    assert abs(found.intervals - READOUT_S / interval_s) < 3 * found.intervals_sigma < 0.06
    assert 'rolling_shutter_unstamped' in [one.kind for one in result.findings]
    error = result.camera.parameters - made.camera.parameters
    assert all(abs(error[k]) < 3 * result.sigma[name] for k, name in ((0, 'fx'), (2, 'cx'),
                                                                      (3, 'cy')))
