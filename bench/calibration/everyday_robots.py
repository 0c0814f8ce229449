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
Scenes and paths of robots, in the simulation of `../shared/world_cases.py`.

Metres, z up. A path gives the rotation of the camera and its centre at a time from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from bench.calibration.suppositions import load_worlds
import numpy as np

#: Rotation (3, 3) of the camera from the world, and its centre (3,).
Pose = tuple[np.ndarray, np.ndarray]
Path = Callable[[float], Pose]


@dataclass(frozen=True)
class Robot:
    """
    What a robot sees, and how it moves.

    Attributes
    ----------
    camera : world_cases.Cam
    scene : (ndarray, ndarray or None)
        Points (P, 3), and normals of the surfaces that they are on.
    path : callable
    views : int
    options : dict
        Of `world_cases.observe`, beside the usual ones.
    stops : bool
        For every image; the path is a list of poses.

    """

    camera: object
    scene: tuple[np.ndarray, np.ndarray | None]
    path: Path
    views: int
    options: dict = field(default_factory=dict)
    stops: bool = False


def _sines(rng: np.random.Generator, axes: int, waves: int, sigma: float,
           ) -> Callable[[float], np.ndarray]:
    """Draw smooth functions of time, shape (axes,), of this standard deviation."""
    size = rng.normal(size=(axes, waves))
    size *= sigma / np.sqrt((size**2).sum(axis=1, keepdims=True) / 2)
    phase = rng.uniform(0, 2 * np.pi, (axes, waves))
    rate = 2 * np.pi * np.arange(1, waves + 1) * rng.uniform(0.6, 1.4, (axes, waves))
    return lambda time: (size * np.sin(rate * time + phase)).sum(axis=1)


def _turned(pose: Pose, by_rad: np.ndarray) -> Pose:
    """Turn the camera in its own frame, by a rotation vector (3,)."""
    return load_worlds().rodrigues(by_rad) @ pose[0], pose[1]


def _driven(heading: np.ndarray, length_m: float, start: tuple[float, float], height_m: float,
            pitch_deg: float, aside_deg: float = 0.0, ahead_m: float = 0.0) -> Path:
    """Drive along headings (n,), evenly spaced; the camera looks aside by so much, and down."""
    time = np.linspace(0, 1, len(heading))
    step = length_m / (len(heading) - 1)
    way = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * step
    way += np.array(start) - way[0]
    pitch, aside = np.radians([pitch_deg, aside_deg])

    def path(at: float) -> Pose:
        yaw, x, y = (np.interp(at, time, axis) for axis in (heading, *way.T))
        place = np.array([x + ahead_m * np.cos(yaw), y + ahead_m * np.sin(yaw), height_m])
        return load_worlds().heading_R(yaw + aside, pitch), place
    return path


def _winding(rng: np.random.Generator, sigma_deg: float, waves: int = 3) -> np.ndarray:
    """Draw headings (1001,) of a winding drive."""
    course = _sines(rng, 1, waves, np.radians(sigma_deg))
    return np.array([course(time)[0] for time in np.linspace(0, 1, 1001)])


def _looking_at(centre: np.ndarray, target: np.ndarray, roll_rad: float = 0.0) -> Pose:
    """Look at a target, with the x axis of the image level."""
    ahead = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(ahead, right), ahead])
    return load_worlds().rodrigues([0, 0, roll_rad]) @ R, centre


def _small(rng: np.random.Generator, low_px: float = 400.0, high_px: float = 700.0) -> object:
    """Draw a camera of 640x480 pixels."""
    return load_worlds().Cam(
        f=rng.uniform(low_px, high_px), cx=320 + rng.normal(0, 8), cy=240 + rng.normal(0, 8),
        d=(rng.normal(-0.14, 0.07), rng.normal(0.04, 0.03), *rng.normal(0, 4e-4, 2), 0))


def _large(rng: np.random.Generator, low_px: float, high_px: float, height: int = 960) -> object:
    """Draw a camera of 1280 pixels by so many."""
    return load_worlds().Cam(
        f=rng.uniform(low_px, high_px), cx=640 + rng.normal(0, 12), w=1280, h=height,
        cy=height / 2 + rng.normal(0, 12),
        d=(rng.normal(-0.07, 0.05), rng.normal(0.03, 0.03), *rng.normal(0, 4e-4, 2), 0))


