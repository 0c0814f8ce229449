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
"""The result of a calibration as JSON, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.calibration.reconstruction import Measured, StructureSample
from selfcal_ros.calibration.result import (Calibration, FixedPoints, FocalCourse, Identifiability,
                                            NotCalibrated)
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.calibration.structure.angular_measurement import central_angle, fields_of_view
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera, MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import lens_model
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB
from selfcal_ros.report.board_shape import board_shape
from selfcal_ros.report.mounts.record import mount_from_dict, mount_to_dict
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.parameter_status import Status
from selfcal_ros.values.track_labels import NAMES, STILL_IN_IMAGE, TrackLabels

#: Version of what is written; the first had none.
SCHEMA = 2
#: What is told of a hint, under a key of its own: who looks for a camera must not take it.
OF_A_HINT = ('camera', 'lens', 'sigma', 'covariance', 'parameter_names')
#: Parameters of files without a k3.
_BEFORE_K3 = 9


def result_to_dict(result: Calibration | NotCalibrated) -> dict[str, Any]:
    """
    Return the result as plain Python values that strict JSON can hold.

    Both outcomes have the same keys; what a NotCalibrated does not have is None. So is a number
    that is not finite: the sigma of a parameter that the data do not determine, for example.
    Complex numbers are pairs [real, imaginary]. The schema is docs/result.schema.json.

    Parameters
    ----------
    result : Calibration or NotCalibrated

    Returns
    -------
    dict
        'status' ('calibrated', 'hint' or 'not_calibrated'), 'reason', 'advice', 'motion',
        'camera',
        'lens' ('model' and 'coefficients' by name), 'sigma', 'covariance' (square, in the order
        of 'parameter_names'), 'parameter_names', 'parameters', 'held_by', 'frames',
        'reprojection_rms_px', 'noise_sigma_px', 'observations', 'outliers', 'fixed_points',
        'identifiability' ('from_images', 'without', 'weakest', 'weakest_share'; an infinite
        factor in 'without' is None),
        'measurement' ('field_of_view_deg' with 'horizontal', 'vertical', 'diagonal',
        'central_angle_deg', 'length_ratio' with the tracks of its two lengths in 'first' and
        'second', 'structure_angle_deg' with the tracks of its three points in 'corner': each
        'value' and 'sigma'; the last two None without a structure that was adjusted), 'facts',
        'notes', 'software', 'schema'; and, only where there are any, 'kind' (of a refusal),
        'findings' (each with its 'kind' and its values; a refusal is the first of its own),
        'focal' ('frame', 'fx' and 'sigma' of each, where the focal length varies), 'shutter'
        (`RowReadout`), 'board' (`board_shape`: how it bends), 'mount' (where poses of a robot were
        given; see `selfcal_ros.report.mounts.record`), 'segments' (what was followed of a long
        recording), 'labels' (tracks by what they are, where something moves by itself, jumps, or
        stands still in the image), and 'hint' (what the images suggest where the status is 'hint':
        'camera', 'lens', 'sigma', 'covariance', 'parameter_names').

    """
    fixed = result.fixed_points if result else None
    found: dict[str, Any] = {
        'schema': SCHEMA,
        'status': 'calibrated' if result else 'hint' if result.is_hint else 'not_calibrated',
        'reason': '' if result else result.reason,
        'advice': '' if result else result.advice,
        'motion': result.motion,
        'camera': _camera(result.camera) if result else None,
        'lens': _lens(result.camera) if result else None,
        'sigma': _sigma(result) if result else None,
        'covariance': result.covariance if result else None,
        'parameter_names': result.parameter_names if result else (),
        'parameters': result.status,
        'held_by': result.held_by if result else {},
        'frames': {'count': len(result.frames), 'used': result.frames},
        'reprojection_rms_px': result.reprojection_rms_px if result else None,
        'noise_sigma_px': result.noise_sigma_px if result else None,
        'observations': result.observation_count if result else None,
        'outliers': result.outlier_count if result else None,
        'fixed_points': None if fixed is None else {
            'horizon': fixed.horizon, 'vanishing_point': fixed.vanishing_point,
            'circular_point': fixed.circular_point},
        'identifiability': _identifiability(result) if result else None,
        'measurement': _measurement(result) if result else None,
        'facts': dataclasses.asdict(result.facts),
        'notes': result.notes if result else (),
        'software': result.software,
    }
    if result and result.focal is not None:
        found['focal'] = [
            {'frame': frame, 'fx': fx, 'sigma': sigma} for frame, fx, sigma in zip(
                result.focal.frames, result.focal.fx, result.focal.sigma)]
    findings: list[Any] = list(result.findings)
    if not result and result.kind:
        found['kind'] = result.kind
        findings.insert(0, {'kind': result.kind, **result.values})
    if findings:
        found['findings'] = findings
    parts = [one.values['segments'] for one in result.findings if one.kind == 'segments_followed']
    if parts:
        found['segments'] = parts[0]
    if result and result.shutter is not None:
        found['shutter'] = result.shutter.as_dict()
    board = board_shape(result) if result else None
    if board is not None:
        found['board'] = board
    if result and result.mount is not None:
        found['mount'] = mount_to_dict(result.mount)
    if result and result.labels is not None:
        found['labels'] = {name: result.labels.of(name) for name in result.labels.names}
    if not result and result.hint is not None:
        found['hint'] = {name: value for name, value in result_to_dict(result.hint).items()
                         if name in OF_A_HINT}
    plain: dict[str, Any] = to_jsonable(found)
    return plain


def _identifiability(result: Calibration) -> dict[str, Any] | None:
    known = result.identifiability
    return None if known is None else dataclasses.asdict(known)


def _measurement(result: Calibration) -> dict[str, Any] | None:
    if not min(result.camera.width, result.camera.height) > 0:
        return None
    angle = central_angle(result.camera, result.covariance)
    return {'field_of_view_deg': {name: dataclasses.asdict(one) for name, one in fields_of_view(
        result.camera, result.covariance).items()},
            'central_angle_deg': None if angle is None else dataclasses.asdict(angle),
            **_in_the_structure(result.measured)}


def _in_the_structure(sample: StructureSample | None) -> dict[str, Any]:
    if sample is None:
        return {'length_ratio': None, 'structure_angle_deg': None}
    return {'length_ratio': {**dataclasses.asdict(sample.length_ratio), 'first': sample.first,
                             'second': sample.second},
            'structure_angle_deg': {**dataclasses.asdict(sample.angle_deg),
                                    'corner': sample.corner}}


def write_result_json(path: str | Path, result: Calibration | NotCalibrated,
                      seed: int | None = None) -> Path:
    """
    Write the result as JSON; the file appears whole or not at all.

    Parameters
    ----------
    path : str or Path
    result : Calibration or NotCalibrated
    seed : int, optional
        See `result_to_json`.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    return atomic_write(path, result_to_json(result, seed))


