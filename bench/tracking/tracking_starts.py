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
Wrong starts, wrong models, wrong cameras, other objects and absent ones: said, never tracked.

The objects and sequences are none of those that the limits of the tracker were set on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import time

from bench.tables import Report
from bench.tracking.tracking_objects import NEW_OBJECTS
import numpy as np
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.objects import tracked_object
from selfcal_ros.values.wireframe import WireframeModel

#: Sequences of each object, their seeds, and images of each.
SEEDS, IMAGES = (71, 72), 36
#: A pose is right within these: share of the distance, degrees. A wrong model moves the pose; then
#: its own sigmas are asked, and this many of them are too many.
_NEAR, _TURN_DEG, _SIGMAS = 0.02, 3.0, 4.0
#: No turn, and half turns about the axes.
_HALVES = (1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)
#: A start some degrees off is followed, or no pose is published, within so many images.
_STARTS_DEG, _START_IMAGES = (15, 30, 90), 18
#: What is wrong must be said within so many images.
SAID_WITHIN = 30
#: Images before an object is away, away, and in which it must be found again.
_SEEN, _AWAY, FOUND_WITHIN = 20, 50, 20


@dataclass(frozen=True)
class Sequence:
    """A rendered object with its images."""

    made: object
    images: list

    @classmethod
    def render(cls, name: str, seed: int, count: int, first: int = 0) -> Sequence:
        """Render images of one of the new objects, from image `first` of its path on."""
        made = tracked_object(first + count, NEW_OBJECTS[name](seed), seed=seed, supersampling=2,
                              speed=0.7 + 0.1 * (seed % 5))
        renderer = made.renderer()
        return cls(made, [made.frame(k, renderer) for k in range(first, first + count)])


def run(report: Report, options) -> None:
    """Print the tables; with --runs sequences of so many images."""
    count = min(options.runs or IMAGES, IMAGES)
    sequences = [(name, Sequence.render(name, seed, count))
                 for name in NEW_OBJECTS for seed in SEEDS]
    starts(report, sequences)
    right_models(report, sequences)
    wrong_models(report, sequences)
    absent(report)


def right(frame, made, k: int) -> bool:
    """Whether a frame's pose is that of image k."""
    return off_by(frame, made, k) == (True, True)


def off_by(frame, made, k: int) -> tuple[bool, bool]:
    """Whether position and rotation are near the truth, or one that looks the same."""
    distance = np.linalg.norm(made.translations[k])
    near = np.linalg.norm(frame.translation - made.translations[k]) < _NEAR * distance
    turned = made.rotations[k].T @ frame.rotation
    # lines of a rectangular box are the same after half a turn about its axes
    same = np.array([np.diag(half) for half in _HALVES[:4 if made.model.name == 'slab' else 1]])
    turn = (np.trace(same @ turned, axis1=1, axis2=2).max() - 1) / 2
    return bool(near), bool(turn > np.cos(np.deg2rad(_TURN_DEG)))


def starts(report: Report, sequences) -> None:
    """Start some degrees off, about axes at random."""
    report.section('Starts off by some degrees: new objects',
                   f'{len(sequences)} sequences, three axes each, {_START_IMAGES} images. A start '
                   'may be refused; a wrong pose may not be published.')
    rows, wrong_at_all = [], 0
    for degrees in _STARTS_DEG:
        began = followed = refused = wrong = published = degraded = 0
        for number, (_, sequence) in enumerate(sequences):
            made, rng = sequence.made, np.random.default_rng([7, number, degrees])
            for _ in range(3):
                axis = rng.normal(size=3)
                turn = rotation_matrix(np.deg2rad(degrees) * axis / np.linalg.norm(axis))
                tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
                tracker.start(turn @ made.rotations[0], made.translations[0])
                frames = [tracker.track(image) for image in sequence.images[:_START_IMAGES]]
                bad = [f for k, f in enumerate(frames) if f and not right(f, made, k)]
                began += 1
                wrong += bool(bad)
                published += len(bad)
                degraded += sum(f.state is TrackerState.DEGRADED for f in bad)
                refused += not any(frames)
                followed += bool(frames[-1]) and right(frames[-1], made, len(frames) - 1)
        wrong_at_all += wrong
        rows.append((degrees, began, followed, refused, wrong, published, degraded))
    report.table(('degrees off', 'starts', 'followed', 'no pose', 'wrong', 'wrong poses',
                  'of them degraded'), rows)
    report.say('')
    report.judge(rows[0][2] == rows[0][1], f'15° off: {rows[0][2]} of {rows[0][1]} followed')
    report.judge(wrong_at_all == 0, f'{wrong_at_all} starts published a wrong pose')


