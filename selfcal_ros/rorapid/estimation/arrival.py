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
An object that comes into a scene, or stands in it, and was not followed before.

What is new before a camera that stands still has a silhouette. So has what stands out from a plain
background. Poses with such a silhouette are starts. Anywhere else a polyhedron is sought by its
corners. That start whose lines are seen best is proposed, with all that are seen nearly as well. A
cube looks the same from six sides, and the outline of a round part nearly so.

Texture tells them apart. Without any, poses that take the model onto itself are equally right.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from selfcal_ros.rorapid.estimation.corner_alignment import CornerAlignment, has_corners
from selfcal_ros.rorapid.estimation.pose_search import (
    best_turned, OTHER_RAD, PoseSearch, turned_by)
from selfcal_ros.rorapid.estimation.sampled_views import SampledViews
from selfcal_ros.rorapid.estimation.start_check import quartered
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.region.background_change import BackgroundChange
from selfcal_ros.rorapid.region.foreground_blob import foreground_blobs

#: Poses with a like silhouette that are tried in one image; in so many images all are.
_SILHOUETTES, _TURNS = 16, 4
#: What stands out is tried in every so many images.
_STANDING_EVERY = 3
#: Poses by corners are tried in every so many images, and more seldom of what was seen before:
#: they take 0.2 s.
_CORNERS_EVERY, _CORNERS_AGAIN_EVERY = 3, 9
#: Poses by corners that are tried in one image.
_ALIGNED = 24
#: A model is taken onto itself if its vertices meet within this share of its diameter.
_ITSELF = 0.02


class Arrival:
    """
    Proposes poses of what comes in.

    Parameters
    ----------
    search : PoseSearch
    K : ndarray, shape (3, 3)
        Of images without distortion.

    """

    def __init__(self, search: PoseSearch, K: np.ndarray):
        """Begin without a scene; silhouettes are drawn when they are first needed."""
        self._search, self._K = search, K
        self._change = BackgroundChange()
        self._sampled: SampledViews | None = None
        self._alignment: CornerAlignment | None = None
        self._images = 0

    def forget(self) -> None:
        """Forget the scene."""
        self._change.forget()

    def poses(self, image: np.ndarray, undistorted: np.ndarray,
              covariance: np.ndarray, was_seen: bool) -> Iterator[list[ObjectPose]]:
        """
        Propose poses of each thing that is new or stands out, if any is seen well.

        Parameters
        ----------
        image, undistorted : ndarray, shape (H, W), uint8
            As it is, and without distortion.
        covariance : ndarray, shape (m, m)
            Covariance of a pose that is only proposed.
        was_seen : bool
            The object was followed before.

        Yields
        ------
        list of ObjectPose
            Of one thing: the pose that is seen best, and others that lines cannot tell from it.

        """
        search = self._search
        outlined = search.control.is_outlined
        self._images += 1
        for states, by_corners in self._starts(undistorted, was_seen):
            ranked = search.ranked(image, states, covariance)
            if not ranked or not search.check.stands_out(ranked[0][1], was_seen):
                continue
            best, support = ranked[0]
            free = search.control.free_turns
            if by_corners and not search.check.stands_alone(support, best_turned(
                    ranked, best, free)):
                # among so many lines something is always partly like the object
                continue
            if not outlined:
                ranked += search.ranked(image, quartered(best), covariance)
            yield [best] + [
                pose for pose, other in ranked[1:] if turned_by(best, pose, free) > OTHER_RAD
                and search.check.rivals(support, other)]

    def _starts(self, undistorted: np.ndarray,
                was_seen: bool) -> Iterator[tuple[list[ObjectPose], bool]]:
        """Yield the starts for each thing in an image, and whether its corners told of it."""
        control = self._search.control
        pieces = self._change.look(undistorted)
        if not pieces and self._images % _STANDING_EVERY == 1:
            pieces = foreground_blobs(undistorted)
        for piece in pieces:
            if self._sampled is None:
                self._sampled = SampledViews(control.visible_model, control.centre)
            states = self._sampled.poses(piece, self._K, _TURNS * _SILHOUETTES)
            if not control.is_outlined:
                # the likest first, others in the next images
                first = self._images % _TURNS * _SILHOUETTES
                states = states[first:first + _SILHOUETTES]
            yield states, False
        every = _CORNERS_AGAIN_EVERY if was_seen else _CORNERS_EVERY
        if self._images % every == 2 and has_corners(control.visible_model):
            if self._alignment is None:
                self._alignment = CornerAlignment(control.visible_model, control.centre)
            yield self._alignment.poses(undistorted, self._K, _ALIGNED), True

    def nearest(self, poses: list[ObjectPose], expected: ObjectPose) -> list[ObjectPose]:
        """
        Choose of poses that nobody can tell apart.

        Parameters
        ----------
        poses : list of ObjectPose
        expected : ObjectPose

        Returns
        -------
        list of ObjectPose
            That turned least from what is expected; none unless the object looks the same in all.

        """
        vertices = self._search.control.visible_model.model.vertices - self._search.control.centre
        if self._search.control.is_outlined or not len(vertices):
            return []
        first = poses[0]
        tree = cKDTree(vertices)
        for pose in poses[1:]:
            shift = pose.translation - first.translation
            moved = (vertices @ pose.rotation.T + shift) @ first.rotation
            if tree.query(moved)[0].max() > _ITSELF * np.ptp(vertices, axis=0).max():
                return []
        return [min(poses, key=lambda pose: turned_by(pose, expected))]
