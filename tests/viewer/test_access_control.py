"""Access control of the page: no foreign host name or origin, no access without the secret; floods do no harm."""

from __future__ import annotations

import http.client
import logging
import socket
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from tests.patience import PATIENCE_S

from visuohaptic.io.meshes import PlyMesh
from visuohaptic.viewer import BrowsePage, LivePage, SurfaceView

viser = pytest.importorskip("viser", reason="the browser page is an extra")


@pytest.fixture(scope="module")
def page():
    with LivePage(port=0) as live:
        yield live


def place(page) -> tuple[int, str]:
    """Port and secret of a page."""
    address = urlsplit(page.url)
    return address.port, address.path.strip("/")


def ask(page, path: str, *headers: tuple[str, str]) -> int:
    """Status of an answer to exactly these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", place(page)[0], timeout=PATIENCE_S)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in headers:
        connection.putheader(name, value)
    connection.endheaders()
    status = connection.getresponse().status
    connection.close()
    return status


def connect(page, path: str, origin: str | None):
    """A web socket, as viser's client opens it."""
    from websockets.sync.client import connect

    port = place(page)[0]
    return connect(
        f"ws://127.0.0.1:{port}/{path}", origin=origin, subprotocols=[f"viser-v{viser.__version__}"]
    )


def test_only_a_local_host_name_with_the_secret_is_answered(page):
    port, secret = place(page)
    host = ("Host", f"127.0.0.1:{port}")
    assert ask(page, f"/{secret}/", host) == 200
    assert ask(page, f"/{secret}", host, ("Origin", f"http://127.0.0.1:{port}")) == 200
    # A tunnel of ssh: another port of the same name.
    assert ask(page, f"/{secret}/", ("Host", "localhost:9000")) == 200
    for path in ("/", "/index.html", f"/{secret}x/", f"/{secret[:-1]}/", f"/?{secret}", "//", "/%00/"):
        assert ask(page, path, host) == 403, path
    foreign = [f"evil.example:{port}", "192.168.0.7", "127.0.0.1.evil.example", "", "[", "0.0.0.0"]
    # What a lenient parser of addresses takes for the local name with something beside it.
    foreign += [
        f"127.0.0.1:{port}.evil.example",
        "x@127.0.0.1",
        "127.0.0.1/evil.example",
        "127.0.0.1:",
        "::1",
    ]
    for name in foreign:
        assert ask(page, f"/{secret}/", ("Host", name)) == 403, name
    assert ask(page, f"/{secret}/") == 403
    assert ask(page, f"/{secret}/", host, ("Host", "evil.example")) == 403
    assert ask(page, f"/{secret}/../../etc/passwd", host) == 404


