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
"""The parts of the tracker's benches: what gets in the way, how it is judged, peers."""

from bench.inputs import data_folder
from bench.tables import Report
from bench.tracking import tracking_poses, tracking_starts, visp_peer
from bench.tracking.hindrances import CLEAN_IMAGES, HIDDEN_FROM, HINDRANCES
from bench.tracking.tracking_objects import NEW_OBJECTS
from bench.tracking.tracking_occlusion import judge, longest_run
from bench.tracking.tracking_poses import coverage, start_of, tracked
from bench.tracking.tracking_runs import cube_sequence
import numpy as np
import pytest
from selfcal_ros.rorapid.tracker import TrackerState
from selfcal_ros.synthetic.objects import tracked_object

BOX = (40, 30, 100, 80)


@pytest.mark.parametrize('hindrance', HINDRANCES, ids=lambda one: one.name)
def test_hindrances_cover_what_they_say_and_leave_the_first_images(hindrance):
    image = np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)
    kept = image.copy()
    rng = np.random.default_rng(1)
    if 'blur' not in hindrance.name:
        assert (hindrance.apply(image, 0, BOX, rng) == image).all()
    shares = []
    for number in range(CLEAN_IMAGES, 100):
        seen = hindrance.apply(image, number, BOX, rng)
        assert seen.shape == image.shape and seen.dtype == np.uint8
        inside = (seen != image)[30:80, 40:100]
        shares.append(inside.mean())
    assert (image == kept).all()
    wanted = {'bar over 25 %': 0.25, 'bar over 50 %': 0.5, 'bar over 75 %': 0.75,
              'lower half hidden': 0.5, 'fence': 1 / 3}.get(hindrance.name)
    if wanted:
        assert np.mean(shares) == pytest.approx(wanted, abs=0.05)
    if hindrance.name.startswith('all hidden'):
        assert sum(share > 0.9 for share in shares) == int(hindrance.name.split()[3])
        assert shares[HIDDEN_FROM - CLEAN_IMAGES] > 0.9


def test_the_longest_run_is_counted():
    assert [longest_run(np.array(flags, bool)) for flags in (
        [], [0, 0], [1, 1, 0, 1], [1, 0, 1, 1, 1])] == [0, 0, 2, 3]


@pytest.mark.long
def test_a_rendered_object_is_followed_within_the_bars():
    recording = tracked_object(30, 'cube', size=(480, 360))
    track, errors = tracked(recording, start=start_of(recording))
    assert not track.lost.any() and len(errors) < 30
    assert np.rad2deg(np.linalg.norm(errors[:, 3:], axis=1).mean()) < 0.5


def test_new_objects_are_their_models_and_every_wrong_model_is_another():
    sequence = tracking_starts.Sequence.render('channel', 71, 3)
    frames = tracking_starts.follow(sequence, sequence.made.model)
    assert frames[-1].state is TrackerState.TRACKING and frames[-1].rms_px < 0.3
    assert tracking_starts.right(frames[-1], sequence.made, 2)
    for name, build in NEW_OBJECTS.items():
        made = tracked_object(1, build(0), background=False)
        assert made.model.name == name
        for what, wrong, _ in tracking_starts.WRONGS:
            model, camera, sigma = wrong(made, 1)
            same = np.array_equal(model.vertices, made.model.vertices)
            assert same == (camera is not None) and (sigma is not None) == ('stated' in what)


@pytest.mark.long
def test_a_missed_bar_is_told(capsys, monkeypatch):
    # one sequence tells as much of the report as all do
    monkeypatch.setattr(tracking_poses, 'SEEDS', tracking_poses.SEEDS[:1])
    report = Report()
    coverage(report, 12)
    assert 'largest difference from the nominal share' in capsys.readouterr().out


@pytest.mark.long
def test_the_cube_sequence_is_followed_and_visp_agrees():
    if data_folder('visp_mbt_cube') is None:
        pytest.skip('the recorded sets (../shared/data) are not there')
    sequence = cube_sequence()
    images, numbers = sequence.images[:25], np.arange(25)
    share, silent, at_the_end = judge(sequence, images, numbers, 'modern')
    assert share > 0.95 and silent == 0 and at_the_end
    peer = visp_peer.build()
    if peer is None:
        pytest.skip('ViSP is not installed')
    rotations, translations, seconds = visp_peer.track(peer, images, 'both')
    assert len(rotations) == 25 and (seconds > 0).all()
    assert np.linalg.norm(translations - sequence.reference.translations[:25], axis=1).max() < 0.02
