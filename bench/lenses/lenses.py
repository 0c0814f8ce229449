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
Every lens, simulated: is the covariance true, the family right, and the projection in the corners?

Lenses are drawn from measured ones (`lens_population`), a brand by the root of its number, and put
before a drive or a hand-held camera. `auto` has to find the lens; square pixels are stated.

`python -m bench lenses [--runs N] [--cache FOLDER]`: each run is kept in FOLDER, a line of
`runs.jsonl`. Runs that lie there are not made again; the tables are of all of them, so a
thousand runs can be made in several sittings.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from itertools import product

from bench.lenses.lens_population import profile_path
from bench.lenses.lens_runs import (CIRCLE, DECENTRING, kept_outcomes, LENSES, MOTIONS, NOISES_PX,
                                    one_decentred, PLACES, TRACKS, VIEWS)
from bench.monte_carlo import run_seeds
from bench.tables import Report
import numpy as np
from scipy.stats import chi2

SHARES, ALLOWED = np.array([0.60, 0.80, 0.90, 0.95]), 0.03
#: Beyond so many stated sigmas a result is wrong.
MAX_SIGMAS = 4.0
#: How much worse than with the model stated fx and the principal point may be.
WORSE = 1.3


def binomial_error(runs: int) -> float:
    """Return the standard error of a share of 0.60, the largest of `SHARES`, in so many runs."""
    return float(np.sqrt(SHARES[0] * (1 - SHARES[0]) / runs))


def inside(outcomes) -> np.ndarray:
    """Shares of the calibrations inside the ellipsoids that should hold `SHARES` of them."""
    return np.mean([[one.distance < chi2.ppf(share, one.size) for share in SHARES]
                    for one in outcomes], axis=0)


def _decimals(values) -> str:
    return ' '.join(f'{value:.2f}' for value in values)


def run(report: Report, options) -> None:
    """Print the tables of lenses, of rays and of decentring."""
    if profile_path() is None:
        report.section('Every lens')
        report.say('left out: there is no lens_profiles.csv')
        return
    _every_lens(report, options)
    _decentred(report, options)


def _every_lens(report: Report, options) -> None:
    seeds = range(options.runs or 1000)
    tasks = [(lens, motion, seed) for seed, lens, motion in product(seeds, LENSES, MOTIONS)]
    outcome = kept_outcomes(tasks, options)
    rows, rays, verdicts = [], [], []
    for lens, motion in product(LENSES, MOTIONS):
        every = [one for task, one in outcome.items() if task[:2] == (lens, motion)]
        good = [one for one in every if not one.reason]
        refused = Counter(one.reason for one in every if one.reason)
        if not good:
            rows.append((lens, motion, len(every), len(every), *[''] * 7, _counted(refused)))
            continue
        share = inside(good)
        family = np.mean([one.same_family for one in good])
        worst = np.array([one.worst for one in good])
        wrong = int((worst > MAX_SIGMAS).sum())
        seed = next((task[2] for task, one in outcome.items() if task[:2] == (lens, motion)
                     and one.worst > MAX_SIGMAS), '')
        rows.append((lens, motion, len(every), len(every) - len(good), _decimals(share),
                     f'{100 * family:.0f}', f'{np.median(worst):.1f}', f'{worst.max():.1f}',
                     wrong, seed, _counted(Counter(one.choice for one in good)),
                     _counted(refused)))
        rays.append((lens, motion, *_ray_row(good)))
        verdicts.append((f'{lens}, {motion}', np.abs(share - SHARES).max(),
                         binomial_error(len(good)), family, wrong))
    report.section(
        f'Every lens, {len(outcome)} runs, square pixels stated, `auto`',
        f'{VIEWS} views, {TRACKS} tracks, {NOISES_PX[0]} to {NOISES_PX[1]} px. Shares: all '
        'estimated parameters inside the 60, 80, 90, 95 % ellipsoids', '(fx, cx, cy where the '
        'lens found is rational, or not the model that made the images). '
        f'Wrong: beyond {MAX_SIGMAS:g} σ.')
    report.table(('lens', 'motion', 'runs', 'refused', 'shares', 'family %', 'median σ',
                  'worst σ', 'wrong', 'seed', 'found', 'refusals'), rows)
    report.say('')
    for name, off, error, family, wrong in verdicts:
        report.verdict(f'{name}: shares off by (chance alone {error:.3f})', off, ALLOWED)
        report.judge(family >= 0.99, f'{name}: right family in {100 * family:.1f} %, required 99')
        report.judge(not wrong, f'{name}: {wrong} beyond {MAX_SIGMAS:g} σ, required 0')
    report.section(
        'Where a pixel looks: the sigma of its ray',
        'The true ray of a pixel, projected by the estimate. Shares inside the stated 60, 80, 90, '
        '95 % ellipses,', f'and the median error in pixels. A fisheye: at {100 * CIRCLE:.0f} % of '
        'what it sees.')
    report.table(('lens', 'motion', *(word for place in PLACES for word in (place, 'px'))), rays)