def test_a_path_of_other_bytes_is_refused_as_any_without_the_secret(page):
    port, secret = place(page)
    for path in (b"/\xff\xfe", b"/" + secret.encode() + b"\xff", b"/%ff/"):
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as connection:
            connection.sendall(b"GET " + path + b" HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % port)
            assert connection.recv(4096).startswith(b"HTTP/1.1 403"), path


def test_no_foreign_page_reads_the_stream(page):
    from websockets.exceptions import InvalidStatus

    port, secret = place(page)
    with connect(page, secret, f"http://127.0.0.1:{port}") as stream:
        assert len(stream.recv(timeout=PATIENCE_S)) > 16
    foreign = ("http://evil.example", "null", f"https://127.0.0.1:{port}", "http://127.0.0.1:1", "")
    for origin in foreign:
        with pytest.raises(InvalidStatus, match="403"):
            connect(page, secret, origin)
    with pytest.raises(InvalidStatus, match="403"):
        connect(page, "", f"http://127.0.0.1:{port}")


def test_two_pages_have_two_secrets(page):
    with LivePage(port=0) as other:
        assert place(other)[1] != place(page)[1]
        assert len(place(other)[1]) >= 22  # 128 bits in base 64


def test_a_server_of_another_library_is_left_alone(page):
    """Access control applies to viser's server only, also while one is started."""
    import asyncio

    from websockets.asyncio.server import serve
    from websockets.sync.client import connect

    from visuohaptic.viewer.access_control import AccessControl

    async def greet(connection):
        await connection.send("hello")

    def ask_it(port):
        with connect(f"ws://127.0.0.1:{port}/") as stream:
            return stream.recv(timeout=PATIENCE_S)

    async def run():
        access = AccessControl()
        with access.guarding():
            from websockets.asyncio import server as library

            assert library.serve is not serve
            server = await library.serve(greet, "127.0.0.1", 0)
        assert access.closed
        async with server:
            return await asyncio.to_thread(ask_it, server.sockets[0].getsockname()[1])

    assert asyncio.run(run()) == "hello"


@pytest.fixture
def heard(caplog):
    """The log as a program without settings of its own has it."""
    caplog.set_level(logging.INFO)
    return caplog


def test_malformed_messages_end_their_connection_and_nothing_else(page, capfd, heard):
    import msgspec

    port, secret = place(page)
    encode = msgspec.msgpack.encode
    malformed = [
        b"",
        b"\xff" * 100,
        "text",
        encode([1, 2]),
        encode({"type": "Nothing"}),
        encode({"type": "ViewerCameraMessage"}),
        encode({"type": "GuiUpdateMessage", "uuid": 3}),
        encode({"type": "GuiUpdateMessage", "uuid": "x", "updates": 3}),
        b"a" * (2 << 20),
    ]
    rng = np.random.default_rng(2)
    malformed += [rng.bytes(int(rng.integers(1, 200))) for _ in range(60)]
    for message in malformed:
        with connect(page, secret, f"http://127.0.0.1:{port}") as stream:
            stream.send(message)
    for garbage in (
        b"\0" * 1000,
        b"GET / HTTP/1.1\r\nHost\r\n\r\n",
        b"GET " + b"a" * 100_000,
        b"\r\n" * 99,
    ):
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as raw:
            raw.sendall(garbage)
    assert ask(page, f"/{secret}/", ("Host", f"127.0.0.1:{port}")) == 200
    said = capfd.readouterr()
    assert "Traceback" not in said.out + said.err
    assert heard.text == ""


def test_too_many_browsers_are_refused_and_leave_room_when_they_go():
    from contextlib import ExitStack

    from websockets.exceptions import InvalidStatus

    from visuohaptic.viewer.access_control import MAX_BROWSERS

    with LivePage(port=0) as page, ExitStack() as browsers:
        port, secret = place(page)
        for _ in range(MAX_BROWSERS):
            last = browsers.enter_context(connect(page, secret, f"http://127.0.0.1:{port}"))
        with pytest.raises(InvalidStatus, match="503"):
            connect(page, secret, f"http://127.0.0.1:{port}")
        last.close()
        until_s = time.monotonic() + PATIENCE_S
        while page._access._browsers == MAX_BROWSERS:  # the server learns of it a moment later
            assert time.monotonic() < until_s
            time.sleep(0.01)
        with connect(page, secret, f"http://127.0.0.1:{port}") as again:
            assert again.recv(timeout=PATIENCE_S)


def test_slow_clients_keep_nobody_waiting(page):
    port, secret = place(page)
    slow = [socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) for _ in range(100)]
    try:
        for number, one in enumerate(slow):
            one.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1"[: number % 30])
        assert ask(page, f"/{secret}/", ("Host", f"127.0.0.1:{port}")) == 200
        assert page.update(1e9)
    finally:
        for one in slow:
            one.close()


def test_a_value_that_no_widget_offers_is_one_line(heard, capfd):
    import msgspec

    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    views = [SurfaceView(name, PlyMesh(points, np.array([[0, 1, 2]]), None, {})) for name in ("one", "two")]
    camera = {"type": "ViewerCameraMessage", "image_width": 9, "image_height": 9}
    camera |= {"wxyz": (1, 0, 0, 0), "fov": 1, "near": 0.1, "far": 9}
    camera |= {"position": (0, 0, 1), "look_at": (0, 0, 0), "up_direction": (0, 0, 1)}
    with BrowsePage(views, port=0) as page:
        port, secret = place(page)
        with connect(page, secret, f"http://127.0.0.1:{port}") as stream:
            stream.send(msgspec.msgpack.encode(camera))
            for updates in ({"value": "three"}, {"nothing": 1}, {"nothing": 2}):
                update = {"type": "GuiUpdateMessage", "uuid": page._choice._impl.uuid, "updates": updates}
                stream.send(msgspec.msgpack.encode(update))
            until_s = time.monotonic() + PATIENCE_S
            while len(heard.messages) < 2 and time.monotonic() < until_s:
                time.sleep(0.02)
    assert sorted(heard.messages) == [
        "a browser sent an invalid value (AssertionError)",
        "the page: BrowsePage: found 'three', expected one of one, two",
    ]
    assert "Traceback" not in capfd.readouterr().err


def test_a_viser_that_cannot_be_guarded_is_not_started(monkeypatch):
    from contextlib import nullcontext

    from visuohaptic.core import DeviceError
    from visuohaptic.viewer.access_control import AccessControl

    monkeypatch.setattr(AccessControl, "guarding", lambda self: nullcontext())
    with pytest.raises(DeviceError, match="cannot be protected with viser"):
        LivePage(port=0)
