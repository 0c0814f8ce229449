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
Cameras that move together: how often truth lies in the stated covariance, and how far off it is.

Run: python -m bench.mounts.rigs [--seeds 40]. Rigs are carried by hand or driven, with and
without a common field of view; nothing is known but square pixels.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from scipy.stats import chi2
from selfcal_ros import calibrate_rig, CameraFacts
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.synthetic.rig_scenes import driven_path, hand_path, rig_scene

from bench.monte_carlo import run_seeds

#: Parameters that are compared, of each camera; then the pose of the second.
LENS, POSE = ('fx', 'cx', 'cy'), ('x', 'y', 'z', 'roll', 'pitch', 'yaw')
#: Shares of runs that ellipsoids should hold.
SHARES = (0.6, 0.8, 0.9, 0.95)
KINDS = ('hand', 'drive')


def one_run(kind: str, overlap: bool, seed: int):
    """Return errors, their covariance and which are estimated; None for a refusal."""
    rng = np.random.default_rng(seed)
    scene = rig_scene(rng, hand_path(rng, 10) if kind == 'hand' else driven_path(16), overlap,
                      points=200)
    result = calibrate_rig(scene.tracks, shared_tracks=overlap, facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='none'))
    if not result:
        return None
    T, found = scene.T_rig_camera['right'], result.poses['right'].T_rig_camera
    lens = [result.cameras[name].camera.parameters[[0, 2, 3]] - camera.parameters[[0, 2, 3]]
            for name, camera in scene.cameras.items()]
    errors = np.r_[(*lens, found[:3, 3] - T[:3, 3] / scene.step_m,
                    rotation_vector(found[:3, :3] @ T[:3, :3].T))]
    names = [f'{name}.{one}' for name in scene.cameras for one in LENS]
    rows = [result.parameter_names.index(name)
            for name in (*names, *(f'right.{one}' for one in POSE))]
    covariance = result.covariance[np.ix_(rows, rows)]
    known = np.isfinite(errors) & np.isfinite(np.diag(covariance))
    way = np.linalg.norm(np.diff(scene.rig_from_world[:, :, 3], axis=0), axis=1).sum()
    return errors, covariance, known, scene.step_m / way


def report(kind: str, overlap: bool, seeds: int) -> str:
    """Run one kind of rig, and return a row of the table."""
    runs = [run for run in run_seeds(partial(one_run, kind, overlap), range(seeds), 1)
            if run is not None]
    inside = np.array([chi2.cdf(e[k] @ np.linalg.solve(C[np.ix_(k, k)], e[k]), k.sum())
                       for e, C, k, _ in runs])
    z = np.array([np.where(k, e, np.nan) / np.sqrt(np.diag(C)) for e, C, k, _ in runs])
    turn = np.median([np.degrees(np.linalg.norm(e[9:])) for e, _, _, _ in runs])
    place = np.median([100 * np.linalg.norm(e[6:9][k[6:9]]) * share for e, _, k, share in runs])
    return (f'| {kind} | {"yes" if overlap else "no"} | {len(runs)}/{seeds} | {turn:.3f} | '
            f'{place:.2f} | {np.sqrt(np.nanmean(z**2)):.2f} | '
            + ' | '.join(f'{np.mean(inside < share):.2f}' for share in SHARES) + ' |')


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=40)
    parser.add_argument('--kind', choices=KINDS)
    args = parser.parse_args()
    print('| rig | overlap | runs | rotation, deg | place, % of the path | z rms | '
          + ' | '.join(f'{share:g}' for share in SHARES) + ' |')
    print('|---' * (6 + len(SHARES)) + '|')
    for kind in (args.kind,) if args.kind else KINDS:
        for overlap in (False, True):
            print(report(kind, overlap, args.seeds), flush=True)


if __name__ == '__main__':
    main()
