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
"""Who may see the live page, and press its buttons."""

from concurrent.futures import Future
import http.client
import json
import re
import socket
import threading
import time
from urllib.parse import urlsplit

import pytest
from selfcal_ros.errors import ArgumentError
from selfcal_ros.nodes import page_node, page_server
from selfcal_ros.nodes.page_server import ACTIONS, MOST_VIEWERS, PageServer


@pytest.fixture(scope='module')
def pressed():
    return []


@pytest.fixture(scope='module')
def server(pressed):
    """Serve, and answer every button at once."""
    def press(action):
        pressed.append(action)
        answer = Future()
        answer.set_result((True, f'did {action} <b>'))
        return answer

    made = PageServer('127.0.0.1', 0, press)
    yield made
    made.close()
    assert not made._thread.is_alive()


def ask(server, path, method='GET', body=None, **headers):
    """Send a request; returns status, headers and body."""
    at = urlsplit(server.url)
    link = http.client.HTTPConnection('127.0.0.1', at.port, timeout=20)
    try:
        link.request(method, path, body,
                     {name.replace('_', '-'): value for name, value in headers.items()})
        answer = link.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode()
    finally:
        link.close()


def test_the_page_has_its_token_and_a_policy_that_lets_nothing_else_in(server):
    status, headers, text = ask(server, '/')
    assert status == 200 and f'content="{server.token}"' in text
    policy = headers['Content-Security-Policy']
    assert "default-src 'none'" in policy and 'unsafe' not in policy and '*' not in policy
    assert "frame-ancestors 'none'" in policy
    for name in ('page.css', 'live.css', 'live.js'):
        status, headers, text = ask(server, f'/{name}')
        assert status == 200 and headers['X-Content-Type-Options'] == 'nosniff' and text
        assert server.token not in text
    # no script and no style within the markup, and nothing from elsewhere
    page = (page_server.TEMPLATES / 'live.html').read_text(encoding='utf-8')
    assert not re.search(r'style=|<style|\son\w+=|https?:', page)
    script = (page_server.TEMPLATES / 'live.js').read_text(encoding='utf-8')
    assert not re.search(r'innerHTML|outerHTML|insertAdjacent|document\.write|eval\(', script)


@pytest.mark.parametrize('host', ['evil.example', 'evil.example:80', '192.168.1.7', '',
                                  'localhost.evil.example', 'x@localhost', 'localhost;x'])
def test_other_names_are_refused_as_after_dns_rebinding(server, host):
    for path, method in (('/', 'GET'), ('/live.js', 'GET'), ('/save', 'POST'), ('/x', 'GET')):
        status, _, text = ask(server, path, method, Host=host, X_Token=server.token)
        # of names that are none the library knows by itself
        assert status == 400 or status == 403 and 'not served under this name' in text
    # a tunnel may have any port
    assert ask(server, '/', Host='localhost:9999')[0] == 200
    assert ask(server, '/', Host='[::1]:1')[0] == 200


def test_buttons_want_the_token_and_no_other_page_may_press_them(server, pressed):
    del pressed[:]
    host = urlsplit(server.url).netloc
    assert ask(server, '/save', 'POST')[0] == 403
    assert ask(server, '/save', 'POST', X_Token='x' * 22)[0] == 403
    assert ask(server, '/save', 'POST', X_Token=server.token,
               Origin='http://evil.example')[0] == 403
    assert ask(server, '/save', 'POST', X_Token=server.token, Origin='null')[0] == 403
    assert ask(server, '/save', 'GET', X_Token=server.token)[0] == 405
    assert ask(server, '/delete', 'POST', X_Token=server.token)[0] == 404
    assert ask(server, '/..%2flive.html')[0] == 404
    assert not pressed
    for name in ACTIONS:
        status, headers, text = ask(server, f'/{name}', 'POST', X_Token=server.token,
                                    Origin=f'http://{host}')
        assert status == 200 and headers['Content-Type'] == 'application/json'
        assert json.loads(text) == {'success': True, 'message': f'did {name} <b>'}
    assert pressed == list(ACTIONS)