def _hall(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return load_worlds().room(rng, n=6000, L=10, W=8)


def _terrain(rng: np.random.Generator, relief_m: float) -> tuple[np.ndarray, None]:
    """Hills of a metre, and sixty buildings."""
    xy = rng.uniform(-30, 230, (9000, 2))
    z = np.sin(xy[:, 0] / 23) + np.cos(xy[:, 1] / 31) + rng.normal(0, 0.1, len(xy))
    for _ in range(60):
        inside = (np.abs(xy - rng.uniform(-20, 220, 2)) < rng.uniform(3, 9)).all(axis=1)
        z[inside] += relief_m * rng.uniform(0.3, 1)
    return np.column_stack([xy, z]), None


def _surfaces(rng: np.random.Generator, patches: list[tuple]) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals on patches: corner, two sides, number of points."""
    points, normals = zip(*(load_worlds().surf(rng, *patch) for patch in patches))
    return np.concatenate(points), np.concatenate(normals)


def _boxes(corner: tuple, size: np.ndarray, count: int) -> list[tuple]:
    """List the four sides and the top of a box."""
    (x, y, z), (a, b, c) = corner, size
    return [((x, y, z + c), (a, 0, 0), (0, b, 0), count), ((x, y, z), (a, 0, 0), (0, 0, c), count),
            ((x, y, z), (0, b, 0), (0, 0, c), count), ((x + a, y, z), (0, b, 0), (0, 0, c), count),
            ((x, y + b, z), (a, 0, 0), (0, 0, c), count)]


def _part(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Six boxes on a table of a metre."""
    patches = [((-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0), 800)]
    for _ in range(6):
        patches += _boxes((*rng.uniform(-0.25, 0.25, 2), 0), rng.uniform(0.05, 0.2, 3), 120)
    return _surfaces(rng, patches)


def _crossing(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two streets with houses and parked cars."""
    patches = [((-60, -6, 0), (200, 0, 0), (0, 12, 0), 2500),
               ((34, -100, 0), (0, 200, 0), (12, 0, 0), 2500)]
    for at in range(-60, 140, 8):
        if at + 8 < 28 or at > 52:
            patches += [((at, side * (9 + rng.uniform(0, 3)), 0), (7, 0, 0),
                         (0, 0, rng.uniform(5, 12)), 140) for side in (-1, 1)]
    for at in range(-100, 100, 8):
        if at + 8 < -10 or at > 10:
            patches += [((40 + side * (9 + rng.uniform(0, 3)), at, 0), (0, 7, 0),
                         (0, 0, rng.uniform(5, 12)), 140) for side in (-1, 1)]
    for _ in range(25):
        corner = rng.uniform(-50, 130), rng.choice([-5, 5]), 0
        patches.append((corner, (4, 0, 0), (0, 0, 1.5), 60))
    return _surfaces(rng, patches)


# ------------------------------------------------------------------ in the air

def drone_down(rng: np.random.Generator) -> Robot:
    """Fly four strips over buildings, straight down; it turns at the ends."""
    shake = _sines(rng, 3, 6, np.radians(3))

    def path(time: float) -> Pose:
        strip = min(int(4 * time), 3)
        along, back = 4 * time - strip, strip % 2
        place = np.array([40 + 90 * (1 - along if back else along), 40 + 16 * strip, 45.0])
        return _turned((load_worlds().heading_R(np.pi * back, np.radians(89.9)), place),
                       shake(time))
    return Robot(_large(rng, 850, 1300), _terrain(rng, 8.0), path, int(rng.integers(32, 48)),
                 {'dmax': 200})


def drone_round(rng: np.random.Generator) -> Robot:
    """Fly round a place and look at it."""
    turn, radius, height = np.radians(rng.uniform(120, 360)), *rng.uniform([30, 25], [50, 45])
    shake, middle = _sines(rng, 3, 5, np.radians(3)), np.array([100.0, 100.0, 0.0])

    def path(time: float) -> Pose:
        at = turn * time
        offset = [radius * np.cos(at), radius * np.sin(at), height + 4 * np.sin(5 * time)]
        return _turned(_looking_at(middle + offset, middle), shake(time))
    return Robot(_large(rng, 850, 1300), _terrain(rng, 8.0), path, int(rng.integers(20, 40)),
                 {'dmax': 300})


# ------------------------------------------------------------------ arms and hands

def arm_round(rng: np.random.Generator) -> Robot:
    """Look at a part from stations on a hemisphere; some images at each."""
    stations, images = int(rng.integers(10, 20)), int(rng.integers(1, 4))
    poses = []
    for k in range(stations):
        up, round_ = np.radians(rng.uniform(40, 85)), 2 * np.pi * k / stations + rng.normal(0, 0.2)
        away = rng.uniform(0.5, 0.8) * np.array([
            np.cos(round_) * np.cos(up), np.sin(round_) * np.cos(up), np.sin(up)])
        poses += [_looking_at(away, rng.normal(0, 0.05, 3) * [1, 1, 0],
                              rng.uniform(-0.6, 0.6))] * images
    return Robot(_large(rng, 700, 1400, 1024), _part(rng),
                 lambda time: poses[int(round(time * (len(poses) - 1)))], len(poses),
                 {'dmax': 3, 'hazard': 0.12}, stops=True)


def arm_shifted(rng: np.random.Generator) -> Robot:
    """Shift the camera over a part without turning it: nothing to calibrate from."""
    down, place = _looking_at(np.array([0, 0.02, 0.6]), np.zeros(3)), np.array([-0.15, -0.15, 0.6])
    shake = np.radians(0.02) * rng.normal(size=(16, 3))

    def path(time: float) -> Pose:
        k = int(round(15 * time))
        return _turned((down[0], place + [0.1 * (k % 4), 0.1 * (k // 4), 0]), shake[k])
    return Robot(_large(rng, 700, 1400, 1024), _part(rng), path, 16, {'dmax': 3}, stops=True)


def object_round(rng: np.random.Generator) -> Robot:
    """Carry the camera round an object."""
    turn, rise = np.radians(rng.uniform(60, 360)), _sines(rng, 1, 3, 0.12)
    shake, up = _sines(rng, 3, 4, np.radians(3)), rng.uniform(0.3, 0.7)

    def path(time: float) -> Pose:
        at, high = turn * time, up + rise(time)[0]
        away = 0.75 * np.array([np.cos(at) * np.cos(high), np.sin(at) * np.cos(high),
                                np.sin(high)])
        return _turned(_looking_at(away, np.array([0, 0, 0.05])), shake(time))
    return Robot(_small(rng), _part(rng), path, int(rng.integers(20, 40)), {'dmax': 3})


def hand_rests(rng: np.random.Generator) -> Robot:
    """Move by hand, and rest for a fifth to a half of the time."""
    hand = load_worlds().General(rng, rot=rng.uniform(12, 25), trans=rng.uniform(0.3, 0.7))
    begin, rest = rng.uniform(0.1, 0.6), rng.uniform(0.2, 0.5)
    shake, sway = _sines(rng, 3, 20, np.radians(rng.uniform(0.05, 0.6))), _sines(
        rng, 3, 20, rng.uniform(2e-4, 4e-3))

    def path(time: float) -> Pose:
        moved = time / (1 - rest)
        moved = moved if moved < begin else max(begin, (time - rest) / (1 - rest))
        R, centre = hand(min(moved, 1.0))
        return _turned((R, np.array([5, 1.5, 1.3]) + centre + sway(time)), shake(time))
    return Robot(_small(rng), _hall(rng), path, int(rng.integers(24, 44)), {'hazard': 0.12})


# ------------------------------------------------------------------ on the ground

def car(rng: np.random.Generator) -> Robot:
    """Turn off at a crossing; an image of 1280x400 pixels that is cut at the top."""
    radius, before, after = rng.uniform([6, 15, 15], [10, 25, 25])
    arc = radius * np.pi / 2
    length = before + arc + after
    heading = rng.choice([-1, 1]) * np.clip(
        (np.linspace(0, length, 1001) - before) / radius, 0, np.pi / 2)
    drive = _driven(heading, length, (40 - radius - before, 0.0), 1.6, 1.0)
    shake = _sines(rng, 3, 9, np.radians(0.4))
    return Robot(_large(rng, 600, 1000, 400), _crossing(rng),
                 lambda time: _turned(drive(time), shake(time)), int(rng.integers(28, 45)),
                 {'dmax': 60})


def looks_aside(rng: np.random.Generator) -> Robot:
    """Drive with a camera that looks to one side."""
    return Robot(_small(rng), _hall(rng), _driven(
        _winding(rng, rng.uniform(15, 35)), 4.5, (2.5, 4.0), 0.7, rng.uniform(0, 15),
        aside_deg=rng.choice([-1, 1]) * rng.uniform(70, 110)), int(rng.integers(20, 36)))


def looks_down(rng: np.random.Generator) -> Robot:
    """Drive with a camera that sees little but the floor."""
    return Robot(_small(rng, 330, 430), _hall(rng), _driven(
        _winding(rng, rng.uniform(20, 40)), 3.0, (2.5, 4.0), 1.0, rng.uniform(40, 60)),
        int(rng.integers(20, 36)))


def looks_up(rng: np.random.Generator) -> Robot:
    """Drive with a camera that looks at a ceiling with beams and lamps, nearly straight up."""
    xy = rng.uniform(-4, 16, (6000, 2))
    z = 3.5 - 0.4 * (np.abs(xy[:, 0] % 2 - 1) < 0.25) - 0.7 * (np.abs(xy[:, 1] % 3 - 1.5) < 0.3)
    scene = np.column_stack([xy, z + rng.normal(0, 0.02, len(xy))]), None
    drive = _driven(_winding(rng, rng.uniform(20, 50)), 4.0, (3.0, 5.0), 0.4, -89.9)
    tilt = np.radians(6) * rng.normal(size=3)
    return Robot(_small(rng, 330, 430), scene, lambda time: _turned(drive(time), tilt),
                 int(rng.integers(20, 36)))


def legged(rng: np.random.Generator) -> Robot:
    """Walk: pitch, yaw and roll swing with every step, and so does the height."""
    drive = _driven(_winding(rng, rng.uniform(20, 40)), 3.5, (2.5, 4.0), 0.5, 12.0)
    rate, swing = rng.uniform(75, 125), np.radians(rng.uniform(1.5, 4, 3))

    def path(time: float) -> Pose:
        R, centre = _turned(drive(time), swing * np.sin(rate * time * np.array([2, 1, 1])))
        return R, centre + [0, 0.03 * np.sin(rate * time), 0.03 * np.sin(2 * rate * time)]
    return Robot(_small(rng, 330, 430), _hall(rng), path, int(rng.integers(20, 36)))


def stops_often(rng: np.random.Generator) -> Robot:
    """Drive, and stand as long in three to five places."""
    drive = _driven(_winding(rng, rng.uniform(20, 40)), 3.4, (2.5, 4.0), 0.6, 17.0)
    stops = np.sort(rng.uniform(0, 1, rng.integers(3, 6)))
    length = 0.5 / len(stops)
    begin = 0.5 * stops + length * np.arange(len(stops))
    known = np.column_stack([begin, begin + length]).ravel()
    driven = np.repeat(stops, 2)
    return Robot(_small(rng), _hall(rng), lambda time: drive(
        float(np.interp(time, [0, *known, 1], [0, *driven, 1]))), int(rng.integers(30, 50)),
        {'hazard': 0.12})


def back_and_forth(rng: np.random.Generator) -> Robot:
    """Manoeuvre: forward and back, and turn meanwhile."""
    turns = np.radians(rng.uniform(20, 60, 5)) * [-1, -1, 1, 1, -1]
    heading = rng.uniform(-1, 1) + np.interp(np.linspace(0, 5, 1001), np.arange(6),
                                             np.append(0, np.cumsum(turns)))
    lengths = np.repeat(rng.uniform(0.8, 1.6, 5) * [1, -1, 1, -1, 1], 200) / 200
    way = np.array([4.0, 4.0]) + np.cumsum(lengths[:, None] * np.column_stack(
        [np.cos(heading[1:]), np.sin(heading[1:])]), axis=0)
    shake, time = _sines(rng, 3, 8, np.radians(0.1)), np.linspace(0, 1, 1000)

    def path(at: float) -> Pose:
        yaw, x, y = (np.interp(at, time, axis) for axis in (heading[1:], *way.T))
        return _turned((load_worlds().heading_R(yaw, 0.25), np.array([x, y, 0.6])), shake(at))
    return Robot(_small(rng), _hall(rng), path, int(rng.integers(22, 40)))


def head_on_vehicle(rng: np.random.Generator) -> Robot:
    """Drive, and move a head whose axes miss the camera by 3 to 12 cm."""
    drive = _driven(_winding(rng, rng.uniform(10, 30)), 3.0, (2.5, 4.0), 1.2, 0.0)
    head, lever = _sines(rng, 3, 4, np.radians(12)), rng.uniform(0.03, 0.12)

    def path(time: float) -> Pose:
        R, centre = _turned(drive(time), head(time) * [0.5, 1, 0])
        return R, centre + lever * R[2]
    return Robot(_small(rng), _hall(rng), path, int(rng.integers(22, 40)))


def corridor(rng: np.random.Generator) -> Robot:
    """Drive along a corridor, and hardly turn."""
    return Robot(_small(rng), load_worlds().room(rng, n=9000, L=40, W=2.4, boxes=0), _driven(
        _winding(rng, rng.uniform(3, 6), 4), rng.uniform(6, 9), (2.0, 1.2), 1.0, 3.0),
        int(rng.integers(25, 45)), {'dmax': 15})


def mower(rng: np.random.Generator) -> Robot:
    """Drive on a rough lawn; trees stand 30 to 150 m away."""
    lawn = np.column_stack([rng.uniform([-20, -25], [40, 25], (5000, 2)),
                            np.abs(rng.normal(0, 0.03, 5000))])
    away, round_ = rng.uniform(30, 150, 2500), rng.uniform(0, 2 * np.pi, 2500)
    trees = np.column_stack([10 + away * np.cos(round_), away * np.sin(round_),
                             rng.uniform(0, 12, 2500)])
    drive, shake = _driven(_winding(rng, rng.uniform(20, 40)), 8.0, (0, 0), 0.4, 7.0), _sines(
        rng, 3, 12, np.radians(0.8))
    return Robot(_small(rng, 330, 430), (np.concatenate([lawn, trees]), None),
                 lambda time: _turned(drive(time), shake(time)), int(rng.integers(25, 45)),
                 {'dmax': 160})


# ------------------------------------------------------------------ under water

def under_water(rng: np.random.Generator) -> Robot:
    """Dive with a camera behind a flat port, which bends outward, before what is near."""
    camera = load_worlds().Cam(
        f=rng.uniform(600, 900), cx=480 + rng.normal(0, 10), cy=270 + rng.normal(0, 10), w=960,
        h=540, d=(rng.uniform(0.1, 0.35), rng.uniform(0, 0.3), *rng.normal(0, 6e-4, 2), 0))
    path = load_worlds().General(rng, rot=rng.uniform(8, 20), trans=rng.uniform(0.5, 1.0))
    return Robot(camera, load_worlds().cloud(rng, 2500, c=(0, 4, 0), s=(4, 3, 2)), path,
                 int(rng.integers(18, 34)), {'dmax': 6})


ROBOTS: dict[str, Callable[[np.random.Generator], Robot]] = {
    'drone, straight down': drone_down, 'drone round a place': drone_round,
    'arm round a part': arm_round, 'arm that only shifts': arm_shifted,
    'round an object': object_round, 'hand that rests': hand_rests, 'car at a crossing': car,
    'vehicle, looks aside': looks_aside, 'looks down': looks_down, 'looks up': looks_up,
    'legged': legged, 'stops often': stops_often, 'back and forth': back_and_forth,
    'head on a vehicle': head_on_vehicle, 'corridor': corridor, 'mower in a field': mower,
    'under water': under_water}
