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
Finding the object again: hypotheses of its pose from what it looked like when last seen.

Two kinds. Near the last pose: the object as it was is shifted over the image (normalised
correlation, a few pixels per step). Anywhere: binary features of remembered views, matched to
those of the image; a similarity between the two images turns the remembered pose into a new one.
Both only propose; the tracker's own measurement decides.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import cv2
import numpy as np

from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.region_of_interest import Region

#: Views are remembered when their direction differs by 0.35 rad, and so many at the most.
_SAME_VIEW, _MAX_VIEWS = math.cos(0.35), 12
#: Views that are compared with one image.
_VIEWS_A_FRAME = 3
#: Features agree with a similarity within this share of the object's size in the image.
_AGREE_FRACTION, _MIN_AGREEING = 0.08, 6
#: Correlation below which a place is not worth a measurement.
_MIN_CORRELATION = 0.35


@dataclass
class _View:
    """A remembered view; its features are computed when they are first needed."""

    region: Region
    state: ObjectPose
    direction: np.ndarray
    pixels: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    descriptors: np.ndarray | None = None
    described: bool = False


class ViewMemory:
    """
    Remembered views of one object.

    Parameters
    ----------
    projection : Projection
    outline : ndarray, shape (N, 3)
        Points that span the object, object frame (centred).
    rng : numpy.random.Generator

    """

    def __init__(self, projection: Projection, outline: np.ndarray, rng: np.random.Generator,
                 ) -> None:
        """Start without any view."""
        self.projection, self.outline, self.rng = projection, outline, rng
        # OpenCV's stubs do not know the name that all its versions have
        self._features = cv2.ORB_create(             # type: ignore[attr-defined]
            nfeatures=700, scaleFactor=1.2, nlevels=6, edgeThreshold=12, patchSize=23,
            fastThreshold=7)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        self.forget()

    def forget(self) -> None:
        """Drop all views."""
        self._views: list[_View] = []
        self._directions = np.zeros((0, 3))
        self._last: _View | None = None
        self._searches = 0

    def remember(self, region: Region, state: ObjectPose) -> None:
        """Keep a well-tracked view: always the last one, and each new direction."""
        direction = -state.rotation.T @ state.translation
        direction /= math.sqrt(direction @ direction)
        self._last = _View(region, state, direction)
        if len(self._views) < _MAX_VIEWS and not (
                self._directions @ direction > _SAME_VIEW).any():
            self._views.append(self._last)
            self._directions = np.array([view.direction for view in self._views])

    def shifted(self, region: Region, state: ObjectPose) -> list[ObjectPose]:
        """
        Propose states shifted in the image to where the last view correlates best.

        Parameters
        ----------
        region : Region
            To search in.
        state : ObjectPose
            Only its shift is changed.

        Returns
        -------
        list of ObjectPose
            The best place, if any.

        """
        last = self._last
        if last is None:
            return []
        box = last.region.inside(self.projection.project(last.state, self.outline).pixels)
        low = np.maximum(np.floor(box.min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(box.max(axis=0)) + 1, last.region.image.shape[::-1]).astype(int)
        if (high - low).min() < 8:
            return []
        patch = last.region.image[low[1]:high[1], low[0]:high[0]]
        # about 32 pixels across is enough to tell the object from the rest
        scale = min(1.0, 32 / max(patch.shape)) * last.region.scale
        small = _resized(patch, scale / last.region.scale)
        field = _resized(region.image, scale / region.scale)
        if min(small.shape) < 4 or (np.array(field.shape) <= small.shape).any() or \
                small.std() < 2:
            return []
        score = cv2.matchTemplate(field, small, cv2.TM_CCOEFF_NORMED)
        score[~np.isfinite(score)] = -1
        _, best, _, at = cv2.minMaxLoc(score)
        if best < _MIN_CORRELATION:
            return []
        corner = region.corner + np.array(at) / scale
        expected = self.projection.project(state, self.outline).pixels
        there = self.projection.project(last.state, self.outline).pixels
        shift = corner - (last.region.corner + low / last.region.scale) \
            + there.mean(axis=0) - expected.mean(axis=0)
        return [self._moved_in_image(state, shift)]

    def _moved_in_image(self, state: ObjectPose, shift: np.ndarray) -> ObjectPose:
        """Shift a state by pixels."""
        K = self.projection.camera.K
        y = shift[1] / (K[1, 1] * state.zoom)
        x = (shift[0] / state.zoom - K[0, 1] * y) / K[0, 0]
        step = np.array([x, y, 0.0]) * state.translation[2]
        return ObjectPose(state.rotation, state.translation + step, state.zoom)

    def recognised(self, image: np.ndarray) -> list[ObjectPose]:
        """
        Propose states anywhere in the image, from features of the remembered views.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
            Without distortion.

        Returns
        -------
        list of ObjectPose
            The best supported first.

        """
        if self._last is None:
            return []
        step = 1.0
        while max(image.shape) * step > 900:
            step *= 0.5
        small = image if step == 1 else cv2.resize(image, None, fx=step, fy=step,
                                                   interpolation=cv2.INTER_AREA)
        points, descriptors = self._features.detectAndCompute(small, None)
        if descriptors is None or len(points) < _MIN_AGREEING:
            return []
        pixels = (np.array([p.pt for p in points]) + 0.5) / step - 0.5
        self._searches += 1
        others = [view for view in self._views if view is not self._last]
        turn = self._searches % max(len(others), 1)
        views = [self._last] + (others[turn:] + others[:turn])[:_VIEWS_A_FRAME - 1]
        found = []
        for view in views:
            proposal = self._by_features(view, pixels, descriptors)
            if proposal is not None:
                found.append(proposal)
        found.sort(key=lambda pair: -pair[0])
        return [state for _, state in found]

    def _describe(self, view: _View) -> None:
        """Compute the features of a view that lie on the object."""
        outline = view.region.inside(
            self.projection.project(view.state, self.outline).pixels).astype(np.float32)
        mask = np.zeros(view.region.image.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.round(cv2.convexHull(outline)).astype(np.int32), 255)
        points, descriptors = self._features.detectAndCompute(view.region.image, mask)
        view.pixels = view.region.outside(np.array([p.pt for p in points]).reshape(-1, 2))
        view.descriptors, view.described = descriptors, True

    def _by_features(self, view: _View, pixels: np.ndarray, descriptors: np.ndarray,
                     ) -> tuple[int, ObjectPose] | None:
        """Return (support, state) from one view, or None."""
        if not view.described:
            self._describe(view)
        if view.descriptors is None or len(view.pixels) < _MIN_AGREEING:
            return None
        pairs = self._matcher.knnMatch(view.descriptors, descriptors, k=2)
        kept = [p[0] for p in pairs if len(p) == 2 and p[0].distance < 0.85 * p[1].distance
                and p[0].distance < 70]
        if len(kept) < _MIN_AGREEING:
            return None
        old = view.pixels[[p.queryIdx for p in kept]]
        new = pixels[[p.trainIdx for p in kept]]
        size = np.ptp(self.projection.project(view.state, self.outline).pixels, axis=0).max()
        fit = self._similarity(old, new, _AGREE_FRACTION * size)
        if fit is None:
            return None
        support, turn, factor, old_mean, new_mean = fit
        middle = self.projection.project(view.state, np.zeros((1, 3))).pixels[0]
        rotated = factor * _turned(middle - old_mean, turn)
        place = new_mean + rotated
        state = view.state
        depth = state.translation[2] / factor
        xy = self.projection.camera.normalised(
            (place - self.projection.camera.K[:2, 2]) / state.zoom
            + self.projection.camera.K[:2, 2])
        if not np.isfinite(xy).all():
            return None
        rotation = rotation_matrix(np.array([0, 0, turn])) @ state.rotation
        return support, ObjectPose(rotation, depth * np.array([*xy, 1.0]), state.zoom)

    def _similarity(self, old: np.ndarray, new: np.ndarray, limit: float,
                    ) -> tuple[int, float, float, np.ndarray, np.ndarray] | None:
        """Similarity from old to new pixels with most agreement, from samples of two."""
        n = len(old)
        a, b = self.rng.integers(0, n, 300), self.rng.integers(0, n, 300)
        x = (old @ (1, 1j)), (new @ (1, 1j))
        span, other = x[0][b] - x[0][a], x[1][b] - x[1][a]
        usable = np.abs(span) > limit
        factor = np.where(usable, other / np.where(usable, span, 1), 0)
        usable &= (np.abs(factor) > 0.4) & (np.abs(factor) < 2.5)
        error = np.abs(x[1] - x[1][a][:, None] - factor[:, None] * (x[0] - x[0][a][:, None]))
        near = (error < limit) & usable[:, None]
        best = int(near.sum(axis=1).argmax())
        agree = near[best]
        if agree.sum() < _MIN_AGREEING:
            return None
        z, w = x[0][agree], x[1][agree]
        z, w, z_mean, w_mean = z - z.mean(), w - w.mean(), z.mean(), w.mean()
        factor = (w * z.conj()).sum() / max((np.abs(z)**2).sum(), 1e-12)
        if not 0.4 < abs(factor) < 2.5:
            return None
        return (int(agree.sum()), float(np.angle(factor)), float(abs(factor)),
                np.array([z_mean.real, z_mean.imag]), np.array([w_mean.real, w_mean.imag]))


def _turned(vector: np.ndarray, angle: float) -> np.ndarray:
    """Turn a vector (2,) by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _resized(image: np.ndarray, factor: float) -> np.ndarray:
    """Reduce an image."""
    if factor >= 1:
        return image
    width, height = (max(int(round(side * factor)), 1) for side in image.shape[::-1])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