def test_what_is_sent_is_bounded(server, pressed):
    del pressed[:]
    with pytest.raises((http.client.HTTPException, OSError)):
        status = ask(server, '/save', 'POST', 'x' * 100_000, X_Token=server.token)[0]
        raise OSError(status) if status >= 400 else AssertionError(status)
    with pytest.raises((http.client.HTTPException, OSError)):
        status = ask(server, '/', X_Long='x' * 100_000)[0]
        raise OSError(status) if status >= 400 else AssertionError(status)
    assert not pressed and ask(server, '/')[0] == 200


def web_socket(server, token, **headers):
    """Open a WebSocket by hand; returns the socket and the first line of the answer."""
    at = urlsplit(server.url)
    link = socket.create_connection(('127.0.0.1', at.port), 20)
    lines = {'Host': at.netloc, 'Upgrade': 'websocket', 'Connection': 'Upgrade',
             'Sec-WebSocket-Key': 'dGhlIHNhbXBsZSBub25jZQ==', 'Sec-WebSocket-Version': '13',
             **headers}
    link.sendall(f'GET /live?token={token} HTTP/1.1\r\n'.encode() + ''.join(
        f'{name}: {value}\r\n' for name, value in lines.items()).encode() + b'\r\n')
    return link, link.recv(4096).split(b'\r\n')[0]


def wait(condition):
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def masked(text):
    """Frame a short text as a browser does, with a mask of zeros."""
    return bytes([0x81, 0x80 | len(text)]) + bytes(4) + text.encode()


def test_images_go_to_those_who_look_and_to_no_more_than_a_few(server):
    for token, headers in (('', {}), ('x', {}), (server.token, {'Origin': 'http://evil.example'}),
                           (server.token, {'Host': 'evil.example'})):
        link, line = web_socket(server, token, **headers)
        link.close()
        assert b' 403 ' in line
    assert not server.is_open
    links = []
    try:
        for k in range(MOST_VIEWERS):
            link, line = web_socket(server, server.token)
            links.append(link)
            assert b' 101 ' in line
            wait(lambda: len(server.viewers) == k + 1)
        assert b' 503 ' in web_socket(server, server.token)[1]
        # nobody has asked for an image yet
        assert server.is_open and not server.is_looked_at and not server.is_waited_for
        links[0].sendall(masked('image'))
        wait(lambda: server.is_looked_at and server.is_waited_for)
        server.show(b'jpeg' * 9)
        wait(lambda: not server.is_waited_for)
        got = b''
        while b'jpeg' * 9 not in got:
            got += links[0].recv(4096)
        # what is no request ends the talk
        links[1].sendall(masked('delete'))
        got = b''
        while b'\x88\x02\x03\xf0' not in got:
            got += links[1].recv(4096)
        links[1].close()
        wait(lambda: len(server.viewers) == MOST_VIEWERS - 1)
    finally:
        for link in links:
            link.close()
    wait(lambda: not server.is_open)


def test_others_than_this_machine_need_the_token_that_is_printed():
    made = PageServer('0.0.0.0', 0, lambda action: Future())
    try:
        assert made.url.endswith(f'?token={made.token}')
        for host in ('10.1.2.3:80', socket.gethostname(), 'localhost'):
            assert ask(made, '/', Host=host)[0] == 403
            assert ask(made, f'/?token={made.token}', Host=host)[0] == 200
        assert ask(made, f'/?token={made.token}', Host='evil.example')[0] == 403
    finally:
        made.close()


def test_a_port_that_is_taken_is_passed_over_and_a_wrong_address_is_a_sentence(server):
    taken = urlsplit(server.url).port
    running = set(threading.enumerate())
    other = PageServer('127.0.0.1', taken, lambda action: Future())
    other.close()
    assert urlsplit(other.url).port > taken
    for host in ('192.0.2.1', 'no such host', 'x' * 300, ''):
        with pytest.raises(ArgumentError, match='Cannot serve the live page on'):
            PageServer(host, 0, lambda action: Future())
    assert set(threading.enumerate()) <= running


def test_without_the_library_there_is_one_sentence(monkeypatch):
    import sys
    monkeypatch.setitem(sys.modules, 'tornado', None)
    monkeypatch.setitem(sys.modules, 'tornado.httpserver', None)
    monkeypatch.delitem(sys.modules, 'selfcal_ros.nodes.page_server')
    with pytest.raises(ArgumentError, match=r"pip install '\.\[watch\]' in the clone"):
        page_node._page_server()
