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
"""Many jobs in processes and on Dask: order, crashes, threads, errors of the caller."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from operator import call
import os
from pathlib import Path
import re
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline import many_inputs
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.calibrate_input import CalibrationSettings
from selfcal_ros.pipeline.engines import run_jobs
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.many_inputs import calibrate_many, find_recordings, Job
from selfcal_ros.synthetic.special_scenes import drive

#: Facts that ten views determine a camera with.
SETTINGS = CalibrationSettings(CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'),
                               image_size=(640, 480))
needs_dask = pytest.mark.skipif(not find_spec('distributed'), reason='Dask is not installed')
both_engines = pytest.mark.parametrize('engine', ['processes',
                                                  pytest.param('dask', marks=needs_dask)])


@pytest.fixture(scope='module', params=['processes', pytest.param('dask', marks=needs_dask)])
def done(request):
    """Run jobs of many kinds once; gives engine, results by number, environment before, after."""
    before = dict(os.environ)
    jobs = [partial(os.getenv, 'OMP_NUM_THREADS'), partial(pow, 2, 10), os.getpid,
            cv2.getNumThreads, partial(os.getenv, 'MALLOC_TRIM_THRESHOLD_'), partial(int, 'x')]
    found = dict(run_jobs(call, jobs, engine=request.param, workers=2))
    assert len(found) == len(jobs)
    return request.param, found, before, dict(os.environ)


@pytest.mark.long
def test_every_result_comes_and_is_computed_with_one_thread(done):
    engine, found, before, after = done
    assert found[0] == '1' and found[1] == 1024 and found[2] != os.getpid() and found[3] == 1
    # memory stays with the process: Dask's own choice costs half as much time again
    assert found[4] == before.get('MALLOC_TRIM_THRESHOLD_')
    # Dask adds variables of its own
    assert {name: after.get(name) for name in before} == before
    assert engine == 'dask' or after == before


def test_a_job_that_raises_says_what(done):
    _, found, *_ = done
    assert found[1] == 1024
    assert isinstance(found[5], ValueError) and "'x'" in str(found[5])


def unreadable():
    raise ImportError('no module of this name')


class Unreadable:
    """What cannot be read where it arrives, as where a module is missing."""

    def __reduce__(self):
        return unreadable, ()

    def __call__(self):
        return 1


@needs_dask
def test_a_job_that_cannot_be_read_on_the_cluster_says_what():
    (_, value), = run_jobs(call, [Unreadable()], engine='dask', workers=1)
    assert isinstance(value, Exception)


@pytest.mark.long
@both_engines
def test_a_job_that_kills_its_process_costs_only_itself(engine):
    jobs = [partial(pow, number, 2) for number in range(12)]
    jobs[2] = jobs[7] = partial(os._exit, 1)
    expected = {number: number**2 for number in range(12)} | {2: None, 7: None}
    found = list(run_jobs(call, jobs, engine=engine, workers=2))
    assert dict(found) == expected and len(found) == 12


def test_a_recording_that_could_not_be_run_says_why(monkeypatch):
    def run(function, jobs, **_):
        yield 0, ModuleNotFoundError("No module named\n 'rosbags'")
        yield 1, None

    monkeypatch.setattr(many_inputs, 'run_jobs', run)
    first, second = calibrate_many(['a.mcap', 'b.mcap'], SETTINGS).failures
    assert first.error == ("a.mcap: it could not be run there (ModuleNotFoundError: No module "
                           "named 'rosbags').")
    assert second.error.startswith('b.mcap: its process died')


def test_a_cluster_gets_absolute_paths_and_outcomes_keep_theirs(monkeypatch, tmp_path):
    jobs = []

    def run(_, given, **__):
        jobs.extend(given)
        yield 0, [many_inputs.Outcome(given[0].path, error=f'{given[0].path} is empty.')]

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(many_inputs, 'run_jobs', run)
    Path('mask.png').touch()
    Path('points.csv').touch()
    settings = replace(SETTINGS, mask='mask.png', known_object='points.csv')
    for engine, folder in (('dask', f'{tmp_path}/'), ('processes', '')):
        summary = calibrate_many([Path('a.mcap')], settings, engine=engine)
        job = jobs.pop()
        assert (job.path, job.settings.mask, job.settings.known_object) == tuple(
            f'{folder}{name}' for name in ('a.mcap', 'mask.png', 'points.csv'))
        assert [(one.path, one.error) for one in summary.failures] == [
            ('a.mcap', 'a.mcap is empty.')]
    calibrate_many(['a.mcap'], replace(settings, known_object='chessboard:9x6:0.02'),
                   engine='dask')
    assert jobs.pop().settings.known_object == 'chessboard:9x6:0.02'


def test_what_cannot_be_opened_is_a_plain_sentence(monkeypatch):
    def refuse(path):
        raise PermissionError(13, 'Permission denied', 'locked')

    monkeypatch.setattr('selfcal_ros.pipeline.bag_source.is_bag_folder', refuse)
    monkeypatch.setattr(Path, 'is_dir', lambda _: True)
    (outcome,) = many_inputs.calibrate_job(Job('locked', SETTINGS))
    assert outcome.error == 'locked cannot be read: Permission denied.'


def test_whoever_stops_listening_stops_the_work():
    results = run_jobs(call, [partial(pow, 1, 1)] + [partial(time.sleep, 60)] * 3, workers=2)
    assert next(results) == (0, 1)
    began = time.monotonic()
    results.close()
    assert time.monotonic() - began < 30


@pytest.mark.parametrize('options, words', [
    ({'engine': 'magic'}, 'unknown'), ({'workers': 0}, 'positive'),
    ({'scheduler': 'tcp://x:1'}, '--engine dask')])
def test_wrong_engines(options, words):
    with pytest.raises(ArgumentError, match=words):
        list(run_jobs(abs, [1], **options))


def test_without_dask_the_sentence_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, 'dask.distributed', None)
    with pytest.raises(ArgumentError, match=r"pip install '\.\[dask\]' in the clone"):
        list(run_jobs(abs, [1], engine='dask'))


@pytest.fixture
def scheduler(tmp_path):
    """Start a scheduler of Dask without workers; returns its process and its address."""
    said = tmp_path / 'said.txt'
    with open(said, 'wb') as standard_error:
        process = subprocess.Popen(
            [sys.executable, '-m', 'distributed.cli.dask_scheduler', '--host', '127.0.0.1',
             '--port', '0', '--no-dashboard', '--scheduler-file',
             str(tmp_path / 'scheduler.json')], stderr=standard_error, cwd=tmp_path)
    try:
        deadline = time.monotonic() + 60
        while not (at := re.search(r'Scheduler at:\s+(\S+)\n', said.read_text())):
            assert process.poll() is None and time.monotonic() < deadline, said.read_text()
            time.sleep(0.05)
        yield process, at[1]
    finally:
        process.kill()
        process.wait()


@contextmanager
def working(address):
    """Start a worker of Dask for a scheduler; gives its process."""
    worker = subprocess.Popen([sys.executable, '-m', 'distributed.cli.dask_worker', address,
                               '--nthreads', '1', '--no-nanny', '--no-dashboard'],
                              stderr=subprocess.DEVNULL, cwd=Path(__file__).parents[2])
    try:
        yield worker
    finally:
        worker.kill()
        worker.wait()


@pytest.mark.long
@needs_dask
def test_a_scheduler_that_is_not_there_has_no_workers_or_goes_away_is_a_sentence(
        scheduler, monkeypatch):
    process, address = scheduler
    with monkeypatch.context() as patch:
        patch.setattr('selfcal_ros.pipeline.engines.FIRST_WORKER_S', 1.0)
        with pytest.raises(InputError, match=rf'{address} has no workers; start some: dask work'):
            list(run_jobs(abs, [1], engine='dask', scheduler=address))
    with working(address):
        results = run_jobs(call, [partial(pow, 3, 2), partial(time.sleep, 60)], engine='dask',
                           scheduler=address)
        assert next(results) == (0, 9)
        process.kill()
        with pytest.raises(InputError, match='lost on the way'):
            list(results)
    monkeypatch.setattr('selfcal_ros.pipeline.engines.CONNECT_S', 1.0)
    with pytest.raises(InputError, match=f'{address} cannot be reached'):
        list(run_jobs(abs, [1], engine='dask', scheduler=address))


@pytest.mark.long
@needs_dask
def test_a_run_whose_workers_are_all_gone_ends_with_a_sentence(scheduler, monkeypatch):
    _, address = scheduler
    monkeypatch.setattr('selfcal_ros.pipeline.engines.NO_WORKERS_S', 2.0)
    with working(address) as worker:
        results = run_jobs(call, [partial(pow, 3, 2), partial(time.sleep, 60)], engine='dask',
                           scheduler=address)
        assert next(results) == (0, 9)
        worker.kill()
        with pytest.raises(InputError, match=f'{address} has had no workers for 2 s'):
            list(results)


def tracks_folder(tmp_path, count):
    """Write tracks of short drives; returns the folder."""
    folder = tmp_path / 'drives'
    folder.mkdir()
    for number in range(count):
        drive(np.random.default_rng(number), 0.2, 10, 150, 10).tracks.to_csv(
            folder / f'd{number}.csv')
    return folder


@pytest.mark.long
@both_engines
def test_a_broken_recording_is_its_own_line_and_nothing_else(tmp_path, engine):
    folder = tracks_folder(tmp_path, 3)
    (folder / 'd1b.csv').write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    (folder / 'junk.mcap').write_bytes(b'junk')
    paths, many = find_recordings([folder])
    assert many and [path.name for path in paths] == ['d0.csv', 'd1.csv', 'd1b.csv', 'd2.csv',
                                                      'junk.mcap']
    seen = []
    summary = calibrate_many(paths, SETTINGS, each=seen.append, engine=engine,
                             workers=2)
    assert len(seen) == 5
    assert [Path(one.path).name for one in summary.failures] == ['d1b.csv', 'junk.mcap']
    assert all(one.error.startswith(one.path) for one in summary.failures)
    (camera,) = summary.cameras
    assert all(one.result for one in camera.outcomes) and camera.joint.used.all()
    # what the joint estimate has is what each has alone, whatever the engine
    alone = many_inputs.calibrate_job(Job(str(paths[0]), SETTINGS))[0]
    assert np.array_equal(alone.result.camera.parameters,
                          camera.outcomes[0].result.camera.parameters)
    error = camera.joint.calibration.camera.K[0, 0] - 520
    assert abs(error) < 4 * camera.joint.calibration.sigma['fx']
    assert camera.joint.calibration.sigma['fx'] < min(
        one.result.sigma['fx'] for one in camera.outcomes)


def test_what_inputs_name(tmp_path, monkeypatch):
    folder = tracks_folder(tmp_path, 2)
    rng = np.random.default_rng(0)
    frames = [Frame(k, 10**18 + k, rng.integers(0, 256, (48, 64), np.uint8)) for k in range(3)]
    write_image_bag(folder / 'bag', frames)
    monkeypatch.chdir(tmp_path)
    assert [p.name for p in find_recordings(['drives'])[0]] == ['bag', 'd0.csv', 'd1.csv']
    assert find_recordings(['drives/*.csv', 'drives/d0.csv']) == (
        [Path('drives/d0.csv'), Path('drives/d1.csv')], True)
    # a rosbag2 folder, even without its metadata, is one recording
    assert find_recordings(['drives/bag']) == ([Path('drives/bag')], False)
    (folder / 'bag' / 'metadata.yaml').unlink()
    assert find_recordings(['drives/bag']) == ([Path('drives/bag')], False)
    # among others a lone file is a recording like them
    (folder / 'lone.mcap').touch()
    assert [p.name for p in find_recordings(['drives'])[0]] == ['bag', 'd0.csv', 'd1.csv',
                                                                'lone.mcap']
    for name in ('d0.csv', 'd1.csv'):
        (folder / name).unlink()
    assert [p.name for p in find_recordings(['drives'])[0]] == ['bag', 'lone.mcap']
    assert find_recordings(['nowhere']) == ([Path('nowhere')], False)
    with pytest.raises(many_inputs.InputError, match='Nothing fits'):
        find_recordings(['no/*.mcap'])
    # a table or a film beside many images is about them, and a few pictures about a table
    images = tmp_path / 'images'
    images.mkdir()
    for name in ('0.png', '1.png', '2.png', '3.png', 'poses.csv'):
        (images / name).touch()
    assert find_recordings(['images']) == ([Path('images')], False)
    (images / '3.png').unlink()
    assert find_recordings(['images'])[1]
    # a shell has taken a folder apart; beside recordings they are a line each
    for name in ('a.png', 'b.JPG'):
        (folder / name).touch()
    for inputs in (['drives/a.png', 'drives/b.JPG'], ['drives/*.[pJ]*']):
        with pytest.raises(many_inputs.InputError, match='drives/a.png and 1 more are single '
                           'images; give the folder, drives,'):
            find_recordings(inputs)
    assert find_recordings(['drives/a.png', 'drives/bag'])[1]


def test_topics_of_a_bag_are_cameras_of_their_own(tmp_path):
    from selfcal_ros.pipeline.bag_source import image_topics
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import get_typestore, Stores
    store = get_typestore(Stores.ROS2_JAZZY)
    Image = store.types['sensor_msgs/msg/Image']
    Header = store.types['std_msgs/msg/Header']
    Time = store.types['builtin_interfaces/msg/Time']
    kind = 'sensor_msgs/msg/Image'
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for side in ('left', 'right'):
            topic = writer.add_connection(f'/{side}/image_raw', kind, typestore=store)
            again = writer.add_connection(f'/{side}/image_raw/compressed', kind, typestore=store)
            message = Image(Header(Time(1, 0), 'cam'), 4, 4, 'mono8', 0, 4,
                            np.zeros(16, np.uint8))
            for connection in (topic, again):
                writer.write(connection, 10**9, store.serialize_cdr(message, kind))
        writer.add_connection('/empty/image_raw', kind, typestore=store)
    assert image_topics(tmp_path / 'bag') == ['/left/image_raw', '/right/image_raw']
    found = many_inputs.calibrate_job(Job(str(tmp_path / 'bag')))
    assert [one.topic for one in found] == ['/left/image_raw', '/right/image_raw']
    assert all(one.error for one in found)
