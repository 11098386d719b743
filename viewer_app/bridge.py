"""All that leans on viser's private parts: who may connect, and HTML that calls back. Checked against one version of viser.

Where the version is another one, `Wire.works` is False and tables are plain text: everything they do has an ordinary control too.
"""

from __future__ import annotations

import asyncio
import html
import json
import logging
import math
import secrets
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from typing import Any
from urllib.parse import quote, unquote_to_bytes

import viser

from solvers import Unsupported

from .label_script import SCRIPT as LABELS
from .wire_script import SCRIPT

KNOWN = "1.1."
"""The versions of viser this file was written for."""

LOCAL_HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
FAREWELL = 0.5
"""How long a page may take to answer that the server closes, seconds; one that draws millions of points does not answer soon."""
LIMIT = 2000
"""Longest message a wire takes, characters."""


def known_version() -> bool:
    return viser.__version__.startswith(KNOWN)


class Server(viser.ViserServer):
    """viser's server, which never opens a public tunnel, whoever asks."""

    def request_share_url(self, verbose: bool = True) -> None:
        return None


def is_local(host: str) -> bool:
    """Whether an address to listen at is this machine's own, which no other can reach."""
    return host in LOCAL_HOSTS | {"::1"}


def open_server(host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> viser.ViserServer:
    """A server that answers its own pages only: known Host, same Origin, and the right token if there is one.

    Raises Unsupported where viser is another version and a host beyond this machine is asked for: then nothing would guard it.
    """
    remote = not is_local(host)
    if not known_version():
        if remote or token:
            raise Unsupported(
                f"viser {viser.__version__} cannot be guarded; install viser 1.1 to open the viewer to other machines"
            )
        return Server(host=host, port=port, verbose=False)
    hosts = None if remote else LOCAL_HOSTS
    _hush()
    _wake()
    with _guarded(token, hosts):
        return Server(host=host, port=port, verbose=False)


def _hush() -> None:
    """viser says where it serves and that it stopped on standard output, even where verbose is False, the latter late and from a
    thread of its own: there it would stand in the middle of our own answers. And a browser that opens a connection ahead of need
    and leaves it unused is no error, least of all with a traceback."""
    import rich

    real: Any = rich.print
    if real.__name__ == "without_viser":
        return

    def without_viser(*said: Any, **how: Any) -> None:
        first = said[0] if said else ""
        if not ("(viser)" in str(first) or "viser" in str(getattr(first, "title", ""))):
            real(*said, **how)

    rich.print = without_viser
    logging.getLogger("websockets.server").addFilter(lambda record: record.getMessage() != "opening handshake failed")


class _Told(asyncio.Event):
    """An event that only its own loop sets. viser sets its own from any thread as well, before it lets the loop do so: between a
    waiter's look and its wait that is heard by nobody, and the page never gets another message."""

    def set(self) -> None:
        with suppress(RuntimeError):  # another thread: the loop is about to be told
            asyncio.get_running_loop()
            super().set()


def _wake() -> None:
    """Every buffer of messages made from now on wakes who waits for it."""
    import viser.infra._infra as infra

    library: Any = infra
    if library.AsyncMessageBuffer.__name__ == "Buffer":
        return

    class Buffer(library.AsyncMessageBuffer):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            self.message_event = _Told()

    library.AsyncMessageBuffer = Buffer


@contextmanager
def _guarded(token: str | None, hosts: frozenset[str] | None) -> Iterator[None]:
    """The server made inside checks its requests first; viser has no hook for that. hosts None: any, the token guards."""
    import viser.infra._infra as infra

    library: Any = infra
    asyncio_server = library.websockets.asyncio.server
    real = asyncio_server.serve

    def serve(handler: Any, host: str, port: int, **options: Any) -> Any:
        inner = options["process_request"]

        def check(connection: Any, request: Any) -> Any:
            refusal = refuse(dict(request.headers.raw_items()), request.path, token, hosts)
            if refusal is not None:
                return _response(*refusal)
            answer = inner(connection, request)
            if answer is not None:
                if token is not None:
                    answer.headers["Set-Cookie"] = f"collinea={quote(token, safe='')}; HttpOnly; SameSite=Strict; Path=/"
                answer.headers["X-Content-Type-Options"] = "nosniff"
                answer.headers["Referrer-Policy"] = "no-referrer"
                answer.headers["X-Frame-Options"] = "SAMEORIGIN"
            return answer

        return real(handler, host, port, **{**options, "process_request": check, "close_timeout": FAREWELL})

    asyncio_server.serve = serve
    try:
        yield
    finally:
        asyncio_server.serve = real


def refuse(headers: dict[str, str], path: str, token: str | None, hosts: frozenset[str] | None) -> tuple[HTTPStatus, str] | None:
    """Why a request is refused, None where it is welcome."""
    said = {name.lower(): value for name, value in headers.items()}
    netloc = said.get("host", "")
    if hosts is not None and (netloc.rpartition(":")[0] or netloc) not in hosts:  # a name rebound to this machine
        return HTTPStatus.MISDIRECTED_REQUEST, "wrong host"
    if "origin" in said and said["origin"] not in (f"http://{netloc}", f"https://{netloc}"):
        return HTTPStatus.FORBIDDEN, "wrong origin"
    if token is not None:
        cookies = [c.strip() for c in said.get("cookie", "").split(";")]
        shown = [c.removeprefix("collinea=") for c in cookies if c.startswith("collinea=")]
        shown += [q.removeprefix("token=") for q in path.partition("?")[2].split("&") if q.startswith("token=")]
        known = token.encode()
        if not any(secrets.compare_digest(unquote_to_bytes(s.encode("utf-8", "surrogateescape")), known) for s in shown):
            return HTTPStatus.FORBIDDEN, "open the address printed in the terminal"
    return None


MAX_UPLOAD = 64 * 2**20
"""Largest file a browser may hand over, bytes."""
MAX_TEXT = 2000
"""Longest text a control takes, characters."""


_given: Counter[str] = Counter()
"""By control, how many values people gave it that the viewer has not taken yet."""
_counting = threading.Lock()


def _count(control: str, change: int) -> None:
    with _counting:
        _given[control] += change
        if _given[control] <= 0:
            del _given[control]


def given(handle: Any) -> bool:
    """Whether a person gave the control a value that the state does not know yet: it must not be put back to what the state says,
    for that would wipe out what is being typed."""
    return bool(_given) and handle._impl.uuid in _given


def guard_values(server: viser.ViserServer, afterwards: Callable[[Callable[[], None]], None]) -> None:
    """From now on a browser may only give a control a value that the control offers; anything else is dropped and the control
    is shown again as it is. viser itself believes every message, even one that names parts of the control.

    afterwards: calls a function once all that the value brought about was taken.
    """
    if not known_version():
        return
    from viser import _messages

    gui: Any = server.gui
    handlers: Any = server._websock_server._incoming_handlers
    inner = gui._handle_gui_updates

    async def checked(client_id: int, message: Any) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid) if isinstance(message.uuid, str) else None
        updates = message.updates if isinstance(message.updates, dict) else {}
        if handle is None or set(updates) != {"value"} or not acceptable(handle, updates["value"]):
            logging.getLogger("collinea").debug("refused: %s", str(message)[:200])
            if handle is not None and not handle._impl.is_button:
                again = _messages.GuiUpdateMessage(message.uuid, {"value": handle._impl.value})
                for client in server.get_clients().values():
                    if client.client_id == client_id:
                        client._websock_connection.queue_message(again)
            return
        _count(message.uuid, 1)
        try:
            await inner(client_id, message)
        finally:
            afterwards(lambda: _count(message.uuid, -1))

    handlers[_messages.GuiUpdateMessage] = [checked if h == inner else h for h in handlers[_messages.GuiUpdateMessage]]
    start, part = gui._handle_file_transfer_start, gui._handle_file_transfer_part
    sizes: dict[str, int] = {}

    def starts(client_id: int, message: Any) -> None:
        for left in [t for t in sizes if t not in gui._current_file_upload_states]:  # its browser has gone
            del sizes[left]
        handle = gui._gui_input_handle_from_uuid.get(message.source_component_uuid)
        fits = isinstance(message.size_bytes, int) and 0 <= message.size_bytes <= MAX_UPLOAD and len(sizes) < 8
        if isinstance(handle, viser.GuiUploadButtonHandle) and fits:
            sizes[message.transfer_uuid] = message.size_bytes
            start(client_id, message)

    def parts(client_id: int, message: Any) -> None:
        if message.transfer_uuid not in sizes:
            return
        sizes[message.transfer_uuid] -= len(message.content)
        if sizes[message.transfer_uuid] < 0:  # more than was announced
            gui._current_file_upload_states.pop(message.transfer_uuid, None)
        else:
            part(client_id, message)
        if sizes[message.transfer_uuid] <= 0:
            del sizes[message.transfer_uuid]

    for kind, old, new in ((_messages.FileTransferStartUpload, start, starts), (_messages.FileTransferPart, part, parts)):
        handlers[kind] = [new if h == old else h for h in handlers.get(kind, [])]


