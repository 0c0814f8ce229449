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
"""The thread of rorapid_tracker: what belongs to the time before a reset stays there."""

import threading
from types import SimpleNamespace

import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.nodes.tracking_worker import InstantMessages, TrackingWorker
from test_support import image_stream


class SlowSession:
    """A session whose images take as long as the test likes."""

    model = camera = None
    wants_colour = False

    def __init__(self):
        self.taken, self.may_go = threading.Semaphore(0), threading.Semaphore(0)

    def finding(self, image, stamp_ns, depth):
        yield from ()
        self.taken.release()
        assert self.may_go.acquire(timeout=20)
        return stamp_ns

    def snapshot(self):
        return SimpleNamespace()


@pytest.fixture
def worker():
    session, ready = SlowSession(), threading.Semaphore(0)
    made = TrackingWorker([session], ready.release)
    made.session, made.ready = session, ready
    yield made
    session.may_go.release(100)
    made.stop()


def submit(worker, number):
    msg = image_stream.image(number)
    worker.submit(InstantMessages(msg.header, (msg,), (False,)))


def test_of_images_from_before_a_reset_nothing_comes_out(worker):
    session = worker.session
    # one is done and waits to be fetched, one is in work, one waits for its turn
    submit(worker, 0)
    session.may_go.release()
    assert worker.ready.acquire(timeout=20)
    session.taken.acquire(timeout=20)
    submit(worker, 1)
    assert session.taken.acquire(timeout=20)
    submit(worker, 2)
    done = []
    worker.command(lambda session: done.append('reset'), anew=True)
    assert worker.dropped == 1
    session.may_go.release()
    assert worker.ready.acquire(timeout=20) and worker.ready.acquire(timeout=20)
    assert done == ['reset'] and worker.poll() is None
    # what comes after it does come out
    submit(worker, 3)
    session.may_go.release()
    assert worker.ready.acquire(timeout=20)
    assert worker.poll().header.stamp.sec == 103 and worker.poll() is None


@pytest.fixture
def pair():
    sessions, ready = [SlowSession(), SlowSession()], threading.Semaphore(0)
    made = TrackingWorker(sessions, ready.release)
    made.sessions, made.ready = sessions, ready
    yield made
    for session in sessions:
        session.may_go.release(100)
    made.stop()


def test_a_reset_of_one_object_does_not_concern_the_other(pair):
    first, second = pair.sessions
    submit(pair, 0)
    assert first.taken.acquire(timeout=20)
    submit(pair, 1)
    pair.command(lambda session: None, which=0, anew=True)
    assert pair.dropped == 0
    for session in pair.sessions:
        session.may_go.release(2)
    # of the first object neither image counts: both are from before its reset
    for second_stamp in (100, 101):
        assert pair.ready.acquire(timeout=20)
        done = pair.poll()
        assert done.header.stamp.sec == second_stamp
        assert done.objects[0] is None and done.objects[1].tracked is not None
    assert not first.taken.acquire(blocking=False)
    # both begin anew: the image that waits is dropped
    submit(pair, 2)
    assert first.taken.acquire(timeout=20)
    submit(pair, 3)
    pair.command(lambda session: None, anew=True)
    assert pair.dropped == 1


def test_other_commands_and_sentences_cost_no_image(worker):
    def refuse(session):
        raise InputError('That cannot be.')

    worker.session.may_go.release()
    submit(worker, 0)
    assert worker.ready.acquire(timeout=20)
    worker.command(refuse)
    assert worker.ready.acquire(timeout=20)
    worker.command(lambda session: None)
    assert worker.ready.acquire(timeout=20)
    assert worker.poll().header.stamp.sec == 100
    assert worker.poll() == 'That cannot be.'
    worker.command(refuse)
    assert worker.ready.acquire(timeout=20)
    # what was wrong is still told after a reset
    worker.command(lambda session: None, anew=True)
    assert worker.poll() == 'That cannot be.'
