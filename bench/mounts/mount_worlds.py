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
Robots whose camera was calibrated, with the truth: paths, mounts, and errors of known laws.

The images are not simulated, only what their adjustment would say: poses and lens with a joint
Gaussian error, drawn from the covariance that the calibration states. So a thousand runs are
cheap, and what they show is the mount's own estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.mount import mount_rotation
from selfcal_ros.calibration.reconstruction import PosePrecision, Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.path_precision import in_the_world
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.values.body_poses import ABSOLUTE, BodyPoses, ODOMETRY

#: The camera of every world: 80 degrees wide.
WIDTH, HEIGHT, FOCAL = 640, 480, 380.0
#: What the images leave open of the lens: f, cx, cy (pixels).
LENS_SIGMA = np.array([0.6, 0.5, 0.5])
#: Error of a camera pose: a turn (rad), and its place as a share of a step of the path.
TURN_SIGMA, PLACE_SHARE = 1e-4, 1e-3


@dataclass(frozen=True)
class World:
    """
    A robot with a camera.

    Attributes
    ----------
    rotation, position : ndarray, shapes (V, 3, 3), (V, 3)
        Of the body at the images, true.
    T_body_camera : ndarray, shape (4, 4)
    planar : bool

    """

    rotation: np.ndarray
    position: np.ndarray
    T_body_camera: np.ndarray
    planar: bool


def mount_of(rng: np.random.Generator) -> np.ndarray:
    """Draw a camera that looks about forward."""
    T = np.eye(4)
    T[:3, :3] = mount_rotation(*rng.uniform(-0.2, 0.2, 3))
    T[:3, 3] = rng.uniform([0.05, -0.2, 0.1], [0.5, 0.2, 0.8])
    return T


def drive(times: np.ndarray, speed: float = 0.5, turns: float = 0.8,
          rhythm: float = 0.35) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and position of a vehicle that drives curves to both sides."""
    fine = np.arange(-2.0, times[-1] + 2.01, 0.005)

    def heading(t):
        return turns * np.sin(rhythm * t) + 0.5 * turns * np.sin(1.7 * rhythm * t + 1)
    step = speed * 0.005 * np.stack([np.cos(heading(fine)), np.sin(heading(fine))], axis=1)
    way = np.cumsum(step, axis=0)
    position = np.stack([np.interp(times, fine, way[:, 0]), np.interp(times, fine, way[:, 1]),
                         0 * times], axis=1)
    return rotation_matrix(np.stack([0 * times, 0 * times, heading(times)], axis=1)), position


def hand(times: np.ndarray, turns: float = 0.5, reach: float = 0.4,
         ) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and position of a body that an arm or a hand moves about."""
    phases = np.outer(times, [0.9, 1.3, 0.7])
    vector = turns * np.sin(phases + [0, 1, 2])
    position = reach * np.sin(1.2 * phases[:, ::-1] + [0.5, 0, 1.5])
    return rotation_matrix(vector), position


