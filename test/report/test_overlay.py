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
"""Overlay pictures, their video, and the table of poses."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.report.overlay import (draw_overlay, FOUND, HIDDEN, MISSING, project_tracked,
                                        REJECTED, wireframe_segments)
from selfcal_ros.report.overlay_video import OverlayVideo
from selfcal_ros.report.poses_csv import PosesTable, read_poses
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.values.wireframe import Conic, Cylinder, WireframeModel

CAMERA = Camera([[300, 0, 160], [0, 300, 120], [0, 0, 1]], (-0.1, 0.02, 0, 0), 320, 240)


def seen(state=TrackerState.TRACKING, focal_px=300.0, **changes):
    """Describe an image in which four lines were looked at: all kinds of outcome."""
    x = np.linspace(40, 280, 6)
    points = np.concatenate([np.column_stack([x, np.full(6, y)]) for y in (60, 100, 140, 180)])
    line = np.repeat(np.arange(4), 6)
    fields = {
        'state': state, 'reason': '', 'rotation': rotation_matrix([0.1, 0.2, 0.3]),
        'translation': np.array([0.01, 0.02, 0.5]), 'covariance': np.diag([4e-6] * 3 + [1e-4] * 3),
        'focal_px': focal_px, 'focal_sigma_px': 0.0, 'camera_model': 'perspective',
        'image_px': points, 'normal': np.tile([0.0, 1.0], (24, 1)),
        'edge_px': np.where(line < 2, 0.2, np.nan), 'found': line == 0, 'rejected': line == 1,
        'hidden': line == 3, 'primitive': line, 'texture_px': np.zeros((0, 2)), 'rms_px': 0.2,
        'share_found': 0.5, 'innovation': 1.0, 'stamp_ns': 7}
    return TrackedFrame(**{**fields, **changes})


def near(image, colour, y):
    """Tell whether a colour is on a row of the image, between the ticks."""
    return (np.abs(image[y].astype(int) - colour).max(axis=1) < 40).sum() > 50


def test_lines_have_the_colours_of_their_outcome():
    grey = np.full((240, 320), 30, np.uint8)
    drawn = draw_overlay(grey, seen())
    for y, colour in ((60, FOUND), (100, REJECTED), (140, MISSING), (180, HIDDEN)):
        assert near(drawn, colour, y), y
    assert (grey == 30).all() and drawn.shape == (240, 320, 3)
    lost = draw_overlay(grey, seen(TrackerState.LOST, reason='It is gone.'))
    assert not any(near(lost, colour, y) for y in (60, 100) for colour in (FOUND, REJECTED))


def test_what_is_not_a_number_or_far_outside_does_no_harm():
    points = np.array([[np.nan, 1], [1e9, -1e9], [5, 5], [300, 200]])
    few = {name: value[:4] for name, value in vars(seen()).items()
           if isinstance(value, np.ndarray) and len(value) == 24}
    few['image_px'] = points
    assert draw_overlay(np.zeros((240, 320, 3), np.uint8), seen(**few)).any()
    none = {name: value[:0] for name, value in few.items()}
    draw_overlay(np.zeros((1, 1), np.uint8), seen(**none))
    assert not draw_overlay(np.zeros((20, 20), np.uint8), None).any()


def test_points_are_projected_with_lens_and_zoom():
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    tracked = seen()
    expected = CAMERA.project(points @ tracked.rotation.T + tracked.translation)
    assert np.allclose(project_tracked(points, tracked, CAMERA), expected)
    zoomed = project_tracked(points, seen(focal_px=600.0), CAMERA)
    assert np.allclose(zoomed - [160, 120], 2 * (expected - [160, 120]))
    assert np.isnan(project_tracked(np.array([[0, 0, -5.0]]), tracked, CAMERA)).all()


def test_a_model_becomes_straight_pieces():
    model = WireframeModel(np.eye(3), [(0, 1), (1, 2)],
                           conics=[Conic([0, 0, 0], [1, 0, 0], [0, 1, 0])],
                           cylinders=[Cylinder([0, 0, 0], [0, 0, 1], 0.5)])
    pieces = wireframe_segments(model, 24)
    assert pieces.shape[1:] == (2, 3) and len(pieces) > 2 + 3 * 24
    circle = pieces[2:26]
    assert np.allclose(np.linalg.norm(circle, axis=2), 1) and np.allclose(circle[-1, 1],
                                                                          circle[0, 0])


def test_a_video_appears_when_it_is_whole(tmp_path):
    path = tmp_path / 'out.avi'
    with OverlayVideo(path, 15.0) as video:
        for k in range(5):
            video.add(np.full((48, 64, 3), 40 * k, np.uint8))
        assert not path.exists()
    capture = cv2.VideoCapture(str(path))
    assert (capture.get(cv2.CAP_PROP_FRAME_COUNT), capture.get(cv2.CAP_PROP_FPS)) == (5, 15)
    with pytest.raises(RuntimeError), OverlayVideo(tmp_path / 'broken.avi') as video:
        video.add(np.zeros((48, 64, 3), np.uint8))
        raise RuntimeError
    assert [entry.name for entry in tmp_path.iterdir()] == ['out.avi']
    for name in ('out.gif', 'nowhere/out.mp4'):
        with pytest.raises(InputError):
            OverlayVideo(tmp_path / name)


def test_poses_come_back_as_they_were(tmp_path):
    table, image = PosesTable(), np.zeros((2, 2), np.uint8)
    table.add(Frame(3, 10**18, image), seen())
    table.add(Frame(4, 10**18 + 1, image), seen(TrackerState.LOST))
    poses = read_poses(table.write(tmp_path / 'poses.csv'))
    assert list(poses['frame']) == [3, 4] and list(poses['stamp_ns']) == [10**18, 10**18 + 1]
    assert list(poses['state']) == ['tracking', 'lost']
    assert np.allclose(poses['rotation'][0], seen().rotation, atol=1e-8)
    assert np.allclose(poses['translation'][0], seen().translation, atol=1e-9)
    assert poses['sigma_t'][0] == pytest.approx(np.sqrt(12e-6))
    assert poses['sigma_r'][0] == pytest.approx(np.sqrt(3e-4))
    assert np.isnan(poses['translation'][1]).all()


@pytest.mark.parametrize('text', ['', 'a,b\n1,2\n', 'frame,stamp_ns,state,tx,ty,tz,rx,ry,rz,'
                                  'focal_px,sigma_t,sigma_r\n1,x,tracking\n'])
def test_what_is_no_table_of_poses_is_refused(tmp_path, text):
    path = tmp_path / 'poses.csv'
    path.write_text(text)
    with pytest.raises(InputError, match='poses.csv'):
        read_poses(path)
