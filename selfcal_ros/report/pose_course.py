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
"""Position and angles over time: whether the camera went as its driver remembers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import metres_a_step, metric_path
from selfcal_ros.geometry.rotation import roll_pitch_yaw
from selfcal_ros.report.style import (BLUE, counted_along_x, Drawing, figure_of, GREEN, GREY,
                                      new_panel, ORANGE, styled)
from selfcal_ros.values.tracks import Tracks

#: Body axes (REP 103: x forward, y left, z up) from optical ones (x right, y down, z forward).
_BODY_FROM_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
#: More views than this are drawn without dots.
_MOST_DOTS = 80


@dataclass(frozen=True)
class PoseCourse:
    """
    Poses of the camera over time, in the body frame of the first view.

    Attributes
    ----------
    time : ndarray, shape (V,)
        Seconds since the first view, or image numbers.
    in_seconds : bool
    position : ndarray, shape (V, 3)
        x forward, y left, z up; the median step between views is 1, unless `in_metres`.
    angles_deg : ndarray, shape (V, 3)
        Roll, pitch and yaw of the camera's body axes (REP 103), without jumps of a turn.
    in_metres : bool
        The poses of a robot tell the scale.

    """

    time: np.ndarray
    in_seconds: bool
    position: np.ndarray
    angles_deg: np.ndarray
    in_metres: bool = False


def pose_course(result: Calibration, tracks: Tracks | None = None) -> PoseCourse | None:
    """
    Follow the camera.

    Parameters
    ----------
    result : Calibration
    tracks : Tracks, optional
        Their stamps give the time.

    Returns
    -------
    PoseCourse or None
        None where the views do not follow each other.

    """
    shape = result.reconstruction
    if result.motion == 'known-object' or shape is None or len(shape.frames) < 3 \
            or not np.isfinite(shape.cam_from_world).all():
        return None
    order = np.argsort(shape.frames, kind='stable')
    poses = metric_path(result)[order]
    frames = np.asarray(shape.frames)[order]
    world_from_cam = np.swapaxes(poses[:, :, :3], 1, 2)
    position = -np.einsum('vij,vj->vi', world_from_cam, poses[:, :, 3])
    angles = np.unwrap(roll_pitch_yaw(world_from_cam @ _BODY_FROM_OPTICAL.T), axis=0)
    stamps = {} if tracks is None else tracks.stamps_ns or {}
    known = [stamps[int(frame)] for frame in frames if int(frame) in stamps]
    time = np.asarray(frames, float)
    in_seconds = len(known) == len(frames) and len(set(known)) > 1
    if in_seconds:
        time = np.array([stamp - known[0] for stamp in known]) / 1e9
    return PoseCourse(time, in_seconds, position, np.degrees(angles),
                      metres_a_step(result) is not None)


def pose_figure(result: Calibration, tracks: Tracks | None = None) -> Drawing | None:
    """
    Draw position and angles over time.

    Parameters
    ----------
    result : Calibration
    tracks : Tracks, optional

    Returns
    -------
    Drawing or None
        None where the views do not follow each other; a camera that only turns has no position.

    """
    course = pose_course(result, tracks)
    if course is None:
        return None
    parts = [(course.angles_deg, ('roll', 'pitch', 'yaw'), 'angle / degrees', 'Angles')]
    if result.motion != 'rotation':
        parts.insert(0, (course.position, ('x, forward', 'y, left', 'z, up'),
                         f'position / {"m" if course.in_metres else "steps"}', 'Position'))
    dots = '.' if len(course.time) <= _MOST_DOTS else ''
    panels = []
    with styled():
        for values, names, label, title in parts:
            axes = new_panel(2.9)
            axes.axhline(0.0, color=GREY, linewidth=0.7)
            for column, name, colour in zip(values.T, names, (BLUE, ORANGE, GREEN)):
                axes.plot(course.time, column, f'{dots}-', color=colour, linewidth=1, label=name)
            if course.in_seconds:
                axes.set_xlabel('time / s')
            else:
                counted_along_x(axes, 'image')
            axes.set_ylabel(label)
            axes.set_title(title)
            axes.spines[['top', 'right']].set_visible(False)
            axes.legend(loc='best', handlelength=1.4)
            panels.append(figure_of(axes))
    unit = ('lengths are by the poses of the robot' if course.in_metres
            else 'the median step between views is 1')
    return Drawing('course', 'Position and angles over time', f'In the frame of the first view; '
                   f'{unit}. Yaw is positive to the left, pitch downwards, roll to the right '
                   '(REP 103). A robot that drives goes smoothly, photographs may jump. If the '
                   'camera did not go this way, the calibration is wrong.', tuple(panels), 'scene')
