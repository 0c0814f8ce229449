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
A test that is skipped for a reason nobody expects fails the run.

The end of the run lists every reason with the number of tests that it left out. What is not
under `EXPECTED` makes the exit status 1. `--require ros` takes a kind of reason from the list:
`make test` says so where it has installed the ROS wheels, and so does continuous integration.
"""

from collections import Counter
import gc
import re

import pytest

#: Kinds of reasons for which a test may be skipped, as patterns of the whole reason.
EXPECTED = {
    'ros': (r'rclpy is not installed', r'the ROS messages are not installed',
            r"could not import 'rclpy'.*"),
    'ros workspace': (r"could not import '(ament_\w+\.main|image_geometry)'.*",
                      r'tf2_msgs is (not )?installed', r'xmllint is not installed',
                      r'colcon is (at work|not installed)'),
    'data': (r'.*shared/data.*', r'the recorded sets? \w+ (is|are) not there'),
    'chromium': (r'There is no Chromium here.*',),
    'user': (r'this user may write anywhere',),
    'platform': (r'there is no /proc here', r"needs Linux's /proc",
                 r'this Python cannot make virtual environments.*',
                 r'(bash|zsh|fish|groff) is not installed'),
    'opencv': (r'this OpenCV (has|has no) ChArUco boards', r'this OpenCV cannot write MJPG'),
    'optional': (r"could not import '(pycolmap|rerun)'.*", r'this COLMAP has no model \w+',
                 r'ViSP is not installed', r'Dask is not installed'),
    'tools': (r"could not import '(flake8|mypy)'.*", r'(MkDocs|mypy) is not installed',
              r'selfcal is not installed in this environment'),
}
#: Files whose single tests take longest.
LONGEST = ('test/test_lint.py', 'test/test_install.py', 'test/bench/test_worlds_found_wrong.py')


def pytest_addoption(parser):
    """Let the caller say what must be there."""
    parser.addoption('--require', action='append', default=[], choices=sorted(EXPECTED),
                     metavar='KIND', help='a skip for a reason of this kind fails the run: '
                     + ', '.join(EXPECTED))


class Skips:
    """What was skipped, and why."""

    def __init__(self, required):
        self.counts = Counter()
        self.patterns = [re.compile(pattern, re.S) for kind, patterns in EXPECTED.items()
                         if kind not in required for pattern in patterns]

    def pytest_runtest_logreport(self, report):
        """Count a test that was skipped; one that fails as expected is none."""
        if report.skipped and not hasattr(report, 'wasxfail'):
            self._add(report.longrepr)

    def pytest_collectreport(self, report):
        """Count a file that was skipped."""
        if report.skipped:
            self._add(report.longrepr)

    def _add(self, longrepr):
        text = longrepr[2] if isinstance(longrepr, tuple) else str(longrepr)
        self.counts[text.removeprefix('Skipped: ')] += 1

    def unexpected(self):
        """List the reasons that nobody expects."""
        return [reason for reason in self.counts
                if not any(pattern.fullmatch(reason) for pattern in self.patterns)]

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session, exitstatus):
        """Fail a run that would have passed."""
        if exitstatus == pytest.ExitCode.OK and self.unexpected():
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        """Say what was left out."""
        if self.counts:
            terminalreporter.section('left out')
        for reason, count in sorted(self.counts.items()):
            terminalreporter.line(f'{count:4} {reason}')
        for reason in self.unexpected():
            terminalreporter.line(f'UNEXPECTED SKIP: {reason} (test/conftest.py lists the '
                                  'reasons that are expected)', red=True)


def pytest_sessionstart():
    """Leave the collector of garbage out while tests are gathered: a quarter of that time."""
    gc.disable()


def pytest_collection_finish():
    """Let it look at what tests make, and no more at the tests themselves."""
    gc.enable()
    gc.freeze()


def pytest_collection_modifyitems(items):
    """Put what takes longest first: at the end the other process would wait for it."""
    items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))


def pytest_configure(config):
    """Count in the process that reports; the workers of xdist send it what they skip."""
    if not hasattr(config, 'workerinput'):
        config.pluginmanager.register(Skips(config.getoption('--require')), 'skips')