def acceptable(handle: Any, value: Any) -> bool:
    """Whether a control offers this value."""
    props, now = handle._impl.props, handle._impl.value
    if handle._impl.is_button and not hasattr(props, "options"):
        return isinstance(value, bool)
    if hasattr(props, "options"):
        return isinstance(value, str) and value in tuple(props.options)
    if isinstance(now, bool):
        return isinstance(value, bool)
    if isinstance(now, int | float):
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return False
        low, high = getattr(props, "min", None), getattr(props, "max", None)
        return (low is None or value >= low) and (high is None or value <= high)
    return isinstance(now, str) and isinstance(value, str) and len(value) <= MAX_TEXT


def controls(gui: viser.GuiApi) -> tuple[Any, ...]:
    """Every control of the page, as far as this version of viser tells."""
    inner: Any = gui
    return tuple(inner._gui_input_handle_from_uuid.values()) if known_version() else ()


async def operate(gui: viser.GuiApi, handle: Any, value: Any, client_id: int) -> None:
    """As if the browser had given the control this value."""
    from viser import _messages

    inner: Any = gui
    if acceptable(handle, value):
        await inner._handle_gui_updates(client_id, _messages.GuiUpdateMessage(handle._impl.uuid, {"value": value}))
        if not handle._impl.is_button:
            handle._impl.sync_cb(-1, {"value": value})  # the browser that asked does not know yet


