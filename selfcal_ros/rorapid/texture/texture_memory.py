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
The texture of the model's faces, as it was seen, and where it is in the next image.

Each plane face keeps its picture, rectified. For the next image the visible faces are drawn at
the predicted pose and their corners are followed from this drawing into the image (pyramidal
Lucas-Kanade). The drawing is of the pose, not of the last frame: nothing drifts, and an object
that comes out from behind something is known again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math
from typing import NamedTuple

import cv2
import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.region_of_interest import Region
from selfcal_ros.rorapid.texture.face_picture import (
    Face, lay_frame, MIN_SCORE, sample_points)
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry

#: A face seen flatter than this (cosine), or smaller (pixels squared), tells nothing.
_MIN_COSINE, _MIN_AREA_PX = 0.2, 250.0
#: Window of Lucas-Kanade, pixels.
_WINDOW = 11
#: A corner was followed if its surroundings (9 x 9) correlate better than this.
_MIN_CORRELATION = 0.6
#: Share of a face that must lie inside the image to be learned.
_MIN_SEEN = 0.25
#: Score of a new corner beside a face that was seen often enough.
_UNPROVEN, _PROVEN = 0.2, 8
#: A picture of so much more area replaces the one before.
_BETTER = 1.7
#: Places of a face that its picture is led by, from its middle to its corners: what is left
#: between them and beyond is about the same.
_PLACES = 0.7
_GRID = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), axis=-1).reshape(
    -1, 2).astype(np.float32)


@dataclass(frozen=True)
class TextureMatches:
    """
    Attributes of the texture's corners followed into an image.

    Attributes
    ----------
    object_points : ndarray, shape (N, 3)
    pixels : ndarray, shape (N, 2)
        Where they were found; meaningless where not `followed`.
    followed : ndarray of bool, shape (N,)
    face, corner : ndarray of int, shape (N,)
        Which corner of which face.
    score : ndarray, shape (N,)
        How far each corner has proved itself, 0 to 1.
    common : ndarray, shape (6, 6), or None
        Covariance (theta, Delta; camera axes of now) of the pose that the corners were learned in:
        they all share its error. None where it is small beside theirs.

    """

    object_points: np.ndarray
    pixels: np.ndarray
    followed: np.ndarray
    face: np.ndarray
    corner: np.ndarray
    score: np.ndarray
    common: np.ndarray | None = None


class _PlacedFace(NamedTuple):
    """A face in a region: how texels become pixels, and its box (left, top, right, bottom)."""

    face: Face
    homography: np.ndarray
    box: tuple[int, int, int, int]


