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
"""Rendered videos of a camera whose rows are read one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from selfcal_ros.synthetic import worlds
from selfcal_ros.synthetic.recordings import (default_camera, FIRST_STAMP_NS,
                                              REALISTIC_DISTORTION, Recording)
from selfcal_ros.synthetic.render import quantise, Renderer
from selfcal_ros.synthetic.rolling_scenes import drive, hand, Path

#: Height of the camera above the floor, metres, beyond that of the path itself.
_LIFT_M = {'drive': 0.5, 'hand': 1.2}


@dataclass(frozen=True)
class RollingRecording(Recording):
    """
    An image sequence whose rows are read one after the other.

    Parameters
    ----------
    path : callable
        Rotations and centres at times in seconds.
    readout_s : float
        Time in which all rows are read, the middle one at the stamp; negative from the lowest
        row up.

    """

    path: Any = None
    readout_s: float = 0.0

    def frame(self, index: int, renderer: Renderer | None = None) -> np.ndarray:
        """Render image `index`; see `Recording.frame`."""
        renderer = renderer or self.renderer()
        time = 1e-9 * float(self.stamps_ns[index] - FIRST_STAMP_NS)
        grey = renderer.rolling_intensity(
            lambda share: _pose(self.path, time + share * self.readout_s))
        return quantise(grey, np.random.default_rng([self.seed, index]), self.noise_sigma)


def rolling_video(kind: str, readout_s: float, length_s: float = 6.0, rate_hz: float = 30.0,
                  size: tuple[int, int] = (640, 480), seed: int = 1) -> RollingRecording:
    """
    Drive an S through a hall, or wave a camera in it.

    Parameters
    ----------
    kind : {'drive', 'hand'}
    readout_s : float
        Zero: all rows at once.
    length_s, rate_hz : float
    size : (int, int)
        Width and height.
    seed : int
        Seed of hall, path and noise.

    Returns
    -------
    RollingRecording

    """
    rng = np.random.default_rng([seed, 7])
    made = (drive if kind == 'drive' else partial(hand, turn_deg=16.0))(rng, length_s)
    path = _lifted(made, _LIFT_M[kind])
    times = np.arange(round(length_s * rate_hz)) / rate_hz
    R, centres = path(times)
    heading = np.arctan2(R[:, 2, 1], R[:, 2, 0])
    surfaces = worlds.hall(np.random.default_rng([seed, 0]), centres[:, :2], heading)
    poses = np.concatenate([R, -R @ centres[:, :, None]], axis=2)
    stamps = FIRST_STAMP_NS + np.rint(1e9 * times).astype(np.int64)
    record = {'function': 'rolling_video', 'kind': kind, 'readout_s': readout_s, 'seed': seed,
              'length_s': length_s, 'rate_hz': rate_hz}
    return RollingRecording(f'rolling_{kind}', default_camera(size, REALISTIC_DISTORTION), poses,
                            stamps, surfaces, seed=seed, made=record, path=path,
                            readout_s=readout_s)


def _lifted(path: Path, by_m: float) -> Path:
    def pose(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R, centre = path(time)
        return R, centre + [0, 0, by_m]

    return pose


def _pose(path: Path, time: float) -> np.ndarray:
    R, centre = path(np.array(time))
    return np.column_stack([R, -R @ centre])
