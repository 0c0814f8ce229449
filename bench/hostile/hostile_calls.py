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
"""
Bad messages and arguments for the Python interface.

What comes out is a value, an InputError or an ArgumentError; for an argument of another type than
the documents say, a TypeError or a ValueError as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

from msg_adapters.camera_info import camera_from_info
from msg_adapters.image import ImageDecoder, SUPPORTED_ENCODINGS
from msg_adapters.tracks import tracks_from_message
import numpy as np
from selfcal_ros import calibrate, calibrate_known_object, Camera, CameraFacts, KnownObject, Tracks

#: Values of every kind, for arguments that take numbers.
VALUES: tuple[Any, ...] = (
    np.nan, np.inf, -np.inf, 0, -1, 1, 2**63, 1e300, 1e-300, -0.0, None, 'a', '', b'x', [], {}, (),
    True, 1j, object(), np.zeros(0), np.zeros((2, 2)), np.full(3, np.nan), [[1], [2, 3]],
    np.array(['a']), np.ones(2, bool), range(3))


def draw(rng: np.random.Generator) -> tuple[str, Callable]:
    """Draw a call: its name, and what makes it."""
    maker = (_tracks, _camera, _facts, _image, _compressed, _camera_info, _cloud, _known_object,
             _degenerate)[int(rng.integers(9))]
    return maker.__name__.strip('_'), maker(rng)


def _any(rng: np.random.Generator) -> Any:
    return VALUES[int(rng.integers(len(VALUES)))]


def _some(rng: np.random.Generator, good: Any, share: float = 0.15) -> Any:
    """Return the good value or any other."""
    return _any(rng) if rng.random() < share else good


def _points(rng: np.random.Generator) -> Any:
    """Return positions of points, some of them odd."""
    xy = rng.uniform(0, 500, (40, 2))
    for at in rng.integers(0, 40, int(rng.choice([0, 1, 5]))):
        xy[at, rng.integers(2)] = rng.choice([np.nan, np.inf, 1e300, -1e9, 1e-300])
    return xy


def _tracks(rng):
    frame, track = np.repeat(np.arange(4), 10), np.tile(np.arange(10), 4)
    given = [_some(rng, frame), _some(rng, track), _some(rng, _points(rng)),
             _some(rng, (640, 480))]
    return lambda: calibrate(Tracks(*given))


def _camera(rng):
    K = np.diag([500.0, 500.0, 1.0])
    K[rng.integers(3), rng.integers(3)] = rng.choice([np.nan, np.inf, 0, -1, 1e300, 1e-300])
    given = [_some(rng, K), _some(rng, [0.1] * int(rng.integers(12))), _some(rng, 640),
             _some(rng, 480), _some(rng, str(rng.choice(['plumb_bob', 'equidistant', 'fov'])))]
    points = _points(rng)
    return lambda: Camera(*given).normalised(points)


def _facts(rng):
    names = [field.name for field in fields(CameraFacts)]
    given = {str(name): _any(rng) for name in rng.choice(names, 2, replace=False)}
    return lambda: CameraFacts(**given)


def _count(rng: np.random.Generator, good: int) -> int:
    """Return what a message may have for a whole number without a sign."""
    odd = (0, 1, 3, good + 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1)
    return int(odd[rng.integers(len(odd))]) if rng.random() < 0.3 else good


def _real(rng: np.random.Generator, good: Any) -> np.ndarray:
    """Return numbers of a message, one of which may be any."""
    values = np.array(good, float).ravel()
    if rng.random() < 0.5 and values.size:
        values[rng.integers(values.size)] = rng.choice([np.nan, np.inf, 0, -1, 1e300, 1e-300])
    return values[:rng.integers(values.size + 1)] if rng.random() < 0.1 else values


def _image(rng):
    encoding = str(rng.choice([*SUPPORTED_ENCODINGS, '', 'mono9', '32FC1']))
    message = SimpleNamespace(
        header=None, height=_count(rng, 12), width=_count(rng, 16), encoding=encoding,
        is_bigendian=int(rng.integers(3)),
        step=_count(rng, int(rng.choice([16, 32, 48, 64, 96]))),
        data=rng.integers(0, 256, int(rng.choice([0, 100, 192, 384, 768, 2000])), np.uint8))
    return lambda: (ImageDecoder().grey(message), ImageDecoder().bgr(message))


def _compressed(rng):
    import cv2

    from bench.hostile.hostile_cases import damaged
    image = rng.integers(0, 256, (60, 80, 3), np.uint8)
    good = cv2.imencode(str(rng.choice(['.png', '.jpg', '.bmp', '.tiff', '.pgm', '.webp'])),
                        image[..., 0])[1].tobytes()
    message = SimpleNamespace(header=None, format='jpeg', data=damaged(good, rng)[1])
    return lambda: ImageDecoder().grey(message)


def _camera_info(rng):
    model = str(rng.choice(['plumb_bob', 'rational_polynomial', 'equidistant', '', 'odd']))
    message = SimpleNamespace(
        header=None, width=_count(rng, 640), height=_count(rng, 480), distortion_model=model,
        d=_real(rng, np.zeros(rng.integers(9))),
        k=_real(rng, [500, 0, 320, 0, 500, 240, 0, 0, 1]), r=_real(rng, np.eye(3)),
        p=_real(rng, np.eye(3, 4)), binning_x=_count(rng, 0), binning_y=_count(rng, 0),
        roi=SimpleNamespace(x_offset=_count(rng, 0), y_offset=_count(rng, 0),
                            width=_count(rng, 0), height=_count(rng, 0), do_rectify=False))
    return lambda: camera_from_info(message)


def _cloud(rng):
    layout = [SimpleNamespace(name=str(rng.choice([name, 'q'], p=[0.9, 0.1])),
                              offset=_count(rng, 4 * k),
                              datatype=int(rng.choice([7, 7, 5, 0, 8])), count=_count(rng, 1))
              for k, name in enumerate(('x', 'y', 'id'))]
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=_count(rng, 0)), frame_id=''),
        height=_count(rng, 1), width=_count(rng, 3), fields=layout, is_bigendian=False,
        point_step=_count(rng, 12), row_step=_count(rng, 36),
        data=rng.integers(0, 256, int(rng.choice([36, 0, 35])), np.uint8), is_dense=True)
    return lambda: tracks_from_message(message)


def _known_object(rng):
    frame, track = np.repeat(np.arange(3), 10), np.tile(np.arange(10), 3)
    points = rng.uniform(-1, 1, (10, 3))
    points[rng.integers(10)] = rng.choice([np.nan, 1e300, 0])
    given = (_some(rng, np.arange(10)), _some(rng, points))
    xy = rng.uniform(0, 500, (30, 2))
    return lambda: calibrate_known_object(Tracks(frame, track, xy, (640, 480)),
                                          KnownObject(*given))


def _degenerate(rng):
    """Tracks of few values: points that coincide, lines, views that are equal."""
    frame, track = np.repeat(np.arange(3), 30), np.tile(np.arange(30), 3)
    xy = rng.choice([0.0, 1.0, 1e-300, 1e6, 320.0, 1e-9], (90, 2))
    motion = str(rng.choice(['auto', 'planar', 'translation', 'rotation', 'general']))
    return lambda: calibrate(Tracks(frame, track, xy, (640, 480)), motion=motion)
