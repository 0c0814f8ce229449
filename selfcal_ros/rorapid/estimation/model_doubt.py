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
Does the model fit the object, and the camera the image? A score test of what could be wrong.

With a wrong model each pose is a compromise, and what is left of the edges' distances has a
pattern: along one edge they grow, on one face they are all alike. Each pattern is one way of being
wrong by a share s: a focal length, the object stretched along one of its directions, a face
farther out, one edge longer. J are the rows of the pose, D those of the pattern, W the weights and
r the residuals of the last fit. D' = D - J (J'WJ)^-1 J'WD is what no pose can take up, and s = sum
D'Wr / sum D'WD'. The sums run over images; the spread of s comes from how far its lines disagree
(errors along one line are alike).

The scale of the whole model is none of the patterns: with one camera it cannot be told from the
distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.robust_loss import tukey_weight
from selfcal_ros.geometry.robust_scale import fast_robust_sigma
from selfcal_ros.geometry.small_system import solved
from selfcal_ros.rorapid.edges.control_points import ControlModel, ControlView
from selfcal_ros.rorapid.edges.edge_choice import clutter_weight
from selfcal_ros.rorapid.edges.edgels import BOW_OF_LANES, find_edgels, sample_normals
from selfcal_ros.rorapid.estimation.moved_corner import MEMORY, MovedCorners, STEP
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.values.mesh_orientation import oriented
from selfcal_ros.values.same_place import same_place
from selfcal_ros.values.wireframe import WireframeModel

#: Images that are looked at: each one at first, until so many; then every so many, until so many
#: looks and while in doubt; then every so many (so seldom that the time of 95 % is not touched).
_AT_ONCE, _EVERY, _FIRST, _LATER = 5, 3, 15, 25
#: Images of a verdict at the least.
_LEAST = 4
#: Search range, the same for a corner that is elsewhere, and Tukey's limit at the least and at the
#: most, pixels.
_REACH_PX, _FAR_PX, _LIMIT_PX = 8, 12, (1.5, 6.0)
#: Standard deviation of an edge, roughly, pixels.
_EDGE_PX = 0.3
#: A pattern stands out by so many sigmas, matters from this share on, and must explain this share
#: of the squared residuals: single edges more, for one of them always explains the most.
_SIGMAS = 5.0
#: A doubt stands until less than this part is left of what was said, by so many sigmas, and until
#: edges fit without it: an edge out of sight, and a pose that gives way, refute nothing.
_STANDS, _REFUTED = 0.5, 2.0
_MATTERS = {'focal': 0.02, 'stretch': 0.01, 'face': 0.01, 'edge': 0.03}
_EXPLAINS = {'focal': 0.15, 'stretch': 0.2, 'face': 0.2, 'edge': 0.3}
#: A pattern that explains so much of what the best one does is named beside it.
_RIVAL = 0.8
#: Models of more lines have the patterns of the whole object only.
_MOST_LINES = 60


@dataclass(frozen=True)
class Doubt:
    """
    What seems wrong.

    Attributes
    ----------
    kind : str
        'focal', 'stretch', 'face' or 'edge'.
    what : str
        Which part, in words.
    share, sigma : float
        By how much the model (or the focal length) is too long, and its standard deviation.
    others : tuple of str
        What explains the images nearly as well.

    """

    kind: str
    what: str
    share: float
    sigma: float
    others: tuple[str, ...] = ()

    def text(self) -> str:
        """Return one sentence."""
        side = 'long' if self.share > 0 else 'short'
        text = (f'{self.what} seems {100 * abs(self.share):.1f} ± {100 * self.sigma:.1f} % too '
                f'{side}')
        if self.others:
            text += f' (or it is {" or ".join(self.others)})'
        return text + '; the sigmas of the poses say what that does to them.'


@dataclass(frozen=True)
class _Pattern:
    kind: str
    what: str
    shift: np.ndarray | None            # (size, 3): control points, for s = 1; None: focal