def result_to_json(result: Calibration | NotCalibrated, seed: int | None = None) -> str:
    """
    Return the result as strict JSON text, without NaN and infinities.

    Parameters
    ----------
    result : Calibration or NotCalibrated
    seed : int, optional
        What was drawn at random was drawn from it; the key 'seed'.

    """
    content = result_to_dict(result) | ({} if seed is None else {'seed': seed})
    return json.dumps(content, indent=2, allow_nan=False,
                      ensure_ascii=False) + '\n'


def result_from_dict(content: dict[str, Any]) -> Calibration | NotCalibrated:
    """
    Turn what `result_to_dict` gives back into a result.

    A file holds less than a result. Of a calibration, `reconstruction`, `residuals` and
    `population` are None, and `is_steady` of `focal` is False. Of a hint, the file has the camera
    and its covariance; its counts are 0 and its `reprojection_rms_px` is NaN. Sequences in the
    values of findings come back as lists, and numbers that were not finite as NaN.

    Files of the first version, which have no 'schema', are read, too: their notes are findings
    of the kind 'note'.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the content is of another kind.

    """
    if content['status'] != 'calibrated':
        return _refusal(content)
    camera = _stored_camera(content['camera'])
    return Calibration(
        camera=camera, covariance=_stored_covariance(content, camera),
        status=content['parameters'], held_by=content['held_by'], motion=content['motion'],
        facts=_facts(content), frames=tuple(content['frames']['used']),
        reprojection_rms_px=_number(content['reprojection_rms_px']),
        noise_sigma_px=_number(content['noise_sigma_px']),
        observation_count=content['observations'], outlier_count=content['outliers'],
        reconstruction=None, software=content.get('software', ''),
        findings=_findings(content.get('findings', ()), content['notes']),
        fixed_points=_fixed_points(content.get('fixed_points')),
        identifiability=_stored_identifiability(content.get('identifiability')),
        measured=_structure_sample(content.get('measurement')),
        focal=_focal(content.get('focal')),
        shutter=RowReadout(**content['shutter']) if 'shutter' in content else None,
        labels=_labels(content.get('labels')), mount=mount_from_dict(content.get('mount')))


