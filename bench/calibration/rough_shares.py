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
Are the stated sigmas true where the laboratory ends? 1000 runs a world, in the independent rooms.

Rows read in turn, a zoom, a head whose centre is not the camera's, uneven ground, an aspect ratio
stated with a sigma; in every run another measured lens. The share of runs with the true fx, cx, cy
inside the stated ellipsoids. Each run is kept in a folder by `--cache FOLDER`, and the table is
made of all that lie there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product

from bench.calibration.coverage import ALLOWED, SHARES, shares
from bench.calibration.further_worlds import SQUARE
from bench.calibration.suppositions import load_worlds, MAX_SIGMAS
from bench.lenses.lens_runs import draw_camera
from bench.monte_carlo import kept_runs
from bench.tables import Report
import numpy as np
from selfcal_ros import calibrate, CameraFacts, Tracks

VIEWS, PER_VIEW = 14, 70
NAMES = ('fx', 'cx', 'cy')
#: Focal length at the end over that at the beginning.
ZOOM = 1.1
ASPECT_SIGMA = 0.005


@dataclass(frozen=True)
class Trouble:
    """
    What is not as in the laboratory.

    Attributes
    ----------
    world : dict
        Of `world_cases.cond`.
    facts : dict
        Beside square pixels.
    aspect_sigma : float
        Spread of the camera's aspect ratio about the stated 1.
    readout_ms : float
    zooms : bool

    """

    world: dict
    facts: dict = field(default_factory=dict)
    aspect_sigma: float = 0.0
    readout_ms: float = 0.0
    zooms: bool = False


def _zooming(time: float) -> float:
    return ZOOM**(time - 0.5)


@lru_cache(maxsize=1)
def troubles() -> dict[str, Trouble]:
    """Return all worlds by name; none where the independent simulation is not at hand."""
    cases = load_worlds()
    if cases is None:
        return {}
    drive, hand = {'path': {'T': 6.8}}, {'base': 'gen', 'path': {'T': 6.0}}
    head = {'base': 'fn', 'mkpath': cases.ptu(0.08, 20.0)}
    found = {}
    for name, world in (('drive', drive), ('hand', hand)):
        for ms in (5, 15, 33):
            found[f'{name}, read in {ms} ms'] = Trouble({**world, 'rs': 1e-3 * ms}, readout_ms=ms)
        found[f'{name}, zoom of 10 %'] = Trouble({**world, 'fs': _zooming}, zooms=True)
        found[f'{name}, aspect ratio ± {ASPECT_SIGMA}'] = Trouble(
            world, {'aspect_ratio_sigma': ASPECT_SIGMA}, ASPECT_SIGMA)
    # tilts in degrees, and how long they last as a share of the drive
    for name, lasts in (('bumps', 0.004), ('slow waves', 0.1)):
        found[f'drive, {name}'] = Trouble({'path': {'wob': 0.8, 'wobtau': lasts}})
    return {**found, 'head, lever of 8 cm': Trouble(head)}


def one_run(task: tuple) -> dict:
    """
    Calibrate once; the task is (name of the world, seed).

    Returns
    -------
    dict
        `refused`, the kind of the refusal, or '' with `error` and `covariance` of fx, cx, cy.
        Where rows are found to be read in turn there are `readout_ms`, `readout_sigma_ms`. Of a
        zoom fx is the geometric mean over the views.

    """
    name, seed = task
    trouble, cases = troubles()[name], load_worlds()
    rng = np.random.default_rng([seed, 23])
    ratio, drawn = 1 + trouble.aspect_sigma * rng.standard_normal(), draw_camera(rng, 'plumb_bob')
    camera = cases.Cam(drawn.K[0, 0], ratio, *drawn.K[:2, 2], d=tuple(drawn.distortion))
    cases.C[name] = {'n': VIEWS, 'per_view': PER_VIEW, 'cam': camera, **trouble.world}
    case = cases.build(name, seed)
    result = calibrate(Tracks(case['F'], case['T'], case['XY'], tuple(case['size'])),
                       facts=CameraFacts(**{**SQUARE, **trouble.facts}))
    if not result:
        return {'refused': result.kind}
    truth = np.array(case['truth'], float)[[0, 2, 3]]
    if trouble.zooms:
        truth[0] *= np.exp(np.mean(np.log([
            _zooming(frame / (VIEWS - 1)) for frame in result.frames])))
    places = [result.parameter_names.index(one) for one in NAMES]
    fields = {'refused': '', 'error': result.camera.parameters[places] - truth,
              'covariance': result.covariance[np.ix_(places, places)],
              'findings': [one.kind for one in result.findings]}
    if result.shutter is not None:
        between_ms = 1e3 * trouble.world.get('path', {}).get('T', 10.0) / (VIEWS - 1)
        fields |= {'readout_ms': between_ms * result.shutter.intervals,
                   'readout_sigma_ms': between_ms * result.shutter.intervals_sigma}
    return fields


def run(report: Report, options) -> None:
    """Print one line a world."""
    runs = options.runs or 1000
    report.section('Shares of runs with the true fx, cx, cy inside the stated ellipsoids, in the '
                   f'independent worlds ({runs} each)', f'{VIEWS} views of {PER_VIEW} tracks.')
    if not troubles():
        report.say('left out: ../shared/world_cases.py is not there')
        return
    # seeds outermost: what is interrupted has as many runs of each
    tasks = [(name, seed) for seed, name in product(range(runs), troubles())]
    found = kept_runs(one_run, tasks, options.cache, options.processes)
    rows = [row(report, name, [one for task, one in found.items() if task[0] == name])
            for name in troubles()]
    report.table(('world', 'runs', 'refused', *(f'{share:.2f}' for share in SHARES),
                  'rms of z: fx', 'cx', 'cy', 'worst z', f'beyond {MAX_SIGMAS:g}',
                  'readout ms', 'in its sigmas: mean', 'rms'), rows)


def row(report: Report, name: str, results: list[dict]) -> tuple:
    """Return a line of the table, and judge it; the bar is widened for fewer than 1000 runs."""
    done = [one for one in results if not one['refused']]
    estimates = [(np.array(one['error']), np.array(one['covariance'])) for one in done]
    held = shares(estimates)
    z = np.array([error / np.sqrt(np.diag(covariance)) for error, covariance in estimates])
    report.verdict(f'{name}: largest distance from the shares',
                   float(np.abs(held - SHARES).max()), ALLOWED if len(done) >= 1000 else
                   round(ALLOWED + 3 * float(np.sqrt(0.24 / len(done))), 3))
    readouts = np.array([(one['readout_ms'], one['readout_sigma_ms'])
                         for one in done if 'readout_ms' in one])
    late = ('-', '-', '-')
    if len(readouts) > len(done) / 2:
        off = (readouts[:, 0] - troubles()[name].readout_ms) / readouts[:, 1]
        late = (f'{readouts[:, 0].mean():.2f} ({len(readouts)} runs)', f'{off.mean():+.2f}',
                f'{np.sqrt(np.mean(off**2)):.2f}')
    return (name, len(done), len(results) - len(done), *(f'{share:.3f}' for share in held),
            *(f'{value:.2f}' for value in np.sqrt(np.mean(z**2, axis=0))),
            f'{np.abs(z).max():.1f}', int((np.abs(z).max(axis=1) > MAX_SIGMAS).sum()), *late)
