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
"""A real browser, spoken to through two pipes, for tests that look at pages."""

import base64
import fcntl
import json
import os
from pathlib import Path
import select
import shutil
import subprocess
import tempfile
import time

import pytest

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable', 'chrome',
         'chrome-headless-shell')
WAIT_S = 60


def find_chromium():
    """Return the browser's path: of $CHROMIUM, or by its usual names; None if there is none."""
    named = os.environ.get('CHROMIUM')
    return named or next(filter(None, map(shutil.which, NAMES)), None)


class Chromium:
    """A headless browser, spoken to through two pipes (its protocol for developer tools)."""

    def __init__(self, path):
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        # the browser reads commands from 3 and writes to 4; keep the ends that we copy above those
        theirs_in, self._out = (fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 20) for end in os.pipe())
        self._in, theirs_out = (fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 20) for end in os.pipe())

        def ends():
            os.dup2(theirs_in, 3)
            os.dup2(theirs_out, 4)

        options = ['--headless', '--disable-gpu', '--no-first-run', '--remote-debugging-pipe',
                   '--disable-dev-shm-usage', '--hide-scrollbars', '--force-device-scale-factor=1',
                   f'--user-data-dir={self._folder.name}']
        # Chromium refuses to run as root with its sandbox, as in most containers
        options += ['--no-sandbox'] if os.geteuid() == 0 else []
        self._process = subprocess.Popen(
            [path, *options, 'about:blank'], preexec_fn=ends, close_fds=False,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(theirs_in)
        os.close(theirs_out)
        self._buffer, self._count, self.events = b'', 0, []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.send('Browser.close')
            self._process.wait(20)
        except (OSError, TimeoutError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._folder.cleanup()

    def send(self, method, session=None, **parameters):
        """Send a command and return its answer; what happens meanwhile goes to `events`."""
        self._count += 1
        message = {'id': self._count, 'method': method, 'params': parameters}
        if session:
            message['sessionId'] = session
        os.write(self._out, json.dumps(message).encode() + b'\0')
        while True:
            answer = self.receive()
            if answer.get('id') == message['id']:
                assert 'error' not in answer, (method, answer['error'])
                return answer['result']
            self.events.append(answer)

    def receive(self):
        """Return the next message."""
        end = time.monotonic() + WAIT_S
        while b'\0' not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(end - time.monotonic(), 0))
            if not ready:
                raise TimeoutError('The browser does not answer.')
            data = os.read(self._in, 1 << 20)
            if not data:
                raise TimeoutError('The browser has gone away.')
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b'\0')
        return json.loads(line)

    def open(self, path, width, height=900, scheme='light', scripts=True):  # noqa: A003
        """Open a file, or an address, in a window of the given size in pixels."""
        target = self.send('Target.createTarget', url='about:blank')['targetId']
        session = self.send('Target.attachToTarget', targetId=target, flatten=True)['sessionId']
        return Page(self, session, path, width, height, scheme, scripts)


class Page:
    """One page, loaded."""

    def __init__(self, browser, session, path, width, height, scheme, scripts):
        self._browser, self._session = browser, session
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.send(f'{domain}.enable')
        self.send('Emulation.setScriptExecutionDisabled', value=not scripts)
        self.send('Emulation.setDeviceMetricsOverride', width=width, height=height,
                  deviceScaleFactor=1, mobile=width < 600)
        self.media('screen', scheme)
        browser.events.clear()
        self.send('Page.navigate', url=path if str(path).startswith('http')
                  else Path(path).absolute().as_uri())
        while not any(e.get('method') == 'Page.loadEventFired' for e in self._mine()):
            browser.events.append(browser.receive())
        if scripts:
            self.frames(2)

    def _mine(self):
        return [e for e in self._browser.events if e.get('sessionId') == self._session]

    def send(self, method, **parameters):
        return self._browser.send(method, self._session, **parameters)

    def media(self, kind, scheme='light'):
        self.send('Emulation.setEmulatedMedia', media=kind, features=[
            {'name': 'prefers-color-scheme', 'value': scheme}])

    def frames(self, count=1):
        """Wait until so many frames have been drawn."""
        self.evaluate('new Promise(done => { let n = %d; const next = () => n-- ? '
                      'requestAnimationFrame(next) : done(1); next(); })' % count)

    def evaluate(self, expression):
        """Return the value of an expression in the page."""
        answer = self.send('Runtime.evaluate', expression=expression, returnByValue=True,
                           awaitPromise=True)
        assert 'exceptionDetails' not in answer, answer['exceptionDetails']
        return answer['result'].get('value')

    @property
    def complaints(self):
        """Exceptions, errors, warnings and messages of the console, broken policy included."""
        self.evaluate('1')
        return [e['params'] for e in self._mine() if e['method'] in (
            'Runtime.exceptionThrown', 'Runtime.consoleAPICalled', 'Log.entryAdded')]

    @property
    def requests(self):
        """Addresses that were asked for."""
        return [e['params']['request']['url'] for e in self._mine()
                if e['method'] == 'Network.requestWillBeSent']

    def screenshot(self, full=False):
        clip = {}
        if full:
            height = self.evaluate('document.documentElement.scrollHeight')
            width = self.evaluate('innerWidth')
            clip = {'clip': {'x': 0, 'y': 0, 'width': width, 'height': height, 'scale': 1}}
        return base64.b64decode(self.send('Page.captureScreenshot', captureBeyondViewport=full,
                                          **clip)['data'])

    def pdf(self):
        self.media('print')
        return base64.b64decode(self.send('Page.printToPDF', printBackground=True,
                                          preferCSSPageSize=True, paperWidth=8.27,
                                          paperHeight=11.69)['data'])

    def mouse(self, kind, x, y, **more):
        self.send('Input.dispatchMouseEvent', type=kind, x=x, y=y, **more)


def started_browser():
    """Yield a browser; the test is left out where there is none."""
    path = find_chromium()
    if path is None:
        pytest.skip('There is no Chromium here (looked for $CHROMIUM and the names '
                    f'{", ".join(NAMES)}); install the package chromium to look at the page.')
    with Chromium(path) as chromium:
        yield chromium
