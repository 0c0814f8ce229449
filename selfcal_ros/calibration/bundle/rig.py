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
The rig block: several cameras that move together, in the place of one lens.

    X_camera = R_cᵀ (X_rig - w p_c),    X_rig, w a homogeneous point before the first camera

Every camera has a lens of its own; all but the first, whose frame is the rig's, have a pose:
their place p_c and the rotation R_c that turns camera coordinates to those of the rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import intrinsic_names, Lens
from selfcal_ros.calibration.bundle.priors import Prior, Priors
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.model import LensModel
from selfcal_ros.geometry.lenses.population import Population
from selfcal_ros.geometry.rotation import rotation_matrix

#: Unknowns of a camera's pose: its place in the rig, and small turns about the rig's axes (rad).
POSE_NAMES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')


def name_in_rig(camera: str, name: str) -> str:
    """Name an unknown of one of the cameras."""
    return f'{camera}.{name}'


@dataclass(frozen=True)
class Rig(Lens):
    """
    Values of the rig block.

    It takes the place of a `Lens` in states and priors, which know unknowns by name alone. What
    belongs to one lens (`camera`, `distortion`, `pixel_directions`) has no meaning here: take
    that of `lens(k)`.

    Attributes
    ----------
    values : ndarray, shape (k,)
        Of `names`: the lenses one after the other, then the poses; turns are counted from
        `rotations`, so that theirs are zero.
    model : LensModel
        Of the first camera.
    models : tuple of LensModel
        One a camera.
    cameras : tuple of str
    rotations : ndarray, shape (C, 3, 3)
        R_c of every camera; that of the first is the identity.

    """

    models: tuple[LensModel, ...] = ()
    cameras: tuple[str, ...] = ()
    rotations: np.ndarray = field(default_factory=lambda: np.eye(3)[None])

    @classmethod
    def of_cameras(cls, cameras: Sequence[str], lenses: Sequence[Lens],
                   poses: np.ndarray) -> Rig:
        """Put cameras of these lenses at poses [R | p] in the rig, shape (C, 3, 4)."""
        turned = [np.r_[place, np.zeros(3)] for place in poses[1:, :, 3]]
        return cls(np.concatenate([*(lens.values for lens in lenses), *turned]),
                   lenses[0].model, tuple(lens.model for lens in lenses), tuple(cameras),
                   np.array(poses[:, :, :3]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, each after that of its camera."""
        return rig_names(self.cameras, self.models)

    def camera(self, width: int = 0, height: int = 0) -> Camera:
        """Refuse: a rig is not one camera."""
        raise TypeError('A rig has several cameras; take that of one of its lenses: lens(k).')

    def of_lens(self, k: int) -> slice:
        """Where the lens of a camera stands."""
        sizes = np.cumsum([0, *(len(intrinsic_names(model)) for model in self.models)])
        return slice(int(sizes[k]), int(sizes[k + 1]))

    def of_pose(self, k: int) -> slice:
        """Where the pose of a camera stands, which is not the first."""
        count = len(POSE_NAMES)
        first = self.of_lens(len(self.models) - 1).stop + count * (k - 1)
        return slice(first, first + count)

    def lens(self, k: int) -> Lens:
        """Return the lens of a camera."""
        return Lens(self.values[self.of_lens(k)], self.models[k])

    @property
    def focal_lengths(self) -> np.ndarray:
        """The focal length of every camera, pixels, shape (C,)."""
        return self.values[[self.of_lens(k).start for k in range(len(self.cameras))]]

    @property
    def parts(self) -> tuple[tuple[Lens, slice], ...]:
        """The lens of every camera, and where it stands in the block."""
        return tuple((self.lens(k), self.of_lens(k)) for k in range(len(self.models)))

    def place(self, k: int) -> np.ndarray:
        """Return the centre of a camera in the rig, shape (3,)."""
        return self.values[self.of_pose(k)][:3] if k else np.zeros(3)

    def pose(self, k: int) -> np.ndarray:
        """Return [R | p] of a camera in the rig, shape (3, 4)."""
        return np.column_stack([self.rotations[k], self.place(k)])

    def moved(self, step: np.ndarray) -> Rig:
        """Return the rig after a step (k,) of its unknowns."""
        values, rotations = self.values + step, self.rotations.copy()
        for k in range(1, len(self.cameras)):
            turns = self.of_pose(k).start + np.arange(3, 6)
            rotations[k] = rotation_matrix(step[turns]) @ rotations[k]
            values[turns] = 0
        return replace(self, values=values, rotations=rotations)

    def scaled(self, factor: float) -> Rig:
        """Return the rig in a world that is larger by a factor."""
        values = self.values.copy()
        for k in range(1, len(self.cameras)):
            values[self.of_pose(k)][:3] *= factor
        return replace(self, values=values)

    @property
    def is_possible(self) -> bool:
        """Tell whether such lenses can exist at all."""
        return bool(np.isfinite(self.values).all()
                    and all(self.lens(k).is_possible for k in range(len(self.cameras))))


def rig_names(cameras: Sequence[str], models: Sequence[LensModel]) -> tuple[str, ...]:
    """Name the unknowns of a rig, in the order of `Rig.values`."""
    of_lenses = [name_in_rig(camera, name) for camera, model in zip(cameras, models)
                 for name in intrinsic_names(model)]
    return (*of_lenses, *(name_in_rig(camera, name) for camera in cameras[1:]
                          for name in POSE_NAMES))


@dataclass(frozen=True)
class RigPriors(Priors):
    """
    What is supposed of the lenses of a rig.

    Attributes
    ----------
    models : tuple of LensModel
    cameras : tuple of str

    """

    models: tuple[LensModel, ...] = ()
    cameras: tuple[str, ...] = ()

    @classmethod
    def of_cameras(cls, priors: dict[str, Priors]) -> RigPriors:
        """Put together what is supposed of every camera by itself."""
        of: dict[str, Prior] = {name_in_rig(camera, name): prior
                                for camera, one in priors.items() for name, prior in one.items()}
        known = {camera: one.population for camera, one in priors.items()
                 if one.population is not None}
        names = tuple(name_in_rig(camera, name) for camera, one in known.items()
                      for name in one.names)
        information, at = np.zeros((len(names), len(names))), 0
        for one in known.values():
            part = slice(at, at + len(one.names))
            information[part, part], at = one.information, part.stop
        population = Population(names, np.concatenate([one.mean for one in known.values()]),
                                information) if known else None
        models = tuple(one.lens for one in priors.values())
        return cls(of, models[0], population, models, tuple(priors))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns that may be measured."""
        return rig_names(self.cameras, self.models)
