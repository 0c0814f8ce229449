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
A rig of cameras as other programs want it: stereo camera files, a Kalibr chain, JSON.

The stereo convention is that of `stereo_image_proc` and of OpenCV: R turns each camera to a common
rectified frame whose x axis runs from the left camera to the right one. Both P share f, cx and cy.
P of the right camera has -f b in its last column (metres), whichever was named first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.rigs.result import CameraInRig, POSE, RigCalibration
from selfcal_ros.report.camera_files.kalibr_chain import holds, kalibr_text
from selfcal_ros.report.camera_uncertainty import uncertainty_comment
from selfcal_ros.report.camera_yaml import ros_yaml
from selfcal_ros.report.mounts.words import mount_lines
from selfcal_ros.report.phrases import facts_lines
from selfcal_ros.report.result_json import result_to_dict, to_jsonable
from selfcal_ros.report.shutter_comment import shutter_comment
from selfcal_ros.report.yaml_text import number_text
from selfcal_ros.values.measured_digits import with_sigma

#: Cameras that look farther apart than this, radians, are no stereo pair.
WIDEST_STEREO_RAD = np.radians(30.0)


def rectification(rig: RigCalibration) -> dict[str, tuple[np.ndarray, np.ndarray]] | None:
    """
    Return R (3, 3) and P (3, 4) of both cameras of a stereo pair.

    None where the cameras are not two, look different ways, or do not sit side by side.
    Without a stated length the baseline is not known in metres, and P says nothing of it.
    """
    names = list(rig.cameras)
    if len(names) != 2 or 'unobservable' in rig.poses[names[1]].status.values():
        return None
    T = rig.poses[names[1]].T_rig_camera
    ahead = T[:3, 2] + [0, 0, 1]
    # one above the other is another convention, which ROS's stereo nodes do not take
    if T[2, 2] < np.cos(WIDEST_STEREO_RAD) or not abs(T[0, 3]) > np.abs(T[1:3, 3]).max():
        return None
    baseline, is_right = float(np.linalg.norm(T[:3, 3])), T[0, 3] > 0
    along = T[:3, 3] / baseline * (1 if is_right else -1)
    down = np.cross(ahead / np.linalg.norm(ahead), along)
    down /= np.linalg.norm(down)
    R = np.stack([along, down, np.cross(along, down)])
    turns = {names[0]: R, names[1]: R @ T[:3, :3]}
    cameras = {name: rig.cameras[name].camera for name in names}
    f = min(min(camera.K[0, 0], camera.K[1, 1]) for camera in cameras.values())
    centres = []
    for name, camera in cameras.items():
        middle = camera.rays(np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]]))[0]
        at = turns[name] @ middle
        centres.append([(camera.width - 1) / 2 - f * at[0] / at[2],
                        (camera.height - 1) / 2 - f * at[1] / at[2]])
    cx, cy = np.mean(centres, axis=0)
    found = {}
    for name in names:
        P = np.array([[f, 0, cx, 0], [0, f, cy, 0], [0, 0, 1, 0]])
        if name == names[int(is_right)] and rig.unit == 'm':
            P[0, 3] = -f * baseline
        found[name] = turns[name], P
    return found


def rig_camera_yaml(rig: RigCalibration, name: str, source: str = '') -> str:
    """Return the camera file of one camera, with R and P where it is one of a stereo pair."""
    one, stereo = rig.cameras[name], rectification(rig)
    camera, sigma = one.camera, one.sigma
    R, P = (np.eye(3), np.column_stack([camera.K, np.zeros(3)])) if stereo is None \
        else stereo[name]
    comments = [f'{rig.software}: {source}' if source else rig.software,
                f'fx +- {sigma["fx"]:.3g} px, fy +- {sigma["fy"]:.3g} px, '
                f'cx +- {sigma["cx"]:.3g} px, cy +- {sigma["cy"]:.3g} px (one sigma)',
                f'one of {len(rig.cameras)} cameras that were calibrated together: '
                f'{", ".join(rig.cameras)}']
    if stereo is None and len(rig.cameras) == 2:
        comments.append('R and P are those of this camera alone: the two do not sit side by side, '
                        'look different ways, or their pose is open.')
    if stereo is not None and rig.unit != 'm':
        comments.append('The baseline is not known in metres: state it (--baseline), and the '
                        'projection matrix has it.')
    comments += [*shutter_comment(one.shutter), *uncertainty_comment(camera, one.covariance)]
    return ros_yaml((camera.width, camera.height), name, camera.K, camera.model,
                    camera.distortion, R, P, comments)


