"""Who may connect, and what a wire believes."""

from __future__ import annotations

import asyncio
import json
import socket as socketlib
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from http import HTTPStatus
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser
import websockets
from viser._messages import RunJavascriptMessage
from websockets.asyncio.client import connect

from solvers import Unsupported
from solvers.cli import main
from tests.viewer.conftest import make_state
from tests.viewer.sessions import DEMO
from viewer_app.app import App, run
from viewer_app.bridge import LOCAL_HOSTS, Server, known_version, open_server, parse, refuse


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    made = open_server(token="secret")
    yield made
    made.stop()


@pytest.fixture(scope="module")
def plain() -> Iterator[viser.ViserServer]:
    made = open_server()
    yield made
    made.stop()


def get(port: int, path: str = "/", **headers: str) -> int:
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def socket(port: int, origin: str | None, cookie: str = "") -> int:
    """HTTP status with which a websocket is answered; 101 where it opens."""

    async def ask() -> int:
        try:
            protocol = websockets.Subprotocol("viser-v" + viser.__version__)
            async with connect(
                f"ws://127.0.0.1:{port}/",
                origin=None if origin is None else websockets.Origin(origin),
                subprotocols=[protocol],
                additional_headers={"Cookie": cookie} if cookie else {},
                max_size=None,
            ) as ws:
                await asyncio.wait_for(ws.recv(), 60)
                return 101
        except websockets.exceptions.InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(ask())


def test_viser_is_the_version_the_bridge_was_written_for() -> None:
    assert known_version()


def test_a_foreign_host_or_origin_is_refused(plain: viser.ViserServer) -> None:
    port = plain.get_port()
    assert get(port) == 200
    assert get(port, Host="evil.example") == get(port, Host=f"evil.example:{port}") == 421
    assert get(port, Origin="https://evil.example") == 403
    assert socket(port, f"http://127.0.0.1:{port}") == 101 and socket(port, None) == 101
    assert socket(port, "https://evil.example") == 403 and socket(port, "null") == 403


def test_a_token_is_asked_for_once_and_kept_as_a_cookie(server: viser.ViserServer) -> None:
    port = server.get_port()
    assert get(port) == 403 and get(port, "/?token=wrong") == 403 and get(port, "/?token=secret") == 200
    assert get(port, Cookie="collinea=secret") == 200 and get(port, Cookie="collinea=sécret".encode().decode("latin-1")) == 403
    origin = f"http://127.0.0.1:{port}"
    assert socket(port, origin) == 403 and socket(port, origin, "collinea=secret") == 101
    assert socket(port, "https://evil.example", "collinea=secret") == 403


def test_a_token_may_hold_any_letter() -> None:
    with App(make_state(), token="a b&c;é\r\n=%") as app:
        assert get(app.port, "/?" + app.url.partition("?")[2]) == 200 and get(app.port, "/?token=a") == 403
        with urllib.request.urlopen(app.url) as answer:
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
        assert get(app.port, Cookie=cookie) == 200 and get(app.port, Cookie=cookie + "x") == 403


def test_nobody_but_this_machine_is_answered(plain: viser.ViserServer) -> None:
    with socketlib.create_connection(("127.0.0.1", plain.get_port()), 60):
        pass
    with pytest.raises(OSError):  # another address of this machine stands for all others
        socketlib.create_connection(("127.0.0.2", plain.get_port()), 5)


HOSTS = ("127.0.0.1.evil.example", "127.0.0.1@evil.example", "evil.example#127.0.0.1", "localhost.", "127.1", "0.0.0.0", ":")


@pytest.mark.parametrize("host", HOSTS)
def test_a_host_that_looks_like_this_machine_is_refused(plain: viser.ViserServer, host: str) -> None:
    port = plain.get_port()
    assert get(port, Host=f"{host}:{port}") == get(port, Host=host) == 421


@pytest.mark.parametrize("origin", ["http://127.0.0.1:1", "http://127.0.0.1", "http://localhost:{}", "https://127.0.0.1:{}@evil.example",
                                    "http://127.0.0.1:{}.evil.example", "file://", ""])
def test_an_origin_that_looks_like_this_page_is_refused(plain: viser.ViserServer, origin: str) -> None:
    port = plain.get_port()
    assert socket(port, origin.format(port)) == get(port, Origin=origin.format(port)) == 403


def test_requests_without_a_host_are_refused() -> None:
    assert refuse({}, "/", None, LOCAL_HOSTS) == (HTTPStatus.MISDIRECTED_REQUEST, "wrong host")
    assert refuse({"host": "localhost:1"}, "/", None, LOCAL_HOSTS) is None


