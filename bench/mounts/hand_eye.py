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
The mount beside eleven hand-eye solvers, on pose streams of KinHEC's generator (MIT).

There are no images: a camera pose errs by itself, and nobody says by how much. The solvers are
those of the generator, its protocol and its keyframes are taken. It runs where `kinhec` is
installed.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
import tempfile

from bench.tables import Report
import numpy as np
from selfcal_ros import Camera, CameraFacts
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.values.body_poses import BodyPoses

TRACKS = ('noise', 'motion', 'outliers', 'monocular', 'temporal')
#: Keyframes of the generator's protocol: degrees, metres, most.
KEYFRAMES = (5.0, 0.02, 200)
MAX_SIGMAS = 4.0


@dataclass(frozen=True)
class Solved:
    """
    One sequence.

    Attributes
    ----------
    track, level : str
    timed : bool
        The offset of the clocks is estimated, too.
    peers : dict of str to (float, float)
        Errors of every solver: rotation (degrees), translation (mm).
    ours : (float, float)
        NaN where it is open or refused.
    worst : float
        Largest deviation of what is estimated, sigmas.

    """

    track: str
    level: str
    timed: bool
    peers: dict
    ours: tuple[float, float]
    worst: float


def calibration_of(world_from_camera: np.ndarray, metric: bool) -> Calibration:
    """Take poses (V, 4, 4) for those of a calibration; of none is it known how well."""
    camera = Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), 640, 480)
    names, frames = camera.parameter_names, np.arange(len(world_from_camera))
    return Calibration(
        camera=camera, covariance=np.zeros((len(names), len(names))),
        status=dict.fromkeys(names, 'held'), held_by={},
        motion='known-object' if metric else 'general', facts=CameraFacts(),
        frames=tuple(int(k) for k in frames), reprojection_rms_px=0.0, noise_sigma_px=0.1,
        observation_count=0, outlier_count=0, software='',
        reconstruction=Reconstruction(frames, np.linalg.inv(world_from_camera)[:, :3],
                                      np.empty(0, int), np.empty((0, 4))))


def _mount(sequence, timed: bool):
    """Return our mount of a sequence."""
    from kinhec import motions
    offset = None if sequence.synchronous else sequence.time_offset
    body, camera = sequence.axyb_poses(time_offset=offset)
    rows = motions.select_keyframes(camera if timed else body, *KEYFRAMES)
    rows = rows if len(rows) > 2 else np.arange(len(body))
    calibration = calibration_of(camera[rows], abs(sequence.scale - 1) < 1e-9)
    if not timed:
        return mount_camera(calibration, BodyPoses(
            body[rows, :3, :3], body[rows, :3, 3], frames=np.arange(len(rows)))).mount
    instants = np.round(1e9 * sequence.robot.t).astype(np.int64)
    once = np.append(True, np.diff(instants) > 0)
    robot = sequence.robot.T_base_ee_meas[once]
    seen = sequence.camera.t[sequence.camera.has_measurement][rows]
    return mount_camera(calibration, BodyPoses(
        robot[:, :3, :3], robot[:, :3, 3], stamps_ns=instants[once]),
        {k: int(round(1e9 * t)) for k, t in enumerate(seen)}).mount


def solve(sequence, row: dict, timed: bool) -> Solved:
    """Estimate one sequence by all."""
    from kinhec.benchmark import evaluate_sequence, SOLVERS
    rows = evaluate_sequence(sequence, list(SOLVERS), sync='estimated' if timed else 'oracle',
                             rng=np.random.default_rng(0))
    peers = {one['solver']: (one.get('X_rot_err_deg', np.nan), one.get('X_trans_err_mm', np.nan))
             for one in rows}
    mount, ours, worst = _mount(sequence, timed), (np.nan, np.nan), 0.0
    if mount:
        T, sigma = mount.T_body_camera, mount.sigma
        cosine = (np.trace(T[:3, :3] @ sequence.X[:3, :3].T) - 1) / 2
        away = T[:3, 3] - sequence.X[:3, 3]
        ours = (float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))),
                float(1e3 * np.linalg.norm(away)))
        worst = max((abs(away[k]) / sigma[name] for k, name in enumerate('xyz')
                     if mount.status[name] == 'estimated'), default=0.0)
    return Solved(row['track'], row['level'], timed, peers, ours, float(worst))


def report_track(report: Report, track: str, timed: bool, solved: list[Solved]) -> tuple:
    """Hold medians of a track against those of the best solver; returns a line of the table."""
    ours = np.array([one.ours for one in solved])
    known = np.isfinite(ours).all(axis=1)
    cells = [f'{track}{", clocks apart" if timed else ""}', f'{known.sum()} of {len(solved)}']
    for k, unit in enumerate(('°', 'mm')):
        peers = {name: np.nanmedian([one.peers[name][k] for one, is_known in zip(solved, known)
                                     if is_known]) for name in solved[0].peers}
        best = min(peers, key=peers.__getitem__)
        median = float(np.median(ours[known, k]))
        cells += [f'{median:.3g} {unit}', f'{peers[best]:.3g} ({best})',
                  f'{median / peers[best]:.2f}']
        report.verdict(f'{cells[0]}, median {unit} over that of {best}', median / peers[best],
                       1.0, '')
    wrong = sum(one.worst > MAX_SIGMAS for one in solved)
    return (*cells, f'{max(one.worst for one in solved):.1f}', str(wrong))


def run(report: Report, options) -> None:
    """Print the table; with --cache FOLDER, a tier that lies there is taken."""
    report.section('Hand-eye streams', 'Medians over what we do not call open; the best of '
                   'eleven solvers by that median. sigmas: of x, y, z.')
    if find_spec('kinhec') is None:
        report.say('Left out: kinhec is not installed (pip install kinhec).')
        return
    from kinhec import load_manifest
    from kinhec.io import _load_from_row
    from kinhec.pipeline import generate_dataset
    with tempfile.TemporaryDirectory() as work:
        root = Path(options.cache or work)
        if not (root / 'sequences.parquet').exists():
            root = generate_dataset('smoke', root / 'smoke', tracks=list(TRACKS), progress=False,
                                    work_dir=Path(work) / 'logs', write_card=False)
        rows = [row.to_dict() for _, row in load_manifest(root, list(TRACKS)).iterrows()]
        found = []
        for row in rows:
            sequence = _load_from_row(root, row)
            found += [solve(sequence, row, timed)
                      for timed in ((False,) if sequence.synchronous else (False, True))]
    kinds = sorted({(one.track, one.timed) for one in found})
    report.table(('track', 'not open', 'turn', 'best solver', 'ratio', 'place', 'best solver',
                  'ratio', 'sigmas, largest', f'beyond {MAX_SIGMAS:g}'),
                 [report_track(report, track, timed, [
                     one for one in found if (one.track, one.timed) == (track, timed)])
                  for track, timed in kinds])
    report.verdict('sequences beyond 4 sigmas', float(sum(
        one.worst > MAX_SIGMAS for one in found)), 0.5, '')