def camchain(rig: RigCalibration, topics: Mapping[str, str] | None = None) -> str | None:
    """
    Return Kalibr's chain of all cameras.

    None where it could not hold them: poses that are open, lengths that are not metres, or a lens
    that Kalibr does not know.
    """
    if why_no_camchain(rig):
        return None
    text, before = f'# {rig.software}\n', None
    for k, (name, one) in enumerate(rig.cameras.items()):
        entry = kalibr_text(one.camera, (topics or {}).get(name) or f'/{name}/image_raw')
        entry = entry.replace('cam0:', f'cam{k}:', 1)
        if before is not None:
            T = rig.between(name, before)
            rows = '\n'.join(f'  - [{", ".join(map(number_text, row))}]' for row in T)
            entry += f'  T_cn_cnm1:\n{rows}\n'
        text, before = text + entry, name
    return text


def why_no_camchain(rig: RigCalibration) -> str:
    """Say why `camchain` is None, and what would help; '' where it is not."""
    for name, pose in rig.poses.items():
        if 'unobservable' in pose.status.values():
            return f'part of the pose of {name} is open'
    if rig.unit != 'm':
        return 'lengths are in steps of the path, and --baseline gives metres'
    for name, one in rig.cameras.items():
        if not holds(one.camera):
            return (f'Kalibr has no counterpart of the lens {one.camera.model} of {name}'
                    + (' with its k3; --lens radtan has none'
                       if one.camera.distortion_as('plumb_bob') is not None else ''))
        if abs(one.camera.K[0, 1]) >= 1e-12:
            return f'Kalibr knows no skew, and {name} has one'
    return ''


def rig_to_dict(result: RigCalibration | NotCalibrated) -> dict[str, Any]:
    """
    Return the result as plain values that strict JSON can hold.

    The keys are those of the first camera's result, with what is said of all, and 'cameras' (by
    name, each as of a single one), 'rig' (by name: 'T_rig_camera', 'sigma', 'status',
    'covariance' over x, y, z, roll, pitch, yaw), 'unit' ('m' or 'path'), 'path_step' (units in
    one step of the path) and 'joint' ('parameter_names' and 'covariance' of everything).
    """
    if isinstance(result, NotCalibrated):
        return result_to_dict(result)
    cameras = {name: result_to_dict(one) for name, one in result.cameras.items()}
    joint = {'parameter_names': result.parameter_names, 'covariance': result.covariance}
    of_all = {'frames': {'count': len(result.frames), 'used': result.frames},
              'reprojection_rms_px': result.reprojection_rms_px,
              'noise_sigma_px': result.noise_sigma_px, 'observations': result.observation_count,
              'outliers': result.outlier_count, 'notes': result.notes,
              'findings': list(result.findings), 'software': result.software,
              'cameras': cameras, 'unit': result.unit, 'path_step': result.scale, 'joint': joint,
              'rig': {name: _pose(pose) for name, pose in result.poses.items()}}
    plain: dict[str, Any] = to_jsonable({**next(iter(cameras.values())), **of_all})
    return plain


def _pose(pose: CameraInRig) -> dict[str, Any]:
    """Return where a camera sits."""
    return {'T_rig_camera': pose.T_rig_camera, 'sigma': pose.sigma, 'status': pose.status,
            'covariance': pose.covariance, 'shared_points': pose.shared_points,
            **({'places': [one.as_dict() for one in pose.places]} if pose.places else {})}


