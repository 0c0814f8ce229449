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
"""What the tracker saw, drawn over the image; and a video of it."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.values.wireframe import across_axes, WireframeModel

#: Pieces of the net that is drawn over a mesh, at the most.
MESH_PIECES = 1000
#: bgr, from a palette that colour-blind people can tell apart.
FOUND = (115, 158, 0)
REJECTED = (0, 94, 213)
MISSING = (0, 159, 230)
HIDDEN = (150, 150, 150)
AXES = ((60, 60, 230), (60, 200, 60), (230, 120, 40))
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
#: Bits behind the binary point of coordinates that OpenCV draws at.
_SHIFT = 4
#: Pieces that a straight edge is drawn in, for the lens bends it.
_PIECES = 12


def draw_overlay(image: np.ndarray, tracked: TrackedFrame | None,
                 model: WireframeModel | None = None,
                 camera: Camera | None = None, text: str = '', line: int = 0, name: str = ''
                 ) -> np.ndarray:
    """
    Draw the tracked object over its image.

    Lines are coloured by what became of their control points: green found, vermilion rejected,
    orange nothing found, grey hidden. A small cross marks each edgel.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        Left as it is.
    tracked : TrackedFrame or None
        None: there is nothing to draw but the text.
    model : WireframeModel, optional
        With the camera: axes of the object.
    camera : Camera, optional
    text : str
        In place of the state and its reason.
    line : int
        That the text stands on, from above: one for each object.
    name : str
        Of the object, before the text.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
        bgr.

    """
    drawn = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    thick = max(1, round(min(drawn.shape[:2]) / 480))
    if tracked is not None:
        _draw_points(drawn, tracked, thick, 0 if model is None else len(model.lines),
                     model is not None and model.is_outlined)
        if model is not None and camera is not None and tracked.state is not TrackerState.LOST \
                and tracked.camera_model in ('perspective', 'zoom'):
            _draw_axes(drawn, tracked, model, camera, thick)
    text = text or _state_text(tracked)
    _draw_text(drawn, f'{name}: {text}' if name and text else text, thick, line)
    return drawn


def _draw_points(drawn: np.ndarray, tracked: TrackedFrame, thick: int, lines: int, outlined: bool,
                 ) -> None:
    """
    Draw the primitives through their control points, and the edgels; lines up to their ends.

    Of an outline that comes and goes between parts neighbours are not known: each of its places is
    drawn along its own tangent.
    """
    points = tracked.image_px
    if not len(points):
        return
    usable = np.isfinite(points).all(axis=1) & (np.abs(points) < 1e5).all(axis=1)
    colour = np.where(tracked.hidden, 3, np.where(tracked.found, 0,
                                                  np.where(tracked.rejected, 1, 2)))
    follows = (tracked.primitive[1:] == tracked.primitive[:-1]) & usable[1:] & usable[:-1]
    # a segment shows the worse of its ends
    worse = np.array([0, 2, 1, 3])[colour]
    worse = np.array([0, 2, 1, 3])[np.maximum(worse[1:], worse[:-1])]
    segments = np.stack([points[:-1], points[1:]], axis=1)
    # control points lie in the middle of equal shares of a line
    first = np.append(True, tracked.primitive[1:] != tracked.primitive[:-1])[:-1]
    last = np.append(tracked.primitive[1:] != tracked.primitive[:-1], True)[1:]
    step = 0.5 * (segments[:, 1] - segments[:, 0]) * (tracked.primitive[:-1] < lines)[:, None]
    segments[first, 0] -= step[first]
    segments[last, 1] += step[last]
    if outlined:
        follows &= tracked.primitive[:-1] < lines
        rim = np.flatnonzero(usable & (tracked.primitive >= lines))
        along = _half_step_px(points[rim]) * np.stack(
            [-tracked.normal[rim, 1], tracked.normal[rim, 0]], axis=1)
        segments = np.concatenate([segments, np.stack([points[rim] - along, points[rim] + along],
                                                      axis=1)])
        follows = np.append(follows, np.ones(len(rim), bool))
        worse = np.append(worse, colour[rim])
    for kind, bgr in ((3, HIDDEN), (2, MISSING), (1, REJECTED), (0, FOUND)):
        chosen = segments[follows & (worse == kind)]
        if tracked.state is TrackerState.LOST:
            bgr = HIDDEN
        if len(chosen):
            cv2.polylines(drawn, list(_fixed(chosen)), False, bgr, 1 if kind == 3 else 2 * thick,
                          cv2.LINE_AA, _SHIFT)
    edgels = usable & np.isfinite(tracked.edge_px) & ~tracked.hidden
    if not edgels.any() or tracked.state is TrackerState.LOST:
        return
    at = points[edgels] + tracked.normal[edgels] * tracked.edge_px[edgels, None]
    along = 3.0 * thick * tracked.normal[edgels]
    for good, bgr in ((True, _WHITE), (False, REJECTED)):
        rows = tracked.found[edgels] == good
        if rows.any():
            ticks = np.stack([at[rows] - along[rows], at[rows] + along[rows]], axis=1)
            cv2.polylines(drawn, list(_fixed(ticks)), False, bgr, 1, cv2.LINE_AA, _SHIFT)


def _half_step_px(points: np.ndarray) -> float:
    """Half of the usual distance from a place to its nearest neighbour, pixels."""
    if len(points) < 2:
        return 0.0
    return 0.5 * float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))


def _draw_axes(drawn: np.ndarray, tracked: TrackedFrame, model: WireframeModel, camera: Camera,
               thick: int) -> None:
    """Draw the object's x, y and z from its origin: red, green, blue."""
    length = 0.25 * model.diameter_m
    axes = np.linspace(0, length, _PIECES)[None, :, None] * np.eye(3)[:, None]
    pixels = project_tracked(axes.reshape(-1, 3), tracked, camera).reshape(3, _PIECES, 2)
    for line, bgr in zip(pixels, AXES):
        if np.isfinite(line).all() and (np.abs(line) < 1e5).all():
            cv2.polylines(drawn, list(_fixed(line[None])), False, bgr, thick, cv2.LINE_AA, _SHIFT)


