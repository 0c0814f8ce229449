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
"""A ROS graph for one test: domain of its own, log in a temporary folder, waits with a timeout."""

from functools import partialmethod
import gc
from importlib.util import find_spec
import os
from pathlib import Path
import queue
import subprocess
import sys
import threading
import time

import pytest
from selfcal_ros.pipeline.child_process import end_processes
from test_support.ros_domain import reserved_domain

ROOT = Path(__file__).resolve().parents[2]


class LeftOut(pytest.File):
    """A file whose imports would fail: skipped as a whole, and told so."""

    def collect(self):
        """Say why."""
        pytest.skip('rclpy is not installed')


def pytest_pycollect_makemodule(module_path, parent):
    """Leave the tests of nodes out where there is no ROS."""
    if find_spec('rclpy') is None:
        return LeftOut.from_parent(parent, path=module_path)


@pytest.fixture(scope='session')
def domain_id():
    """Reserve a domain for the tests of this process."""
    with reserved_domain() as number:
        yield number


def keep_to_itself(patch, folder, domain_id):
    """Set the environment that ROS begins with."""
    patch.setenv('ROS_DOMAIN_ID', str(domain_id))
    patch.setenv('ROS_LOG_DIR', str(folder / 'log'))
    patch.setenv('ROS_HOME', str(folder / 'ros_home'))
    patch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(ROOT / 'config' / 'fastdds.xml'))
    patch.setenv('PYTHONPATH', os.pathsep.join(
        filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])))


@pytest.fixture(autouse=True)
def ros_environment(tmp_path, monkeypatch, domain_id):
    """Keep the test to itself; sub-processes inherit it."""
    keep_to_itself(monkeypatch, tmp_path, domain_id)


@pytest.fixture(scope='session')
def ros(tmp_path_factory, domain_id):
    """
    Start ROS once for all tests of this process, in one DDS participant.

    A context has a participant for as long as it has nodes. Fast DDS 2.14 crashes or hangs now
    and then where participants come and go, as they would from test to test.
    """
    import rclpy
    from rclpy.node import Node
    with pytest.MonkeyPatch.context() as patch:
        keep_to_itself(patch, tmp_path_factory.mktemp('ros'), domain_id)
        rclpy.init(args=[])
        keeper = Node('keeper', enable_rosout=False, start_parameter_services=False)
    keeper.own_topics = dds_topics(keeper)
    yield keeper
    keeper.destroy_node()
    rclpy.try_shutdown()


def dds_topics(node):
    """Return the topics that a node sees, of half-made nodes, too."""
    return {name for name, _ in node.get_topic_names_and_types()}


def wait_until_alone(keeper, timeout_s=40.0):
    """
    Wait until nothing of an earlier test is seen.

    A process that was killed, or ended before its node was whole, is seen for twenty seconds.
    Every node has a topic, if only /rosout. Names are not asked for: that of a process that has
    ended may stay in the graph of rmw_fastrtps for good.
    """
    deadline = time.monotonic() + timeout_s
    while seen := dds_topics(keeper) - keeper.own_topics:
        assert time.monotonic() < deadline, f'of an earlier test live on: {sorted(seen)}'
        time.sleep(0.02)


