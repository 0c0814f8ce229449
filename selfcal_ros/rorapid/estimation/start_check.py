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
Is the object really there? A test of a pose by what the estimate of it never looked at.

A pose is fitted to a few edgels on each line, and in clutter some edgels lie near any line. So
each line is looked at anew in many places: one that is there is seen along its whole length,
inside the object with one polarity, which chance hardly gives. A pose is confirmed by the share of
lines that are seen so, and by no other pose around (turned by some degrees, or by quarters) doing
better.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.edges.control_points import ControlModel, ControlView
from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.visibility.visible_mesh import visible_of

#: Places on a line, on a conic and on the outline of a mesh.
_ON_LINE, _ON_CONIC, _ON_OUTLINE = 16, 32, 180
#: An edgel within this of its line counts, pixels; so much of a line's length makes it seen.
_NEAR_PX, _SEEN = 1.75, 0.7
#: What an outline of changing polarity counts less, share of its length.
_TURNCOAT = 0.15
#: Lines seen, and length seen, of a pose that needs no further test ...
_PLAIN = 0.9, 0.85
#: ... of one that is called tracked, not only followed ...
_SURE = 0.8, 0.88
#: ... of one that is good if no other is better ...
_FAIR = 0.75, 0.8
#: ... of one that is better than all others by a margin: its faces may be painted ...
_ALONE, _MARGIN = (0.6, 0.75), 0.15
#: ... and of one that is so, and stays, image after image.
_LITTLE, _IMAGES = (0.45, 0.55), 5
#: Length seen of a lost object that its texture recognises: with faces, and of a round part, whose
#: pattern shows edges near any outline.
_RECOGNISED = 0.35, 0.65
#: Poses are alike that differ by less than this share of the length.
_ALIKE = 0.05
#: An outline is known where no other pose comes as near as this. What was never seen must be seen
#: whole besides: of 67 seen whole in 337 images of six parts five were another pose, of 41 with a
#: clear margin none.
_CLEAR, _WHOLE = 0.15, 0.95
#: Turns of the other poses, degrees.
_TURNS = 14.0, 28.0


@dataclass(frozen=True)
class Support:
    """
    How much of the object's lines an image shows.

    Attributes
    ----------
    lines : float
        Share of the lines (by length) that are seen along their length.
    length : float
        Share of the length that is seen.

    """

    lines: float = 0.0
    length: float = 0.0

    def reaches(self, bar: tuple[float, float]) -> bool:
        """Whether both shares reach a bar."""
        return self.lines >= bar[0] and self.length >= bar[1]


