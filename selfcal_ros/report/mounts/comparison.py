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
"""How far apart two mounts of a camera are: in millimetres, in degrees and in sigmas."""

from __future__ import annotations

from dataclasses import dataclass, field
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.mount import Mount, PLACE, TURN
from selfcal_ros.geometry.distributions import chi2_sf
from selfcal_ros.report.comparison import in_sigmas
from selfcal_ros.report.mounts.record import known_matrix, mount_from_dict, POSE
from selfcal_ros.report.mounts.transform_files import StoredTransform
from selfcal_ros.report.mounts.transform_reading import (is_transform_file, read_transform,
                                                         stored_of)

#: The turn between two mounts is one about the axes of the body, and no difference of angles.
SMALL_TURNS = dict(zip(TURN, ('about x', 'about y', 'about z')))
#: A smaller variance is that of what is held, m² or rad².
_HELD = 1e-18
#: Differences of what both hold are the same below this, m or rad.
_SAME = 1e-6


@dataclass(frozen=True)
class PlacedCamera:
    """
    A pose of a camera on a body, as far as it is known.

    Attributes
    ----------
    frame : str
        Of the body.
    matrix : ndarray, shape (4, 4)
        NaN where a number is not known.
    covariance : ndarray, shape (6, 6), or None
        Of x, y, z (m) and small turns about the body's axes (rad).
    known : tuple of str
        Degrees of freedom that are.

    """

    frame: str
    matrix: np.ndarray
    covariance: np.ndarray | None
    known: tuple[str, ...]

    @staticmethod
    def of(mount: Mount | StoredTransform) -> PlacedCamera:
        """Take what a result or a file of a transform tells."""
        if isinstance(mount, StoredTransform):
            return PlacedCamera(mount.parent, mount.matrix, mount.covariance, POSE)
        known = tuple(name for name in POSE if mount.status[name] != 'unobservable')
        return PlacedCamera(mount.frame, known_matrix(mount), mount.covariance[:6, :6], known)


@dataclass(frozen=True)
class MountComparison:
    """
    The second mount less the first.

    Attributes
    ----------
    difference : dict of str to float
        Of every degree of freedom that both know: metres, and turns about the axes of the body
        (rad).
    sigma : dict of str to float
        Of each difference; empty without covariances.
    distance_m, angle_rad : float
        Length of the whole difference; NaN where a part is not known.
    joint_sigmas : float or None
        The whole difference in sigmas; None without covariances.
    left_open : dict of str to str
        In which of both each degree of freedom is open: 'A', 'B' or 'A and B'.
    bodies : tuple of str
        The frames that both are told in, where these have different names.

    """

    difference: dict[str, float]
    sigma: dict[str, float]
    distance_m: float
    angle_rad: float
    joint_sigmas: float | None
    left_open: dict[str, str] = field(default_factory=dict)
    bodies: tuple[str, ...] = ()

    def sentences(self) -> list[str]:
        """Say it for a person."""
        lines = [f'{"":>7} {"B - A":>10} {"":2}  {"sigma":>10} {"":2} {"sigmas":>7}'.rstrip()]
        for name, value in self.difference.items():
            unit, factor = ('mm', 1e3) if name in PLACE else ('°', 180 / np.pi)
            sigma = self.sigma.get(name)
            judged = ('' if not sigma else f'  {factor * sigma:>10.3g} {unit:2} '
                      f'{abs(value) / sigma:>7.1f}')
            lines.append(f'{SMALL_TURNS.get(name, name):>7} {factor * value:>+z10.3f} '
                         f'{unit:2}{judged}'.rstrip())
        told = [f'A is told in {self.bodies[0]} and B in {self.bodies[1]}: that means something '
                'only if these are one frame.'] if self.bodies else []
        return [*lines, self.verdict, *told, *self._not_in_full()]

    @property
    def verdict(self) -> str:
        """Say in one sentence how far apart they are."""
        whole = [f'{1e3 * self.distance_m:.2f} mm' if np.isfinite(self.distance_m) else '',
                 f'{np.degrees(self.angle_rad):.3f} degrees' if np.isfinite(self.angle_rad)
                 else '']
        text = f'The mounts are {" and ".join(filter(None, whole)) or "not comparable"} apart'
        if self.joint_sigmas is not None:
            text += (f': {self.joint_sigmas:.1f} sigmas, all degrees of freedom '
                     f'{"that both know " if self.left_open else ""}together')
        return f'{text}.'

    def _not_in_full(self) -> list[str]:
        """Say which parts of the poses are not compared in full, and why."""
        said = []
        for names, part in ((PLACE, 'place is'), (TURN, 'turns are')):
            missing = [name for name in names if name in self.left_open]
            if missing:
                why = ', '.join(f'{name} is open in {self.left_open[name]}' for name in missing)
                said.append(f'The {part} not compared in full: {why}.')
        return said

    def as_dict(self) -> dict[str, Any]:
        """Say it for a program."""
        return {'difference': self.difference, 'sigma': self.sigma,
                'distance_mm': 1e3 * self.distance_m,
                'angle_deg': float(np.degrees(self.angle_rad)),
                'joint_sigmas': self.joint_sigmas}


