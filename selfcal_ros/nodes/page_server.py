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
The web server of the live page, in a thread of its own.

Whoever may open the page may press its buttons, so the page is not for everybody. It is served to
this machine alone unless told otherwise, and then asks for a token. A page of another origin can
reach neither buttons nor images: they want the token, which stands in our page only, and names
that are not ours are refused (DNS rebinding). No part of the page comes from elsewhere or is
written into it as markup.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
import hmac
import ipaddress
import json
from pathlib import Path
import re
import secrets
import socket
import threading
import time
from typing import Any
from urllib.parse import urlsplit

from selfcal_ros import report
from selfcal_ros.errors import ArgumentError
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

TEMPLATES = Path(report.__file__).parent / 'templates'
#: What a button may call.
ACTIONS = ('calibrate', 'reset', 'save')
#: Browsers at once; each gets its own copy of every image.
MOST_VIEWERS = 8
#: Who has not asked for an image for so long does not look.
LOOKING_S = 3.0
#: A service that has not answered by then is told as such.
ANSWER_S = 20.0
#: Where a port is taken, so many that follow are tried.
MORE_PORTS = 20
_FILES = {'page.css': 'text/css', 'live.css': 'text/css', 'live.js': 'text/javascript'}
_HOST = re.compile(r'[\w.:\[\]-]+', re.ASCII)
_LIMITS = {'max_body_size': 1024, 'max_header_size': 16384, 'idle_connection_timeout': 60,
           'body_timeout': 5}


class PageServer:
    """
    Serves the page, hands out what it shows, and takes its buttons.

    Methods may be called from any thread but that of the server.

    Parameters
    ----------
    host : str
        Address to serve on.
    port : int
        0: any that is free.
    press : callable
        Called in the server's thread with one of `ACTIONS`; returns a Future of (bool, str).

    Attributes
    ----------
    url : str
        What to open.
    token : str

    Raises
    ------
    ArgumentError
        If the address cannot be served on.

    """

    def __init__(self, host: str, port: int,
                 press: Callable[[str], Future[tuple[bool, str]]]) -> None:
        self.press, self.token = press, secrets.token_urlsafe(16)
        self.is_local = _is_loopback(host)
        self.viewers: set[Viewer] = set()
        self.newest = '{}'
        self._asked_s = -LOOKING_S
        sockets = _bind(host, port)
        self.names = _names(host, self.is_local)
        self.url = self._address(host, sockets[0].getsockname()[1])
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(sockets,), daemon=True,
                                        name='live page')
        self._thread.start()
        self._ready.wait(10)

    def _address(self, host: str, port: int) -> str:
        shown = socket.gethostname() if host in ('0.0.0.0', '::') else host
        shown = f'[{shown}]' if ':' in shown else shown
        return f'http://{shown}:{port}/' + ('' if self.is_local else f'?token={self.token}')

    def _serve(self, sockets: list[socket.socket]) -> None:
        asyncio.set_event_loop(self._loop)
        about: dict[str, Any] = {'server': self}
        application = Application(
            [(r'/', Page, about), (r'/(page\.css|live\.css|live\.js)', File, about),
             (r'/live', Viewer, about), (rf'/({"|".join(ACTIONS)})', Button, about)],
            default_handler_class=Nothing, default_handler_args=about,
            log_function=lambda handler: None, websocket_max_message_size=256,
            websocket_ping_interval=20)
        server = HTTPServer(application, **_LIMITS)
        server.add_sockets(sockets)
        IOLoop.current().add_callback(self._ready.set)
        try:
            self._loop.run_forever()
        finally:
            server.stop()
            self._loop.run_until_complete(server.close_all_connections())
            self._loop.run_until_complete(asyncio.sleep(0))
            self._loop.close()

    def close(self) -> None:
        """End the server."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)

    @property
    def is_open(self) -> bool:
        """Whether some browser has the page open."""
        return bool(self.viewers)

    @property
    def is_looked_at(self) -> bool:
        """Whether some browser shows the page now."""
        return self.is_open and time.monotonic() - self._asked_s < LOOKING_S

    @property
    def is_waited_for(self) -> bool:
        """Whether some browser waits for an image."""
        return any(viewer.is_hungry for viewer in tuple(self.viewers))

    def asked(self) -> None:
        """Take note that an image is wanted."""
        self._asked_s = time.monotonic()

    def tell(self, state: dict[str, Any]) -> None:
        """Send what has changed to all browsers."""
        self.newest = json.dumps(state, allow_nan=False)
        self._loop.call_soon_threadsafe(self._send, self.newest)

    def show(self, jpeg: bytes) -> None:
        """Send an image to the browsers that wait for one."""
        self._loop.call_soon_threadsafe(self._send, jpeg)

    def _send(self, what: str | bytes) -> None:
        for viewer in tuple(self.viewers):
            viewer.give(what)

    def takes(self, host: str) -> bool:
        """Tell whether the Host of a request is one of ours, whatever the port (tunnels)."""
        if not _HOST.fullmatch(host):
            return False
        name = (urlsplit(f'//{host}').hostname or '').lower()
        if name in self.names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        # nobody's name server has a say in an address
        return address.is_loopback if self.is_local else True

    def knows(self, token: str) -> bool:
        """Tell whether a token is that of this run."""
        return hmac.compare_digest(token.encode(), self.token.encode())


class Guarded(RequestHandler):
    """Refuses names and origins that are not ours, in a line of plain text."""

    def initialize(self, server: PageServer) -> None:
        """Take the server; Tornado calls it."""
        self.server = server

    def set_default_headers(self) -> None:
        """Let nothing in, and nothing out."""
        # Tornado calls this before it looks at the name, hence no name of the request here
        for name, value in {
                'Server': 'selfcal_ros', 'Cache-Control': 'no-store',
                'Content-Type': 'text/plain; charset=utf-8',
                'Content-Security-Policy': "default-src 'none'; frame-ancestors 'none'",
                'Cross-Origin-Resource-Policy': 'same-origin',
                'Cross-Origin-Opener-Policy': 'same-origin', 'X-Frame-Options': 'DENY',
                'X-Content-Type-Options': 'nosniff', 'Referrer-Policy': 'no-referrer'}.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Look at who asks."""
        host, origin = self.request.host, self.request.headers.get('Origin')
        if not self.server.takes(host):
            raise HTTPError(403, reason='This page is not served under this name')
        if origin is not None and urlsplit(origin).netloc != host:
            raise HTTPError(403, reason='Another page asks')

    def needs_token(self, token: str) -> None:
        """Refuse who has not seen our page."""
        if not self.server.knows(token):
            raise HTTPError(403, reason='The token is not of this run: open the printed address')

    def write_error(self, status_code: int, **_: Any) -> None:
        """Say in a line what was wrong."""
        self.finish(f'{self._reason}.\n')


