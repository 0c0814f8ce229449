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
Cramér-Rao bound of planar self-calibration: the smallest spread that any unbiased method has.

Independent of `selfcal_ros.calibration`: the projection is written out once more, and its
derivatives are taken by complex steps, which are exact to rounding. Points enter as nuisance
parameters and are eliminated block by block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.synthetic.scenes import PointSequence

_STEP = 1e-20


@dataclass(frozen=True)
class Bound:
    """
    Smallest covariance of the free internal parameters and of the fixed points.

    Attributes
    ----------
    names : tuple of str
        Free internal parameters; fx carries fy along where the aspect ratio is known.
    covariance : ndarray, shape (n, n)
        Of `names`.
    sigma : dict of str to float
    vanishing_point_covariance : ndarray, shape (2, 2)
        Of v / v3, pixels squared.
    horizon_covariance : ndarray, shape (2, 2)
        Of l / l3.

    """

    names: tuple
    covariance: np.ndarray
    sigma: dict
    vanishing_point_covariance: np.ndarray
    horizon_covariance: np.ndarray


def cramer_rao_bound(sequence: PointSequence, noise_px: float,
                     free=('fx', 'cx', 'cy', 'skew')) -> Bound:
    """
    Bound for a camera in exactly planar motion that sees unknown points.

    Parameters
    ----------
    sequence : PointSequence
        Its true poses must be planar, world z along the rotation axis. Only the visibility
        counts of its tracks, not their noise.
    noise_px : float
        Standard deviation of each image coordinate.
    free : sequence of str
        Unknowns among `PARAMETER_NAMES`. Without 'fy', fy = ζ fx with the true ζ.

    Returns
    -------
    Bound

    """
    tracks, poses = sequence.tracks, sequence.cam_from_world
    model = _Model(sequence, tuple(free))
    view, point = tracks.frame, tracks.track
    start = np.zeros(model.size)
    points = sequence.points.astype(complex)
    shared = np.empty((len(view), 2, model.size))
    for k in range(model.size):
        moved = start.astype(complex)
        moved[k] += 1j * _STEP
        shared[:, :, k] = model.project(moved, view, points[point]).imag / _STEP
    own = np.empty((len(view), 2, 3))
    for k in range(3):
        moved = points + 1j * _STEP * np.eye(3)[k]
        own[:, :, k] = model.project(start.astype(complex), view, moved[point]).imag / _STEP
    # only the ratio of lengths is seen: hold the largest translation
    lengths = np.abs(np.diff(_centres(poses)[:, :2], axis=0, prepend=0)).ravel()
    held = model.first_position + int(np.argmax(lengths[2:]))
    shared = np.delete(shared, held, axis=2)
    count = len(sequence.points)
    V = np.zeros((count, 3, 3))
    W = np.zeros((count, shared.shape[2], 3))
    np.add.at(V, point, np.einsum('nci,ncj->nij', own, own))
    np.add.at(W, point, np.einsum('nci,ncj->nij', shared, own))
    seen = np.bincount(point, minlength=count) >= 2
    information = np.einsum('nci,ncj->ij', shared, shared)
    information -= np.einsum('pia,pab,pjb->ij', W[seen], np.linalg.inv(V[seen]), W[seen])
    once = ~seen[point]
    information -= np.einsum('nci,ncj->ij', shared[once], shared[once])
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    covariance *= noise_px ** 2
    n = len(model.free)
    shape = model.fixed_point_slopes(n + 2)
    fixed = shape @ covariance[:n + 2, :n + 2] @ shape.T
    sigma = dict(zip(model.free, np.sqrt(np.diag(covariance)[:n]).tolist()))
    return Bound(model.free, covariance[:n, :n], sigma, fixed[:2, :2], fixed[2:, 2:])


def _centres(poses):
    return -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])


class _Model:
    """Projection as a function of: free intrinsics, axis (2), angles, positions of views 1.."""

    def __init__(self, sequence, free):
        self.free = free
        self.camera = sequence.camera
        self.aspect = self.camera.K[1, 1] / self.camera.K[0, 0]
        poses = sequence.cam_from_world
        self.mount = poses[0, :, :3]
        turn = self.mount.T @ poses[:, :, :3]
        self.angles = np.arctan2(turn[:, 0, 1], turn[:, 0, 0])
        if not np.allclose(turn[:, 2], [0, 0, 1], atol=1e-9):
            raise ValueError('the motion is not planar')
        self.centres = _centres(poses)
        self.views = len(poses)
        self.first_position = len(free) + 2 + self.views - 1
        self.size = self.first_position + 2 * (self.views - 1)

    def intrinsics(self, change):
        values = self.camera.parameters.astype(complex)
        for name, step in zip(self.free, change):
            values[PARAMETER_NAMES.index(name)] += step
        if 'fy' not in self.free:
            values[1] = self.aspect * values[0]
        return values

    def tilted(self, change):
        """Mount whose axis is turned by two small angles; Cayley's form, so exactly a rotation."""
        a, b = change
        cross = np.array([[0, 0, b], [0, 0, -a], [-b, a, 0]])
        return self.mount @ np.linalg.solve(np.eye(3) - cross / 2, np.eye(3) + cross / 2)

    def project(self, change, view, X):
        """Pixels (N, 2), complex, of world points X (N, 3)."""
        n = len(self.free)
        fx, fy, cx, cy, skew, k1, k2, p1, p2, k3 = self.intrinsics(change[:n])
        mount = self.tilted(change[n:n + 2])
        angles = self.angles + np.r_[0, change[n + 2:self.first_position]]
        centres = self.centres.astype(complex)
        centres[1:, :2] += change[self.first_position:].reshape(-1, 2)
        offset = X - centres[view]
        c, s = np.cos(angles)[view], np.sin(angles)[view]
        body = np.stack([c * offset[:, 0] + s * offset[:, 1],
                         c * offset[:, 1] - s * offset[:, 0], offset[:, 2]], axis=1)
        seen = body @ mount.T
        x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([fx * xd + skew * yd + cx, fy * yd + cy], axis=1)

    def fixed_point_slopes(self, count):
        """Derivatives (4, count) of v / v3 and l / l3."""
        slopes = np.empty((4, count))
        for k in range(count):
            change = np.zeros(count, complex)
            change[k] = 1j * _STEP
            fx, fy, cx, cy, skew = self.intrinsics(change[:count - 2])[:5]
            K = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])
            axis = self.tilted(change[count - 2:])[:, 2]
            v, line = K @ axis, np.linalg.solve(K.T, axis)
            slopes[:, k] = np.r_[v[:2] / v[2], line[:2] / line[2]].imag / _STEP
        return slopes