def _refusal(content: dict[str, Any]) -> NotCalibrated:
    """Read why there is no calibration, and what the images suggest where they do."""
    kind, stored = content.get('kind', ''), list(content.get('findings', ()))
    values = {name: value for name, value in stored.pop(0).items() if name != 'kind'} \
        if kind and stored else {}
    refusal = NotCalibrated(
        content['reason'], content['advice'], content.get('motion', 'unknown'),
        frames=tuple(content.get('frames', {}).get('used', ())), facts=_facts(content),
        status=dict(content.get('parameters', {})), software=content.get('software', ''),
        kind=kind, values=values, findings=_findings(stored, ()))
    if 'hint' not in content:
        return refusal
    return dataclasses.replace(refusal, hint=_hint(content['hint'], refusal))


def _hint(stored: dict[str, Any], refusal: NotCalibrated) -> Calibration:
    """Read what the images suggest; the rest is that of the refusal."""
    camera = _stored_camera(stored['camera'])
    status: dict[str, Status] = {
        name: 'held' if sigma == 0 else 'unobservable' if sigma is None else 'estimated'
        for name, sigma in stored['sigma'].items()}
    return Calibration(
        camera=camera, covariance=_stored_covariance(stored, camera), status=status, held_by={},
        motion=refusal.motion, facts=refusal.facts, frames=refusal.frames,
        reprojection_rms_px=np.nan, noise_sigma_px=np.nan, observation_count=0, outlier_count=0,
        reconstruction=None, software=refusal.software)


def _facts(content: dict[str, Any]) -> CameraFacts:
    stated: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value
                              for name, value in content.get('facts', {}).items()}
    return CameraFacts(**stated)


def _stored_camera(c: dict[str, Any]) -> Camera:
    model = lens_model(c.get('distortion_model', 'plumb_bob'))
    # older files of a plumb bob lack its k3
    if len(c['d']) not in (len(model.coefficients), 0, *((4,) if model is PLUMB_BOB else ())):
        raise ValueError(f'the lens model {model.name} has not {len(c["d"])} coefficients')
    return Camera(np.array([[c['fx'], c['skew'], c['cx']], [0, c['fy'], c['cy']], [0, 0, 1]]),
                  np.array(c['d']), c['width'], c['height'], model.name)


def _stored_covariance(content: dict[str, Any], camera: Camera) -> np.ndarray:
    covariance = np.array([[_number(v) for v in row] for row in content['covariance']], float)
    return _complete(covariance, content.get('parameter_names'), camera)


def _number(stored: float | None) -> float:
    """Read a number; null stands for one that was not finite."""
    return np.nan if stored is None else stored


def _fixed_points(stored: dict[str, Any] | None) -> FixedPoints | None:
    if not stored:
        return None
    real, imaginary = np.array(stored['circular_point'], float).T
    return FixedPoints(np.array(stored['horizon'], float),
                       np.array(stored['vanishing_point'], float), real + 1j * imaginary)


def _stored_identifiability(stored: dict[str, Any] | None) -> Identifiability | None:
    """Read where the knowledge of each parameter comes from; infinite factors are null."""
    if not stored:
        return None
    without = {fact: {name: np.inf if factor is None else factor
                      for name, factor in factors.items()}
               for fact, factors in stored['without'].items()}
    return Identifiability({name: _number(one) for name, one in stored['from_images'].items()},
                           without,
                           {name: _number(one) for name, one in stored['weakest'].items()},
                           _number(stored['weakest_share']))


