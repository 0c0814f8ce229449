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
"""Settings of the object tracker: the constants of algorithm 7.2 by name, and what came after."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import get_args, Literal, TypeAlias

import numpy as np

from selfcal_ros.errors import ArgumentError

#: 'rapid' (algorithm 7.1) and 'rorapid' (7.2) are the thesis's own; 'modern' is ours.
TrackerMethod: TypeAlias = Literal['modern', 'rorapid', 'rapid']
TrackedCamera: TypeAlias = Literal['perspective', 'zoom', 'weak', 'affine']
ObjectMotion: TypeAlias = Literal['general', 'translation', 'planar']
METHODS: tuple[TrackerMethod, ...] = get_args(TrackerMethod)
ReadLines: TypeAlias = Literal['rows', 'columns']
CAMERA_MODELS: tuple[TrackedCamera, ...] = get_args(TrackedCamera)
MOTIONS: tuple[ObjectMotion, ...] = get_args(ObjectMotion)
LINES: tuple[ReadLines, ...] = get_args(ReadLines)

# name: (least, most) of the numbers that are checked alike
_RANGES = {
    'control_points_per_line': (2, 200), 'control_points_per_conic': (5, 400),
    'least_per_line': (2, 200), 'least_per_conic': (5, 400),
    'support_px': (0.1, 50), 'search_least_px': (2, 100), 'search_most_px': (2, 200),
    'least_contrast': (0.5, 255), 'candidates': (1, 8), 'rounds': (1, 10), 'steps': (1, 20),
    'texture_points': (0, 1000), 'tracking_share': (0, 1), 'lost_share': (0, 1),
    'frames_to_lost': (1, 1000), 'frame_rate_hz': (0.01, 1e5),
    'depth_scale_sigma': (1e-5, 1.0), 'line_delay_s': (-1e-3, 1e-3),
    'acceleration_m_s2': (0, 1e6), 'acceleration_rad_s2': (0, 1e6), 'zoom_rate_s': (0, 100),
}


@dataclass(frozen=True)
class TrackerOptions:
    """
    Settings of `RorapidTracker`.

    Parameters
    ----------
    method : {'modern', 'rorapid', 'rapid'}
        'rapid': algorithm 7.1. 'rorapid': algorithm 7.2. 'modern': several Gauss-Newton steps
        with an M-estimator over several edge candidates, the object's texture as it was seen,
        and recovery after loss.
    camera_model : {'perspective', 'zoom', 'weak', 'affine'}
        'zoom' also estimates the focal length.
    motion : {'general', 'translation', 'planar'}
        How the object can move before the camera (7.3.3).
    plane_axis : sequence of 3 floats, optional
        Axis of rotation of planar motion, camera frame; None: learned from a general track.
    control_points_per_line, control_points_per_conic : int
        Control points on each primitive (the thesis: 6 and 10).
    least_per_line, least_per_conic : int
        Edgels that a primitive needs to count as found (4 and 7).
    support_px : float
        Largest distance of an edgel to the primitive that it supports (2 px).
    search_least_px, search_most_px : float
        Bounds of the adaptive search range, to each side (8 and 24 px).
    least_contrast : float
        Weakest edge, grey levels.
    candidates : int
        Edges kept per control point ('modern').
    rounds, steps : int
        Searches per frame, and Gauss-Newton steps after each ('modern').
    texture : bool
        Remember and use the texture of the model's faces ('modern').
    texture_points : int
        Points of the texture that are followed in a frame.
    recovery : bool
        Search for the object again after a loss ('modern').
    doubt : bool
        Confirm a start by a test of its own, and watch for a model or a camera that is wrong
        ('modern').
    tracking_share, lost_share : float
        Two thresholds on the share of what should be visible and is confirmed: above the first
        the state is TRACKING, below the second the frame counts as a miss.
    depth_scale_sigma : float
        Standard deviation of the one factor by which the depths of a depth camera err.
    frames_to_lost : int
        Misses in a row until the state is LOST.
    frame_rate_hz : float
        Frame rate where images carry no stamps.
    acceleration_m_s2, acceleration_rad_s2 : float
        Standard deviation of the object's acceleration (process noise).
    zoom_rate_s : float
        Standard deviation of the relative change of the focal length in a second.
    line_delay_s : float
        Time from one line of the image to the next, seconds, where lines are read one after the
        other; negative from the lowest row up, or from the rightmost column. The pose is that at
        the stamp, when the middle line is read.
    lines : {'rows', 'columns'}
        What is read one after the other.

    Raises
    ------
    ArgumentError
        If a value is impossible; the sentence names it.

    """

    method: TrackerMethod = 'modern'
    camera_model: TrackedCamera = 'perspective'
    motion: ObjectMotion = 'general'
    plane_axis: tuple[float, float, float] | None = None
    control_points_per_line: int = 6
    control_points_per_conic: int = 10
    least_per_line: int = 4
    least_per_conic: int = 7
    support_px: float = 2.0
    search_least_px: float = 8.0
    search_most_px: float = 24.0
    least_contrast: float = 4.0
    candidates: int = 3
    rounds: int = 2
    steps: int = 4
    texture: bool = True
    texture_points: int = 48
    recovery: bool = True
    doubt: bool = True
    tracking_share: float = 0.5
    lost_share: float = 0.25
    depth_scale_sigma: float = 0.005
    frames_to_lost: int = 3
    frame_rate_hz: float = 25.0
    acceleration_m_s2: float = 2.0
    acceleration_rad_s2: float = 10.0
    zoom_rate_s: float = 0.1
    line_delay_s: float = 0.0
    lines: ReadLines = 'rows'

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        for name, allowed in (('method', METHODS), ('camera_model', CAMERA_MODELS),
                              ('motion', MOTIONS), ('lines', LINES)):
            if getattr(self, name) not in allowed:
                raise ArgumentError(f'{name} must be one of {", ".join(allowed)}, '
                                    f'not {getattr(self, name)!r}.')
        for name, (least, most) in _RANGES.items():
            value = getattr(self, name)
            if not (isinstance(value, (int, float, np.integer, np.floating))
                    and math.isfinite(value) and least <= value <= most):
                raise ArgumentError(f'{name} must lie between {least:g} and {most:g}, '
                                    f'not {value!r}.')
        for name in ('control_points_per_line', 'control_points_per_conic', 'least_per_line',
                     'least_per_conic', 'candidates', 'rounds', 'steps', 'texture_points',
                     'frames_to_lost'):
            if int(getattr(self, name)) != getattr(self, name):
                raise ArgumentError(f'{name} must be a whole number, '
                                    f'not {getattr(self, name)!r}.')
        for low, high in (('search_least_px', 'search_most_px'), ('lost_share', 'tracking_share'),
                          ('least_per_line', 'control_points_per_line'),
                          ('least_per_conic', 'control_points_per_conic')):
            if getattr(self, low) > getattr(self, high):
                raise ArgumentError(f'{low} must not exceed {high}.')
        if self.plane_axis is not None:
            axis = np.asarray(self.plane_axis, float).ravel()
            length = np.linalg.norm(axis) if axis.shape == (3,) else 0.0
            if not (np.isfinite(length) and length > 1e-9):
                raise ArgumentError('plane_axis must be three finite numbers, not all zero, '
                                    f'not {self.plane_axis!r}.')
            object.__setattr__(self, 'plane_axis', tuple(float(v) for v in axis / length))
        if self.camera_model == 'affine' and self.motion == 'planar':
            raise ArgumentError('The affine camera has no rotation that planar motion could '
                                'restrict; use weak perspective, or general motion.')

    @property
    def control_points(self) -> tuple[int, int]:
        """Control points on each line and on each conic."""
        return self.control_points_per_line, self.control_points_per_conic

    @property
    def built_in(self) -> tuple[object, ...]:
        """What a tracker cannot change once it is made; the rest it reads from image to image."""
        return (self.method, self.camera_model, self.motion, self.plane_axis, self.texture_points,
                self.doubt, self.acceleration_m_s2, self.acceleration_rad_s2, self.zoom_rate_s,
                self.line_delay_s, self.lines)

    @property
    def verifies(self) -> bool:
        """Whether starts are confirmed, and models and cameras doubted."""
        return self.method == 'modern' and self.doubt

    @property
    def seeks(self) -> bool:
        """Whether an object that is lost is sought."""
        return self.method == 'modern' and self.recovery
