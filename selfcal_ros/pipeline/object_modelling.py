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
"""From a recording to a model of an object: which images, whose vertices, what scale."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.findings.phrase import put_in_words
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.rorapid.acquisition.line_matching import match_vertices, MatchedVertices
from selfcal_ros.rorapid.acquisition.picked_vertices import PickedVertices
from selfcal_ros.rorapid.acquisition.plane_loops import facing, plane_loops
from selfcal_ros.rorapid.acquisition.two_view_model import acquire_model, AcquiredModel

#: Where in a clip a partner of the first image is looked for, as a share of its length.
_PARTNERS = (0.25, 0.5, 0.75, 1.0)
#: Noise of a corner where lines that were found meet, and of one picked by hand, pixels. Measured:
#: 0.05 to 0.1 px on rendered objects, 0.5 px on the rounded corners of a wooden cube.
_FOUND_PX, _PICKED_PX = 0.1, 0.5


@dataclass(frozen=True)
class ModelRequest:
    """
    What model is wanted of which object.

    Parameters
    ----------
    camera : Camera
    length_m : float, optional
        Length of the longest line of the model, or of the one between two vertices.
    baseline_m : float, optional
        How far camera or object moved between the images; this or `length_m`.
    between : (str, str), optional
        The vertices of the known length: names of picked vertices, else their numbers.
    region : (left, top, right, bottom), optional
        Where the object is in the first image, pixels.
    picked : PickedVertices, optional
        In place of those that are found.
    exact : bool
        Leave picked vertices where they are, and do not move them onto the edges.
    faces : bool
        Make closed plane loops of the lines that were found opaque faces.
    name : str

    Raises
    ------
    ArgumentError
        If the scale is not given once, or is not positive.

    """

    camera: Camera
    length_m: float | None = None
    baseline_m: float | None = None
    between: tuple[str, str] | None = None
    region: tuple[float, float, float, float] | None = None
    picked: PickedVertices | None = None
    exact: bool = False
    faces: bool = True
    name: str = 'object'

    def __post_init__(self) -> None:
        """Check the scale and the region."""
        if self.length_m is not None and self.baseline_m is not None:
            raise ArgumentError('A length of the object and how far the camera moved both tell '
                                'how large it is; state one of them.')
        if self.length_m is None and self.baseline_m is None:
            raise ArgumentError('Two images do not tell how large an object is: state a length '
                                'of the object (--length), or how far the camera moved '
                                '(--baseline).')
        for value, what in ((self.length_m, 'length'), (self.baseline_m, 'distance moved')):
            if value is not None and not 0 < value < 1e6:
                raise ArgumentError(f'The {what} must be more than 0 and less than a million '
                                    f'metres, not {value:g}.')
        if self.between is not None and self.length_m is None:
            raise ArgumentError('Two vertices are named, but not the length between them.')
        if self.region is not None and not (self.region[0] < self.region[2]
                                            and self.region[1] < self.region[3]):
            raise ArgumentError('The region is left, top, right and bottom, in this order.')


@dataclass(frozen=True)
class ModelledObject:
    """
    A model with the images that it was made of.

    Parameters
    ----------
    acquired : AcquiredModel
    images : (int, int)
        Count of the two images in their recording, from 0.

    """

    acquired: AcquiredModel
    images: tuple[int, int]

    @property
    def start(self) -> str:
        """Pose of the object in the first image, as `selfcal track --init` takes it."""
        pose = np.concatenate([self.acquired.translation,
                               rotation_vector(self.acquired.rotation)])
        # far finer than a start must be, so that a zero is not some 1e-06
        step = 10.0 ** np.floor(np.log10(1e-3 * np.linalg.norm(self.acquired.translation)))
        pose[:3] = step * np.round(pose[:3] / step)
        pose[3:] = np.round(pose[3:], 4)
        # without the sign of a zero
        return ' '.join(f'{value:.6g}' for value in pose + 0.0)

    def text(self) -> str:
        """Return what was made, for a person."""
        model, structure = self.acquired.model, self.acquired.structure
        sigma = 1000 * np.sqrt(np.trace(structure.shape_covariances, axis1=1, axis2=2))
        bare = sum(not faces for faces in model.line_faces)
        first, second = self.images
        lines = [
            put_in_words('Model of {vertices} vertices, {lines} line{lines:plural} and {faces} '
                         'face{faces:plural}, ', {'vertices': len(model.vertices), 'lines': len(
                             model.lines), 'faces': len(model.faces)}) +
            f'{1000 * _across(model.vertices):.4g} mm across, from images {first} and {second}.',
            f'The vertices miss a pure translation by {structure.noise_px:.2g} px; between the '
            f'images it was {1000 * np.linalg.norm(structure.moved):.4g} mm.',
            f'Their places in the model are known to {np.median(sigma):.2g} mm (median) and '
            f'{sigma.max():.2g} mm (worst), if pixels are to {structure.sigma_px:.2g} px.']
        if bare and model.faces:
            lines.append(put_in_words(
                '{n} line{n:plural} {n:belongs|belong} to no face; nothing hides what is behind '
                '{n:it|them}.', {'n': bare}))
        if not model.faces:
            lines.append('No lines close to a face; nothing hides what is behind the object.')
        lines.append(f'Where it is in image {first}: --init "{self.start}"')
        return '\n'.join(lines)


def model_recording(source: FrameSource, request: ModelRequest,
                    images: tuple[int, int] | None = None,
                    seed: int = 0) -> ModelledObject | NoEstimate:
    """
    Make a model of an object from two images of a recording.

    Parameters
    ----------
    source : FrameSource
    request : ModelRequest
    images : (int, int), optional
        Which two, counted from 0. By default the first and the last, and where vertices are
        to be found also the first and some others: the pair with most lines wins.
    seed : int
        Of the samples of RANSAC.

    Returns
    -------
    ModelledObject or NoEstimate

    Raises
    ------
    InputError, ArgumentError
        If there are no such images, they are not of the camera's size, or vertices are named
        that the model does not have.

    """
    first, *others = _frames(source, images, request)
    outcomes = [(model_of_images(first.image, other.image, request,
                                 np.random.default_rng(seed)), other)
                for other in reversed(others)]
    made = [ModelledObject(acquired, (first.index, other.index)) for acquired, other in outcomes
            if not isinstance(acquired, NoEstimate)]
    if not made:
        return next(found for found, _ in outcomes if isinstance(found, NoEstimate))
    return max(made, key=lambda one: len(one.acquired.model.lines))


def _frames(source: FrameSource, images: tuple[int, int] | None, request: ModelRequest,
            ) -> list[Frame]:
    """Read the first image, and those that may be its partner."""
    if images is not None:
        if images[0] == images[1] or min(images) < 0:
            raise ArgumentError('The two images must be different, and are counted from 0.')
        found = {frame.index: frame for frame in _until(source, max(images))
                 if frame.index in images}
        if len(found) < 2:
            raise InputError(f'{source.path} has no image {max(images)}; images are counted '
                             'from 0.')
        frames = [found[index] for index in images]
    else:
        frames = _spread(source, request.picked is None)
    for frame in frames:
        size = frame.image.shape[1], frame.image.shape[0]
        camera = request.camera
        if camera.width and camera.height and size != (camera.width, camera.height):
            raise InputError(f'{frame.name} is {size[0]}x{size[1]} pixels, but the camera was '
                             f'calibrated at {camera.width}x{camera.height}.')
    return frames


def _across(vertices: np.ndarray) -> float:
    """Return the largest distance between two vertices."""
    return float(np.linalg.norm(vertices[:, None] - vertices, axis=2).max())


def _until(source: FrameSource, last: int) -> Iterator[Frame]:
    for frame in source:
        yield frame
        if frame.index >= last:
            return


def _spread(source: FrameSource, search: bool) -> list[Frame]:
    """Return the first and the last image, and if a partner is searched some between them."""
    try:
        count = len(source)
    except TypeError:
        count = 0
    wanted = {round(share * (count - 1)) for share in _PARTNERS} if search else set()
    frames: list[Frame] = []
    last = None
    for frame in source:
        if not frames or frame.index in wanted:
            frames.append(frame)
        last = frame
    if last is None or last.index == frames[0].index:
        raise InputError(f'{source.path} must hold two images of the object at least.')
    if frames[-1].index != last.index:
        frames.append(last)
    return frames


def model_of_images(first: np.ndarray, second: np.ndarray, request: ModelRequest,
                    rng: np.random.Generator) -> AcquiredModel | NoEstimate:
    """
    Make a model of an object from two images.

    Parameters
    ----------
    first, second : ndarray, shape (H, W), uint8
        Grey.
    request : ModelRequest
    rng : numpy.random.Generator
        For the samples of RANSAC.

    Returns
    -------
    AcquiredModel or NoEstimate

    Raises
    ------
    ArgumentError
        If vertices are named that the model does not have.

    """
    picked, camera = request.picked, request.camera
    names: list[str]
    if picked is None:
        reach = 0.5 * float(np.hypot(*first.shape))
        matched = match_vertices(first, second, camera, rng, request.region, reach)
        if isinstance(matched, NoEstimate):
            return matched
        names = [str(k) for k in range(len(matched.first_px))]
        parts: dict[str, Any] = {'lines': matched.lines}
    else:
        ends = (picked.first_px, picked.second_px) if request.exact else picked.refined(
            first, second)
        matched, names = MatchedVertices(*ends, list(picked.lines)), list(picked.names)
        parts = {'lines': picked.lines, 'faces': picked.faces, 'conics': picked.ellipses,
                 'frame': picked.frame}
    bare = acquire_model(matched.first_px, matched.second_px, camera, **parts, baseline_m=1.0)
    if isinstance(bare, NoEstimate):
        return bare
    if picked is None and request.faces:
        vertices = bare.model.vertices @ bare.rotation.T + bare.translation
        parts['faces'] = [facing(vertices, loop) for loop in plane_loops(vertices, matched.lines)]
        if not parts['faces']:
            return NoEstimate('no_closed_faces', lines=len(matched.lines))
    # what the points show of their noise, where that is more than usual
    sigma = max(_FOUND_PX if picked is None else _PICKED_PX, bare.structure.noise_px)
    return acquire_model(matched.first_px, matched.second_px, camera, **parts,
                         name=request.name, sigma_px=sigma, **_scale(request, bare, names))


def _scale(request: ModelRequest, bare: AcquiredModel, names: list[str]) -> dict[str, Any]:
    """Return the fact that fixes the scale."""
    if request.baseline_m is not None:
        return {'baseline_m': request.baseline_m}
    if request.between is None:
        edges = bare.model.edges()
        longest = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).argmax()
        i, j = bare.model.lines[longest]
    else:
        for name in request.between:
            if name not in names:
                raise ArgumentError(f'There is no vertex {name[:40]!r}; the vertices are '
                                    f'{", ".join(names[:20])}.')
        i, j = (names.index(name) for name in request.between)
        if i == j:
            raise ArgumentError('The known length is between two different vertices.')
    return {'known_length': (int(i), int(j), request.length_m)}
