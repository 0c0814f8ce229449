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
"""Which camera file is which, and one entry each for reading and writing any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files import colmap_cameras, kalibr_chain, mrcal_model
from selfcal_ros.report.camera_files.colmap_cameras import (colmap_binary, colmap_text, is_colmap,
                                                            parse_colmap_binary,
                                                            parse_colmap_text)
from selfcal_ros.report.camera_files.kalibr_chain import kalibr_text, parse_kalibr
from selfcal_ros.report.camera_files.mrcal_model import is_mrcal, mrcal_text, parse_mrcal
from selfcal_ros.report.camera_files.opencv_storage import (is_opencv, OPENCV_MODELS, opencv_text,
                                                            parse_opencv)
from selfcal_ros.report.camera_files.stored import StoredCamera
from selfcal_ros.report.camera_uncertainty import stored_uncertainty
from selfcal_ros.report.camera_yaml import (camera_from_document, camera_yaml, is_kalibr,
                                            ROS_MODELS)
from selfcal_ros.report.result_json import result_from_dict
from selfcal_ros.report.shutter_comment import stored_line_delay
from selfcal_ros.report.yaml_text import decoded, load_yaml, MAX_BYTES, read_bytes
from selfcal_ros.values.output_files import atomic_write

#: File names without suffix that COLMAP reads.
_COLMAP_NAMES = ('cameras.bin', 'cameras.txt')
#: That of mrcal's camera models.
MRCAL_SUFFIX = '.cameramodel'
#: Suffixes of files that may hold cameras.
CAMERA_SUFFIXES = ('.yaml', '.yml', '.xml', '.json', '.txt', '.bin', MRCAL_SUFFIX)


@dataclass(frozen=True)
class Format:
    """
    A kind of camera file that can be written.

    Attributes
    ----------
    title : str
        Whose it is.
    holds : callable
        Tells whether the format has the lens model of a camera, exactly.

    """

    title: str
    holds: Callable[[Camera], bool]


FORMATS = {
    'ros': Format('ROS', lambda camera: camera.model in ROS_MODELS),
    'opencv': Format('OpenCV', lambda camera: camera.model in OPENCV_MODELS),
    'kalibr': Format('Kalibr', kalibr_chain.holds),
    'colmap': Format('COLMAP', colmap_cameras.holds),
    'mrcal': Format('mrcal', mrcal_model.holds),
}


def is_camera_file(path: str | Path) -> bool:
    """Tell by its name whether a file, or the folder of a COLMAP model, may hold a camera."""
    path = Path(path)
    if path.is_dir():
        return any((path / name).is_file() for name in _COLMAP_NAMES)
    return path.suffix.lower() in CAMERA_SUFFIXES


def read_cameras(path: str | Path, *, fisheye: bool = False,
                 image_size: tuple[int, int] | None = None) -> tuple[str, list[StoredCamera]]:
    """
    Read all cameras of a file of ROS, OpenCV, Kalibr, COLMAP or mrcal, or of our result.json.

    Parameters
    ----------
    path : str or Path
        The kind is known by the content; a folder must hold COLMAP's cameras.bin or cameras.txt.
    fisheye : bool
        The coefficients of an OpenCV file are those of cv2.fisheye.
    image_size : (int, int), optional
        For OpenCV files that do not tell.

    Returns
    -------
    kind : {'ros', 'opencv', 'kalibr', 'colmap', 'mrcal', 'result'}
    cameras : list of StoredCamera

    Raises
    ------
    InputError
        If there is no camera, or it has no exact counterpart here.

    """
    path = Path(path)
    if path.is_dir():
        path = next((path / name for name in _COLMAP_NAMES if (path / name).is_file()), path)
    suffix, source = path.suffix.lower(), str(path)
    raw = read_bytes(path, mrcal_model.MAX_BYTES if suffix == MRCAL_SUFFIX else MAX_BYTES)
    if suffix == '.bin':
        return 'colmap', parse_colmap_binary(raw, source)
    text = decoded(raw, source)
    if is_opencv(text):
        return 'opencv', parse_opencv(text, source, fisheye, image_size)
    if fisheye:
        raise InputError(f'{source} is no OpenCV file and says itself what its lens is; leave '
                         '--fisheye out.')
    if suffix == MRCAL_SUFFIX or is_mrcal(text):
        return 'mrcal', parse_mrcal(text, source)
    if text.lstrip().startswith('{'):
        return 'result', _from_result(text, source)
    if is_colmap(text):
        return 'colmap', parse_colmap_text(text, source)
    document = load_yaml(text, source)
    if is_kalibr(document):
        return 'kalibr', parse_kalibr(document, source)
    camera, name = camera_from_document(document, source)
    delay, lines = stored_line_delay(text) or (None, 'rows')
    return 'ros', [StoredCamera(camera, name, covariance=stored_uncertainty(text, camera),
                                line_delay_s=delay, lines=lines)]


def read_camera(path: str | Path, which: str | None = None, option: str = '--camera',
                **options: Any) -> StoredCamera:
    """
    Read one camera of a file; see `read_cameras`.

    Parameters
    ----------
    path : str or Path
    which : str, optional
        Its name, when the file has several: cam1, for example, left of a rig, or the number of a
        COLMAP camera.
    option : str
        What the user names it with.

    Raises
    ------
    InputError
        If there is no such camera, or there are several and none is named.

    """
    return chosen(path, read_cameras(path, **options)[1], which, option)


def chosen(path: str | Path, cameras: list[StoredCamera], which: str | None = None,
           option: str = '--camera') -> StoredCamera:
    """Choose one of the cameras of a file; see `read_camera`."""
    if which is None and len(cameras) == 1:
        return cameras[0]
    names = ', '.join(camera.name for camera in cameras[:12])
    if which is None:
        raise InputError(f'{path} holds {len(cameras)} cameras, choose one with {option}: '
                         f'{names}.')
    found = [camera for camera in cameras if which in (camera.name,
                                                       camera.name.removeprefix('camera_'))]
    if not found:
        raise InputError(f'{path} has no camera {which}; it has {names}.')
    return found[0]


def write_camera(path: str | Path, kind: str, camera: Camera, name: str = 'camera',
                 topic: str = '', replace: bool = True) -> Path:
    """
    Write a camera file; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
        For OpenCV a suffix .xml makes XML, for COLMAP .bin makes cameras.bin.
    kind : {'ros', 'opencv', 'kalibr', 'colmap', 'mrcal'}
    camera : Camera
        With its image size.
    name : str
        Name inside a file of ROS.
    topic : str
        Image topic inside a file of Kalibr.
    replace : bool
        Whether a file with content may be replaced.

    Raises
    ------
    ArgumentError
        If the format cannot hold the camera exactly; the sentence says which can.
    InputError
        If the file cannot be written.

    """
    suffix = Path(path).suffix.lower()
    if not FORMATS[kind].holds(camera):
        others = [other.title for other in FORMATS.values() if other.holds(camera)]
        named = ', '.join(others[:-1]) + (' and ' if others[1:] else '') + ''.join(others[-1:])
        # the usual camera file of ours, but for a number that is nearly nothing
        only_k3 = kind == 'kalibr' and camera.distortion_as('plumb_bob') is not None
        raise ArgumentError(f'{FORMATS[kind].title} has no model for the {camera.model} '
                            f'distortion of this camera; {named} have'
                            f'{", or calibrate with --lens radtan" if only_k3 else ""}.')
    if camera.width <= 0 or camera.height <= 0:
        raise ArgumentError('The image size is not known; give it with --image-size W H.')
    if kind == 'ros':
        text: str | bytes = camera_yaml(camera, name)
    elif kind == 'opencv':
        text = opencv_text(camera, xml=suffix == '.xml')
    elif kind == 'kalibr':
        text = kalibr_text(camera, topic=topic)
    elif kind == 'mrcal':
        text = mrcal_text(camera)
    else:
        text = colmap_binary(camera) if suffix == '.bin' else colmap_text(camera)
    return atomic_write(path, text, replace)


def _from_result(text: str, source: str) -> list[StoredCamera]:
    """Take the cameras out of our result.json: that of one, or all of a rig by their names."""
    try:
        stored = json.loads(text)
        several = stored.get('cameras')
        results = {str(name): result_from_dict(one) for name, one in (
            {'camera': stored} if several is None else several).items()}
        found = [(name, result, dict(result.status)) for name, result in results.items()]
    except ArgumentError as error:
        raise InputError(f'{source}: {error}') from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError):
        # whatever values of other kinds and sizes lead to
        raise InputError(f'{source} is neither a result.json of selfcal nor an OpenCV file; give '
                         'camera.yaml of the same calibration.') from None
    failed = [result for _, result, _ in found if not result]
    if failed or not found:
        raise InputError(f'{source} holds no camera. {" ".join(map(str, failed[:1]))}'.rstrip())
    return [StoredCamera(
        result.camera, name, covariance=result.covariance, status=status,
        line_delay_s=None if result.shutter is None else result.shutter.line_delay_s,
        lines='rows' if result.shutter is None else result.shutter.lines)
        for name, result, status in found]
