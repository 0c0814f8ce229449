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
"""Matches of pairs joined into tracks, and their positions registered to sub-pixel accuracy."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from selfcal_ros.features.curvature import curvature_bias
from selfcal_ros.features.detection import Features
from selfcal_ros.features.matching import ImagePairMatches
from selfcal_ros.features.neighbours import local_turns
from selfcal_ros.features.registration import PatchRegistration
from selfcal_ros.geometry.camera import Camera

_REGISTRATION = PatchRegistration(half_px=7)
_MIN_CORRELATION = 0.75
_LEVELS = 3


def link(features: list[Features], matches: list[ImagePairMatches]):
    """
    Join the matches of image pairs into tracks.

    A component with two places in one image is cut down to the edges that a third image
    confirms; where that does not settle it, it is dropped.

    Parameters
    ----------
    features : list of Features
    matches : list of ImagePairMatches

    Returns
    -------
    image, place, track : ndarray of int, shape (N,)
        Position of the image, row of its features, and track 0, 1, ...
    dropped : int
        Components that contradicted themselves.

    """
    offset = np.concatenate([[0], np.cumsum([len(feature.xy) for feature in features])])
    image = np.repeat(np.arange(len(features)), np.diff(offset))
    none = np.empty(0, int)
    if not matches:
        return none, none, none, 0
    a = np.concatenate([offset[match.first] + match.a for match in matches])
    b = np.concatenate([offset[match.second] + match.b for match in matches])
    component, bad = _components(a, b, image)
    dubious = bad[component[a]]
    graph = sparse.coo_matrix((np.ones(2 * dubious.sum()),
                               (np.concatenate([a[dubious], b[dubious]]),
                                np.concatenate([b[dubious], a[dubious]]))),
                              shape=(len(image), len(image))).tocsr()
    keep = ~dubious
    # SciPy answers a sparse matrix, which has no truth value, where nothing is asked for
    if dubious.any():
        keep[dubious] = np.asarray((graph @ graph)[a[dubious], b[dubious]]).ravel() > 0
    component, still_bad = _components(a[keep], b[keep], image)
    size = np.bincount(component)
    good = (size[component] >= 2) & ~still_bad[component]
    node = np.flatnonzero(good)
    _, track = np.unique(component[node], return_inverse=True)
    return image[node], node - offset[image[node]], track.ravel(), int(still_bad.sum())


def _components(a, b, image):
    """Component of every node, and which components hold two places of one image."""
    count = len(image)
    graph = sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    number, component = connected_components(graph, directed=False)
    order = np.lexsort((image, component))
    twice = ((np.diff(component[order]) == 0) & (np.diff(image[order]) == 0))
    bad = np.zeros(number, bool)
    bad[component[order][1:][twice]] = True
    return component, bad


def refine(images, image: np.ndarray, track: np.ndarray, xy: np.ndarray, size_px: np.ndarray,
           camera: Camera | None = None):
    """
    Register every observation against one reference view of its track.

    The reference is the middle view, so that the deformation to the others stays small. A point
    that registration cannot follow (occlusion edge, strong deformation, poor texture) keeps its
    position. The reference itself counts as registered.

    Parameters
    ----------
    images : sequence of ndarray of uint8, shape (H, W)
    image, track : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    size_px : ndarray, shape (N,)
        Standard deviation of the blob: coarse ones are registered at a coarser scale.
    camera : Camera, optional
        Roughly that of the images, if it is wide: what its curvature does is taken off.

    Returns
    -------
    xy : ndarray, shape (N, 2)
    registered : ndarray of bool, shape (N,)
    sigma_px : ndarray, shape (N,)
        Standard deviation of each coordinate, predicted from texture and likeness; 0 for the
        references.

    """
    if not len(track):
        return xy.copy(), np.zeros(0, bool), np.zeros(0)
    order = np.lexsort((image, track))
    first = np.searchsorted(track[order], np.arange(track.max() + 1))
    length = np.bincount(track)
    reference = order[first + (length - 1) // 2]
    coarseness = np.clip(np.round(np.log2(size_px[reference] / 1.8)), 0, _LEVELS - 1).astype(int)
    refined, registered = xy.copy(), np.zeros(len(xy), bool)
    registered[reference] = True
    sigma = np.zeros(len(xy))
    smooth = [_pyramid(grey) for grey in images]
    turns = local_turns(image, xy, reference[track])
    for level in range(_LEVELS):
        scale = 2.0 ** level
        tracks = np.flatnonzero(coarseness == level)
        if not len(tracks):
            continue
        slot = np.full(len(length), -1)
        slot[tracks] = np.arange(len(tracks))
        base = reference[tracks]
        # whole pixels: the template is taken without interpolation, its residue added back
        anchor = np.round(xy[base] / scale)
        residue = xy[base] / scale - anchor
        templates = _gather(smooth, level, image[base], anchor)
        for k in range(len(images)):
            rows = np.flatnonzero((image == k) & (slot[track] >= 0) & ~registered)
            if not len(rows):
                continue
            at = slot[track[rows]]
            ratio = np.clip(size_px[rows] / size_px[reference[track[rows]]], 0.5, 2.0)
            start = turns[rows] * ratio[:, None, None]
            begin = xy[rows] / scale - (start @ residue[at][:, :, None])[:, :, 0]
            found, affine, correlation, step = _REGISTRATION.register(
                templates.select(at), smooth[k][level], begin, start)
            found = found + (affine @ residue[at][:, :, None])[:, :, 0]
            shift = np.linalg.norm(found - xy[rows] / scale, axis=1)
            good = (correlation > _MIN_CORRELATION) & (step < 0.05) & (shift < 2.5)
            found = found * scale
            if camera is not None:
                found -= scale**2 * curvature_bias(camera, xy[reference[track[rows]]], found,
                                                   affine)
            refined[rows[good]] = found[good]
            registered[rows[good]] = True
            sigma[rows] = scale * templates.position_sigma(correlation, at)
    return refined, registered, sigma


def _pyramid(grey):
    """Slightly smoothed levels (cv2.pyrDown keeps the centre of pixel (0, 0) in place)."""
    levels = [cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.7)]
    for _ in range(_LEVELS - 1):
        levels.append(cv2.pyrDown(levels[-1]))
    return levels


def _gather(smooth, level, image, xy):
    """Templates of points that lie in different images, in the order given."""
    parts, rows = [], []
    for k in np.unique(image):
        here = np.flatnonzero(image == k)
        parts.append(_REGISTRATION.templates(smooth[k][level], xy[here]))
        rows.append(here)
    whole = parts[0]
    for part in parts[1:]:
        whole = whole.extended(part)
    return whole.select(np.argsort(np.concatenate(rows)))
