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
Days that are bad in other ways than those of `../shared/world_cases.py`, in its own world.

What happens to images and tracks on the way: pixels that are whole numbers, a stabilised lens,
points that change their names, torn images, some that are turned. Cameras that only turn, the
upright video of a phone, lenses that are stated wrong, and two troubles at once. Every case is
counted by how far K is off in its own sigmas, and whether that was said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product

from bench.calibration.suppositions import load_worlds, MAX_SIGMAS
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, Calibration, CameraFacts, NotCalibrated, Tracks

SQUARE = {'aspect_ratio': 1.0, 'skew': 0.0}
#: Findings beside which a K that is far off does not count as silent.
WARNINGS = ('fact_contradicted', 'fact_contradicted_too', 'fact_doubtful', 'fact_unchecked',
            'focal_varies', 'focal_drifts', 'two_cameras', 'other_camera_left_out')
#: Refusals that need no excuse: what is supposed does not hold, or nothing can be told.
JUSTIFIED = ('fact_contradicted', 'two_cameras', 'images_mirrored', 'only_a_hint')


@dataclass(frozen=True)
class World:
    """
    The tracks of a day, and what is true.

    Attributes
    ----------
    frame, track : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
    size : (int, int)
    truth : ndarray, shape (4,)
        fx, fy, cx, cy.

    """

    frame: np.ndarray
    track: np.ndarray
    xy: np.ndarray
    size: tuple[int, int]
    truth: np.ndarray

    @classmethod
    def of(cls, case: dict) -> World:
        """Take what `world_cases.build` returns."""
        return cls(case['F'], case['T'], case['XY'], tuple(case['size']), case['truth'][:4])

    def calibrated(self, facts: dict) -> Calibration | NotCalibrated:
        """Calibrate from the tracks."""
        return calibrate(Tracks(self.frame, self.track, self.xy, self.size),
                         facts=CameraFacts(**facts))

    def away(self, result: Calibration) -> float:
        """Return the largest deviation of K from the truth, in stated sigmas."""
        sigma = np.array([result.sigma[one] for one in ('fx', 'fy', 'cx', 'cy')])
        return float(np.max(np.abs(result.camera.parameters[:4] - self.truth)
                            / np.maximum(sigma, 1e-12)))


@dataclass(frozen=True)
class Day:
    """
    One way for a day to be bad.

    Attributes
    ----------
    change : callable, optional
        (world, rng) -> world.
    world : dict
        Of `world_cases.cond`, in place of a plain drive or hand.
    facts : dict
        Beside square pixels.
    name : str
        Of a world of `world_cases`, behind 'agv_' or 'gen_'.

    """

    change: Callable | None = None
    world: dict = field(default_factory=dict)
    facts: dict = field(default_factory=dict)
    name: str = 'base'


def stabilised(sigma_px: float) -> Callable:
    """Shift every image by itself, as a lens that is stabilised does."""
    def change(world: World, rng: np.random.Generator) -> World:
        shift = rng.normal(0, sigma_px, (world.frame.max() + 1, 2))
        return replace(world, xy=world.xy + shift[world.frame])
    return change


def rounded(step_px: float) -> Callable:
    """Round positions."""
    return lambda world, rng: replace(world, xy=np.round(world.xy / step_px) * step_px)


def of_levels(world: World, rng: np.random.Generator) -> World:
    """Take positions from the levels of a pyramid, each coarser by 1.4."""
    level = rng.integers(0, 5, world.track.max() + 1)[world.track]
    noise = rng.normal(0, 0.3, world.xy.shape) * 1.4**level[:, None]
    return replace(world, xy=world.xy + noise)


