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
"""The tea box before a stereo pair: left and right are tracked alone, and must agree."""

from __future__ import annotations

from bench.inputs import data_folder
from bench.tables import Report
from bench.tracking.tracking_runs import follow
import numpy as np
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.pipeline.file_sources import VideoSource
from selfcal_ros.rorapid.estimation.initial_pose import pose_from_clicks
from selfcal_ros.rorapid.model import read_model

#: Corners of the box that were clicked in the first images, metres, and where, pixels.
CORNERS = np.array([(0, 0, 0), (.165, 0, 0), (.165, 0, -.08), (.165, .068, 0), (0, .068, 0),
                    (0, 0, -.08)])
CLICKS = {'left': [(247, 338), (523, 325), (514, 384), (503, 236), (252, 250), (266, 401)],
          'right': [(23, 283), (303, 290), (298, 348), (301, 197), (44, 193), (50, 347)]}
#: The cameras' published calibrations, fx fy cx cy.
CAMERAS = {'left': (680.0610429442, 680.8199518458, 338.1239478994, 247.1568627435),
           'right': (682.2252216804, 682.1643147488, 320.0806549595, 225.3683556175)}
MAX_MM, MAX_DEG = 3.0, 1.0


def run(report: Report, options) -> None:
    """Print how far the two poses are apart after the known stereo transform."""
    report.section('The tea box, stereo: both cameras tracked alone')
    folder = data_folder('visp_tracking_videos')
    if folder is None:
        report.say('left out: the recorded sets are not there')
        return
    model = read_model(folder / 'teabox.cao')
    tracks = {}
    for side in ('left', 'right'):
        fx, fy, cx, cy = CAMERAS[side]
        camera = Camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], (), 640, 480)
        images = [frame.image for frame in VideoSource(folder / 'images' / f'teabox_{side}.mp4')]
        start = pose_from_clicks(CORNERS, CLICKS[side], camera)[:2]
        tracks[side] = track = follow(images, model, camera, start)
        report.judge(not track.lost.any(), f'{side}: {len(images)} images tracked to the end, '
                     f'edges {np.sqrt(np.nanmean(track.rms_px**2)):.2f} px rms')
    right_from_left = np.loadtxt(folder / 'cRightMcLeft.txt')
    count = min(len(track.states) for track in tracks.values())
    left, right = tracks['left'], tracks['right']
    R, t = right_from_left[:3, :3], right_from_left[:3, 3]
    apart = 1000 * (left.translations[:count] @ R.T + t - right.translations[:count])
    turn = np.rad2deg(rotation_vector(
        R @ left.rotations[:count] @ np.swapaxes(right.rotations[:count], 1, 2)))
    rows = [(name, f'{_rms(apart_):.2f}', f'{_rms(turn_):.2f}') for name, apart_, turn_ in (
        ('rms', apart, turn), ('constant part', apart.mean(axis=0)[None], turn.mean(axis=0)[None]),
        ('rms about it', apart - apart.mean(axis=0), turn - turn.mean(axis=0)))]
    report.table(('left against right', 'position mm', 'rotation °'), rows)
    report.say('\nThe box is not quite its model, and the two cameras see different edges of it: '
               'that can be constant.\n')
    report.verdict('position, rms', _rms(apart), MAX_MM, 'mm')
    report.verdict('rotation, rms', _rms(turn), MAX_DEG, '°')


def _rms(rows: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
