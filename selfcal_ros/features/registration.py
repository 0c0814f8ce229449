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
Sub-pixel registration of many small patches at once.

Inverse compositional alignment (Baker and Matthews, 2004, section 3.2) with an affine warp; gain
and offset are projected out by normalising every patch to zero mean and unit spread. A relative
blur (defocus, another distance) is a linear change of appearance too, along the Laplacian, but
it is allowed for only where it shows. The template never changes, so the error of a position
does not grow with the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

#: Standard deviation by which images are smoothed before they are doubled, which smooths as much.
SMOOTHING_PX = 0.5
#: Smoothing makes noise alike in neighbouring pixels, so that positions scatter by more than from
#: white noise: measured as 1.1 to 1.4 in rendered images, and 1.6 where all is white noise.
SHARED_NOISE = 1.25
#: Rows of one cv2.remap call; its sizes are limited to 32767.
_ROWS = 16384
#: Squared signal to noise ratio below which relative blur is taken as nothing; noise of
#: neighbouring pixels is not independent, so that chance exceeds 1 by far.
_BLUR_SIGNIFICANT = 8.0


@dataclass(frozen=True)
class DoubledImage:
    """
    An image ready to be sampled between its pixels.

    OpenCV's bicubic kernel does not keep a slope: between two pixels it shifts a patch by up to
    0.05 pixels. Linear steps between the samples of a spline, two a pixel, shift it by 0.003.

    Attributes
    ----------
    values : ndarray of float32, shape (2 H, 2 W)
        The uniform cubic B-spline over the pixels, after one subdivision (Lane and Riesenfeld
        1980): it smooths by a variance of 1/4 to 1/3 pixels squared.

    """

    values: np.ndarray

    @classmethod
    def of(cls, image: np.ndarray) -> DoubledImage:
        """Subdivide an image (H, W)."""
        return cls(cv2.pyrUp(np.asarray(image, np.float32)))

    @classmethod
    def smoothed(cls, grey: np.ndarray, levels: int = 1) -> list[DoubledImage]:
        """
        Smooth an image (H, W) slightly, and subdivide it: whole, halved, halved again, ...

        cv2.pyrDown keeps the centre of pixel (0, 0) in place.
        """
        image = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTHING_PX)
        several = [cls.of(image)]
        for _ in range(levels - 1):
            image = cv2.pyrDown(image)
            several.append(cls.of(image))
        return several

    @property
    def size(self) -> np.ndarray:
        """Width and height in pixels."""
        return np.array(self.values.shape[::-1]) // 2


@dataclass
class Templates:
    """
    Appearance of N points, ready for `register`.

    Parameters
    ----------
    values : ndarray, shape (N, P)
        Normalised grey values: weighted mean 0, weighted mean square 1.
    solver : ndarray, shape (N, 6, P)
        Maps a grey value difference to the warp (dx, dy, a11, a12, a21, a22).
    blur_row : ndarray, shape (N, P)
        Maps a grey value difference to the blur of the image relative to the template: half
        the difference of the variances, pixels squared, estimated together with the warp.
    blur_warp : ndarray, shape (N, 6)
        Warp that `solver` mistakes a unit of relative blur for.
    blur_information : ndarray, shape (N,)
        Inverse variance of the relative blur for grey value noise of the contrast's size.
    sigma : ndarray, shape (N,)
        Standard deviation in pixels of the worse coordinate for a grey value noise of 1 % of
        the contrast; large where the patch holds too little texture.
    response : ndarray, shape (N, 2, 6)
        Shift that `solver` mistakes a second-order displacement for: of x and y, by its second
        derivatives (x by xx, xy, yy, then y).

    """

    values: np.ndarray
    solver: np.ndarray
    blur_row: np.ndarray
    blur_warp: np.ndarray
    blur_information: np.ndarray
    sigma: np.ndarray
    response: np.ndarray

    def __len__(self) -> int:
        """Count the templates."""
        return len(self.values)

    def select(self, index: np.ndarray | slice) -> Templates:
        """Keep the templates of an index or a mask."""
        return Templates(*(part[index] for part in self._parts()))

    def _parts(self) -> tuple[np.ndarray, ...]:
        """List the arrays."""
        return (self.values, self.solver, self.blur_row, self.blur_warp, self.blur_information,
                self.sigma, self.response)

    def steps(self, index: np.ndarray, difference: np.ndarray,
              correlation: np.ndarray) -> np.ndarray:
        """
        Turn grey value differences (N, P) into warps (N, 6), free of what blur feigns.

        Where the blur is no larger than its noise (shrinkage of James and Stein, 1961) the warp
        stays as it is: a seventh unknown for nothing would only cost accuracy.

        Parameters
        ----------
        index : ndarray of int, shape (N,)
            Templates taken.
        difference : ndarray, shape (N, P)
            Normalised grey values of the image less those of the template.
        correlation : ndarray, shape (N,)

        """
        warp = (self.solver[index] @ difference[:, :, None])[:, :, 0]
        blur = np.einsum('np,np->n', self.blur_row[index], difference)
        noise = 2 * np.clip(1 - correlation, 0, 1)
        share = 1 - _BLUR_SIGNIFICANT * noise / (blur * blur * self.blur_information[index]
                                                 + 1e-12)
        blur *= np.maximum(share, 0)
        warps: np.ndarray = warp - self.blur_warp[index] * blur[:, None]
        return warps

    def position_sigma(self, correlation: np.ndarray, index: np.ndarray | slice = slice(None),
                       ) -> np.ndarray:
        """
        Predict the standard deviation in pixels of registered positions.

        What the correlation lacks to 1 is taken as noise: two normalised patches with noise of
        standard deviation n correlate by 1 - n^2 / 2.
        """
        noise = np.sqrt(2 * np.clip(1 - correlation, 0, 1))
        sigma_px: np.ndarray = 100 * self.sigma[index] * noise
        return sigma_px

    def extended(self, other: Templates) -> Templates:
        """Append other templates."""
        return Templates.joined([self, other])

    @classmethod
    def joined(cls, several: list[Templates]) -> Templates:
        """Put several one behind the other."""
        return cls(*(np.concatenate(parts)
                     for parts in zip(*(one._parts() for one in several))))

    def replace(self, index: np.ndarray, fresh: Templates) -> None:
        """Put fresh templates in place of those of an index."""
        for part, new in zip(self._parts(), fresh._parts()):
            part[index] = new


