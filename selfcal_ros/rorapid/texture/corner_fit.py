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
"""The pose on which followed corners of the texture agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.robust_loss import tukey_weight
from selfcal_ros.geometry.robust_scale import fast_robust_sigma
from selfcal_ros.geometry.small_system import inverted, solved
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, ProjectedPoints, Projection
from selfcal_ros.rorapid.texture.texture_memory import TextureMatches

#: Standard deviation that corners have at the least, pixels, and Tukey's limit in sigmas.
_TEXTURE_SIGMA_PX, _TUKEY = 0.1, 4.5
#: Corners beside edges: their common error is that of the pose in which they were learned, which
#: does not average out, so that each counts for little - the more, the fewer edges there are.
_EDGE_FRACTIONS, _BESIDE_EDGES_PX = (0.35, 0.7), (0.5, 2.0)
#: A corner of the texture agrees with a pose within this distance, pixels.
AGREE_PX = 2.5
#: So many corners must agree before they lead the edges.
MIN_TEXTURE = 5


@dataclass(frozen=True)
class AgreeingCorners:
    """
    A pose, and the corners of the texture that agree with it.

    Attributes
    ----------
    state : ObjectPose
    matches : TextureMatches or None
        None where no texture is known.
    agree : ndarray of bool, shape (N,)
        Which of the matches.

    """

    state: ObjectPose
    matches: TextureMatches | None
    agree: np.ndarray


class CornerFit:
    """
    Fits poses to corners.

    Parameters
    ----------
    projection : Projection
        Of a camera without distortion.
    basis : ndarray, shape (size, m)
        Of the motion model.
    rng : numpy.random.Generator

    """

    def __init__(self, projection: Projection, basis: np.ndarray, rng: np.random.Generator,
                 ) -> None:
        """Take the camera and the motion model."""
        self.projection, self.basis, self.rng = projection, basis, rng

    def switch(self, basis: np.ndarray) -> None:
        """Go on with another basis of corrections."""
        self.basis = basis

    def agreement(self, matches: TextureMatches, predicted: ObjectPose, prior: np.ndarray,
                  near_px: float) -> tuple[ObjectPose, np.ndarray]:
        """Pose from followed corners: RANSAC, then an M-estimator; and which corners agree."""
        good = np.flatnonzero(matches.followed)
        agree = np.zeros(len(matches.followed), bool)
        if len(good) < MIN_TEXTURE:
            return predicted, agree
        points, pixels = matches.object_points[good], matches.pixels[good]
        rows, residual = self._rows(predicted, points, pixels)
        score = matches.score[good]
        if np.count_nonzero((residual**2).sum(axis=0) < AGREE_PX**2) > 0.7 * len(good):
            # the prediction is right already
            best: np.ndarray | None = np.zeros(rows.shape[2])
        else:
            best = self._sample(rows, residual, prior, score)
        if best is None:
            return predicted, agree
        m = self.basis.shape[1]
        state = self.projection.moved(predicted, self.basis @ best)
        for _ in range(2):
            rows, residual = self._rows(state, points, pixels)
            distance = np.sqrt((residual**2).sum(axis=0))
            sigma = max(fast_robust_sigma(distance[distance < 6] / 1.5, _TEXTURE_SIGMA_PX), 0.5)
            w = tukey_weight(distance, min(_TUKEY * sigma, 6.0)) * score
            both = rows.reshape(-1, m)
            wide = np.concatenate([w, w])
            H = (both * wide[:, None]).T @ both / sigma**2
            g = both.T @ (wide * residual.ravel()) / sigma**2
            back = self.basis.T @ self.projection.difference(state, predicted)
            q = solved(H + prior, g - prior @ back)
            state = self.projection.moved(state, self.basis @ q)
        near = self.near(state, matches, near_px)
        return (state, near) if near.sum() >= MIN_TEXTURE else (predicted, agree)

    def near(self, state: ObjectPose, matches: TextureMatches, near_px: float = AGREE_PX,
             ) -> np.ndarray:
        """Which of the followed corners lie where a state puts them, (N,) bool."""
        seen = self.projection.project(state, matches.object_points).pixels
        square = ((matches.pixels - seen)**2).sum(axis=1)
        near: np.ndarray = matches.followed & (square < near_px**2)
        return near

    def _rows(self, state: ObjectPose, points: np.ndarray, pixels: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian (2, N, m) and residual (2, N) of corners, x and then y."""
        seen = self.projection.project(state, points)
        n = len(points)
        twice = ProjectedPoints(*(np.concatenate([part, part]) for part in (
            seen.pixels, seen.xy, seen.turned, seen.inverse_depth)))
        way = np.zeros((2 * n, 2))
        way[:n, 0] = way[n:, 1] = 1
        rows = self.projection.rows(state, twice, way) @ self.basis
        return rows.reshape(2, n, -1), (pixels - seen.pixels).T

    def _sample(self, rows: np.ndarray, residual: np.ndarray, prior: np.ndarray,
                weight: np.ndarray, samples: int = 48) -> np.ndarray | None:
        """Correction (m,) with most agreement out of many from three corners each."""
        n, m = rows.shape[1], rows.shape[2]
        pick = self.rng.integers(0, n, (samples, 3))
        J = rows[:, pick].transpose(1, 0, 2, 3).reshape(samples, 6, m)
        r = residual[:, pick].transpose(1, 0, 2).reshape(samples, 6)
        H = np.einsum('ski,skj->sij', J, J) + 0.25 * prior
        q = np.linalg.solve(H, np.einsum('ski,sk->si', J, r)[..., None])[..., 0]
        q = np.concatenate([q, np.zeros((1, m))])
        error = residual.ravel()[:, None] - rows.reshape(-1, m) @ q.T
        square = error[:n]**2 + error[n:]**2
        score = weight @ np.maximum(1 - square / 16.0, 0.0)
        best = int(score.argmax())
        return q[best] if score[best] > 0.5 else None

    def terms(self, state: ObjectPose, matches: TextureMatches, agree: np.ndarray,
              edge_share: float) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of the agreeing corners about a state."""
        rows, residual = self._rows(state, matches.object_points[agree],
                                    matches.pixels[agree])
        distance = np.sqrt((residual**2).sum(axis=0))
        sigma = fast_robust_sigma(distance / 1.5, float(np.interp(
            edge_share, _EDGE_FRACTIONS, _BESIDE_EDGES_PX)))
        w = tukey_weight(distance, _TUKEY * sigma) / sigma**2
        w *= np.minimum(2 * matches.score[agree], 1.0)
        both = rows.reshape(-1, rows.shape[2])
        wide = np.concatenate([w, w])
        H, g = (both * wide[:, None]).T @ both, both.T @ (wide * residual.ravel())
        if matches.common is None:
            return H, g
        # what the corners share does not average out: (H^-1 + C)^-1 = (I + H C)^-1 H
        B = self.basis[:6]
        less = inverted(np.eye(len(H)) + H @ (B.T @ matches.common @ B))
        return less @ H, less @ g
