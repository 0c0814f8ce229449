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
What the second-order part of the true warp does to registered positions.

A patch is registered with an affine warp. The true one bends as well: the image of a plane is a
homography, and a lens bends it further. The affine fit takes part of that for a shift, by some
hundredths of a pixel, alike wherever surfaces and turns are alike. Which part is known for every
template (`Templates.response`). The second-order part follows from the epipolar geometry of two
images and the affine warp that was found: of all planes through the point, one has that warp
(Hartley and Zisserman 2004, section 13.1: H = [e']F + e'n).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.features.epipolar import EpipolarImages
from selfcal_ros.features.matching import ImagePairMatches
from selfcal_ros.geometry.division import DivisionModel

#: Step of the differences, pixels.
_STEP_PX = 2.0
#: Where they are taken, in steps: the point, and six places around it.
_STENCIL = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]], float)
#: Second derivatives by xx, xy and yy from the values there.
_SECOND = np.array([[-2, 1, 1, 0, 0, 0, 0], [1, -0.5, -0.5, -0.5, -0.5, 0.5, 0.5],
                    [-2, 0, 0, 1, 1, 0, 0]]) / _STEP_PX**2
#: Nearer to the epipole than this the affine warp does not tell the plane.
_EPIPOLE_PX = 30.0
#: A second-order part larger than this at a distance of a pixel is a mistake.
_LARGEST = 0.02


@dataclass(frozen=True)
class EpipolarGeometry:
    """
    Epipolar geometry of some pairs of images.

    Attributes
    ----------
    number : ndarray of int, shape (images, images)
        Row of the pair from one image to another; -1 where there is none.
    F : ndarray, shape (2 M, 3, 3)
        x_second' F x_first = 0 of lifted points, both ways.
    lens : tuple of DivisionModel
        Of each row of F, by which points are lifted.

    """

    number: np.ndarray
    F: np.ndarray
    lens: tuple[DivisionModel, ...]

    @classmethod
    def of(cls, pairs: Sequence[tuple[int, int, np.ndarray, DivisionModel]], images: int,
           ) -> EpipolarGeometry:
        """Collect finite ones of (first, second, F as `EpipolarImages` has it, lens)."""
        number = np.full((images, images), -1)
        F: list[np.ndarray] = []
        lenses: list[DivisionModel] = []
        for first, second, matrix, lens in pairs:
            lifted = EpipolarImages(lens).of_lifted(matrix)
            if not np.isfinite(lifted).all():
                continue
            for a, b, one in ((first, second, lifted), (second, first, lifted.T)):
                number[a, b] = len(F)
                F.append(one)
                lenses.append(lens)
        return cls(number, np.array(F).reshape(-1, 3, 3), tuple(lenses))

    @classmethod
    def of_matches(cls, matches: Sequence[ImagePairMatches], images: int) -> EpipolarGeometry:
        """Collect the pairs that were matched."""
        return cls.of([(one.first, one.second, one.F, one.lens) for one in matches], images)

    def curvature(self, a: np.ndarray, b: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray,
                  affine: np.ndarray) -> np.ndarray:
        """
        Second derivatives of warps from images a (N,) to images b (N,).

        Zero where the epipolar geometry of the two is not known; else see `plane_curvature`.
        """
        found = np.zeros((len(a), 2, 3))
        number = self.number[a, b]
        lenses = list(dict.fromkeys(self.lens))
        of_lens = np.array([lenses.index(one) for one in self.lens], int)
        for k, lens in enumerate(lenses):
            rows = np.flatnonzero(number >= 0)
            rows = rows[of_lens[number[rows]] == k]
            found[rows] = plane_curvature(self.F[number[rows]], lens, xy_a[rows], xy_b[rows],
                                          affine[rows])
        return found


def plane_curvature(F: np.ndarray, lens: DivisionModel, xy_a: np.ndarray, xy_b: np.ndarray,
                    affine: np.ndarray) -> np.ndarray:
    """
    Second derivatives of the images of planes, from their positions and first derivatives.

    Parameters
    ----------
    F : ndarray, shape (N, 3, 3)
        x_b' F x_a = 0 of lifted points.
    lens : DivisionModel
        Of both images.
    xy_a, xy_b : ndarray, shape (N, 2)
        Pixels.
    affine : ndarray, shape (N, 2, 2)
        Derivative of the position in b by that in a.

    Returns
    -------
    ndarray, shape (N, 2, 3)
        Of x and y by xx, xy and yy, 1/pixels. Less near the epipole, where the plane is not
        known; zero where there is no such plane.

    """
    with np.errstate(all='ignore'):
        H, apart = _plane_homographies(F, lens, xy_a, xy_b, affine)
        near = xy_a[:, None] + _STEP_PX * _STENCIL
        moved = lens.pixels(np.einsum('nij,nkj->nki', H, lens.lifted(near)))
        second = np.einsum('mk,nkc->ncm', _SECOND, moved)
        far = (apart * lens.half_diagonal_px / _EPIPOLE_PX)**2
        second *= (far / (1 + far))[:, None, None]
    sound = np.abs(second).max(axis=(1, 2), initial=0) < _LARGEST
    return np.where(sound[:, None, None], second, 0.0)