def _counted(counter: Counter) -> str:
    return ', '.join(f'{name} {count}' for name, count in counter.most_common())


def _ray_row(outcomes) -> list[str]:
    row = []
    for place in PLACES:
        squares = np.concatenate([one.rays[place] for one in outcomes])
        away = np.concatenate([one.ray_px[place] for one in outcomes])
        row += [_decimals([np.mean(squares < chi2.ppf(share, 2)) for share in SHARES]),
                f'{np.nanmedian(away):.2f}']
    return row


def _decentred(report: Report, options) -> None:
    seeds = range(options.runs or 100)
    tasks = list(product(DECENTRING, MOTIONS, seeds))
    found = {stated: dict(zip(tasks, run_seeds(partial(one_decentred, stated=stated), tasks,
                                               options.processes)))
             for stated in ('auto', 'plumb_bob')}
    rows, verdicts = [], []
    for p, motion in product(DECENTRING, MOTIONS):
        both = [(found['auto'][p, motion, seed], found['plumb_bob'][p, motion, seed])
                for seed in seeds]
        refused = [sum(bool(pair[k].reason) for pair in both) for k in (0, 1)]
        both = [pair for pair in both if not pair[0].reason and not pair[1].reason]
        if not both:
            rows.append((f'{p:g}', motion, f'{refused[0]}, {refused[1]}', '', '', '', ''))
            continue
        auto, stated = (np.array([pair[k].error_px for pair in both]) for k in (0, 1))
        sigmas = np.abs([pair[0].error for pair in both])
        ratio = np.sqrt(np.mean(auto**2, axis=0) / np.mean(stated**2, axis=0))
        rows.append((f'{p:g}', motion, f'{refused[0]}, {refused[1]}',
                     ' '.join(f'{one:.1f}' for one in sigmas.max(axis=0)),
                     ' '.join(f'{one:.2f}' for one in np.sqrt(np.mean(sigmas**2, axis=0))),
                     _decimals(ratio), _counted(Counter(pair[0].choice for pair in both))))
        verdicts.append((f'p1 = p2 = {p:g}, {motion}', ratio.max(),
                         np.mean(sigmas.max(axis=1) > 3)))
    report.section(
        f'Decentring, f = 520, 0.3 px, {len(seeds)} runs each',
        'fx, cx, cy in stated sigmas with `auto`: largest, and root mean square (1 is true). '
        'Ratio: rms error over that with plumb_bob stated, without the prior over lenses.')
    report.table(('p1 = p2', 'motion', 'refused (auto, stated)', 'largest σ', 'rms σ', 'ratio',
                  'found'), rows)
    report.say('')
    for name, ratio, beyond in verdicts:
        report.verdict(f'{name}: error over that with the lens stated', ratio, WORSE)
        report.verdict(f'{name}: share of runs beyond 3 σ', beyond, 0.02)