class Graph:
    """A node to talk with, and an executor that spins it and the nodes under test."""

    def __init__(self):
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        self.executor = SingleThreadedExecutor()
        self.nodes, self.clients = [], {}
        self.probe = self.add(Node('probe'))

    def add(self, node):
        """Spin a node, too."""
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def wait_for(self, condition, timeout_s=20.0, what='condition'):
        """Spin until a condition holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f'{what} did not come within {timeout_s} s'
            self.executor.spin_once(timeout_sec=0.02)

    def spin_for(self, seconds):
        """Spin for a while, to see that nothing comes."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.02)

    def meet(self, node):
        """Wait until a node of this process sends to all that the probe listens to."""
        heard = {one.topic_name for one in self.probe.subscriptions}
        self.wait_for(lambda: all(one.get_subscription_count() for one in node.publishers
                                  if one.topic_name in heard), what='subscriptions')

    def listen(self, message, topic, qos=100):
        """Subscribe, and return the list that the messages go to."""
        heard = []
        self.probe.create_subscription(message, topic, heard.append, qos)
        return heard

    def ask(self, kind, service, request):
        """
        Call a service, again where no answer comes; it must bear being called twice.

        A server that has not met the client's reader yet sends its answer to nobody
        (rmw_fastrtps#842), as happens on a busy machine. No test hangs on that.
        """
        client = self.clients.get(service)
        if client is None:
            client = self.clients[service] = self.probe.create_client(kind, service)
        self.wait_for(client.service_is_ready, what=service)
        asked, began = [], time.monotonic()

        def answered():
            if time.monotonic() >= began + 5.0 * len(asked):
                asked.append(client.call_async(request))
            return any(future.done() for future in asked)

        self.wait_for(answered, what=f'answer of {client.srv_name}')
        return next(future.result() for future in asked if future.done())

    def call(self, service):
        """Call a Trigger service."""
        from std_srvs.srv import Trigger
        return self.ask(Trigger, service, Trigger.Request())

    def set_parameters(self, node, atomically=False, **values):
        """Set parameters as `ros2 param set` does; returns why it was refused, one a value."""
        from rcl_interfaces.srv import SetParameters, SetParametersAtomically
        from rclpy.parameter import Parameter
        kind = SetParametersAtomically if atomically else SetParameters
        answer = self.ask(
            kind, f'{node}/set_parameters{"_atomically" if atomically else ""}',
            kind.Request(parameters=[Parameter(name, value=value).to_parameter_msg()
                                     for name, value in values.items()]))
        results = [answer.result] if atomically else answer.results
        return [one.reason or 'refused' if not one.successful else '' for one in results]


@pytest.fixture
def graph(ros, monkeypatch):
    """Make a graph whose nodes have the parameters that a test asks for, as in `-p x:=1`."""
    from rclpy.node import Node
    wait_until_alone(ros)
    made = []

    def make(*parameters):
        if parameters:
            monkeypatch.setattr(Node, '__init__', partialmethod(
                Node.__init__, cli_args=['--ros-args', *parameters]))
        made.append(Graph())
        return made[0]

    yield make
    # a node that was refused as it was made lives in cycles yet, and is seen by later tests
    gc.collect()
    for one in made:
        # what still refers to a node must go before it: rclpy crashed at a node's end else
        one.executor.shutdown()
        for node in one.nodes:
            node.destroy_node()


class Process:
    """A node in a process of its own, and what it has said on standard error so far."""

    def __init__(self, module, *arguments, cwd):
        self.process = subprocess.Popen(
            [sys.executable, '-m', f'selfcal_ros.nodes.{module}', *arguments],
            stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True,
            cwd=cwd, env=dict(os.environ))
        self.said = ''
        self._lines = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self.process.stderr:
            self._lines.put(line)

    def has_said(self, words):
        """Tell whether words have been said."""
        while not self._lines.empty():
            self.said += self._lines.get()
        return words in self.said

    def end(self, number):
        """Send a signal; returns the exit status."""
        self.process.send_signal(number)
        status = self.process.wait(15)
        self._reader.join(5)
        self.has_said('')
        return status


@pytest.fixture
def ended(tmp_path):
    """Run a node that ends by itself, in a process of its own; return its status and errors."""
    def run(module, *arguments):
        found = subprocess.run(
            [sys.executable, '-m', f'selfcal_ros.nodes.{module}', '--ros-args', *arguments],
            capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False)
        return found.returncode, found.stderr

    return run


@pytest.fixture
def launch(tmp_path):
    """Start nodes as processes of their own, by the name of their module."""
    started = []

    def run(module, *arguments, before=()):
        started.append(Process(module, *before, '--ros-args', *arguments, cwd=tmp_path))
        return started[-1]

    yield run
    # a node that is killed would be seen by the next tests for a while
    end_processes(one.process for one in started)
    for one in started:
        one.process.stderr.close()