class Nothing(Guarded):
    """All other addresses."""

    def prepare(self) -> None:
        """Refuse."""
        super().prepare()
        raise HTTPError(404)


class Page(Guarded):
    """The page itself, with the token of this run in it."""

    def get(self) -> None:
        """Send it."""
        if not self.server.is_local:
            self.needs_token(self.get_query_argument('token', ''))
        self.set_header('Content-Type', 'text/html; charset=utf-8')
        self.set_header(
            'Content-Security-Policy',
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
            f"connect-src 'self' ws://{self.request.host}; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'")
        text = (TEMPLATES / 'live.html').read_text(encoding='utf-8')
        self.finish(text.replace('TOKEN', self.server.token))


class File(Guarded):
    """Looks and behaviour of the page; they hold no secret."""

    def get(self, name: str) -> None:
        """Send one of them."""
        self.set_header('Content-Type', f'{_FILES[name]}; charset=utf-8')
        self.finish((TEMPLATES / name).read_bytes())


class Button(Guarded):
    """One of the services of the calibrator."""

    async def post(self, name: str) -> None:
        """Call it, and tell the page what it answered."""
        self.needs_token(self.request.headers.get('X-Token', ''))
        try:
            success, message = await asyncio.wait_for(
                asyncio.wrap_future(self.server.press(name)), ANSWER_S)
        except asyncio.TimeoutError:
            success, message = False, f'~/{name} did not answer within {ANSWER_S:.0f} s'
        self.set_header('Content-Type', 'application/json')
        self.finish(json.dumps({'success': success, 'message': message}))


class Viewer(Guarded, WebSocketHandler):
    """
    A browser that has the page open.

    It asks for one image at a time, while it can be seen: a slow one gets fewer, a hidden one
    none.
    """

    def initialize(self, server: PageServer) -> None:
        """Take the server; Tornado calls it."""
        super().initialize(server)
        self.is_hungry = self._is_busy = False

    def prepare(self) -> None:
        """Look at who asks, and at the crowd."""
        super().prepare()
        self.needs_token(self.get_query_argument('token', ''))
        if len(self.server.viewers) >= MOST_VIEWERS:
            raise HTTPError(503, reason='Too many browsers look on')

    def check_origin(self, origin: str) -> bool:
        """Take what `prepare` has let pass."""
        return True

    def open(self, *_: str, **__: str) -> None:  # noqa: A003
        """Show what is known so far."""
        self.server.viewers.add(self)
        self.give(self.server.newest)

    def on_close(self) -> None:
        """Forget the browser."""
        self.server.viewers.discard(self)

    def on_message(self, message: str | bytes) -> None:
        """Take note that the browser has shown its last image."""
        if message != 'image':
            self.close(1008)
            return
        self.is_hungry = True
        self.server.asked()

    def give(self, what: str | bytes) -> None:
        """Send an image that is wanted, or a state unless the last one is still on its way."""
        is_image = isinstance(what, bytes)
        if not self.is_hungry if is_image else self._is_busy:
            return
        try:
            sent = self.write_message(what, binary=is_image)
        except WebSocketClosedError:
            return
        if is_image:
            self.is_hungry = False
        else:
            self._is_busy = True
        sent.add_done_callback(lambda done: self._sent(done, is_image))

    def _sent(self, done: asyncio.Future[None], is_image: bool) -> None:
        # who went away meanwhile is nobody's fault
        done.cancelled() or done.exception()
        if not is_image:
            self._is_busy = False


def _is_loopback(host: str) -> bool:
    if host == 'localhost':
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _names(host: str, is_local: bool) -> frozenset[str]:
    """Return the names under which the page may be asked for, beside addresses."""
    names = {'localhost'}
    if not is_local:
        own = socket.gethostname()
        names |= {host, own, f'{own}.local', socket.getfqdn()}
    return frozenset(name.lower() for name in names)


def _bind(host: str, port: int) -> list[socket.socket]:
    """Return sockets on the first of some ports that is free."""
    if not host:
        # to the library that is every address of this machine
        raise ArgumentError("Cannot serve the live page on '': give an address, such as "
                            '127.0.0.1 for this machine only, or 0.0.0.0 for all that reach it.')
    family = socket.AF_INET if ':' not in host else socket.AF_INET6
    for number in (port,) if port == 0 else range(port, min(port + MORE_PORTS, 65536)):
        try:
            return bind_sockets(number, address=host, family=family)
        except (OSError, UnicodeError) as error:
            fault = error
    why = getattr(fault, 'strerror', None) or fault
    raise ArgumentError(f'Cannot serve the live page on {host!r:.80}, port {port}: {why}; give '
                        'another host or port (port 0: any that is free).')