class PatchRegistration:
    """
    A patch size, its window, and the two operations on it.

    Parameters
    ----------
    half_px : int
        The patch covers (2 half + 1) x (2 half + 1) pixels.

    """

    def __init__(self, half_px: int = 7):
        """Lay out the patch."""
        side = np.arange(-half_px, half_px + 1, dtype=np.float32)
        u, v = (grid.ravel() for grid in np.meshgrid(side, side))
        window = np.exp(-0.5 * (u * u + v * v) / (0.55 * half_px) ** 2)
        self.half_px = half_px
        self.offsets = np.stack([u, v], axis=1)
        self._grid = np.stack([u, v, np.ones_like(u)])
        self.window = (window / window.sum()).astype(np.float32)
        self._bent = np.stack([u * u / 2, u * v, v * v / 2], axis=1)
        self._side = len(side)

    def sample(self, image: DoubledImage, xy: np.ndarray, affine: np.ndarray | None = None,
               ) -> np.ndarray:
        """Grey values (N, P) of an image at xy + affine @ offsets."""
        warp = np.empty((len(xy), 2, 3), np.float32)
        warp[:, :, :2] = np.eye(2) if affine is None else affine
        warp[:, :, 2] = xy
        warp *= 2
        x, y = warp[:, 0] @ self._grid, warp[:, 1] @ self._grid
        out = np.empty(x.shape, np.float32)
        for k in range(0, len(out), _ROWS):
            out[k:k + _ROWS] = cv2.remap(image.values, x[k:k + _ROWS], y[k:k + _ROWS],
                                         cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return out

    def _normalise(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted mean to 0 and mean square to 1; also the spread (N, 1) before."""
        values = values - values @ self.window[:, None]
        spread = np.sqrt((values * values) @ self.window[:, None]) + np.float32(1e-3)
        return values / spread, spread

    def templates(self, image: DoubledImage, xy: np.ndarray) -> Templates:
        """
        Take templates around xy (N, 2), pixels.

        A position at whole pixels is best: nothing is interpolated then.
        """
        values, spread = self._normalise(self.sample(image, xy))
        square = values.reshape(len(xy), self._side, self._side)
        gradient_y, gradient_x = np.gradient(square, axis=(1, 2))
        gradients = np.stack([gradient_x.reshape(values.shape),
                              gradient_y.reshape(values.shape)], axis=1)
        u, v = self.offsets.T
        steepest = np.concatenate([gradients, gradients[:, :1] * u, gradients[:, :1] * v,
                                   gradients[:, 1:] * u, gradients[:, 1:] * v], axis=1)
        # what a change of gain and offset explains must not be mistaken for motion
        steepest -= steepest @ self.window[:, None]
        steepest -= ((steepest * values[:, None]) @ self.window[:, None]) * values[:, None]
        blurred = (np.gradient(gradient_x, axis=2)
                   + np.gradient(gradient_y, axis=1)).reshape(values.shape)
        blurred -= blurred @ self.window[:, None]
        blurred -= ((blurred * values) @ self.window[:, None]) * values
        weighted = steepest * self.window
        normal = weighted @ np.swapaxes(steepest, 1, 2)
        # a weak pull towards no deformation keeps the affine part of poor texture in bounds
        scale = 0.5 * (normal[:, 0, 0] + normal[:, 1, 1])
        pull = np.array([1e-6, 1e-6] + 4 * [0.02 * self.half_px ** 2])
        pull = scale[:, None, None] * np.diag(pull).astype(np.float32)
        normal = normal + np.eye(6, dtype=np.float32) * 1e-9
        # the pull holds single steps back, not where they end
        where_it_ends, normal = normal + 0.05 * pull, normal + pull
        inverse = np.linalg.inv(normal.astype(float))
        noise = SHARED_NOISE * 0.01 * np.sqrt((self.window ** 2).sum())
        sigma = noise * np.sqrt(np.maximum(inverse[:, 0, 0], inverse[:, 1, 1]))
        solver = (inverse @ weighted).astype(np.float32)
        # the blur as a seventh unknown, by its Schur complement
        coupling = weighted @ blurred[:, :, None]
        blur_warp = (inverse @ coupling)[:, :, 0]
        weighted_blur = blurred * self.window
        own = (weighted_blur * blurred).sum(axis=1)
        left = np.maximum(own - (coupling[:, :, 0] * blur_warp).sum(axis=1), 0.01 * own) + 1e-9
        blur_row = (weighted_blur - (np.swapaxes(coupling, 1, 2) @ solver)[:, 0]) / left[:, None]
        ends = (np.linalg.inv(where_it_ends.astype(float))[:, :2] @ weighted).astype(np.float32)
        response = np.swapaxes((ends[:, None] * gradients[:, :, None]) @ self._bent, 1, 2)
        return Templates(values, solver, blur_row.astype(np.float32), blur_warp,
                         left / (self.window ** 2).sum(), sigma,
                         response.reshape(-1, 2, 6))

    def register(self, templates: Templates, image: DoubledImage, xy: np.ndarray,
                 affine: np.ndarray | None = None, iterations: int = 8, tolerance_px: float = 0.01,
                 rows: np.ndarray | None = None,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """
        Find the templates in another image, from a start within about two pixels.

        Parameters
        ----------
        templates : Templates
            N of them, unless `rows` are given.
        image : DoubledImage
        xy : ndarray, shape (N, 2)
            Start in pixels.
        affine : ndarray, shape (N, 2, 2), optional
            Start of the deformation, template offsets to image offsets; identity by default.
        iterations : int
            Gauss-Newton steps at most.
        tolerance_px : float
            A point whose step falls below this is finished.
        rows : ndarray of int, shape (N,), optional
            Which of the templates to find.

        Returns
        -------
        xy : ndarray, shape (N, 2)
        affine : ndarray, shape (N, 2, 2)
        correlation : ndarray, shape (N,)
            Weighted correlation with the template at the last but one step, -1 where the
            iteration left the image or broke down.
        step_px : ndarray, shape (N,)
            Length of the last step: large where the iteration has not converged.

        """
        rows = np.arange(len(templates)) if rows is None else rows
        count = len(rows)
        xy = np.array(xy, dtype=float)
        affine = (np.tile(np.eye(2), (count, 1, 1)) if affine is None
                  else np.array(affine, dtype=float))
        correlation, last = np.full(count, -1.0), np.full(count, np.inf)
        limit = image.size - 1.0
        active = np.arange(count)
        for _ in range(iterations):
            if not len(active):
                break
            values, _ = self._normalise(self.sample(image, xy[active], affine[active]))
            target = templates.values[rows[active]]
            correlation[active] = (values * target) @ self.window
            update = templates.steps(rows[active], values - target, correlation[active])
            change = np.eye(2) + update[:, 2:].reshape(-1, 2, 2)
            determinant = np.linalg.det(change)
            sound = (np.abs(determinant - 1) < 0.7) & (np.abs(update[:, :2]).max(axis=1) < 3)
            correlation[active[~sound]], last[active[~sound]] = -1, np.inf
            active, change, update = active[sound], change[sound], update[sound]
            inverse = np.linalg.inv(change)
            affine[active] = affine[active] @ inverse
            step = -(affine[active] @ update[:, :2, None])[:, :, 0]
            xy[active] += step
            last[active] = np.linalg.norm(step, axis=1)
            inside = ((xy[active] > 0) & (xy[active] < limit)).all(axis=1)
            correlation[active[~inside]] = -1
            last[active[~inside]] = np.inf
            active = active[inside & (last[active] > tolerance_px)]
        return xy, affine, correlation, last
