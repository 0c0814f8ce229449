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
"""Where points and tensors of known cameras go: the truth for tests of the geometry."""

import numpy as np

from selfcal_ros.geometry.projective import euclidean, homogeneous, unit


def transform_points(H, xy):
    """Map points (..., 2) by a homography (3, 3)."""
    return euclidean(homogeneous(xy) @ np.asarray(H).T)


def tensor_from_cameras(second, third):
    """Tensor (3, 3, 3) of [I | 0] and two more cameras (3, 4) (5.19)."""
    a, b = np.asarray(second, float), np.asarray(third, float)
    return (np.einsum('ji,k->ijk', a[:, :3], b[:, 3])
            - np.einsum('j,ki->ijk', a[:, 3], b[:, :3]))


def transfer_point(T, first, second):
    """
    Predict points of the third image from the first two.

    Parameters
    ----------
    T : array_like, shape (3, 3, 3)
    first, second : array_like, shape (m, 2)

    Returns
    -------
    ndarray, shape (m, 2)
        The line through each second point is the one across its epipolar line.

    """
    T = np.asarray(T, float)
    x, y = homogeneous(np.asarray(first, float)), homogeneous(np.asarray(second, float))
    # x^i T_i^{jk} = (point j) (epipole k) - (epipole j) (point k): its columns span, in the
    # second image, the epipolar line
    slices = np.einsum('mi,ijk->mjk', x, T)
    U = np.linalg.svd(slices)[0]
    epipolar = U[:, :, 2]
    across = np.stack([epipolar[:, 1], -epipolar[:, 0],
                       y[:, 1] * epipolar[:, 0] - y[:, 0] * epipolar[:, 1]], axis=-1)
    z = np.einsum('mj,mjk->mk', across, slices)
    return z[:, :2] / z[:, 2:]


def circular_image(kappa, H):
    """Circular point i = H^-1 (-kappa, 0, 1) in pixels, complex, shape (3,), unit norm."""
    return unit(np.linalg.solve(np.asarray(H, complex), np.array([-kappa, 0, 1])))