def _structure_sample(stored: dict[str, Any] | None) -> StructureSample | None:
    """Read the two measurements in the structure, where there are any."""
    length, angle = ((stored or {}).get(name) for name in ('length_ratio', 'structure_angle_deg'))
    if not (length and angle):
        return None
    sigmas = [Measured(_number(one['value']), _number(one['sigma'])) for one in (length, angle)]
    return StructureSample(sigmas[0], tuple(length['first']), tuple(length['second']), sigmas[1],
                           tuple(angle['corner']))


def _labels(stored: dict[str, Any] | None) -> TrackLabels | None:
    """Read what every track is."""
    if stored is None:
        return None
    aside = STILL_IN_IMAGE in stored
    names = TrackLabels(np.zeros(0, int), np.zeros(0, int), len(stored) - len(NAMES) - aside,
                        aside).names
    pairs = sorted((track, names.index(name)) for name, of in stored.items() for track in of)
    track, label = np.array(pairs, int).reshape(-1, 2).T
    return TrackLabels(track, label, len(names) - len(NAMES) - aside, aside)


def _focal(stored: list[dict[str, Any]] | None) -> FocalCourse | None:
    """Read the focal lengths of the frames, where they differ."""
    if not stored:
        return None
    frames, fx, sigma = (np.array([np.nan if one[name] is None else one[name] for one in stored])
                         for name in ('frame', 'fx', 'sigma'))
    return FocalCourse(frames.astype(int), fx, sigma)


def _complete(covariance: np.ndarray, names: Sequence[str] | None, camera: Camera) -> np.ndarray:
    """Return the covariance of all parameters; older files know fewer, the others are held."""
    if names is None:
        # k3 came later than the names
        known = camera.parameter_names
        names = known if len(covariance) == len(known) else known[:_BEFORE_K3]
    if covariance.shape != (len(names),) * 2 or not set(names) <= set(camera.parameter_names):
        raise ValueError(f'the covariance has the shape {covariance.shape}')
    places = [camera.parameter_names.index(name) for name in names]
    whole = np.zeros((len(camera.parameter_names),) * 2)
    whole[np.ix_(places, places)] = covariance
    return whole


def _findings(stored: list[dict[str, Any]] | None, notes: Sequence[object]) -> tuple[Finding, ...]:
    """Read findings; kinds of another version become what the notes say of them."""
    if not stored:
        return tuple(Finding('note', text=str(text)) for text in notes)
    found = []
    for k, one in enumerate(stored):
        try:
            found.append(Finding.from_dict(one))
        except ValueError:
            text = notes[k] if k < len(notes) else f'Something of the kind {one["kind"]}.'
            found.append(Finding('note', text=str(text)))
    return tuple(found)


def _camera(camera: Camera) -> dict[str, Any]:
    values = dict(zip(MATRIX_PARAMETERS, camera.parameters))
    return {'width': camera.width, 'height': camera.height, **values,
            'distortion_model': camera.model, 'd': camera.distortion}


def _lens(camera: Camera) -> dict[str, Any]:
    return {'model': camera.model,
            'coefficients': dict(zip(camera.lens.coefficients, camera.distortion))}


def _sigma(result: Calibration) -> dict[str, Any]:
    variance = np.diag(np.asarray(result.covariance, float))
    # rounding can leave a variance of zero slightly negative
    with np.errstate(invalid='ignore'):
        sigma = np.sqrt(np.where(variance < 0, np.nan, variance))
    # of what the data do not determine there is no spread to report
    return {name: None if result.status.get(name) == 'unobservable' else value
            for name, value in zip(result.parameter_names, sigma)}


def to_jsonable(value: object) -> Any:
    """Convert to what strict JSON knows; what is not finite becomes None."""
    if isinstance(value, Finding):
        return to_jsonable(value.as_dict())
    if isinstance(value, dict):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_jsonable(value.tolist())
    if isinstance(value, (list, tuple, set, frozenset)):
        return [to_jsonable(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (complex, np.complexfloating)):
        return [to_jsonable(float(value.real)), to_jsonable(float(value.imag))]
    return None if value is None else str(value)
