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
"""Facts as measurements of named unknowns, whichever block owns them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import intrinsic_names, Lens, places_among
from selfcal_ros.calibration.bundle.state import StateT
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.geometry.lenses.model import LensModel
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB
from selfcal_ros.geometry.lenses.population import lens_population, Population
from selfcal_ros.geometry.scaled_inverse import scaled_inverse

#: Sigma of p1 and p2 among ordinary lenses.
ORDINARY_DECENTRING = 1e-3
#: While starts are compared: standard deviation of the coefficients among ordinary lenses.
START_SIGMA = {'plumb_bob': {'k1': 0.2, 'k2': 0.1},
               'rational_polynomial': {'k1': 0.2, 'k2': 0.1},
               'equidistant': {'k1': 0.15, 'k2': 0.08, 'k3': 0.04, 'k4': 0.02}}


@dataclass(frozen=True)
class Prior:
    """One measurement of an unknown: value and sigma (0: fixed, infinite: nothing known)."""

    value: float
    sigma: float

    @property
    def is_soft(self) -> bool:
        """Tell whether it is a measurement like any other, neither exact nor void."""
        return 0 < self.sigma < float('inf')


@dataclass(frozen=True)
class Priors(Mapping[str, Prior]):
    """
    What is supposed of a lens: its model, and measurements of its unknowns.

    Attributes
    ----------
    of : mapping of str to Prior
        Measurements of single unknowns, by name.
    lens : LensModel
    population : Population, optional
        What such lenses are like; a joint measurement of several unknowns.

    """

    of: Mapping[str, Prior] = field(default_factory=dict)
    lens: LensModel = PLUMB_BOB
    population: Population | None = None

    def __getitem__(self, name: str) -> Prior:
        """Return the measurement of an unknown."""
        return self.of[name]

    def __iter__(self) -> Iterator[str]:
        """Name the unknowns that are measured."""
        return iter(self.of)

    def __len__(self) -> int:
        """Count the measurements of single unknowns."""
        return len(self.of)

    def updated(self, more: Mapping[str, Prior]) -> Priors:
        """Return these, with some measurements added or replaced."""
        return replace(self, of={**self.of, **more})

    def under(self, usual: Mapping[str, Prior]) -> Priors:
        """Return these, with what is usual where nothing is stated."""
        return replace(self, of={**usual, **self.of})

    def without(self, names: Iterable[str]) -> Priors:
        """Return these without the measurements of some unknowns."""
        left = set(names)
        return replace(self, of={name: one for name, one in self.of.items() if name not in left})

    @property
    def soft(self) -> dict[str, Prior]:
        """The measurements that fix nothing."""
        return {name: one for name, one in self.of.items() if one.is_soft}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns that may be measured."""
        return intrinsic_names(self.lens)

    @property
    def free(self) -> np.ndarray:
        """Which unknowns of the lens are not fixed, in the order of the block, shape (k,)."""
        return np.array([name not in self.of or self.of[name].sigma > 0 for name in self.names])

    def soft_information(self) -> np.ndarray:
        """Information (k, k) about the unknowns of the lens that all this is, 1 / sigma²."""
        names = self.names
        matrix = np.zeros((len(names), len(names)))
        for name, one in self.soft.items():
            place = names.index(name)
            matrix[place, place] = 1 / one.sigma**2
        if self.population is not None:
            places = places_among(names, self.population.names)
            matrix[np.ix_(places, places)] += self.population.information
        return matrix


def priors_from_facts(facts: CameraFacts) -> Priors:
    """
    Translate facts to measurements of the lens block's unknowns; sigma 0 fixes one.

    A distortion model that is not chosen yet ('auto') counts as 'radial2'.
    """
    model, free = LENS_CHOICES.get(facts.distortion, LENS_CHOICES['radial2'])
    priors = {}
    if facts.aspect_ratio is not None:
        priors['aspect'] = Prior(facts.aspect_ratio, facts.aspect_ratio_sigma)
    if facts.skew is not None:
        priors['skew'] = Prior(facts.skew, facts.skew_sigma_px)
    if facts.principal_point is not None:
        priors['cx'] = Prior(facts.principal_point[0], facts.principal_point_sigma_px)
        priors['cy'] = Prior(facts.principal_point[1], facts.principal_point_sigma_px)
    for name in model.coefficients:
        if name not in free:
            priors[name] = Prior(0.0, 0.0)
    return Priors(priors, model)


def population_of(choice: str, model: LensModel, corner: float,
                  decentring: float | None = None) -> Population:
    """
    Return what lenses of a kind are like, as a measurement of their coefficients.

    Parameters
    ----------
    choice : str
        Among `LENS_CHOICES`.
    model : LensModel
        Its model.
    corner : float
        Distance of the image's corner from the middle over the focal length.
    decentring : float, optional
        Sigma of p1 and p2 in place of the usual one.

    """
    mean, covariance = lens_population(choice, corner)
    for k, name in enumerate(model.coefficients):
        if name in ('p1', 'p2') and decentring is not None:
            covariance[k, k] = decentring**2
    return Population(model.coefficients, mean, scaled_inverse(covariance))


def start_lens(facts: CameraFacts, model: LensModel | None = None) -> Priors:
    """
    Facts, and for starts what most lenses are like.

    Decentring, and what bends the outermost image alone, wait until there is a start.
    """
    stated = LENS_CHOICES.get(facts.distortion, LENS_CHOICES['radial2'])[0]
    if model is not None and model is not stated:
        # a start of another family than the one that is stated
        facts = replace(facts, distortion=next(
            name for name, (one, free) in LENS_CHOICES.items()
            if one is model and free == model.coefficients))
    priors = priors_from_facts(facts)
    waiting = {name: Prior(0.0, 0.0) for name in priors.lens.coefficients
               if name not in START_SIGMA[priors.lens.name]}
    usual = {name: Prior(0.0, sigma) for name, sigma in START_SIGMA[priors.lens.name].items()}
    return priors.under(usual).updated(waiting)


def all_fixed(lens: Lens) -> Priors:
    """Fix every unknown of a lens where it is."""
    return Priors({name: Prior(lens[name], 0.0) for name in lens.names}, lens.model)


def with_fixed(state: StateT, priors: Priors) -> StateT:
    """Put the fixed unknowns of a state at the values that they are fixed at."""
    fixed = {name: prior.value for name, prior in priors.items() if prior.sigma == 0}
    return replace(state, lens=state.lens.with_values(fixed))