def compare_mounts(a: PlacedCamera, b: PlacedCamera) -> MountComparison:
    """
    Compare two mounts in the degrees of freedom that both know.

    Parameters
    ----------
    a, b : PlacedCamera
        Of the same body frame.

    """
    values = np.full(6, np.nan)
    values[:3] = b.matrix[:3, 3] - a.matrix[:3, 3]
    turns = b.matrix[:3, :3] @ a.matrix[:3, :3].T
    if np.isfinite(turns).all():
        values[3:] = Rotation.from_matrix(turns).as_rotvec()
    shared = [k for k, name in enumerate(POSE)
              if name in a.known and name in b.known and np.isfinite(values[k])]
    difference = {POSE[k]: float(values[k]) for k in shared}
    covariances = [one.covariance for one in (a, b) if one.covariance is not None]
    sigma, joint = {}, None
    if covariances and shared:
        C = np.sum([one[np.ix_(shared, shared)] for one in covariances], axis=0)
        sigma = {POSE[k]: float(np.sqrt(max(C[row, row], 0.0))) for row, k in enumerate(shared)}
        free = np.diag(C) > _HELD
        held = np.abs(values[shared])[~free]
        if free.any():
            d = values[shared][free]
            statistic = float(d @ np.linalg.solve(C[np.ix_(free, free)], d))
            chance = float(chi2_sf(statistic, free.sum()))
            joint = in_sigmas(statistic, chance, int(free.sum()))
        if (held > _SAME).any():
            # what both hold and contradict each other in is beyond any
            joint = float('inf')
    whole = {name for name in difference}
    return MountComparison(
        difference, sigma,
        float(np.linalg.norm(values[:3])) if whole >= set(PLACE) else np.nan,
        float(np.linalg.norm(values[3:])) if whole >= set(TURN) else np.nan, joint,
        {name: ' and '.join(letter for letter, one in (('A', a), ('B', b))
                            if name not in one.known)
         for name in POSE if not (name in a.known and name in b.known)},
        (a.frame, b.frame) if a.frame and b.frame and a.frame != b.frame else ())


def placed_camera(path: str | Path, which: str | None = None) -> PlacedCamera | None:
    """
    Read the mount of a file; None where it has none.

    Parameters
    ----------
    path : str or Path
    which : str, optional
        The camera of a rig; by default its first.

    Raises
    ------
    InputError
        If the file of a transform cannot be read.

    """
    path = Path(path)
    if is_transform_file(path):
        return PlacedCamera.of(read_transform(path)[1])
    if path.suffix.lower() != '.json':
        return None
    try:
        stored = json.loads(path.read_text(encoding='utf-8'))
        mount = mount_from_dict(stored_of(stored, which, str(path)).get('mount'))
    except (OSError, AttributeError, KeyError, TypeError, ValueError, RecursionError):
        # whatever else is read of the file says what is wrong with it
        return None
    return PlacedCamera.of(mount) if isinstance(mount, Mount) else None