def _plane_homographies(F: np.ndarray, lens: DivisionModel, xy_a: np.ndarray, xy_b: np.ndarray,
                        affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Homographies (N, 3, 3) of lifted points, and distances (N,) from the epipole."""
    X, slope_a = lens.lifted(xy_a), lens.lifted_slope(xy_a)
    Y, slope_b = lens.lifted(xy_b), lens.lifted_slope(xy_b)
    epipole = np.linalg.svd(F)[0][:, :, 2]
    S = np.cross(epipole[:, None], np.swapaxes(F, 1, 2)).swapaxes(1, 2)
    ahead = np.einsum('nij,nj->ni', S, X)
    # by the place along the epipolar curve
    towards = np.cross(Y, epipole)
    place = -(np.cross(Y, ahead) * towards).sum(axis=1) / (towards**2).sum(axis=1)
    scale = ((ahead + epipole * place[:, None]) * Y).sum(axis=1) / (Y**2).sum(axis=1)
    # from changes of a lifted point to those of its image
    frame = np.linalg.inv(np.concatenate([slope_b, Y[:, :, None]], axis=2))
    to_image = frame[:, :2]
    seen = np.einsum('nij,nj->ni', frame, epipole)
    apart = np.linalg.norm(seen[:, :2], axis=1) / np.abs(seen[:, 2])
    along = seen[:, :2] / scale[:, None]
    left = affine - (to_image @ S @ slope_a) / scale[:, None, None]
    tilt = np.einsum('nij,ni->nj', left, along) / (along**2).sum(axis=1)[:, None]
    normal = np.linalg.solve(
        np.concatenate([np.swapaxes(slope_a, 1, 2), X[:, None]], axis=1),
        np.column_stack([tilt, place])[:, :, None])[:, :, 0]
    H = S + epipole[:, :, None] * normal[:, None]
    return H / scale[:, None, None], apart


def along_tracks(geometry: EpipolarGeometry, image: np.ndarray, track: np.ndarray,
                 reference: np.ndarray, xy: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """
    Second derivatives of the warps from the reference of each track to its other views.

    They are put together from pairs whose geometry is known, the fewest there are.

    Parameters
    ----------
    geometry : EpipolarGeometry
    image, track : ndarray of int, shape (N,)
    reference : ndarray of bool, shape (N,)
        One observation of every track.
    xy : ndarray, shape (N, 2)
        Pixels.
    affine : ndarray, shape (N, 2, 2)
        From the template of the track, which the reference shows alike: nearly the identity.

    Returns
    -------
    ndarray, shape (N, 2, 3)

    """
    order = np.lexsort((image, track))
    first = np.flatnonzero(np.r_[True, np.diff(track[order]) != 0])
    place = np.arange(len(order)) - np.repeat(first, np.diff(np.r_[first, len(order)]))
    start = np.zeros(int(track.max()) + 1, int)
    start[track[order[reference[order]]]] = place[reference[order]]
    steps = place - start[track[order]]
    total = np.zeros((len(order), 2, 3))
    for distance in range(1, int(np.abs(steps).max(initial=0)) + 1):
        at = np.flatnonzero(np.abs(steps) == distance)
        here, before = order[at], _nearest_known(geometry, image, order, at, steps)
        link = affine[here] @ np.linalg.inv(affine[before])
        second = geometry.curvature(image[before], image[here], xy[before], xy[here], link)
        total[here] = composed(link, second, affine[before], total[before])
    return total


def _nearest_known(geometry: EpipolarGeometry, image: np.ndarray, order: np.ndarray,
                   at: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Of each track the view nearest to the reference whose geometry with another is known."""
    side, here = np.sign(steps[at]), image[order[at]]
    before: np.ndarray = order[at - side]
    for back in range(2, int(np.abs(steps[at]).max()) + 1):
        farther = order[at - back * side]
        before = np.where(geometry.number[image[farther], here] >= 0, farther, before)
    return before


def composed(affine: np.ndarray, second: np.ndarray, affine_before: np.ndarray,
             second_before: np.ndarray) -> np.ndarray:
    """Second derivatives (N, 2, 3) of one warp after another; first ones are (N, 2, 2)."""
    (a, b), (c, d) = affine_before[:, 0].T, affine_before[:, 1].T
    # of xx, xy, yy of the second warp by those of the first one's arguments
    turned = np.stack([np.stack([a * a, a * b, b * b], axis=1),
                       np.stack([2 * a * c, a * d + b * c, 2 * b * d], axis=1),
                       np.stack([c * c, c * d, d * d], axis=1)], axis=1)
    after: np.ndarray = affine @ second_before + second @ turned
    return after


def feigned_shift(response: np.ndarray, affine: np.ndarray, second: np.ndarray,
                  scale: float | np.ndarray = 1.0) -> np.ndarray:
    """
    Tell how far registered positions are off, (N, 2) pixels.

    Parameters
    ----------
    response : ndarray, shape (N, 2, 6)
        `Templates.response`.
    affine : ndarray, shape (N, 2, 2)
        Template offsets to offsets where it was found.
    second : ndarray, shape (N, 2, 3)
        Second derivatives of that warp, 1/pixels.
    scale : float or ndarray, shape (N,)
        Pixels in one of the template.

    """
    back = np.linalg.inv(affine) @ second
    shift = np.einsum('nij,nj->ni', response, back.reshape(-1, 6))
    off: np.ndarray = (np.einsum('nij,nj->ni', affine, shift)
                       * np.reshape(np.square(scale), (-1, 1)))
    return off
