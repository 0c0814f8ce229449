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
"""A mesh whose faces are all plane is a polyhedron: each face has edges, and its own texture."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from selfcal_ros.errors import ArgumentError
from selfcal_ros.values.mesh import CREASE_RAD, MeshModel
from selfcal_ros.values.mesh_orientation import borders
from selfcal_ros.values.wireframe import FACE_LIMIT, FLAT_RAD, Polygon, WireframeModel

#: A mesh of more plane faces is followed as a mesh.
_MOST_FACES = 60


def polyhedron(mesh: MeshModel) -> WireframeModel | None:
    """
    Return a mesh as a model of plane faces.

    Parameters
    ----------
    mesh : MeshModel

    Returns
    -------
    WireframeModel or None
        None where the mesh is open, has more than 60 faces or a face with a hole. None, too, where
        faces meet in less than a crease: then it is round, or nearly so.

    """
    triangles, normals = mesh.triangles, mesh.normals
    ends = borders(triangles)
    owner = np.tile(np.arange(len(triangles)), 3)
    _, edge, size = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True,
                              return_counts=True)
    if (size != 2).any():
        return None
    one, other = np.argsort(edge.ravel(), kind='stable').reshape(-1, 2).T
    bend = (normals[owner[one]] * normals[owner[other]]).sum(axis=1)
    flat = bend > np.cos(FLAT_RAD)
    if not (flat | (bend < np.cos(CREASE_RAD))).all():
        return None
    links = owner[one[flat]], owner[other[flat]]
    count, face = connected_components(coo_matrix(
        (np.ones(len(links[0])), links), shape=2 * (len(triangles),)), directed=False)
    if count > _MOST_FACES:
        return None
    sharp = np.concatenate([one[~flat], other[~flat]])
    loops = [_loop(mesh.vertices, ends[sharp[face[owner[sharp]] == k]]) for k in range(count)]
    faces = [Polygon(tuple(loop)) for loop in loops if loop is not None]
    if len(faces) < count:
        return None
    try:
        return WireframeModel.build(mesh.vertices, faces=faces, name=mesh.name,
                                    remarks=mesh.remarks)
    except ArgumentError:
        return None                      # a border that touches itself


def _loop(vertices: np.ndarray, around: np.ndarray) -> list[int] | None:
    """Corners of a face in order, from its directed borders (N, 2); None unless it is one loop."""
    after = dict(around.tolist())
    loop = [int(around[0, 0])] if len(around) else []
    while loop and len(loop) < len(around) and after[loop[-1]] != loop[0]:
        loop.append(after[loop[-1]])
    if not loop or len(after) < len(around) or len(loop) < len(around):
        return None
    span = vertices[np.roll(loop, -1)] - vertices[loop]
    span /= np.linalg.norm(span, axis=1)[:, None]
    # a corner in the middle of a straight border is none
    corner = (span * np.roll(span, 1, axis=0)).sum(axis=1) < np.cos(FLAT_RAD)
    loop = [vertex for vertex, kept in zip(loop, corner) if kept]
    return loop if 3 <= len(loop) <= FACE_LIMIT else None