def test_other_machines_are_let_in_with_a_token_only(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(Unsupported, match="give a token"):
        App(make_state(), host="0.0.0.0")
    for host in ("0.0.0.0", "::", "192.168.1.7", "0"):
        assert main(["view", str(DEMO), "--host", host, "--no-browser"]) == 1
        assert f"host {host} would open the project to other machines; give a token" in capsys.readouterr().err


def test_no_tunnel_is_opened_whoever_asks(plain: viser.ViserServer) -> None:
    assert isinstance(plain, Server) and plain.request_share_url() is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (json.dumps(["point", "G01", "1"]), ("point", "G01")),
        (json.dumps(["photo", [0.25, 1], "1"]), ("photo", (0.25, 1.0))),
        (json.dumps(["photo-box", [0.25, 1, 0, 0.5], "1"]), ("photo-box", (0.25, 1.0, 0.0, 0.5))),
        (json.dumps(["photo-in", [0.25, 1, 0.04], "1"]), ("photo-in", (0.25, 1.0, 0.04))),
        (json.dumps(["photo-box", [0.25, 1, 0, 1, 1], "1"]), None),
        ("", None),
        ("{}", None),
        ("[1,2,3]", None),
        (json.dumps(["photo", [0.5, 2.0], "1"]), None),
        (json.dumps(["photo", [True, False], "1"]), None),
        (json.dumps(["photo", ["a", 1], "1"]), None),
        ('["photo",[NaN,0.5],"1"]', None),
        (json.dumps(["point", "x" * 5000, "1"]), None),
        (r'["point","\ud800","1"]', None),
        (r'["point","\ud83d\ude00","1"]', ("point", "\U0001f600")),
        ("[" * 1900, None),
    ],
)
def test_a_wire_believes_only_what_it_knows(text: str, said: object) -> None:
    assert parse(text) == said


def test_ten_thousand_mutated_messages_leave_the_state_valid() -> None:
    rng = np.random.default_rng(11)
    seeds = [
        json.dumps(["point", "G01", "1"]),
        json.dumps(["photo", [0.25, 0.5], "1"]),
        json.dumps(["row", "3", "1"]),
        json.dumps(["nudge", "left", "1"]),
        json.dumps(["photo-box", [0.1, 0.1, 0.9, 0.9], "1"]),
        json.dumps(["magnifier", [0.5, 0.5], "1"]),
        json.dumps(["image", "right", "1"]),
    ]
    with App(make_state()) as app:
        for _ in range(10_000):
            letters = list(seeds[rng.integers(len(seeds))])
            for _ in range(rng.integers(1, 4)):
                letters[rng.integers(len(letters))] = chr(rng.integers(32, 1000))
            if (said := parse("".join(letters))) is not None:
                app._heard(*said)
        app._actions.join()
        state = app.state
        assert app._loop.is_alive() and state.work.off <= set(state.block.points.names)
        assert state.image in ("left", "right") and 0 <= state.row <= state.last_row


def test_a_server_that_stops_says_nothing_on_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    open_server().stop()
    assert capfd.readouterr().out == ""


def test_a_message_pushed_while_a_connection_goes_to_sleep_wakes_it(plain: viser.ViserServer) -> None:
    """Another thread pushes between the look whether there is anything and the wait for it."""
    inner: Any = plain
    kind = type(inner._websock_server._broadcast_buffer)

    async def first() -> Any:
        buffer = kind(asyncio.get_running_loop(), persistent_messages=False)
        event, real = buffer.message_event, buffer.message_event._get_loop

        def late() -> Any:
            pushing = threading.Thread(target=buffer.push, args=(RunJavascriptMessage(source="1"),))
            pushing.start()
            pushing.join()
            return real()

        event._get_loop = late
        windows = buffer.window_generator(0)
        return await asyncio.wait_for(anext(windows), 5)

    assert len(asyncio.run(first())) == 1


def test_a_connection_that_says_nothing_is_no_news(plain: viser.ViserServer, capfd: pytest.CaptureFixture[str]) -> None:
    """Browsers open some ahead of need."""
    for said in (b"", b"GET / HT"):
        with socketlib.create_connection(("127.0.0.1", plain.get_port())) as silent:
            silent.sendall(said)
    assert get(plain.get_port()) == 200
    assert capfd.readouterr() == ("", "")


def test_a_port_that_is_taken_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def opened(url: str) -> None:
        raise RuntimeError(url)

    monkeypatch.setattr("webbrowser.open", opened)
    with socketlib.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(RuntimeError, match=r"http://127\.0\.0\.1:\d+"):
            run(DEMO, port=port)
    assert f"(port {port} is taken; Ctrl+C ends it)" in capsys.readouterr().out


@pytest.mark.filterwarnings("error")  # a person would read it after Ctrl+C
def test_a_viewer_that_ends_says_nothing_to_who_leaves() -> None:
    app = App(DEMO)
    left: list[Any] = []
    app._eyes.left = left.append  # type: ignore[method-assign]
    app.close()
    app._left(SimpleNamespace(client_id=0))  # type: ignore[arg-type]
    assert left == []