def right_models(report: Report, sequences) -> None:
    """Follow the true models: no doubt may be raised."""
    report.section('The right models: no doubt')
    doubted = {}
    for name, sequence in sequences:
        frames = follow(sequence, sequence.made.model)
        said = sum(frame.state is not TrackerState.TRACKING for frame in frames[2:])
        if said:
            doubted[name] = doubted.get(name, 0) + said, frames[-1].reason
    for name, (images, reason) in doubted.items():
        report.say(f'{name}: {images} images; the last of them: {reason}')
    report.judge(not doubted, f'{sum(n for n, _ in doubted.values())} of '
                 f'{sum(len(s.images) - 2 for _, s in sequences)} images are not TRACKING')


def wrong_models(report: Report, sequences) -> None:
    """Follow models and cameras that are wrong in one way."""
    report.section('Models and cameras that are wrong',
                   f'Said: not TRACKING any more, of {len(sequences)} sequences. Silent poses: '
                   f'TRACKING and more than {_SIGMAS:g} sigmas off after {SAID_WITHIN} images.')
    rows = []
    for what, wrong, judged in WRONGS:
        said, late, silent, total = 0, [], 0, 0
        for number, (name, sequence) in enumerate(sequences):
            model, camera, sigma = wrong(sequence.made, number)
            frames = follow(sequence, model, camera, sigma)
            off = [k for k, f in enumerate(frames) if f.state is not TrackerState.TRACKING]
            late_k = next((k for k in range(len(frames)) if all(
                f.state is not TrackerState.TRACKING for f in frames[k:])), None)
            said += late_k is not None and late_k <= SAID_WITHIN
            late += [late_k] if late_k is not None else []
            total += len(off)
            silent += sum(f.state is TrackerState.TRACKING and sigmas_off(
                f, sequence.made, k) > _SIGMAS for k, f in enumerate(frames) if k > SAID_WITHIN)
        rows.append((what, f'{said} of {len(sequences)}', max(late, default='never'), silent))
        if judged:
            report.judge(said == len(sequences) and not silent,
                         f'{what}: said within {SAID_WITHIN} images in {said} of '
                         f'{len(sequences)}, {silent} silent poses')
    report.say('')
    report.table(('wrong', 'said', 'after images, at most', 'silent poses'), rows)


def follow(sequence: Sequence, model, camera=None, sigma_m=None) -> list:
    """Follow a sequence from nearly its first pose."""
    made = sequence.made
    tracker = RorapidTracker(model, camera or made.camera, rng=np.random.default_rng(0))
    turn = rotation_matrix(np.deg2rad([1.0, -1.0, 0.5]))
    tracker.start(turn @ made.rotations[0], made.translations[0], distance_sigma_m=sigma_m)
    return [tracker.track(image) for image in sequence.images]


def sigmas_off(frame, made, k: int) -> float:
    """Distance of a position from the truth in its own sigmas, Mahalanobis."""
    error = frame.translation - made.translations[k]
    return float(np.sqrt(error @ np.linalg.solve(frame.covariance[:3, :3], error)))


def scaled(share: float, stated: bool = False):
    """Make the whole model too large; the distance may be stated within 0.5 %."""
    def wrong(made, _):
        sigma = 0.005 * float(made.translations[0][2]) if stated else None
        return replace(made.model, vertices=(1 + share) * made.model.vertices), None, sigma
    return wrong


def stretched(share: float):
    """Make one side too long; which one changes from sequence to sequence."""
    def wrong(made, number):
        factors = np.ones(3)
        factors[number % 3] += share
        return replace(made.model, vertices=made.model.vertices * factors), None, None
    return wrong