def mistaken(share: float) -> Callable:
    """Let pairs of tracks go on as each other."""
    def change(world: World, rng: np.random.Generator) -> World:
        track = world.track.copy()
        for a, b in rng.integers(0, track.max() + 1, (int(share * track.max() / 2), 2)):
            of_a, of_b = track == a, track == b
            common = np.intersect1d(world.frame[of_a], world.frame[of_b])
            if a != b and len(common) > 1:
                late = world.frame >= common[len(common) // 2]
                track[of_a & late], track[of_b & late] = b, a
        return replace(world, track=track)
    return change


def beside_own_body(share: float) -> Callable:
    """Let points of the robot itself stand in the lower part of the image."""
    def change(world: World, rng: np.random.Generator) -> World:
        views = world.frame.max() + 1
        count = int(len(world.frame) / views * share / (1 - share))
        place = rng.uniform([5, 0.65 * world.size[1]], np.array(world.size) - 5, (count, 2))
        xy = np.tile(place, (views, 1)) + rng.normal(0, 0.2, (count * views, 2))
        return replace(world, frame=np.r_[world.frame, np.repeat(np.arange(views), count)],
                       track=np.r_[world.track, np.tile(np.arange(count), views)
                                   + world.track.max() + 1], xy=np.r_[world.xy, xy])
    return change


def drifting(step_px: float) -> Callable:
    """Let every track walk at random from where it began."""
    def change(world: World, rng: np.random.Generator) -> World:
        order = np.lexsort((world.frame, world.track))
        track = world.track[order]
        begins = np.r_[True, track[1:] != track[:-1]]
        walk = np.cumsum(np.where(begins[:, None], 0, rng.normal(0, step_px, world.xy.shape)), 0)
        walk -= walk[begins][np.cumsum(begins) - 1]
        xy = world.xy.copy()
        xy[order] += walk
        return replace(world, xy=xy)
    return change


def bumpy(size_px: float) -> Callable:
    """Give the lens bumps that no model has."""
    def change(world: World, rng: np.random.Generator) -> World:
        centre = rng.uniform(0, 1, (12, 2)) * world.size
        near = np.exp(-((world.xy[:, None] - centre)**2).sum(2) / 2 / 80**2)
        return replace(world, xy=world.xy + near @ rng.normal(0, size_px, (12, 2)))
    return change


def in_some_images(count: int, altered: Callable) -> Callable:
    """Do something to the positions in some of the images; altered(xy, size) -> xy."""
    def change(world: World, rng: np.random.Generator) -> World:
        views = rng.choice(np.arange(1, world.frame.max()), count, replace=False)
        rows = np.isin(world.frame, views)
        xy = world.xy.copy()
        xy[rows] = altered(xy[rows], world.size)
        return replace(world, xy=xy)
    return change


def torn(xy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Shift all that lies below row 200, as where a packet was lost."""
    return xy + np.where(xy[:, 1:] > 200, [37.0, 0.0], 0.0)


def turned_over(xy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Turn an image by half a turn."""
    return np.array(size) - 1 - xy


def upright(world: World, rng: np.random.Generator) -> World:
    """Turn all images by 90 degrees, so that what was a row is a column."""
    width, height = world.size
    fx, fy, cx, cy = world.truth
    return replace(world, xy=np.column_stack([world.xy[:, 1], width - 1 - world.xy[:, 0]]),
                   size=(height, width), truth=np.array([fy, fx, cy, width - 1 - cx]))


@lru_cache(maxsize=1)
def days() -> dict[str, Day]:
    """All bad days by name; none where the worlds are not at hand."""
    cases = load_worlds()
    if cases is None:
        return {}
    rolling = {'rs': 0.02, 'path': {'T': 6.8}}
    fisheye = cases.Cam(f=330, kb=(-0.02, 0.003, 0, 0))
    decentred = cases.Cam(d=(-0.12, 0.05, 0.003, 0.003, 0))

    def turns(rng: np.random.Generator) -> object:
        """Turn about the camera's own centre."""
        hand = cases.General(rng, rot=20.0, trans=0.0)
        return cases.Fn(lambda time: (hand(time)[0], np.array([4.0, 1.5, 1.2])), 6.0)

    def zooming(time: float) -> float:
        return 1 + 0.03 * (2 * time - 1)

    def turns_then_drives(lever_m: float, turn_deg: float) -> Callable:
        """Turn on the spot, the camera so far ahead of the axle; then drive on a curve."""
        def forward(heading: float) -> np.ndarray:
            return cases.heading_R(heading, 0.0)[2]

        def path(rng: np.random.Generator) -> object:
            first = rng.uniform(-3, 3) + np.radians(turn_deg)
            place = np.array([3.0, 2.0, 0.6]) + [*rng.uniform(-0.6, 0.6, 2), 0.0]

            def pose(time: float) -> tuple[np.ndarray, np.ndarray]:
                turned, driven = min(2 * time - 1, 0.0), max(2 * time - 1, 0.0)
                heading = first + turned * np.radians(turn_deg) + driven
                way = np.mean([forward(first + share * driven)
                               for share in np.linspace(0, 1, 20)], axis=0)
                return (cases.heading_R(heading, 0.3),
                        place + 2 * driven * way + lever_m * forward(heading))
            return cases.Fn(pose)
        return path

    def turns_then_moves(lever_m: float) -> Callable:
        """Turn by hand about a wrist so far behind the camera; then move freely."""
        def path(rng: np.random.Generator) -> object:
            hand, place = cases.General(rng, rot=20.0, trans=0.5), np.array([4.0, 1.5, 1.2])
            R_then, then = hand(0.5)

            def pose(time: float) -> tuple[np.ndarray, np.ndarray]:
                R, centre = hand(time)
                if time < 0.5:
                    return R, place + lever_m * (R[2] - R_then[2])
                return R, place + centre - then
            return cases.Fn(pose)
        return path

    turning = {'base': 'fn', 'mkpath': turns}
    return {
        **{f'stabilised by {s} px': Day(stabilised(s)) for s in (0.5, 1.5, 5.0)},
        'stabilised by 3 px, read in 20 ms': Day(stabilised(3.0), rolling),
        'only turns, stabilised by 3 px': Day(stabilised(3.0), turning),
        'whole pixels': Day(rounded(1.0)), 'half pixels': Day(rounded(0.5)),
        'levels of a pyramid': Day(of_levels),
        '10 % mistaken': Day(mistaken(0.1)), '30 % mistaken': Day(mistaken(0.3)),
        'own body 15 %': Day(beside_own_body(0.15)), 'own body 30 %': Day(beside_own_body(0.3)),
        'tracks that walk 0.1 px': Day(drifting(0.1)), '0.3 px': Day(drifting(0.3)),
        'bumps of 0.5 px': Day(bumpy(0.5)),
        'three images torn': Day(in_some_images(3, torn)),
        'five images torn': Day(in_some_images(5, torn)),
        'one image turned over': Day(in_some_images(1, turned_over)),
        'three images cut elsewhere': Day(in_some_images(3, lambda xy, size: xy + [8.0, -5.0])),
        'columns read in 20 ms': Day(upright, rolling),
        'columns read in 33 ms': Day(upright, {**rolling, 'rs': 0.033}),
        'only turns': Day(world=turning),
        **{f'only turns, read in {ms} ms': Day(world={**turning, 'rs': ms * 1e-3})
           for ms in (8, 20, 33)},
        'only turns, columns in 20 ms': Day(upright, {**turning, 'rs': 0.02}),
        **{f'turns by {deg}°, {round(100 * lever)} cm off, then drives': Day(
            world={'base': 'fn', 'mkpath': turns_then_drives(lever, deg)})
           for deg, lever in ((60, 0.02), (90, 0.05), (180, 0.02), (180, 0.1))},
        **{f'turns {round(100 * lever)} cm off, then moves': Day(
            world={'base': 'fn', 'mkpath': turns_then_moves(lever)}) for lever in (0.02, 0.05)},
        'only turns, two cameras': Day(name='mix2_f2', world=turning),
        'radial1 stated': Day(facts={'distortion': 'radial1'}),
        'fisheye, plumb_bob stated': Day(world={'cam': fisheye},
                                         facts={'distortion': 'plumb_bob'}),
        'nothing stated': Day(facts={'aspect_ratio': None, 'skew': None}),
        'rolling and zooming': Day(world={**rolling, 'fs': zooming}),
        'rolling and decentred': Day(world={**rolling, 'cam': decentred}),
        'rolling and patches that drift': Day(world={**rolling, 'bias': 0.2}),
        'zooming fisheye': Day(world={'cam': fisheye, 'fs': zooming}),
        'fisheye and few points': Day(world={'cam': fisheye, 'per_view': 30}),
        'fisheye and a pattern': Day(world={'cam': fisheye, 'alias': (0.2, 0.25, False)}),
        'decentred and five views': Day(world={'cam': decentred, 'n': 5}),
    }


def one_run(task: tuple) -> tuple[str, float, tuple[str, ...]]:
    """Calibrate once; the task is (name, 'agv' or 'gen', seed). Kind, distance and findings."""
    name, base, seed = task
    day, cases = days()[name], load_worlds()
    built = f'{base}_{day.name}'
    known = dict(cases.C[built])
    cases.C[name] = {**known, **({} if 'base' in day.world else {'base': base}), **day.world}
    world = World.of(cases.build(name, seed))
    if day.change is not None:
        world = day.change(world, np.random.default_rng([seed, 17]))
    result = world.calibrated({**SQUARE, **day.facts})
    found = tuple(one.kind for one in result.findings)
    if not result:
        return result.kind, np.nan, found
    return '', world.away(result), found


def run(report: Report, options) -> None:
    """Print one line a day."""
    seeds = range(20001, 20001 + (options.runs or 10))
    report.section(f'Bad days beside the shared ones, {len(seeds)} seeds each',
                   f'silent: K beyond {MAX_SIGMAS:g} sigmas, and nothing said that is about K. '
                   'Zooms have no single truth, and do not count.')
    if not days():
        report.say('left out: ../shared/world_cases.py is not there')
        return
    every = [task for task in product(days(), ('agv', 'gen'), seeds)
             if not (task[1] == 'agv' and 'base' in days()[task[0]].world)]
    outcome = dict(zip(every, run_seeds(one_run, every, options.processes)))
    rows, silent, needless = [], 0, 0
    for name in days():
        results = [outcome[task] for task in every if task[0] == name]
        away = np.array([one[1] for one in results])
        refused = [one[0] for one in results if one[0]]
        wrong = [bool(one[1] > MAX_SIGMAS and not set(one[2]) & set(WARNINGS)
                      and 'zoom' not in name) for one in results]
        silent += sum(wrong)
        needless += sum(kind not in JUSTIFIED for kind in refused)
        rows.append((name, len(results), len(refused), ', '.join(sorted(set(refused))) or '-',
                     f'{np.nanmax(away, initial=0):.1f}', sum(wrong)))
    report.table(('day', 'runs', 'refused', 'as', 'worst, sigmas', 'silent'), rows)
    report.verdict('silent', silent, 0)
    report.verdict('needless refusals', 100 * needless / len(every), 3, '%')
