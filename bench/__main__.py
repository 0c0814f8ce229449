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
Print the figures that the project claims: `python -m bench [NAME ...]`.

Exit status 1 when a figure misses its requirement.
"""

from __future__ import annotations

import argparse
from importlib import import_module
import sys
import time

from bench.tables import environment, Report

#: Packages of benches: name on the command line and of the module, and what it shows.
GROUPS = {
    'thesis': {
        'si_triplet': 'spread of K on sequence SI over the Cramér-Rao bound',
        'si_horizon': 'horizon and vanishing point of SI: pairs, batch, bound, thesis',
        'chapter6': 'thesis tables 6.2-6.13 and 6.20: lines, v, l and K of the closed form',
        'si_degenerate': 'degenerate motions and scenes: right, or refused for the right reason',
        'dinosaur': 'the turntable of vgg_dino: steps and fixed points',
        'affine_tables': 'thesis tables 4.1 and 4.2, rotations that leave parameters open',
        'few_views': 'four general views, equal objects in one image, and Kruppa, beside truth',
        'visibility_tables': 'visibility tables of the thesis beside the direct test',
    },
    'calibration': {
        'coverage': 'is the stated covariance of K true? 90 cells, 1000 runs each: hours',
        'hard_scenes': 'sequences at the edge: never confidently wrong, never refused needlessly',
        'suppositions': 'wrong facts, two cameras, mirrored images, a prism: named or silent',
        'rough_shares': 'sigmas true beside rolling shutter, zoom, levers, wrong facts? hours',
        'further_worlds': 'bad days beside the shared ones: turned, torn, rounded, two at once',
        'other_values': 'the shared kinds with other values, cameras and more views',
        'mixed_worlds': 'worlds drawn at random from all troubles at once: right, or refused',
        'everyday': 'drones, arms, cars, walkers and more, with troubles: right, or refused',
        'loops': 'drives that go round or pause on the way: right, or refused',
        'short_clips': 'clips that turn by 2 to 15 degrees: calibration, hint or refusal',
        'rendered_drive': 'rendered drive, images to K, beside COLMAP',
        'rough_images': 'compressed, shaken, dark, interlaced, thermal images: right, or refused',
        'real_sets': 'recorded sets with known cameras (--peer: beside COLMAP)',
        'turntable': 'a fixed camera before a wall and a turntable, rendered and pasted',
        'arm': 'rendered and recorded arms, general motion against its bound',
        'known_object': 'known objects: the grid of the thesis, recorded sets, OpenCV',
        'waved_boards': 'boards waved before a rolling shutter: sigmas true; OpenCV beside',
        'board_corners': 'corners of chessboards and of ChArUco boards in drawn images',
        'zoom': 'a focal length that varies: found, sigmas true, constant ones left alone',
        'shutter': 'rolling shutter: simulated coverage, rendered videos at 30 Hz: hours',
        'whole_image': 'projection of recorded perspective lenses over the image, in sigmas',
    },
    'lenses': {
        'lens_population': 'prior over real lenses against brands it has not seen',
        'lenses': 'every lens, simulated: covariance, family, corners, decentring: hours',
        'uneven_lenses': 'lenses with bumps that no model describes: errors, and sigmas',
        'wide_lenses': 'wide lenses, rendered, in a room and on a drone; COLMAP beside',
    },
    'mounts': {
        'mounts': 'where the camera sits on the robot: recorded sets, degenerate, coverage',
        'hand_eye': 'mounts from pose streams beside eleven hand-eye solvers (kinhec)',
    },
    'tracking': {
        'tracking_occlusion': 'tracker on the cube sequence with things in the way, beside ViSP',
        'tracking_poses': 'tracker against truth: accuracy, covariances, motion models, zoom',
        'tracking_meshes': 'smooth parts by their outline: accuracy, hindrances, time',
        'tracking_recorded': 'a painted cube and a dragon filmed by hand, given as meshes',
        'tracking_sought': 'objects that nobody says a start of: found, or not, never wrong',
        'tracking_starts': 'wrong starts, wrong models, absent objects: said, never tracked',
        'tracking_walls': 'plain parts before walls that share their greys: tracked, and right',
        'tracking_jumps': 'objects that jump, as images are missing: tracked, and right',
        'tracking_stereo': 'the tea box before two cameras that must agree',
        'tracking_rig': 'one object, several cameras: one pose, and what is wrong between them',
        'tracking_speed': 'time of the tracker and its parts, 10 000 images',
        'object_models': 'models of objects from two translated images, rendered and real',
        'tracked_calibration': 'calibration from the edges of a tracked object against truth',
    },
    'live': {
        'monitor': 'how soon a changed camera is noticed, how often an unchanged one is blamed',
        'live': 'image to tracks at 30 Hz, in one process and over DDS',
        'live_page': 'load of the live page at 30 Hz, without and with a browser',
        'composed': 'image to CameraInfo at 30 Hz, nodes apart and in one process',
        'soak': 'memory, threads and files of the nodes over simulated hours: hours',
    },
    'hostile': {
        'hostile_inputs': 'bad files, messages, options, signals, a full disk, at random',
    },
    'speed': {
        'speed': 'time of the estimate, of the command, and their growth',
        'stages': 'every stage of photographs to K beside its floor; the command beside COLMAP',
        'laps': 'three laps in 1000 images, all keyframes: time, memory, loops; COLMAP beside',
        'long_recording': 'ten minutes of 1080p: time, memory, sigma beside every image: hours',
        'many_bags': 'a hundred bags on one core and on two, broken ones, the joint estimate',
    },
}
BENCHES = {name: what for group in GROUPS.values() for name, what in group.items()}
#: Only when asked for by name.
LONG = ('coverage', 'hostile_inputs', 'laps', 'lenses', 'long_recording', 'mounts', 'wide_lenses',
        'rough_images', 'rough_shares', 'shutter')


def main(argv: list[str] | None = None) -> int:
    """Run the benches that are named, all by default; returns the exit status."""
    names = '\n\n'.join(f'{group}:\n' + '\n'.join(
        f'  {name:19} {what}' for name, what in benches.items())
        for group, benches in GROUPS.items())
    parser = argparse.ArgumentParser(
        prog='python -m bench', formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Print the figures that the project claims.', epilog=names)
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help=f'all but {", ".join(LONG)} by default')
    parser.add_argument('--runs', type=int, help='Monte Carlo runs, in place of the full number')
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--engine', choices=('processes', 'dask'),
                        help='many_bags: this engine only (all that are installed)')
    parser.add_argument('--peer', action='store_true',
                        help='run COLMAP on the recorded sets, too (minutes)')
    parser.add_argument('--no-peer', action='store_true',
                        help='leave COLMAP out of the rendered drives')
    parser.add_argument('--cache', metavar='FOLDER',
                        help='keep what takes long here (images, tracks, single runs), and use it')
    args = parser.parse_args(argv)
    unknown = set(args.names) - set(BENCHES)
    if unknown or (args.runs is not None and args.runs < 2):
        parser.error(f'unknown: {", ".join(sorted(unknown))}; choose from {", ".join(BENCHES)}'
                     if unknown else '--runs must be at least 2')
    report = Report()
    report.say(environment())
    for name in args.names or [name for name in BENCHES if name not in LONG]:
        began = time.perf_counter()
        group = next(group for group, benches in GROUPS.items() if name in benches)
        import_module(f'bench.{group}.{name}').run(report, args)
        report.say(f'({name}: {time.perf_counter() - began:.0f} s)')
    if report.failures:
        report.say('\nMissed:\n' + '\n'.join(f'- {failure}' for failure in report.failures))
    return 1 if report.failures else 0


if __name__ == '__main__':
    sys.exit(main())
