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
The texture of a curved surface: views of it with corners whose places on the surface are known.

A mesh has no plane faces to keep pictures of. Here a view is kept as it was seen, each time the
object has turned enough. Its corners are followed into the next image from the view that is
nearest to the predicted pose. That view is drawn as an affine map carries it there. The corners
are of the surface, not of the last image: nothing drifts while one view lasts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.region_of_interest import Region
from selfcal_ros.rorapid.texture.face_picture import FAINT, LEARN, MIN_SCORE
from selfcal_ros.rorapid.texture.texture_memory import follow_corners, TextureMatches
from selfcal_ros.rorapid.visibility.visible_geometry import SurfaceGeometry

#: A view is kept when its direction differs by so much from all others, or its scale by so much;
#: so many are kept, the oldest goes.
_NEW_VIEW_RAD, _NEW_SCALE, _MOST_VIEWS = 0.2, 1.4, 32
#: The surface is seen flatter than this (cosine) where a corner is not learned, or not followed.
_LEARN_COSINE, _FOLLOW_COSINE = 0.4, 0.25
#: Corners so near the outline are not learned, pixels.
_INSIDE_PX = 6
#: A view needs so many corners.
_LEAST_CORNERS = 8
#: Block of the corner detector, pixels, and distance of corners.
_BLOCK, _APART_PX = 5, 6
#: How often places on the surface are asked anew where lines are read one after the other.
_ROUNDS = 2
#: First score of a corner, and the share of good corners below which a view is dropped.
_UNPROVEN, _DROPPED = 0.5, 0.4


@dataclass(eq=False)
class _View:
    """One view with its corners; `texels` are pixels of its region."""

    region: Region
    rotation: np.ndarray        # (3, 3) of the pose then
    covariance: np.ndarray      # (6, 6) of that pose, theta and Delta
    aspect: tuple[np.ndarray, float]    # direction to the camera, object frame; scale
    points: np.ndarray          # (m, 3) object frame
    normals: np.ndarray         # (m, 3)
    texels: np.ndarray          # (m, 2)
    score: np.ndarray           # (m,) how often each corner agreed
    confirmed: bool             # whether the object was known to be there

    def common(self, state: ObjectPose) -> np.ndarray:
        """Covariance (6, 6) of the view's pose, carried to the camera axes of a pose."""
        carry = np.kron(np.eye(2), state.rotation @ self.rotation.T)
        spread: np.ndarray = carry @ self.covariance @ carry.T
        return spread


