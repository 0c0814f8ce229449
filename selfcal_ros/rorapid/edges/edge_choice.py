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
"""Which edge is the right one: polarity, strength, memory, and what runs alongside."""

from __future__ import annotations

import numpy as np
from selfcal_ros.rorapid.edges.control_points import ControlView

#: Control points with another primitive so close alongside count little.
_CLUTTER_PX, _CLUTTER_LENGTH_PX, _CLUTTERED = 5.0, 15.0, 0.1
#: Cosine of the angle between primitives that run alongside, at the least.
_ALONGSIDE = 0.94
#: The contrast of an edge changes by this factor at the most while it is the same edge.
_CHANGE = 2.5
#: Of so many places, this share must have changed alike, up to this factor: then it is the light
#: that changed, and by this (logarithm) at the most.
_LIGHT_PLACES, _LIGHT_AGREE, _LIGHT_LIKE, _MOST_LIGHT = 12, 0.7, 1.5, np.log(8)
#: A weaker edge than the strongest of a control point seems up to so much further away, pixels.
_WEAK_PX = 5.0
#: An edge of the wrong polarity seems so much further away, pixels.
_WRONG_SIGN_PX = 3.0


def contrast_penalty(contrast: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """
    Pixels by which an edge seems further away than it is, for it does not look right.

    Parameters
    ----------
    contrast : ndarray, shape (C, K)
    wanted : ndarray, shape (C,)
        Remembered contrast, 0 where none is: then the strongest edge is preferred.

    Returns
    -------
    ndarray, shape (C, K)

    """
    size = np.abs(contrast)
    strongest = np.maximum(size.max(axis=1, keepdims=True, initial=0.0), 1e-6)
    weak = np.where(wanted[:, None] == 0, _WEAK_PX * (1 - size / strongest), 0.0)
    return np.where(contrast * wanted[:, None] < 0, _WRONG_SIGN_PX, weak)


def contrast_matches(contrast: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Whether edges look as they are remembered, (C,); what is not remembered may be anything."""
    ratio = contrast / np.where(wanted == 0, 1.0, wanted)
    alike: np.ndarray = (wanted == 0) | ((ratio > 1 / _CHANGE) & (ratio < _CHANGE))
    return alike


def change_of_light(contrast: np.ndarray, wanted: np.ndarray) -> float:
    """
    Factor that all contrasts (C,) have changed by against what is remembered, for it is a lamp's.

    1 where few are remembered, or they do not agree: then these are other edges.
    """
    known = np.flatnonzero(contrast * wanted > 0)
    if len(known) < _LIGHT_PLACES or len(known) < _LIGHT_AGREE * np.count_nonzero(wanted):
        return 1.0
    change = np.log(contrast[known] / wanted[known])
    inorder = np.sort(change)
    # np.median takes ten times as long on so few
    common = float(0.5 * (inorder[(len(inorder) - 1) // 2] + inorder[len(inorder) // 2]))
    agree = np.mean(np.abs(change - common) < np.log(_LIGHT_LIKE))
    return float(np.exp(common)) if agree >= _LIGHT_AGREE and abs(common) < _MOST_LIGHT else 1.0


def clutter_weight(view: ControlView) -> np.ndarray:
    """
    Weight of control points by how near other primitives run alongside, (C,).

    Where lines of a face seen from its edge lie close together, an edgel may be that of the next.
    Points that are not searched have weight 1.
    """
    at = np.flatnonzero(view.searched)
    weight = np.ones(len(view.ids))
    if not len(at):
        return weight
    pixels = view.projected.pixels[at].astype(np.float32)
    normal = view.normal[at].astype(np.float32)
    # pieces of one outline do not disturb each other
    primitive = np.minimum(view.primitive[at], view.outline)
    # a line is its first point and its last; a curve is all of its points
    ends = np.flatnonzero(primitive[1:] != primitive[:-1])
    head, tail = np.append(0, ends + 1), np.append(ends, len(at) - 1)
    bent = (view.curvature[at] != 0) | (primitive == view.outline)
    if bent.any():
        curve = np.flatnonzero(bent)
        straight = ~bent[head]
        head, tail = np.append(head[straight], curve), np.append(tail[straight], curve)
    across = normal[head]
    along = pixels @ np.stack([-across[:, 1], across[:, 0]])
    line = np.arange(len(head))
    one, other = along[head, line], along[tail, line]
    clutter = np.abs(pixels @ across.T - np.einsum('hi,hi->h', pixels[head], across)) < _CLUTTER_PX
    clutter &= primitive[:, None] != primitive[head]
    clutter &= along > np.minimum(one, other) - _CLUTTER_LENGTH_PX
    clutter &= along < np.maximum(one, other) + _CLUTTER_LENGTH_PX
    clutter &= np.abs(normal @ across.T) > _ALONGSIDE
    weight[at[clutter.any(axis=1)]] = _CLUTTERED
    return weight
