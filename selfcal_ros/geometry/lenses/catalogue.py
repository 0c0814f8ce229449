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
"""The list of lens models, by the names that files, messages and options use."""

from __future__ import annotations

from typing import Literal, TypeAlias

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.equidistant import EQUIDISTANT
from selfcal_ros.geometry.lenses.fov import FOV
from selfcal_ros.geometry.lenses.model import LensModel
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB
from selfcal_ros.geometry.lenses.rational_polynomial import RATIONAL_POLYNOMIAL
from selfcal_ros.geometry.lenses.unified import DOUBLE_SPHERE, EUCM, UCM

#: Every model that is known, estimated or not.
LENS_MODELS: dict[str, LensModel] = {
    model.name: model for model in (PLUMB_BOB, RATIONAL_POLYNOMIAL, EQUIDISTANT, FOV, UCM, EUCM,
                                    DOUBLE_SPHERE)}
#: Names of what can be stated of a lens; auto: found out.
LensChoice: TypeAlias = Literal['auto', 'none', 'radial1', 'radial2', 'radial3', 'radtan',
                                'plumb_bob', 'rational', 'equidistant']
#: What can be stated (`--lens`): the model, and the coefficients that it leaves free.
LENS_CHOICES: dict[LensChoice, tuple[LensModel, tuple[str, ...]]] = {
    'none': (PLUMB_BOB, ()),
    'radial1': (PLUMB_BOB, ('k1',)),
    'radial2': (PLUMB_BOB, ('k1', 'k2')),
    'radial3': (PLUMB_BOB, ('k1', 'k2', 'k3')),
    # without k3, as Kalibr's radtan and COLMAP's OPENCV
    'radtan': (PLUMB_BOB, ('k1', 'k2', 'p1', 'p2')),
    'plumb_bob': (PLUMB_BOB, PLUMB_BOB.coefficients),
    'rational': (RATIONAL_POLYNOMIAL, RATIONAL_POLYNOMIAL.coefficients),
    'equidistant': (EQUIDISTANT, EQUIDISTANT.coefficients),
}


def lens_model(name: str) -> LensModel:
    """Return the model of a name; ArgumentError where there is none."""
    if name not in LENS_MODELS:
        raise ArgumentError(f'The lens model {name!r:.40} is unknown; known are '
                            f'{", ".join(LENS_MODELS)}.')
    return LENS_MODELS[name]