class ModelDoubt:
    """
    Watches residuals for what the model or the camera gets wrong.

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
    least_contrast : float
        Weaker edges do not count, grey levels.

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, least_contrast: float):
        """Lay out the patterns."""
        self._control, self._least = control, least_contrast
        self.basis = basis
        self._patterns = patterns_of(control)
        shifts = np.array([p.shift for p in self._patterns if p.shift is not None])
        #: Of each control point by each pattern but the first, in x, y and z: (3, size, K - 1).
        self._shifts = np.ascontiguousarray(shifts.transpose(2, 1, 0)) if len(shifts) else None
        self._matters = np.array([_MATTERS[p.kind] for p in self._patterns])
        self._explains = np.array([_EXPLAINS[p.kind] for p in self._patterns])
        self._edges = np.flatnonzero([p.kind == 'edge' for p in self._patterns])
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        lines = len(self._control.visible_model.kind)
        self._images = self._looks = 0
        self._corners = MovedCorners(len(self._edges), lines)
        self._score = np.zeros((lines, len(self._patterns)))
        self._information = np.zeros_like(self._score)
        self._square = self._weight = 0.0
        self._pull = np.zeros((self.basis.shape[1], len(self._patterns)))
        self.doubt: Doubt | None = None
        self._named: int | None = None
        self._said = self._fits = 0.0
        self._bias = np.zeros(self.basis.shape[1])

    def due(self) -> bool:
        """Whether this image is to be looked at; asked once an image that was tracked."""
        self._images += 1
        every = _EVERY if self._looks < _FIRST or self.doubt is not None else _LATER
        return self._looks < _AT_ONCE or self._images % every == 0

    def look(self, image: np.ndarray, state: ObjectPose, view: ControlView) -> None:
        """
        Take in an image.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        state : ObjectPose
            As it was measured there.
        view : ControlView
            At that state.

        """
        at = np.flatnonzero(view.searched)
        if len(at) < 3 * self.basis.shape[1]:
            return
        projection = self._control.projection
        rows = projection.rows(state, view.projected, view.normal)[at] @ self.basis
        profiles = sample_normals(image, view.projected.pixels[at], view.normal[at], _FAR_PX)
        beyond = _FAR_PX - _REACH_PX
        offset, far = (find_edgels(part, 3, self._least).offset
                       - BOW_OF_LANES * view.curvature[at][:, None]
                       for part in (profiles[:, beyond:-beyond], profiles))
        offset, far = (np.where(np.isfinite(one), one, 1e6) for one in (offset, far))
        weight = clutter_weight(view)[at] / (1 + (6 / np.maximum(view.end_px[at], 1.0))**2)
        rows, prior = self._with_velocity(rows, view.projected.pixels[at])
        q, limit = np.zeros(rows.shape[1]), _LIMIT_PX[1]
        line = np.arange(len(at))
        for _ in range(3):
            distance = offset - (rows @ q)[:, None]
            chosen = offset[line, np.abs(distance).argmin(axis=1)]
            residual = chosen - rows @ q
            w = weight * tukey_weight(residual, limit)
            H = (rows * w[:, None]).T @ rows + prior
            q = solved(H, rows.T @ (w * np.where(w > 0, chosen, 0.0)))
            near = np.abs(residual) < limit
            if near.sum() < 3 * self.basis.shape[1]:
                return
            limit = float(np.clip(6 * fast_robust_sigma(residual[near], 0.1), *_LIMIT_PX))
        residual = np.where(w > 0, chosen - rows @ q, 0.0)
        slopes = self._slopes(state, view, at)
        self._corners.look(far - (rows @ q)[:, None], slopes[:, self._edges],
                           view.primitive[at], _FAR_PX)
        pull = solved(H, rows.T @ (w[:, None] * slopes))
        own = slopes - rows @ pull
        primitive = view.primitive[at]
        size = len(self._score)
        within = (np.arange(size)[:, None] == primitive) * w
        self._score = MEMORY * self._score + (within * residual) @ own
        self._information = MEMORY * self._information + within @ (own * own)
        self._square = MEMORY * self._square + float(w @ residual**2)
        self._weight = MEMORY * self._weight + float(w.sum())
        self._pull = pull[:self.basis.shape[1]]
        self._looks += 1
        self._judge()

    def _with_velocity(self, rows: np.ndarray, pixels: np.ndarray,
                       ) -> tuple[np.ndarray, np.ndarray]:
        """
        Add the velocity to what the edges may have moved by, where lines are read in turn.

        An object that moves faster than thought is sheared, which is no fault of its model.

        Returns
        -------
        rows : ndarray, shape (C, m) or (C, 2 m)
        prior : ndarray, shape (m, m) or (2 m, 2 m)
            Information of what the rows are of, in units of squared pixels.

        """
        m, motion = rows.shape[1], self._control.projection.row_motion
        if motion is None:
            return rows, 1e-9 * np.eye(m)
        prior = 1e-9 * np.eye(2 * m)
        known = self.basis.T @ motion.covariance @ self.basis + 1e-12 * np.eye(m)
        prior[m:, m:] += _EDGE_PX**2 * np.linalg.inv(known)
        return np.hstack([rows, rows * motion.seconds(pixels)[:, None]]), prior

    def _slopes(self, state: ObjectPose, view: ControlView, at: np.ndarray) -> np.ndarray:
        """Motion along the normals for s = 1 of each pattern, (C, K) pixels."""
        projection = self._control.projection
        # a shift of a point is a shift of the object for that point alone
        rows = projection.rows(state, view.projected, view.normal)[at]
        x, y, z = (rows[:, 3:6] @ state.rotation).T[:, :, None]
        out = np.empty((len(at), len(self._patterns)))
        out[:, 0] = ((view.projected.pixels[at] - projection.camera.K[:2, 2])
                     * view.normal[at]).sum(axis=1)
        if self._shifts is not None:
            in_x, in_y, in_z = self._shifts[:, view.ids[at]]
            out[:, 1:] = in_x * x + in_y * y + in_z * z
        return out

    def _judge(self) -> None:
        """Say what stands out."""
        total = self._information.sum(axis=0)
        share = self._score.sum(axis=0) / np.maximum(total, 1e-12)
        rest = self._score - share * self._information
        count = (self._information > 1e-3 * total).sum(axis=0)
        sigma = np.sqrt((rest**2).sum(axis=0) * count / np.maximum(count - 1, 1)) \
            / np.maximum(total, 1e-12)
        gain = share**2 * total / max(self._square, 1e-12)
        usable = (count >= 3) & (total > 0)
        out = usable & (np.abs(share) > _SIGMAS * sigma) & (
            gain > self._explains) & (np.abs(share) > self._matters)
        if self._looks < _LEAST:
            return
        named, moved = self._named, None if out.any() else self._corners.found()
        if moved is not None:
            # the pose leaves the lines of that corner aside, as clutter, and is not moved by it
            self._named, self._bias = None, np.zeros_like(self._bias)
            self.doubt = Doubt('edge', self._patterns[self._edges[moved.pattern]].what,
                               -moved.share, STEP)
            return
        if named is not None and not self._refuted(share[named], sigma[named]):
            out[named] = True
        if not out.any():
            self.doubt = self._named = None
            return
        kinds = [p.kind for p in self._patterns]
        best = int(np.argmax(np.where(out, gain, 0.0)))
        pattern = self._patterns[best]
        others = [f't{self._patterns[k].what[1:]}' for k in np.argsort(-gain)
                  if usable[k] and kinds[k] != kinds[best] and gain[k] > _RIVAL * gain[best]]
        # of the picture's side: a model too long shows edgels nearer in
        self.doubt = Doubt(pattern.kind, pattern.what, -float(share[best]), float(sigma[best]),
                           tuple(others[:2]))
        self._bias = self._pull[:, best] * share[best]
        if best != named:
            self._named, self._said = best, float(share[best])
            self._fits = (1 - _STANDS * gain[best]) * self._square / self._weight

    def _refuted(self, share: float, sigma: float) -> bool:
        """Whether too little is left of what was said, and edges fit without it."""
        left = share * np.sign(self._said)
        return (left + _REFUTED * sigma < _STANDS * abs(self._said)
                and self._square / self._weight < self._fits)

    def bias(self) -> np.ndarray | None:
        """Return by how much the doubt moves the pose, (m,), roughly; None without doubt."""
        return None if self.doubt is None else self._bias


def patterns_of(control: ControlModel) -> list[_Pattern]:
    """Return the ways in which a camera and a model can be wrong; the focal length first."""
    visible = control.visible_model.faceted
    if visible is None:
        return []
    model = visible.model
    found = [_Pattern('focal', "The camera's focal length", None)]
    places = visible.resting_points() - control.centre
    for axis, name in zip(_directions(model), 'abc'):
        found.append(_Pattern('stretch', f'The model along {_named(axis)}',
                              (places @ axis)[:, None] * axis))
    if len(model.lines) > _MOST_LINES:
        return found
    size = model.diameter_m
    points = model.vertices
    outward = _outward_normals(model)
    for k, face in enumerate(model.faces):
        normal = outward[k]
        height = (points - points[face.indices[0]]) @ normal
        extent = float(np.ptp(points @ normal))
        if extent > 0.02 * size:
            step = np.where(np.abs(height) < 1e-3 * size, extent, 0.0)[:, None] * normal
            on = np.abs((places + control.centre - points[face.indices[0]]) @ normal)
            shift = visible.carried(step)
            free = visible.free_points
            shift[free] = np.where(on[free, None] < 1e-3 * size, extent * normal, 0.0)
            found.append(_Pattern('face', f'The model from face {face.name or k} inwards', shift))
    internal = model.internal
    for k, (a, b) in enumerate(model.lines):
        if internal[k]:
            continue
        name = model.line_names[k] or f'{a}-{b}'
        for near, far in ((a, b), (b, a)):
            step = np.zeros_like(points)
            step[model.same(far)] = points[far] - points[near]
            found.append(_Pattern('edge', f'The edge {name} of the model', visible.carried(step)))
    return found


def _outward_normals(model: WireframeModel) -> np.ndarray:
    """Unit normals (F, 3) of the faces that lead out of the object, however they are wound."""
    normals = model.face_normals.copy()
    if not len(normals):
        return normals
    triangles = same_place(model.vertices)[model.triangles]
    turned, _ = oriented(model.vertices, triangles)
    normals[model.triangle_face[turned[:, 0] != triangles[:, 0]]] *= -1
    flat = 1e-3 * model.diameter_m
    for normal, face in zip(normals, model.faces):
        height = (model.vertices - model.vertices[face.indices[0]]) @ normal
        # where all of the object is on one side, that is inside, be it closed or not
        if height.min() > -flat and height.max() > flat:
            normal *= -1
    return normals


def _directions(model: WireframeModel) -> list[np.ndarray]:
    """Return up to three directions in which most of the edges run."""
    ends = model.edges()
    spans = ends[:, 1] - ends[:, 0]
    if not len(spans):
        return list(np.eye(3))
    lengths = np.linalg.norm(spans, axis=1)
    unit = spans / lengths[:, None]
    found: list[np.ndarray] = []
    left = lengths.copy()
    while len(found) < 3 and left.max() > 0:
        alike = np.abs(unit @ unit.T) > np.cos(np.deg2rad(10))
        best = int(np.argmax((alike * left).sum(axis=1) * (left > 0)))
        axis = unit[best]
        found.append(axis)
        left[np.abs(unit @ axis) > np.cos(np.deg2rad(30))] = 0
    return found


def _named(axis: np.ndarray) -> str:
    """Name a direction."""
    k = int(np.abs(axis).argmax())
    if abs(axis[k]) > 0.999:
        return f'its {"xyz"[k]}'
    return f'its direction ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f})'
