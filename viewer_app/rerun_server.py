"""rerun's own web viewer, served on this machine only, for one recording; nothing it does can leave the machine.

The program in the rerun wheel holds the web viewer but listens with a server open to any page, and its page calls home.
So it runs only for the moment it takes to read the page out of it, and this small server hands page and recording to the
browser, with a Content-Security-Policy that lets the page speak to this server alone.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.request
import webbrowser
from collections.abc import Iterator
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from urllib.parse import quote, urlsplit

from solvers.errors import BadProject, Unsupported

PAGE = {"/": "text/html; charset=utf-8", "/re_viewer.js": "text/javascript", "/re_viewer_bg.wasm": "application/wasm"}
RECORDING = "/recording.rrd"
LAYOUT = "/layout.rrd"
"""Never ends: what is to be seen of the recording, told anew whenever that changes."""
POLICY = ("default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
          "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; connect-src 'self' data:; "
          "base-uri 'none'; form-action 'none'; frame-ancestors 'self' http://127.0.0.1:* http://localhost:*")
OUTSIDE = re.compile(rb"<link\b[^>]*https?://[^>]*>")  # preconnect is no business of the policy's
START_SECONDS = 30.0


class Served:
    """A recording open to the browsers of this machine at `url`, until `close`; also a context manager.

    follows: its pages take what `lay_out` says as long as they are open.
    """

    def __init__(self, recording: Path, page: dict[str, bytes], follows: bool = False) -> None:
        self.recording = recording
        self._layout = _Layout()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(recording, page, self._layout, follows))
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="rerun page", daemon=True)
        self._thread.start()
        self.origin = f"http://127.0.0.1:{self._server.server_port}"
        sources = (RECORDING, LAYOUT) if follows else (RECORDING,)
        asked = "&".join(f"url={quote(self.origin + path, safe='')}" for path in sources)
        self.url = f"{self.origin}/?{asked}&hide_welcome_screen=1"
        atexit.register(self.close)

    def lay_out(self, blueprint: bytes) -> None:
        """Lay the open pages out by a blueprint, and those that are opened later."""
        self._layout.tell(blueprint)

    def close(self) -> None:
        """Stop serving; a second call does nothing."""
        atexit.unregister(self.close)
        self._layout.tell(None)
        if self._thread.is_alive():
            self._server.shutdown()
            self._server.server_close()
            self._thread.join()

    def __enter__(self) -> Served:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None) -> None:
        self.close()


class _Layout:
    """The blueprint said last, for the pages that wait for it."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._said: bytes | None = None
        self._times = 0

    def tell(self, blueprint: bytes | None) -> None:
        """None: there will be no other."""
        with self._change:
            if self._times and self._said is None:
                return
            self._said, self._times = blueprint, self._times + 1
            self._change.notify_all()

    def each(self, patience: float = 2.0) -> Iterator[bytes]:
        """The one there is, and each that comes, but for those overtaken meanwhile; b"" whenever none came for so long [s]."""
        heard = 0
        while True:
            with self._change:
                came = self._change.wait_for(lambda: self._times > heard, patience)  # noqa: B023
                said, heard = self._said, self._times
            if came and said is None:
                return
            yield said if came and said else b""


def growing(recording: Path) -> bool:
    """Whether rows are still added to a recording: its run says so, and the process that makes them lives."""
    from solvers.workflows_bundle import is_running

    return is_running(recording.parent)


def serve(recording: str | Path, follows: bool = False) -> Served:
    """rerun's web viewer with a recording, on a free port of 127.0.0.1; its page may stand in an iframe of a local page.
    follows: it can be laid out anew (`Served.lay_out`).

    Raises BadProject where there is no recording, Unsupported where rerun's program does not start.
    """
    path = Path(recording).resolve()
    if not path.is_file():
        raise BadProject(f"{recording}: there is no recording; solve the project first (collinea resect PROJECT)")
    return Served(path, web_viewer(), follows)


def open_log(recording: str | Path, open_browser: bool = True) -> None:
    """Serve a recording until Ctrl+C, its address on standard error; the browser opens by itself unless told not to."""
    with serve(recording) as served:
        print(f"{Path(recording).name} is open at {served.url}  (Ctrl+C ends)", file=sys.stderr, flush=True)
        if open_browser:
            webbrowser.open(served.url)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()