def calibrated(rng: np.random.Generator, world: World, turn_sigma: float = TURN_SIGMA,
               place_share: float = PLACE_SHARE) -> Calibration:
    """
    Return what the images of a world would say: poses and lens, wrong by a draw of their law.

    Parameters
    ----------
    rng : numpy.random.Generator
    world : World
    turn_sigma, place_share : float
        See `TURN_SIGMA`.

    Returns
    -------
    Calibration

    """
    M, t = world.T_body_camera[:3, :3], world.T_body_camera[:3, 3]
    R, c = world.rotation @ M, world.position + world.rotation @ t
    steps = np.linalg.norm(np.diff(c, axis=0), axis=1)
    place_sigma = place_share * max(np.median(steps), 1e-3)
    views = len(R)
    # unknowns: f, cx, cy; then of every view its centre and a turn about the world's axes
    across, down = R[:, :, 0], R[:, :, 1]
    turns, moves = np.zeros((2, views, 3, 3 + 6 * views))
    # a principal point that is wrong turns all cameras the other way
    turns[:, :, 1], turns[:, :, 2] = -down / FOCAL, across / FOCAL
    rows = np.arange(views)
    for axis in range(3):
        moves[rows, axis, 3 + 6 * rows + axis] = place_sigma
        turns[rows, axis, 6 + 6 * rows + axis] = turn_sigma
    if world.planar:
        # its path lies in the plane and turns about its normal, but for the pitch and roll of all
        moves[:, 2] = 0
        turns[:, :2, 3:] = 0
    C = np.eye(3 + 6 * views)
    C[:3, :3] = np.diag(LENS_SIGMA**2)
    draw = np.linalg.cholesky(C) @ rng.standard_normal(len(C))
    # the truth is a draw away from the estimate
    found = rotation_matrix(-turns @ draw) @ R
    centre = c - moves @ draw
    poses = np.concatenate([np.swapaxes(found, 1, 2),
                            -np.einsum('vji,vj->vi', found, centre)[:, :, None]], axis=2)
    f, cx, cy = np.array([FOCAL, WIDTH / 2, HEIGHT / 2]) - draw[:3]
    camera = Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (), WIDTH, HEIGHT)
    precision = PosePrecision(camera, ('f', 'cx', 'cy'),
                              in_the_world(poses, *(csr_array(one.reshape(3 * views, -1))
                                                    for one in (turns, moves)), world.planar), C)
    names = camera.parameter_names
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_([0, 1], [0, 1])] = LENS_SIGMA[0]**2
    covariance[[2, 3], [2, 3]] = LENS_SIGMA[1:]**2
    status = {name: 'estimated' if name in ('fx', 'fy', 'cx', 'cy') else 'held'
              for name in names}
    shape = Reconstruction(np.arange(views), poses, np.zeros(0, int), np.zeros((0, 4)), None,
                           precision)
    return Calibration(camera, covariance, status, {}, 'planar' if world.planar else 'general',
                       CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'),
                       tuple(range(views)), 0.1, 0.1, 1000, 0, shape)


def measured(rng: np.random.Generator, rotation: np.ndarray, position: np.ndarray,
             sigma_m: float, sigma_rad: float, **when) -> BodyPoses:
    """Return absolute poses with independent errors."""
    off = rotation_matrix(sigma_rad * rng.standard_normal(position.shape))
    return BodyPoses(off @ rotation, position + sigma_m * rng.standard_normal(position.shape),
                     kind=ABSOLUTE, **when)


def odometry(rng: np.random.Generator, rotation: np.ndarray, position: np.ndarray,
             sigmas: tuple[float, float, float], **when) -> BodyPoses:
    """
    Return odometry in a plane whose errors add up.

    Parameters
    ----------
    rng : numpy.random.Generator
    rotation, position : ndarray, shapes (V, 3, 3), (V, 3)
    sigmas : (float, float, float)
        Forward, sideways (m) and of the heading (rad), of a metre or a radian of the way.
    **when
        Instants or frames.

    Returns
    -------
    BodyPoses

    """
    back = np.swapaxes(rotation[:-1], 1, 2)
    ahead = np.einsum('vij,vj->vi', back, np.diff(position, axis=0))
    turned = rotation_vector(back @ rotation[1:])
    way = np.linalg.norm(ahead, axis=1) + np.linalg.norm(turned, axis=1)
    noise = np.sqrt(way)[:, None] * rng.standard_normal((len(way), 3)) * sigmas
    R, p = [np.eye(3)], [np.zeros(3)]
    for step, turn, error in zip(ahead, turned, noise):
        half = rotation_matrix(turn / 2)
        p.append(p[-1] + R[-1] @ (step + half @ [error[0], error[1], 0]))
        R.append(R[-1] @ rotation_matrix(turn + [0, 0, error[2]]))
    return BodyPoses(np.array(R), np.array(p), kind=ODOMETRY, **when)


def mount_errors(mount, T_body_camera: np.ndarray, scale: float,
                 offset: float = 0.0) -> np.ndarray:
    """Return truth minus mount in the order of its covariance, shape (8,)."""
    found = mount.T_body_camera
    return np.concatenate([
        T_body_camera[:3, 3] - found[:3, 3],
        rotation_vector(T_body_camera[:3, :3] @ found[:3, :3].T),
        [scale - mount.scale, offset - mount.time_offset_s]])


def true_scale(world: World, calibration: Calibration) -> float:
    """
    Return metres in a step of a calibration's path.

    Its unit is the middle step of the estimate, which the world's own poses measure.
    """
    from selfcal_ros.calibration.structure.metric_structure import middle_steps
    estimate = camera_centres(calibration.reconstructed.cam_from_world)
    centre = world.position + world.rotation @ world.T_body_camera[:3, 3]
    return float(np.mean([np.linalg.norm(centre[k + 1] - centre[k])
                          for k in middle_steps(estimate)]))