class TextureMemory:
    """
    Pictures of the faces of one model; an `AppearanceModel`.

    Parameters
    ----------
    visible : VisibleGeometry
        The model, and what of it hides what.
    centre : ndarray, shape (3,)
        Origin of the tracker's object frame.
    projection : Projection
        Of a camera without distortion.
    most_points : int
        Corners to follow at a time.

    """

    def __init__(self, visible: VisibleGeometry, centre: np.ndarray,
                 projection: Projection, most_points: int = 48) -> None:
        """Lay a frame into each face."""
        self.projection, self.most_points = projection, int(most_points)
        self._geometry, self._centre, model = visible, centre, visible.model
        self._faces = [lay_frame(model.vertices[list(face.indices)] - centre)
                       for face in model.faces]
        self._pixel = projection.camera.K
        self._view = None
        self._visible = np.zeros(len(self._faces), bool)
        self._learned = 0
        if self._faces:
            self._origins = np.array([f.corners.mean(axis=0) for f in self._faces])
            self._normals = np.array([f.normal for f in self._faces])
            self._samples = centre + np.concatenate([sample_points(f) for f in self._faces])

    @property
    def known(self) -> bool:
        """Whether any face has a picture."""
        return any(face.seen for face in self._faces)

    @property
    def patterned(self) -> bool:
        """Whether any face has corners by which it is known."""
        return any(len(face.score) for face in self._faces)

    def forget(self) -> None:
        """Drop all pictures."""
        for face in self._faces:
            face.forget()

    def _see(self, state: ObjectPose) -> np.ndarray:
        """Which faces are turned to the camera and not behind others, (F,) bool."""
        if not self._faces:
            return self._visible
        centre = -state.rotation.T @ state.translation
        ray = centre - self._origins
        cosine = np.abs((ray * self._normals).sum(axis=1)) / np.sqrt((ray * ray).sum(axis=1))
        view = centre / math.sqrt(centre @ centre)
        if self._view is None or view @ self._view < 0.9994:
            self._view = view
            hidden = self._geometry.behind(self._samples, state.rotation,
                                           state.translation - state.rotation @ self._centre)
            self._open = (cosine > 0.5 * _MIN_COSINE) & (
                hidden.reshape(len(self._faces), -1).mean(axis=1) < 0.4)
        self._visible = self._open & (cosine > _MIN_COSINE)
        return self._visible

    def _homography(self, face: Face, state: ObjectPose, region: Region) -> np.ndarray:
        """Map texels (x, y, 1) of a face to pixels of a region (undistorted camera)."""
        plane = np.column_stack([state.rotation @ face.axes,
                                 state.rotation @ face.origin + state.translation])
        if self.projection.model in ('weak', 'affine'):
            plane = plane.copy()
            plane[2] = (0, 0, max(state.translation[2], 1e-6))
        pixel = self._pixel.copy()
        pixel[:2, :2] *= state.zoom
        pixel[:2, 2] -= region.corner
        pixel[:2] *= region.scale
        homography: np.ndarray = pixel @ plane
        if self.projection.reads_rows:
            return self._as_rows_show_it(homography, face, state, region)
        return homography

    def _as_rows_show_it(self, homography: np.ndarray, face: Face, state: ObjectPose,
                         region: Region) -> np.ndarray:
        """Lead four places of a face to where they are when their line is read."""
        middle = face.frame_corners.mean(axis=0)
        texels = middle + _PLACES * (face.frame_corners - middle)
        here = texels @ homography[:, :2].T + homography[:, 2]
        if here[:, 2].min() <= 0:
            return homography
        moved = self.projection.displacement(state, texels @ face.axes.T + face.origin)
        there = here[:, :2] / here[:, 2:] + region.scale * moved
        return cv2.getPerspectiveTransform(texels.astype(np.float32), there.astype(np.float32))

    def follow(self, region: Region, state: ObjectPose, levels: int = 3,
               much_hidden: bool = False) -> TextureMatches | None:
        """
        Follow the corners of all visible known faces into an image.

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
            None where no known face is visible.

        """
        if not any((face.score > MIN_SCORE).any() for face in self._faces):
            return None
        visible = self._see(state)
        faces = [k for k in np.flatnonzero(visible) if self._faces[k].seen]
        if not any((self._faces[k].score > MIN_SCORE).any() for k in faces):
            return None
        placed, points, und, owner = self._place(faces, state, region)
        if not len(points):
            return None
        start = region.inside(self.projection.project(state, points).pixels)
        height, width = region.image.shape
        inside = ((und > 6) & (und < (width - 7, height - 7))).all(axis=1)
        if inside.sum() < 4:
            return None
        pick = np.flatnonzero(inside)
        most = self.most_points * (2 if much_hidden else 1)
        if len(pick) > most:
            # every face has its share, each its best corners first
            rank = np.argsort(owner[pick, 1], kind='stable')[:most]
            pick = pick[rank]
        points, und, start, owner = points[pick], und[pick], start[pick], owner[pick]
        found, good = follow_corners(self._draw(placed, region), region.image, und, start, levels)
        return TextureMatches(points, region.outside(found), good,
                              owner[:, 0], owner[:, 1], self._scores(owner))

    def _place(self, faces: Iterable[int | np.integer], state: ObjectPose, region: Region,
               ) -> tuple[list[_PlacedFace], np.ndarray, np.ndarray, np.ndarray]:
        """Place faces in a region; return them and their corners: object frame, pixels, which."""
        height, width = region.image.shape
        placed = []
        points, pixels, owner = [np.zeros((0, 3))], [np.zeros((0, 2))], [np.zeros((0, 2), int)]
        for k in faces:
            face = self._faces[k]
            H = self._homography(face, state, region)
            frame = face.frame_corners @ H[:, :2].T + H[:, 2]
            if frame[:, 2].min() <= 0:
                continue
            frame = frame[:, :2] / frame[:, 2:]
            x, y = np.clip(np.floor(frame.min(axis=0)), 0, (width, height)).astype(int).tolist()
            right, low = np.clip(np.ceil(frame.max(axis=0)) + 1, 0,
                                 (width, height)).astype(int).tolist()
            if right <= x or low <= y:
                continue
            placed.append(_PlacedFace(face, H, (x, y, right, low)))
            good = np.flatnonzero(face.score > MIN_SCORE)
            if len(good):
                at = face.texels[good] @ H[:, :2].T + H[:, 2]
                points.append(face.points[good])
                pixels.append(at[:, :2] / at[:, 2:])
                owner.append(np.column_stack([np.full(len(good), k), good]))
        return placed, np.concatenate(points), np.concatenate(pixels), np.concatenate(owner)

    def _draw(self, placed: Iterable[_PlacedFace], region: Region) -> np.ndarray:
        """Draw faces over a region, one after the other."""
        height, width = region.image.shape
        # elsewhere the image itself: what is not the object shall not pull at its corners
        drawing = region.image.copy()
        for face, H, (x, y, right, low) in placed:
            if face.whole and face.all_known:
                part = H - np.outer([x, y, 0], H[2])
                cv2.warpPerspective(face.picture, part, (right - x, low - y),
                                    dst=drawing[y:low, x:right],
                                    flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)
            else:
                drawn = cv2.warpPerspective(face.picture, H, (width, height))
                mask = cv2.warpPerspective(face.mask & face.known, H, (width, height),
                                           flags=cv2.INTER_NEAREST)
                cv2.copyTo(drawn, mask, drawing)
        return drawing

    def _scores(self, owner: np.ndarray) -> np.ndarray:
        """Scores of corners (face, corner)."""
        scores = np.empty(len(owner))
        for k in np.unique(owner[:, 0]):
            here = owner[:, 0] == k
            scores[here] = self._faces[k].score[owner[here, 1]]
        return scores

    def judge(self, matches: TextureMatches, agree: np.ndarray) -> None:
        """Remember which corners agreed with a pose that is recognised."""
        for k in np.unique(matches.face):
            face, here = self._faces[k], matches.face == k
            if not face.judge(matches.corner[here], matches.followed[here], agree[here]):
                self._choose(face)

    def learn(self, region: Region, state: ObjectPose, confirmed: bool,
              covariance: np.ndarray | None = None) -> None:
        """
        Take the picture of visible faces: new ones at once, known ones little by little.

        Parameters
        ----------
        region : Region
        state : ObjectPose
            The pose as measured in this image.
        confirmed : bool
            Whether new faces may be learned: their surroundings are well tracked.
        covariance : ndarray, optional
            Of that pose; not used: pictures are renewed, and outlive its error.

        """
        visible = self._see(state)
        self._learned += 1
        faces = [(k, f) for k, f in enumerate(self._faces) if visible[k]]
        for order, (k, face) in enumerate(faces):
            # one known face a frame, in turn; the unknown and the young at once
            young = face.young
            if young and not confirmed:
                continue
            if not young and self._learned % len(faces) != order:
                continue
            H = self._homography(face, state, region)
            size = face.mask.shape[::-1]
            corners = face.frame_corners @ H[:, :2].T + H[:, 2]
            if corners[:, 2].min() <= 0:
                continue
            corners = (corners[:, :2] / corners[:, 2:]).astype(np.float32)
            limit = np.array(region.image.shape[::-1])
            area = cv2.contourArea(corners)
            if area < _MIN_AREA_PX * region.scale**2:
                continue
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            picture = cv2.warpPerspective(region.image, H, size, flags=flags,
                                          borderMode=cv2.BORDER_REPLICATE)
            seen = None
            if (corners < -2).any() or (corners > limit + 2).any():
                seen = cv2.warpPerspective(np.full_like(region.image, 255), H, size, flags=flags)
                seen = cv2.compare(seen, 254, cv2.CMP_GT)    # type: ignore[call-overload]
                if cv2.countNonZero(seen) < _MIN_SEEN * seen.size:
                    continue
            self._take(face, picture, area, seen)

    def glance(self, region: Region, state: ObjectPose, covariance: np.ndarray) -> None:
        """Take nothing: a picture does not know how uncertain its pose was."""

    def disown(self) -> None:
        """Drop nothing: see `glance`."""

    def _take(self, face: Face, picture: np.ndarray, area: float, seen: np.ndarray | None) -> None:
        """Blend a picture into the face's memory, or start anew; `seen` masks it or is None."""
        if face.young or area > _BETTER * face.quality:
            if face.renew(picture, area, seen):
                self._choose(face)
            return
        if face.extend(picture, seen):
            self._choose(face)
        face.blend(picture, seen)

    def _choose(self, face: Face) -> None:
        """Choose the corners of a face that can be followed."""
        # what is learned while other faces are known must prove itself: it may be something
        # that happens to be before the object
        others = any(f is not face and f.seen > _PROVEN for f in self._faces)
        face.choose_corners(3 * self.most_points // 4, _UNPROVEN if others else 0.5)


def follow_corners(drawing: np.ndarray, image: np.ndarray, drawn: np.ndarray,
                   expected: np.ndarray, levels: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Follow corners from a drawing of the object into an image.

    Parameters
    ----------
    drawing, image : ndarray, shape (h, w), uint8
    drawn : ndarray, shape (N, 2)
        Pixels of the corners in the drawing.
    expected : ndarray, shape (N, 2)
        Where they are sought first in the image.
    levels : int
        Of the pyramid; each doubles the range.

    Returns
    -------
    found : ndarray, shape (N, 2)
        Pixels of the image; 0 where a corner was lost.
    good : ndarray of bool, shape (N,)
        Whether it was followed, and what is around it looks the same.

    """
    height, width = image.shape
    drawn = np.ascontiguousarray(drawn, np.float32)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        drawing, image, drawn, np.array(expected, np.float32, order='C'),
        winSize=(_WINDOW, _WINDOW), maxLevel=levels, criteria=(3, 12, 0.02),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
    good = (status[:, 0] > 0) & ((found > 2) & (found < (width - 3, height - 3))).all(axis=1)
    found[~good] = 0
    good &= _correlation(drawing, drawn, image, found) > _MIN_CORRELATION
    return found.astype(float), good


def _correlation(one: np.ndarray, here: np.ndarray, other: np.ndarray,
                 there: np.ndarray) -> np.ndarray:
    """Normalised correlation of small windows about points of two images, (N,)."""
    a = cv2.remap(one, here[:, :1] + _GRID[:, 0], here[:, 1:] + _GRID[:, 1], cv2.INTER_LINEAR,
                  borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    b = cv2.remap(other, there[:, :1] + _GRID[:, 0], there[:, 1:] + _GRID[:, 1],
                  cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    a -= a.mean(axis=1, keepdims=True)
    b -= b.mean(axis=1, keepdims=True)
    norm = np.einsum('ns,ns->n', a, a) * np.einsum('ns,ns->n', b, b)
    likeness: np.ndarray = np.einsum('ns,ns->n', a, b) / np.sqrt(np.maximum(norm, 1.0))
    return likeness