def rig_facts(rig: RigCalibration, baseline: tuple[float, float] | None = None) -> list[str]:
    """
    Say what was taken as known, a line each; what holds for single cameras has their names.

    Parameters
    ----------
    rig : RigCalibration
    baseline : (float, float), optional
        Stated distance of the first two cameras and its standard deviation, metres.

    """
    of_camera = {name: facts_lines(one.facts) for name, one in rig.cameras.items()}
    said = [line for line in next(iter(of_camera.values()))
            if all(line in lines for lines in of_camera.values())]
    said += [f'{name}: {line}' for name, lines in of_camera.items()
             for line in lines if line not in said]
    if baseline is not None:
        spread = f'σ = {1e3 * baseline[1]:g} mm' if baseline[1] else 'exact'
        said.append(f'distance of the first two cameras = {1e3 * baseline[0]:g} mm ({spread})')
    return said


def rig_text(rig: RigCalibration, mount_facts: frozenset[str] = frozenset(),
             baseline: tuple[float, float] | None = None) -> str:
    """
    Say where the cameras sit, for a terminal.

    Parameters
    ----------
    rig : RigCalibration
    mount_facts : set of str
        What was stated of the first camera's mount.
    baseline : (float, float), optional
        As it was stated, with its standard deviation, metres.

    """
    unit, factor = ('mm', 1e3) if rig.unit == 'm' else ('steps', 1.0)
    lines = [f'{len(rig.cameras)} cameras from {len(rig.frames)} instants, {rig.motion} motion: '
             f'reprojection {rig.reprojection_rms_px:.3f} px rms over {rig.observation_count} '
             f'observations ({rig.outlier_count} rejected).', '']
    for name, one in rig.cameras.items():
        values, sigma = one.camera.K, one.sigma
        alone = rig.alone.get(name)
        beside = f'  (alone ± {alone.sigma["fx"]:.2g})' if alone else '  (not alone)'
        lines.append(f'{name}: fx {values[0, 0]:.2f} ± {sigma["fx"]:.2g}{beside}, '
                     f'fy {values[1, 1]:.2f} ± {sigma["fy"]:.2g}, cx {values[0, 2]:.2f} ± '
                     f'{sigma["cx"]:.2g}, cy {values[1, 2]:.2f} ± {sigma["cy"]:.2g} px, '
                     f'{one.camera.model}')
    first = next(iter(rig.cameras))
    for name, pose in list(rig.poses.items())[1:]:
        lines += ['', f'{name} in the frame of {first} (x right, y down, z forward):']
        for k, free in enumerate(POSE):
            if pose.status[free] == 'unobservable':
                lines.append(f'{free:>6} {"open":>10}')
                continue
            value, sigma_here, what = (
                (factor * pose.T_rig_camera[k, 3], factor * pose.sigma[free], unit)
                if k < 3 else (np.degrees(pose.angles[free]),
                               np.degrees(pose.angles_sigma[free]), 'deg'))
            shown, spread = with_sigma(value, sigma_here)
            lines.append(f'{free:>6} {shown:>10} ± {spread or "0":>7} {what}')
    if rig.unit != 'm':
        # who has given one is told why it is of no use
        given = any(one.kind == 'rig_baseline_of_no_use' for one in rig.findings)
        lines += ['', 'Lengths are in steps of the path' + (
            '.' if given else '; --baseline METRES gives metres, and so does --robot.')]
    lines += mount_lines(rig.cameras[first], mount_facts)
    return '\n'.join([*lines, '', f'Facts: {"; ".join(rig_facts(rig, baseline))}.', *rig.notes])


def output_names(camera_yaml: Path, cameras: Iterable[str]) -> dict[str, Path]:
    """Name the camera file of every camera: camera.yaml gives camera_left.yaml."""
    return {name: camera_yaml.with_name(f'{camera_yaml.stem}_{name}{camera_yaml.suffix}')
            for name in cameras}