class StartCheck:
    """
    Confirms poses.

    Parameters
    ----------
    control : ControlModel
        Of the tracker; its lines are looked at in more places.
    least_contrast : float
        Weaker edges do not count, grey levels.

    """

    def __init__(self, control: ControlModel, least_contrast: float):
        """Take the model; places are laid out when they are first needed."""
        self._control, self._least = control, least_contrast
        self._dense: ControlModel | None = None
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._held = 0

    @property
    def dense(self) -> ControlModel:
        """The model with places all along its lines."""
        if self._dense is None:
            control = self._control
            try:
                visible = visible_of(control.visible_model.model, _ON_LINE, _ON_CONIC, _ON_OUTLINE)
            except ArgumentError:
                # too many tests: the places that the tracker looks at have to do
                visible = control.visible_model
            self._dense = ControlModel(visible, control.projection, control.image_size)
        self._dense.resize(self._control.image_size)
        return self._dense

    def support(self, image: np.ndarray, state: ObjectPose) -> Support:
        """Look all along the lines that a state shows, in an image (H, W) of uint8."""
        return self.seen(image, self.dense.view(state))

    def seen(self, image: np.ndarray, view: ControlView) -> Support:
        """Look at the places of a view only: fewer, where it is that of the tracker."""
        at = np.flatnonzero(view.searched & view.must_show)
        if not len(at):
            return Support()
        edgels = find_edgels(sample_normals(image, view.projected.pixels[at], view.normal[at], 4),
                             2, self._least)
        near = np.abs(edgels.offset) < _NEAR_PX
        primitive = view.primitive[at]
        count = np.bincount(primitive)
        sides = [np.bincount(primitive, (near & sign).any(axis=1))
                 for sign in (edgels.contrast > 0, edgels.contrast < 0)]
        # before a background of light and dark an outline may change its polarity
        outline = np.bincount(primitive, view.contour[at]) > 0
        either = np.bincount(primitive, near.any(axis=1)) * outline - _TURNCOAT * count
        seen = np.maximum(np.maximum(*sides), either) / np.maximum(count, 1)
        return Support(float(count @ (seen >= _SEEN)) / len(at), float(count @ seen) / len(at))

    def plain(self, support: Support) -> bool:
        """Whether a pose needs no further test."""
        return support.reaches(_PLAIN)

    def sure(self, support: Support) -> bool:
        """Whether this is the object without doubt, not one that is partly like it."""
        return support.reaches(_SURE)

    def fair(self, support: Support) -> bool:
        """Whether a pose is good, if no other is better."""
        return support.reaches(_FAIR)

    def alone(self, support: Support, turned: Support) -> bool:
        """Whether a pose is seen, and none that is turned from it comes near."""
        return support.reaches(_ALONE) and support.length >= turned.length + _MARGIN

    def stands_alone(self, support: Support, turned: Support) -> bool:
        """Whether a pose is without doubt, or seen well and better than all that are turned."""
        return self.sure(support) or self.alone(support, turned)

    def confirms(self, support: Support, rival: Support, turned: Support) -> bool:
        """
        Whether a start is confirmed; asked once an image.

        Parameters
        ----------
        support : Support
            Of the pose.
        rival : Support
            Of the best pose that was found from other starts; it may be the same.
        turned : Support
            Of the best one that is another.

        Returns
        -------
        bool

        """
        clear = support.length >= turned.length + _MARGIN
        self._held = self._held + 1 if support.reaches(_LITTLE) and clear else 0
        return (support.reaches(_PLAIN) or self._held >= _IMAGES or self.alone(support, turned)
                or support.reaches(_FAIR) and support.length >= rival.length - _ALIKE)

    def rivals(self, support: Support, rival: Support) -> bool:
        """Whether another pose is seen so well that lines do not decide."""
        return rival.length > support.length - (_CLEAR if self._control.is_outlined else _ALIKE)

    def stands_out(self, support: Support, was_seen: bool) -> bool:
        """Whether something that came in may be the object."""
        whole = not self._control.is_outlined or was_seen or support.length >= _WHOLE
        return whole and self.fair(support)

    def found(self, support: Support, by_texture: bool, was_seen: bool) -> bool:
        """Whether an object that was lost is found; its texture may have recognised it."""
        outlined = self._control.is_outlined
        if outlined and not was_seen and not self.sure(support):
            return False
        return support.reaches((0.0, _RECOGNISED[outlined]) if by_texture else _FAIR)


def turned(state: ObjectPose) -> list[ObjectPose]:
    """Return poses turned by some degrees about many axes."""
    signs = np.array([axis for axis in product((-1, 0, 1), repeat=3) if any(axis)], float)
    axes = signs / np.linalg.norm(signs, axis=1, keepdims=True)
    return [state.turned_to(rotation_matrix(np.deg2rad(angle) * axis) @ state.rotation)
            for angle in _TURNS for axis in axes]


def quartered(state: ObjectPose) -> list[ObjectPose]:
    """Return the 23 poses that are turned by quarters about the object's axes."""
    found = []
    for z in np.concatenate([np.eye(3), -np.eye(3)]):
        for x in np.concatenate([np.eye(3), -np.eye(3)]):
            quarter = np.column_stack([x, np.cross(z, x), z])
            if x @ z == 0 and np.trace(quarter) < 2.9:
                found.append(state.turned_to(state.rotation @ quarter))
    return found
