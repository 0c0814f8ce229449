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
The cube sequence with things in the way: RAPiD, RoRAPiD, ours, and ViSP where it is installed.

An image counts as followed when the corners of the cube lie within 5 px, on average, of where the
clean sequence puts them.
"""

from __future__ import annotations

from bench.tables import Report
from bench.tracking import visp_peer
from bench.tracking.hindrances import HINDRANCES
from bench.tracking.tracking_runs import (cube_sequence, CubeSequence, follow, FOLLOWED_PX,
                                          project_all)
import numpy as np
from selfcal_ros.rorapid.tracker import TrackerOptions

METHODS = {'RAPiD': 'rapid', 'RoRAPiD': 'rorapid', 'ours': 'modern'}
#: A lost object must be reported within so many images.
REPORTED_WITHIN = 5


def run(report: Report, options) -> None:
    """Print the table."""
    report.section('Occlusion: the cube sequence with things in the way',
                   'Share of images within 5 px; silent: longest run of images beyond 5 px before '
                   'LOST is reported.')
    sequence = cube_sequence()
    if sequence is None:
        report.say('left out: the recorded sets are not there')
        return
    peer = visp_peer.build()
    if peer is None:
        report.say('ViSP is not installed here: its column shows what it reached elsewhere '
                   '(edges, example settings; occluders of the same kind, not the same pixels).'
                   '\n')
    against_visp(report, sequence, peer)
    rows, shares, silent = [], {}, 0
    for hindrance in HINDRANCES:
        images, numbers = hindered(sequence, hindrance)
        row = [hindrance.name, len(images)]
        for name, method in METHODS.items():
            if name == 'ours':
                found, longest, again = judge(sequence, images, numbers, method)
                shares[hindrance.name] = found
                silent = max(silent, longest)
                row += [f'{found:.2f}', longest, 'yes' if again else 'no']
            else:
                row.append(f'{judge(sequence, images, numbers, method)[0]:.2f}')
        if peer is not None:
            row.append('{:.2f}, {:.2f}'.format(*visp_shares(sequence, images, numbers, peer)))
        else:
            row.append('' if hindrance.visp is None else f'{hindrance.visp:.2f}')
        rows.append(row)
    report.table(('in the way', 'images', 'RAPiD', 'RoRAPiD', 'ours', 'silent', 'at the end',
                  'ViSP edges, edges + KLT' if peer else 'ViSP edges'), rows)
    report.say('')
    for hindrance in HINDRANCES:
        if hindrance.least:
            found = shares[hindrance.name]
            report.judge(found >= hindrance.least, f'{hindrance.name}: {found:.2f} of the images '
                         f'within 5 px, required {hindrance.least:g}')
    report.judge(silent <= REPORTED_WITHIN, f'longest unreported loss: {silent} images, required '
                 f'{REPORTED_WITHIN}')


def hindered(sequence: CubeSequence, hindrance):
    """Return the images with what is in the way, and their numbers."""
    corners = sequence.reference.corners(sequence.model.vertices, sequence.camera)
    rng = np.random.default_rng(5)
    numbers = range(0, len(sequence.images), hindrance.every)
    images = []
    for number in numbers:
        box = (*corners[number].min(axis=0), *corners[number].max(axis=0))
        images.append(hindrance.apply(sequence.images[number], number, box, rng))
    return images, np.array(numbers)


def judge(sequence: CubeSequence, images, numbers, method: str):
    """Return share within 5 px, longest silent loss, and whether it is followed at the end."""
    track = follow(images, sequence.model, sequence.camera, sequence.start,
                   TrackerOptions(method=method))
    distance = corner_distance(sequence, numbers, track.rotations, track.translations)
    off = distance > FOLLOWED_PX
    # a lost image shows no pose, so it counts as not followed whatever the prediction
    followed = ~off & ~track.lost
    return float(np.mean(followed)), longest_run(off & ~track.lost), bool(followed[-1])


def corner_distance(sequence: CubeSequence, numbers, rotations, translations) -> np.ndarray:
    """Mean distance (N,) of the projected corners from the clean sequence's, pixels."""
    points, camera = sequence.model.vertices, sequence.camera
    seen = project_all(points, rotations, translations, camera)
    true = sequence.reference.corners(points, camera)[numbers]
    distance = np.linalg.norm(seen - true, axis=2)
    mean = np.nan_to_num(distance, posinf=0.0).mean(axis=1)
    return np.where(np.isfinite(distance).all(axis=1), mean, np.inf)


def longest_run(flags: np.ndarray) -> int:
    """Length of the longest run of True."""
    longest = current = 0
    for flag in flags:
        current = current + 1 if flag else 0
        longest = max(longest, current)
    return longest


def against_visp(report: Report, sequence: CubeSequence, peer) -> None:
    """Compare the clean sequence with ViSP's poses, and with the edges themselves."""
    track = sequence.reference
    report.say(f'Clean: rms of the edges {np.sqrt(np.nanmean(track.rms_px**2)):.2f} px, median '
               f'{1000 * np.median(track.seconds):.2f} ms an image.')
    report.judge(not track.lost.any(), 'the clean sequence is tracked to its end')
    report.verdict('rms of the visible edges', float(np.sqrt(np.nanmean(track.rms_px**2))), 1.0,
                   'px')
    if peer is None:
        return
    numbers = np.arange(len(sequence.images))
    for name, kind in (('edges', 'edges'), ('edges + KLT', 'both')):
        visp = visp_peer.track(peer, sequence.images, kind)
        distance = corner_distance(sequence, numbers, *visp[:2])
        report.say(f'Corners from ViSP, {name}: median {np.median(distance):.2f} px, 90 % '
                   f'{np.percentile(distance, 90):.2f} px; ViSP takes '
                   f'{1000 * np.median(visp[2]):.2f} ms an image.')
    report.verdict('median distance of the corners from ViSP (edges + KLT)',
                   float(np.median(distance)), 1.0, 'px')
    report.say('')


def visp_shares(sequence: CubeSequence, images, numbers, peer):
    """Return the shares within 5 px of ViSP's edges, and of its edges with KLT."""
    for kind in ('edges', 'both'):
        rotations, translations, _ = visp_peer.track(peer, images, kind)
        distance = corner_distance(sequence, numbers, rotations, translations)
        yield float(np.mean(distance <= FOLLOWED_PX))