def zoomed_camera(camera: Camera, tracked: TrackedFrame) -> Camera:
    """Return the camera at the focal length of an image; the aspect ratio stays."""
    K = camera.K.copy()
    K[:2, :2] *= tracked.focal_px / camera.K[0, 0]
    return Camera(K, camera.distortion, camera.width, camera.height, camera.model)


def wireframe_segments(model: WireframeModel, pieces: int = 24) -> np.ndarray:
    """
    Return a model as straight pieces, to be drawn in space.

    Parameters
    ----------
    model : WireframeModel
    pieces : int
        Of a circle.

    Returns
    -------
    ndarray, shape (N, 2, 3)
        Metres, in the frame of the object.

    """
    angles = np.linspace(0, 2 * np.pi, pieces + 1)
    parts = [model.edges()]
    net = model.surface_net
    if len(net):
        # not finer than can be seen
        parts.append(net[::-(-len(net) // MESH_PIECES)])
    parts += [_chain(conic.points(angles)) for conic in model.conics]
    for cylinder in model.cylinders:
        u, v = across_axes(cylinder)
        ring = cylinder.radius_m * (np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v)
        parts += [_chain(cylinder.start + ring), _chain(cylinder.end + ring),
                  np.stack([cylinder.start + ring, cylinder.end + ring], axis=1)[::pieces // 4]]
    return np.concatenate(parts)


def _chain(points: np.ndarray) -> np.ndarray:
    return np.stack([points[:-1], points[1:]], axis=1)


def project_tracked(points: np.ndarray, tracked: TrackedFrame, camera: Camera) -> np.ndarray:
    """
    Project points (N, 3) of the object at a tracked pose and focal length: (N, 2) pixels.

    NaN behind the camera. Of the perspective camera models only.
    """
    seen = points @ tracked.rotation.T + tracked.translation
    depth = np.where(seen[:, 2] > 1e-6, seen[:, 2], np.nan)
    return zoomed_camera(camera, tracked).pixels(seen[:, :2] / depth[:, None])


def _state_text(tracked: TrackedFrame | None) -> str:
    """Say how things stand."""
    if tracked is None:
        return ''
    text = tracked.state.value.upper()
    if tracked.state in (TrackerState.TRACKING, TrackerState.DEGRADED):
        # the fonts of OpenCV have no other letters than ASCII
        text += f'  {100 * tracked.share_found:.0f} %'
        if np.isfinite(tracked.rms_px):
            text += f'  {tracked.rms_px:.2f} px'
        if tracked.focal_sigma_px > 0:
            text += f'  f {tracked.focal_px:.0f} +- {tracked.focal_sigma_px:.1f} px'
    return f'{text}  {tracked.reason}' if tracked.reason else text


def _draw_text(drawn: np.ndarray, text: str, thick: int, line: int) -> None:
    """Write a line into the upper left corner, as small as it must be to fit."""
    text = text.encode('ascii', 'replace').decode()
    if not text:
        return
    scale = 0.45 * thick
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)
    room = drawn.shape[1] - 12
    if width > room:
        scale *= max(room / width, 0.55)
    top = line * (height + base + 8)
    where = (6, top + height + 6)
    cv2.rectangle(drawn, (0, top), (min(width, room) + 12, top + height + base + 8), _BLACK,
                  cv2.FILLED)
    cv2.putText(drawn, text, where, cv2.FONT_HERSHEY_SIMPLEX, scale, _WHITE, thick, cv2.LINE_AA)


def _fixed(lines: np.ndarray) -> np.ndarray:
    """Return coordinates as OpenCV takes them, with a binary point."""
    return np.asarray(np.rint(lines * (1 << _SHIFT)).astype(np.int32))