def dress_labels(server: viser.ViserServer) -> None:
    """Labels in the colours of the theme, names that make room for each other; another version of viser draws them as it does."""
    if known_version():
        from viser import _messages

        inner: Any = server
        inner._websock_server.queue_message(_messages.RunJavascriptMessage(source=LABELS))


def _response(status: HTTPStatus, why: str) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    return Response(status, status.phrase, Headers({"Content-Type": "text/plain"}), why.encode())


class Wire:
    """HTML that calls Python: elements made with `attributes` send (kind, value) when clicked or activated by keyboard."""

    def __init__(self, server: viser.ViserServer, heard: Callable[[str, Any, int | None], None]) -> None:
        self._heard, self._server = heard, server
        self.works = known_version()
        if not self.works:
            return
        box = server.gui.add_text("wire", "", visible=False)
        box.on_update(self._update)
        self._box = box
        from viser import _messages

        self._queue = lambda source: server._websock_server.queue_message(_messages.RunJavascriptMessage(source=source))
        self._queue(SCRIPT.replace("UUID", json.dumps(box._impl.uuid)))

    def run(self, source: str) -> None:
        """Give the page a script of a panel's own, written in this package and free of anything a person or a project says."""
        if self.works:
            self._queue(source)

    def reach(self, client_id: int, tab: str, label: str) -> None:
        """Bring a text box or a file's button of a tab before the keyboard of one browser."""
        self._run_in(client_id, f"collinea.reach({json.dumps(tab)}, {json.dumps(label)})")

    def measure(self, client_id: int) -> None:
        """Let one browser say how large its page and its pictures are."""
        self._run_in(client_id, "window.collinea?.measure()")

    def open(self, client_id: int, tabs: list[str]) -> None:
        """Open tabs in one browser."""
        self._run_in(client_id, f"collinea.open({json.dumps(tabs)})")

    def widen(self, client_id: int, panel: Any, width: int) -> None:
        """Give a panel a width [px] in one browser; viser itself knows but one for all."""
        if not self.works:
            return
        from viser import _messages

        api = panel._placement_gui_api
        for client in self._server.get_clients().values():
            if client.client_id == client_id:
                message = _messages.GuiSetPanelWidthMessage(
                    panel._placement_uuid, width, counter=api._next_layout_counter(), run_id=api._layout_run_id
                )
                client._websock_connection.queue_message(message)

    def _run_in(self, client_id: int, source: str) -> None:
        if not self.works:
            return
        from viser import _messages

        for client in self._server.get_clients().values():
            if client.client_id == client_id:
                client._websock_connection.queue_message(_messages.RunJavascriptMessage(source=source))

    async def _update(self, event: Any) -> None:
        if event.client_id is None:
            return
        said = parse(str(self._box.value))
        if said is not None:
            self._heard(*said, event.client_id)

    def attributes(self, kind: str, value: str, hint: str = "", focus: str = "") -> str:
        """HTML attributes that make an element a button. focus: a name of its own by which it keeps the focus when drawn anew;
        in a table "table/column/row", the arrows then go up and down."""
        if not self.works:
            return f'title="{html.escape(hint)}"' if hint else ""
        return (
            f'tabindex="0" role="button" data-kind="{html.escape(kind)}" '
            f'data-value="{html.escape(value)}" title="{html.escape(hint)}" {_focus(focus)}'
            'onclick="collinea.press(event)" onkeydown="collinea.key(event)" style="cursor:pointer"'
        )

    def field(self, kind: str, value: list[str], text: str, hint: str, focus: str, width: int) -> str:
        """A small text box that says value with the text typed; without a wire the text alone. width: digits it shows at least;
        in a table it fills its column."""
        if not self.works:
            return html.escape(text)
        return (
            f'<input type="text" value="{html.escape(text)}" aria-label="{html.escape(hint)}" data-kind="{html.escape(kind)}" '
            f'data-value="{html.escape(json.dumps(value))}" {_focus(focus)}onkeydown="collinea.typed(event)" '
            f'onchange="collinea.change(event)" style="width:calc({width}ch + 6px);min-width:100%;font:inherit;color:inherit;'
            'text-align:right;border:1px solid rgba(128,128,128,.25);border-radius:3px;background:transparent;padding:0 2px">'
        )

    def surface(self, kind: str) -> str:
        """HTML attributes of an element that says where it was clicked: value [u, v], 0..1 from its top left corner; and what
        rectangle was dragged: value [u, v, u, v], kind with "-box" appended, or with Shift or the middle button "-pan"; the wheel
        says [u, v, width of the element in 10,000 px], kind with "-in" or "-out" appended."""
        if not self.works:
            return ""
        return (
            f'data-kind="{html.escape(kind)}" onpointerdown="collinea.down(event)" '
            'onwheel="collinea.wheel(event)" '
            'style="cursor:crosshair"'
        )


def _focus(name: str) -> str:
    return f'data-focus="{html.escape(name)}" ' if name else ""


def parse(text: str) -> tuple[str, Any] | None:
    """(kind, value) of a wire's message; None for anything else: whoever can send it may send what he likes."""
    if len(text) > LIMIT:
        return None
    try:
        said = json.loads(text)
        json.dumps(said, ensure_ascii=False).encode()  # no half letters, which no file and no page can hold
    except (ValueError, RecursionError):
        return None
    if not (isinstance(said, list) and len(said) == 3 and isinstance(said[0], str)):
        return None
    kind, value = said[0], said[1]
    if isinstance(value, str):
        return kind, value
    numbers = (
        isinstance(value, list)
        and len(value) in (2, 3, 4)
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)
    )
    return (kind, tuple(map(float, value))) if numbers and all(0 <= v <= 1 for v in value) else None