class SurfaceViews:
    """
    Views of one curved object; an `AppearanceModel`.

    Parameters
    ----------
    visible : SurfaceGeometry
    centre : ndarray, shape (3,)
        Origin of the tracker's object frame.
    projection : Projection
        Of a camera without distortion.
    most_points : int
        Corners to follow at a time.

    """

    def __init__(self, visible: SurfaceGeometry, centre: np.ndarray, projection: Projection,
                 most_points: int = 48):
        """Start without any view."""
        self._visible, self._centre = visible, centre
        self.projection, self.most_points = projection, int(most_points)
        model = visible.model
        self._vertices, self._triangles = model.vertices - centre, model.triangles
        self._normals = model.normals
        self._heights = (self._normals * self._vertices[self._triangles[:, 0]]).sum(axis=1)
        self.forget()

    @property
    def known(self) -> bool:
        """Whether there is any view."""
        return bool(self._views)

    @property
    def patterned(self) -> bool:
        """Whether there are corners by which the object is known: each view has some."""
        return self.known

    def forget(self) -> None:
        """Drop all views."""
        self._views: list[_View] = []
        #: Aspects that show too few corners.
        self._plain: list[tuple[np.ndarray, float]] = []
        #: What a view shows whose corners are put on the surface in the next image.
        self._chosen: tuple[Region, ObjectPose, np.ndarray, np.ndarray] | None = None

    def follow(self, region: Region, state: ObjectPose, levels: int = 3,
               much_hidden: bool = False) -> TextureMatches | None:
        """
        Follow the corners of the nearest view into an image.

        Parameters
        ----------
        region : Region
        state : ObjectPose
            Predicted.
        levels : int
            Of the pyramid; each doubles the range.
        much_hidden : bool
            Much of the object is hidden by other things: then more corners are followed.

        Returns
        -------
        TextureMatches or None
            None where no view shows enough of what is visible.

        """
        aspect = self._aspect(state)
        if not self._views:
            return None
        number = min(range(len(self._views)),
                     key=lambda k: _distance(self._views[k].aspect, aspect))
        view = self._views[number]
        pick = self._seen(view, state)
        expected = region.inside(self.projection.project(state, view.points[pick]).pixels)
        limit = np.array(region.image.shape[::-1])
        inside = ((expected > 6) & (expected < limit - 7)).all(axis=1)
        pick, expected = pick[inside], expected[inside]
        if len(pick) < _LEAST_CORNERS:
            return None
        most = self.most_points * (2 if much_hidden else 1)
        best = np.argsort(-view.score[pick], kind='stable')[:most]
        pick, expected = pick[best], expected[best]
        carry = np.linalg.lstsq(np.column_stack([view.texels[pick], np.ones(len(pick))]),
                                expected, rcond=None)[0].T
        drawing = region.image.copy()
        cv2.warpAffine(view.region.image, carry, drawing.shape[::-1], dst=drawing,
                       flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)
        drawn = view.texels[pick] @ carry[:, :2].T + carry[:, 2]
        found, good = follow_corners(drawing, region.image, drawn, expected, levels)
        return TextureMatches(view.points[pick], region.outside(found), good,
                              np.full(len(pick), number), pick, view.score[pick],
                              view.common(state))

    def judge(self, matches: TextureMatches, agree: np.ndarray) -> None:
        """Remember which corners agreed with a pose that is recognised."""
        view = self._views[int(matches.face[0])]
        rate = np.where(matches.followed, LEARN, 0.0)
        view.score[matches.corner] += rate * (agree - view.score[matches.corner])
        if np.count_nonzero(view.score > MIN_SCORE) < _DROPPED * len(view.score):
            self._views.remove(view)

    def learn(self, region: Region, state: ObjectPose, confirmed: bool,
              covariance: np.ndarray) -> None:
        """
        Keep a view that is new: its corners are chosen in one image, and placed in the next.

        Parameters
        ----------
        region : Region
        state : ObjectPose
            The pose as measured in this image.
        confirmed : bool
            Whether the object is well tracked; else nothing is kept.
        covariance : ndarray, shape (6, 6)
            Of that pose (theta, Delta).

        """
        if confirmed:
            for view in self._views:
                view.confirmed = True
        if self._chosen is not None:
            self._place(*self._chosen)
            self._chosen = None
            return
        direction, size = self._aspect(state)
        if not confirmed or self.projection.model in ('weak', 'affine') or any(
                _distance(aspect, (direction, size)) < 1
                for aspect in self._plain + [view.aspect for view in self._views]):
            return
        texels = self._choose(region, state)
        if len(texels) < _LEAST_CORNERS:
            self._plain = self._plain[-_MOST_VIEWS:] + [(direction, size)]
        else:
            self._chosen = region, state, covariance, texels

    def glance(self, region: Region, state: ObjectPose, covariance: np.ndarray) -> None:
        """
        Keep a first view at a pose that is not confirmed, with what is known of that pose.

        Edges of a pattern draw a pose away from image to image. The view holds it where it began.
        """
        if self._views or self.projection.model in ('weak', 'affine'):
            return
        texels = self._choose(region, state)
        if len(texels) >= _LEAST_CORNERS:
            self._place(region, state, covariance, texels, confirmed=False)

    def disown(self) -> None:
        """Drop views of poses that were not confirmed."""
        self._views = [view for view in self._views if view.confirmed]

    def _place(self, region: Region, state: ObjectPose, covariance: np.ndarray,
               texels: np.ndarray, confirmed: bool = True) -> None:
        """Put the corners (N, 2) of a view on the surface, and keep it."""
        aspect = self._aspect(state)
        pixels = region.outside(texels)
        points, normals, cosine = self._on_surface(pixels, state)
        for _ in range(_ROUNDS if self.projection.reads_rows else 0):
            still = pixels - self.projection.displacement(state, points)
            points, normals, cosine = self._on_surface(still, state)
        good = cosine > _LEARN_COSINE
        if np.count_nonzero(good) < _LEAST_CORNERS:
            if confirmed:
                self._plain = self._plain[-_MOST_VIEWS:] + [aspect]
            return
        self._views = self._views[-_MOST_VIEWS + 1:] + [_View(
            region, state.rotation, covariance, aspect, points[good], normals[good],
            texels[good], np.full(np.count_nonzero(good), _UNPROVEN), confirmed)]

    @staticmethod
    def _aspect(state: ObjectPose) -> tuple[np.ndarray, float]:
        """Direction from the object to the camera, and the scale of its image up to the focal."""
        centre = -state.rotation.T @ state.translation
        distance = float(np.linalg.norm(centre))
        return centre / distance, state.zoom / distance

    def _seen(self, view: _View, state: ObjectPose) -> np.ndarray:
        """Which corners of a view should be seen from a pose, (N,) of int."""
        ray = -state.rotation.T @ state.translation - view.points
        cosine = (ray * view.normals).sum(axis=1) / np.linalg.norm(ray, axis=1)
        pick = np.flatnonzero((cosine > _FOLLOW_COSINE) & (view.score > MIN_SCORE))
        shift = state.translation - state.rotation @ self._centre
        behind = self._visible.behind(view.points[pick] + self._centre, state.rotation, shift)
        shown: np.ndarray = pick[~behind]
        return shown

    def _choose(self, region: Region, state: ObjectPose) -> np.ndarray:
        """Corners of a region (N, 2) that lie well inside of the object."""
        mask = self._visible.mask(state.rotation, state.translation
                                  - state.rotation @ self._centre, region.image.shape,
                                  lambda points: region.inside(self.projection.project(
                                      state, points - self._centre).pixels))
        mask = cv2.erode(mask, np.ones((2 * _INSIDE_PX + 1,) * 2, np.uint8))
        _, strongest, _, _ = cv2.minMaxLoc(cv2.cornerMinEigenVal(region.image, _BLOCK), mask=mask)
        quality = max(0.03, FAINT / max(strongest, 1e-12))
        corners = None
        if quality < 1:
            corners = cv2.goodFeaturesToTrack(region.image, 2 * self.most_points, quality,
                                              _APART_PX, mask=mask, blockSize=_BLOCK)
        return np.zeros((0, 2)) if corners is None else corners[:, 0].astype(float)

    def _on_surface(self, pixels: np.ndarray, state: ObjectPose,
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (N, 3) of the surface at pixels, normals, and cosines; -1 where there is none."""
        nowhere = np.zeros((len(pixels), 3))
        camera = -state.rotation.T @ state.translation
        seen = self._vertices @ state.rotation.T + state.translation
        front = self._normals @ camera > self._heights
        front &= (seen[:, 2] > 0)[self._triangles].all(axis=1)
        front = np.flatnonzero(front)
        K = self.projection.camera.K
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(K).T
        rays[:, :2] /= state.zoom
        corners = self._triangles[front].T
        depths = seen[:, 2][corners]
        x, y = (seen[:, k][corners] / depths for k in (0, 1))
        # a ray meets few of the faces: those whose box it lies in
        ray, face = np.nonzero(_within(rays[:, 0], x) & _within(rays[:, 1], y))
        x, y, depths = x[:, face], y[:, face], depths[:, face]
        double = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
        double = np.where(np.abs(double) > 1e-18, double, np.inf)     # seen from the edge
        across, down = rays[ray, 0], rays[ray, 1]
        share = np.stack([((down - y[k]) * (x[j] - x[k]) - (across - x[k]) * (y[j] - y[k]))
                          / double for k, j in ((1, 2), (2, 0), (0, 1))])
        hit = np.flatnonzero((share.min(axis=0) >= 0) & np.isfinite(double))
        inverse = (share[:, hit] / depths[:, hit]).sum(axis=0)
        # the nearest of each ray's faces, which comes last
        order = np.argsort(inverse, kind='stable')
        nearest = np.full(len(pixels), -1)
        nearest[ray[hit[order]]] = order
        met = np.flatnonzero(nearest >= 0)
        at = nearest[met]
        points, normals, cosine = nowhere.copy(), nowhere, np.full(len(pixels), -1.0)
        points[met] = (rays[met] / inverse[at, None] - state.translation) @ state.rotation
        normals[met] = self._normals[front[face[hit[at]]]]
        towards = camera - points[met]
        cosine[met] = (towards * normals[met]).sum(axis=1) / np.linalg.norm(towards, axis=1)
        return points, normals, cosine


def _within(values: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Which values (P,) lie between the corners (3, F) of which faces, (P, F) bool."""
    within: np.ndarray = (values[:, None] >= corners.min(axis=0)) & (
        values[:, None] <= corners.max(axis=0))
    return within


def _distance(one: tuple[np.ndarray, float], other: tuple[np.ndarray, float]) -> float:
    """How far two aspects are from each other, 1 where that is worth a view of its own."""
    angle = np.arccos(np.clip(one[0] @ other[0], -1, 1))
    return max(float(angle) / _NEW_VIEW_RAD,
               float(abs(np.log(one[1] / other[1])) / np.log(_NEW_SCALE)))