def longer_edge(share: float):
    """Move the nearest corner along one of its lines: that is seen."""
    def wrong(made, number):
        model = made.model
        depth = model.vertices @ made.rotations[0][2]
        b = int(depth.argmin())
        ends = [(x, y) if y == b else (y, x) for x, y in model.lines if b in (x, y)]
        a, _ = ends[number % len(ends)]
        vertices = model.vertices.copy()
        vertices[model.same(b)] += share * (vertices[b] - vertices[a])
        return replace(model, vertices=vertices), None, None
    return wrong


def other_focal(share: float):
    """Make the focal length too long."""
    def wrong(made, _):
        K = made.camera.K.copy()
        K[:2, :2] *= 1 + share
        return made.model, replace(made.camera, K=K), None
    return wrong


def another(made, number):
    """Take the model of the next object, of the same size."""
    names = list(NEW_OBJECTS)
    own = next(k for k, name in enumerate(names) if name == made.model.name)
    model: WireframeModel = NEW_OBJECTS[names[(own + 1) % len(names)]](0).model
    size = made.model.diameter_m / model.diameter_m
    return replace(model, vertices=size * model.vertices), None, None


#: What is wrong, how, and whether it must be said.
WRONGS = (
    *((f'side {share:.0%} too long', stretched(share), True) for share in (0.02, 0.05, 0.1)),
    ('one edge 5 % too long', longer_edge(0.05), True),
    ('one edge 10 % too long', longer_edge(0.1), True),
    ('focal length 5 % too long', other_focal(0.05), True),
    ('another object', another, True),
    *((f'whole model {share:.0%} too large', scaled(share), False) for share in (0.02, 0.05, 0.1)),
    *((f'whole model {share:.0%} too large, distance stated within 0.5 %', scaled(share, True),
       True) for share in (0.02, 0.05, 0.1)))


def images_without(made, seed: int, count: int):
    """Yield so many images of the wall alone, with noise."""
    empty = made.renderer()._background(made.camera, made.poses(0))
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.clip(empty + rng.normal(size=empty.shape), 0, 255).astype(np.uint8)


def absent(report: Report) -> None:
    """Take the object away for 50 images, and put it back elsewhere, otherwise turned."""
    report.section('Absent for 50 images, back elsewhere',
                   'The images between show the wall. The object comes back as it is 4 s later on '
                   'its path.')
    found, seconds, rows = 0, [], []
    trials = [(name, seed) for name in NEW_OBJECTS for seed in (81, 82, 83, 84)][:10]
    for name, seed in trials:
        before = Sequence.render(name, seed, _SEEN)
        later = 120
        after = Sequence.render(name, seed, FOUND_WITHIN, _SEEN + later)
        made = after.made
        tracker = RorapidTracker(made.model, made.camera, rng=np.random.default_rng(0))
        tracker.start(made.rotations[0], made.translations[0])
        for image in before.images:
            tracker.track(image)
        wrong = degraded = 0
        for image in images_without(made, seed, _AWAY):
            began = time.thread_time()
            frame = tracker.track(image)
            seconds.append(time.thread_time() - began)
            wrong += bool(frame)
            degraded += bool(frame) and frame.state is TrackerState.DEGRADED
        again = None
        for k, image in enumerate(after.images):
            frame = tracker.track(image)
            if frame and not right(frame, made, _SEEN + later + k):
                wrong += 1
                degraded += frame.state is TrackerState.DEGRADED
            elif frame and again is None:
                again = k + 1
        found += again is not None
        rows.append((name, seed, again or 'not', wrong, degraded))
    report.table(('object', 'seed', 'found after images', 'wrong poses', 'of them degraded'),
                 rows)
    report.say('')
    report.judge(found >= 0.9 * len(trials), f'found within {FOUND_WITHIN} images in {found} of '
                 f'{len(trials)}')
    wrong = sum(row[3] for row in rows)
    report.judge(wrong <= 5 * len(trials), f'{wrong} wrong poses, five a trial while a loss is '
                 'noticed')
    report.say(f'An image without the object takes {1000 * np.median(seconds):.0f} ms, 95 % '
               f'{1000 * np.percentile(seconds, 95):.0f} ms.')