@lru_cache(maxsize=1)
def web_viewer() -> dict[str, bytes]:
    """The files of rerun's web viewer by their path, about 43 MB, read from the program in the wheel.

    Raises Unsupported.
    """
    web, grpc = _free_ports(2)
    command = [program(), "--serve-web", "--bind", "127.0.0.1", "--port", str(grpc), "--web-viewer-port", str(web)]
    quiet = {**os.environ, "CI": "1"}  # rerun's own switch for its usage data
    child = subprocess.Popen(command, env=quiet, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        files = {path: _fetch(f"http://127.0.0.1:{web}{path}", child) for path in PAGE}
    finally:
        child.kill()
        child.wait()
    return {**files, "/": OUTSIDE.sub(b"", files["/"])}


def program() -> str:
    """The rerun program in the wheel. Raises Unsupported."""
    try:
        import rerun_cli
    except ImportError:
        raise Unsupported("the rerun program is not installed; run: pip install rerun-sdk") from None
    found = shutil.which("rerun", path=str(Path(str(rerun_cli.__file__)).parent))
    if found is None:
        raise Unsupported("the rerun program is missing from its package; run: pip install --force-reinstall rerun-sdk")
    return found


def _fetch(url: str, child: subprocess.Popen[bytes]) -> bytes:
    """The body at a local address, as soon as the child answers."""
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            with direct.open(url, timeout=START_SECONDS) as answer:
                return answer.read()
        except OSError:
            if child.poll() is not None:
                raise Unsupported(f"rerun's web viewer ended with code {child.returncode}; try: rerun --serve-web") from None
            if time.monotonic() > deadline:
                raise Unsupported(f"rerun's web viewer did not answer in {START_SECONDS:.0f} s; try again") from None
        time.sleep(0.02)


def _free_ports(n: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(n)]
        for s in sockets:
            s.bind(("127.0.0.1", 0))
        return [s.getsockname()[1] for s in sockets]


def _handler(recording: Path, page: dict[str, bytes], layout: _Layout, follows: bool) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        server: ThreadingHTTPServer  # pyright: ignore[reportIncompatibleVariableOverride]

        def do_GET(self) -> None:
            path = urlsplit(self.path).path
            here = {f"127.0.0.1:{self.server.server_port}", f"localhost:{self.server.server_port}"}
            if self.headers.get("Host") not in here:  # another name for this address: a page from outside is asking
                self._answer(403, "text/plain", b"not this host")
            elif path in PAGE:
                self._answer(200, PAGE[path], page[path])
            elif path == RECORDING and recording.is_file() and growing(recording):
                self._growing(recording)
            elif path == RECORDING and recording.is_file():
                self._answer(200, "application/octet-stream", recording.read_bytes())
            elif path == LAYOUT and follows:
                self._layouts()
            else:
                self._answer(404, "text/plain", b"not found")

        do_HEAD = do_GET

        def _answer(self, status: int, kind: str, body: bytes) -> None:
            self._head(status, kind, ("Content-Length", str(len(body))))
            if self.command == "GET":
                with contextlib.suppress(ConnectionError):  # the page was closed
                    self.wfile.write(body)

        def _head(self, status: int, kind: str, more: tuple[str, str]) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header(*more)
            self.send_header("Content-Security-Policy", POLICY)
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Referrer-Policy", "no-referrer")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()

        def _open(self) -> bool:
            """An answer of unknown length is begun; whether it has a body."""
            self._head(200, "application/octet-stream", ("Connection", "close"))
            self.close_connection = True
            return self.command == "GET"

        def _layouts(self) -> None:
            if self._open():
                with contextlib.suppress(ConnectionError):
                    for blueprint in layout.each():
                        if self._left():
                            return
                        self.wfile.write(blueprint)
                        self.wfile.flush()

        def _left(self) -> bool:
            """Whether the page was closed."""
            heard, _, _ = select.select([self.connection], [], [], 0)
            return bool(heard) and not self.connection.recv(1, socket.MSG_PEEK)

        def _growing(self, path: Path) -> None:
            """A recording that is still being written: what is there, and what comes, until its run is at its end."""
            if not self._open():
                return
            with path.open("rb") as stream, contextlib.suppress(ConnectionError):
                while True:
                    more = growing(path)
                    while part := stream.read(1 << 20):
                        self.wfile.write(part)
                    if not more:
                        return
                    self.wfile.flush()
                    time.sleep(0.1)

        def log_message(self, format: str, *args: object) -> None:
            """Silent: the page's requests are nobody's news."""

    return Handler
