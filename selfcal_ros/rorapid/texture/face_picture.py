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
"""One plane face of the model, its frame of texels, and what of it can be seen."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

#: Texels along the longer side of a face, and the share by which its picture is wider.
TEXELS, MARGIN = 96, 0.08
#: Corners that agreed less often are left out; texels changed in so many pictures are renewed.
MIN_SCORE, _DOUBTS = 0.12, 12
#: Block of the corner detector, pixels, and its answer where grey levels change by 1.5 a pixel in
#: every direction (its scale: Sobel's 8 over 4 x block x 255, squared, summed over the block).
_BLOCK = 5
FAINT = (8 * 1.5 / (4 * _BLOCK * 255))**2 * _BLOCK**2
#: Grey levels by which the surroundings of a texel have changed, and below which they stay what
#: they changed to; texels across those surroundings.
_CHANGED, _STEADY, _AROUND = 12, 6, 9
#: Share by which a score follows what is seen, and while the corner is not seen at all.
LEARN, _LEARN_HIDDEN = 0.07, 0.0


def _empty() -> np.ndarray:
    return np.zeros(0)


@dataclass
class Face:
    """One plane face: its frame, its picture and the corners in it."""

    origin: np.ndarray          # object frame, of texel (0, 0)
    axes: np.ndarray            # (3, 2): object vector of one texel step in x and y
    normal: np.ndarray
    corners: np.ndarray         # (n, 3) object frame
    mask: np.ndarray            # where the texture can be trusted to be the face's
    whole: bool                 # the polygon fills its rectangle
    picture: np.ndarray = field(default_factory=_empty)     # meaningless until `seen`
    known: np.ndarray = field(default_factory=_empty)       # which texels were seen, 255 or 0
    all_known: bool = False
    points: np.ndarray = field(default_factory=_empty)      # (m, 3), object frame
    texels: np.ndarray = field(default_factory=_empty)      # (m, 2)
    score: np.ndarray = field(default_factory=_empty)       # (m,): how often each corner agreed
    doubt: np.ndarray = field(default_factory=_empty)       # how often each texel was another
    other: np.ndarray = field(default_factory=_empty)       # the picture before
    seen: int = 0
    quality: float = 0.0

    def forget(self) -> None:
        """Drop the picture."""
        self.picture = self.points = self.texels = self.score = self.doubt = _empty()
        self.other = self.known = _empty()
        self.all_known, self.seen, self.quality = False, 0, 0.0

    @property
    def frame_corners(self) -> np.ndarray:
        """Texels at the corners of its picture, one after the other round it, (4, 2)."""
        height, width = self.mask.shape
        return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])

    @property
    def young(self) -> bool:
        """Whether the picture is of too few images to be trusted."""
        return self.seen < 3

    @property
    def inner(self) -> np.ndarray:
        """Texels that lie well inside of what is known of the face, (h, w), 255 or 0."""
        if self.all_known:
            return self.mask
        known = cv2.erode(self.known, np.ones((13, 13), np.uint8), borderValue=255)
        usable: np.ndarray = self.mask & known
        return usable

    def renew(self, picture: np.ndarray, area_px: float, seen: np.ndarray | None) -> bool:
        """
        Take a better picture in place of the one before.

        Parameters
        ----------
        picture : ndarray, shape (h, w), uint8
        area_px : float
            Of the face in the image; the larger, the better the picture.
        seen : ndarray, shape (h, w), uint8, optional
            255 where the texel lay inside the image; None: everywhere.

        Returns
        -------
        bool
            False, and nothing has changed, where it does not show the same.

        """
        if not (self.young or self.matches(picture)):
            return False
        self.picture, self.quality = picture, area_px
        self.known = np.full_like(picture, 255) if seen is None else seen
        self.all_known = seen is None
        self.seen += 1
        return True

    def extend(self, picture: np.ndarray, seen: np.ndarray | None) -> bool:
        """Add texels that were never seen; False where there are none to speak of."""
        if self.all_known:
            return False
        fresh = cv2.bitwise_not(self.known)
        if seen is not None:
            fresh = fresh & seen
        if not cv2.countNonZero(fresh) > 0.05 * fresh.size:
            return False
        cv2.copyTo(picture, fresh, self.picture)
        self.known |= fresh
        self.all_known = seen is None
        return True

    def blend(self, picture: np.ndarray, seen: np.ndarray | None) -> None:
        """Renew the picture little by little, where what is seen is the face."""
        # texels that changed are something before the object: they stay as they were
        same = _mean_change(picture, self.picture, _CHANGED)
        # ... unless they stay changed, and stay as they changed to: what passes before the
        # object slides over it, what belongs to it does not
        steady = _mean_change(picture, self.other, _STEADY)
        if seen is not None:
            same &= seen
            steady &= seen
        # OpenCV takes a number for an image; its stubs do not know
        cv2.add(self.doubt, 1, dst=self.doubt)       # type: ignore[call-overload]
        self.doubt &= steady & cv2.bitwise_not(same)
        self.other = picture
        for_good = cv2.compare(                      # type: ignore[call-overload]
            self.doubt, _DOUBTS - 1, cv2.CMP_GT)
        if cv2.countNonZero(for_good):
            cv2.copyTo(picture, for_good, self.picture)
            self.doubt &= cv2.bitwise_not(for_good)
        blended = cv2.addWeighted(self.picture, 0.9, picture, 0.1, 0.5)
        cv2.copyTo(blended, same, self.picture)
        self.seen += 1

    def choose_corners(self, most: int, score: float) -> None:
        """Choose corners of the picture that can be followed, and give them a first score."""
        inner = self.inner
        _, strongest, _, _ = cv2.minMaxLoc(cv2.cornerMinEigenVal(self.picture, _BLOCK), mask=inner)
        quality = max(0.03, FAINT / max(strongest, 1e-12))
        corners = None
        if quality < 1:               # else the face is plain, and what is seen in it is noise
            corners = cv2.goodFeaturesToTrack(self.picture, most, quality, 6, mask=inner,
                                              blockSize=_BLOCK)
        self.texels = np.zeros((0, 2)) if corners is None else corners[:, 0].astype(float)
        self.points = self.origin + self.texels @ self.axes.T
        self.score = np.full(len(self.texels), score)
        self.doubt = np.zeros(self.picture.shape, np.uint8)
        self.other = self.picture.copy()

    def judge(self, corners: np.ndarray, followed: np.ndarray, agree: np.ndarray) -> bool:
        """
        Remember which corners agreed with a pose that is right.

        Parameters
        ----------
        corners : ndarray of int, shape (N,)
        followed, agree : ndarray of bool, shape (N,)

        Returns
        -------
        bool
            Whether enough corners are still good; if not, most of what was learned is not on
            the object.

        """
        # one that does not even look the same is hidden, more likely than wrong
        rate = np.where(followed, LEARN, _LEARN_HIDDEN)[corners < len(self.score)]
        corners, right = corners[corners < len(self.score)], agree[corners < len(self.score)]
        self.score[corners] += rate * (right - self.score[corners])
        return bool((self.score > MIN_SCORE).sum() >= 0.4 * len(self.score))

    def matches(self, picture: np.ndarray) -> bool:
        """Whether a new picture shows the same as the old one."""
        old, new = self.picture.astype(np.float32), picture.astype(np.float32)
        old, new = old - old.mean(), new - new.mean()
        norm = np.sqrt((old**2).sum() * (new**2).sum())
        return bool(norm > 0 and float((old * new).sum() / norm) > 0.8)


def _mean_change(one: np.ndarray, other: np.ndarray, limit: float) -> np.ndarray:
    """Where two pictures differ by less than a limit on average around a texel, 255 or 0."""
    change = cv2.blur(cv2.absdiff(one, other), (_AROUND, _AROUND))
    near: np.ndarray = cv2.compare(      # type: ignore[call-overload]
        change, limit, cv2.CMP_LT)
    return near


def lay_frame(corners: np.ndarray) -> Face:
    """Lay a rectangle of texels around a plane face."""
    centre = corners.mean(axis=0)
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners - centre, following - centre).sum(axis=0)
    normal /= np.linalg.norm(normal)
    # along the longest side
    side = following - corners
    u = side[np.argmax(np.linalg.norm(side, axis=1))]
    u = u / np.linalg.norm(u)
    v = np.cross(normal, u)
    flat = (corners - centre) @ np.column_stack([u, v])
    low, high = flat.min(axis=0), flat.max(axis=0)
    extent = high - low
    step = (1 + 2 * MARGIN) * extent.max() / TEXELS
    low, high = low - MARGIN * extent.max(), high + MARGIN * extent.max()
    width, height = np.maximum(np.ceil((high - low) / step).astype(int), 16)
    polygon = (flat - low) / step
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(polygon).astype(np.int32)], 255)
    whole = len(corners) == 4 and cv2.contourArea(polygon.astype(np.float32)) > (
        0.97 * np.prod(extent) / step**2)
    inner = cv2.erode(mask, np.ones((7, 7), np.uint8), borderValue=0)
    return Face(centre + u * low[0] + v * low[1], np.column_stack([u, v]) * step, normal,
                corners, inner, whole)


def sample_points(face: Face) -> np.ndarray:
    """Points spread over a face, (25, 3), object frame."""
    rows, columns = np.nonzero(face.mask)
    if not len(rows):
        return np.repeat(face.corners.mean(axis=0)[None], 25, axis=0)
    pick = np.linspace(0, len(rows) - 1, 25).astype(int)
    places: np.ndarray = face.origin + np.column_stack([columns[pick], rows[pick]]) @ face.axes.T
    return places
