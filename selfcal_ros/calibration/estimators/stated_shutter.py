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
The stated shutter against the images: a global one, or a line delay.

The images are calibrated without the fact first. Where the line delay that they show differs from
the stated one beyond chance, the fact is contradicted, and judged as other facts are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.calibration.uncertainty.facts_verdict import CONTRADICTED, Contradiction
from selfcal_ros.calibration.uncertainty.free_of_facts import held_against
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.distributions import chi2_sf
from selfcal_ros.geometry.no_estimate import NoEstimate

#: What is found of lines that are read in turn, where their line delay is open.
READ_SOMEHOW = ('rows_by_view', 'rolling_shutter_suspected')


def with_tested_shutter(calibrated: Callable[[CameraFacts], Calibration | NoEstimate],
                        facts: CameraFacts) -> Calibration | NoEstimate:
    """
    Calibrate, and hold what is stated of the shutter against the images.

    Parameters
    ----------
    calibrated : callable
        Makes a calibration from the same images under some facts.
    facts : CameraFacts
        As they were stated.

    Returns
    -------
    Calibration or NoEstimate
        Under the facts. A global shutter that the images do not contradict is one that they
        were asked about: then it is the result of `shutter='auto'`.

    """
    if facts.line_delay_s is not None:
        return _tested(calibrated(facts), calibrated(replace(
            facts, shutter='rolling', line_delay_s=None, line_delay_sigma_s=0.0)), facts)
    if facts.shutter != 'global':
        return calibrated(facts)
    free = calibrated(replace(facts, shutter='auto'))
    if free and free.shutter is None and _read_somehow(free) is None:
        return replace(free, facts=replace(free.facts, shutter='global'))
    return _tested(calibrated(facts), free, facts)


def _tested(held: Calibration | NoEstimate, free: Calibration | NoEstimate, facts: CameraFacts,
            ) -> Calibration | NoEstimate:
    """Hold what is stated of the shutter against a calibration without it."""
    if not free:
        return held
    prefers = _preferred(free, facts)
    return held_against(held, free, [] if prefers is None else [prefers], facts.trusted)


def _read_somehow(free: Calibration) -> Finding | None:
    """What was found of lines that are read in turn, without a line delay."""
    return next((one for one in free.findings if one.kind in READ_SOMEHOW), None)


def _preferred(free: Calibration, facts: CameraFacts) -> Contradiction | None:
    """Tell what the images prefer to the stated shutter; None within chance."""
    readout, somehow = free.shutter, _read_somehow(free)
    preferred: dict[str, Any]
    if readout is None:
        if somehow is None or facts.line_delay_s is not None:
            return None
        sigmas = float(somehow.values['sigmas'])
        preferred = {'name': 'shutter', 'value': 'rolling', 'stated': 'global'}
    else:
        name, value, sigma, stated, stated_sigma = _in_common_unit(readout, facts)
        sigmas = abs(value - stated) / float(np.hypot(sigma, stated_sigma))
        preferred = {'name': name, 'value': value, 'sigma': sigma, 'stated': stated}
    if chi2_sf(sigmas**2, 1) > CONTRADICTED:
        return None
    return Contradiction('global shutter' if facts.line_delay_s is None else 'line delay',
                         [preferred], sigmas, has_sigma=facts.line_delay_sigma_s > 0)


def _in_common_unit(readout: RowReadout, facts: CameraFacts,
                    ) -> tuple[str, float, float, float, float]:
    """Return name, value and sigma of a readout, and value and sigma that were stated."""
    if readout.line_delay_s is None or readout.sigma_s is None:
        return 'readout in intervals', readout.intervals, readout.intervals_sigma, 0.0, 0.0
    name, scale = (('readout in ms', 1e3 * readout.rows) if facts.line_delay_s is None
                   else ('line delay in µs', 1e6))
    return (name, scale * readout.line_delay_s, scale * readout.sigma_s,
            scale * (facts.line_delay_s or 0.0), scale * facts.line_delay_sigma_s)
