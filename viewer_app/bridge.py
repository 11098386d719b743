"""All that leans on viser's private parts: who may connect, and HTML that calls back. Checked against one version of viser.

Where the version is another one, `Wire.works` is False and tables are plain text: everything they do has an ordinary control too.
"""

from __future__ import annotations

import html
import json
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

import viser

from solvers import Unsupported

KNOWN = "1.1."
"""The versions of viser this file was written for."""

LOCAL_HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
LIMIT = 2000
"""Longest message a wire takes, characters."""


def known_version() -> bool:
    return viser.__version__.startswith(KNOWN)


class Server(viser.ViserServer):
    """viser's server, which never opens a public tunnel, whoever asks."""

    def request_share_url(self, verbose: bool = True) -> None:
        return None


def open_server(host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> viser.ViserServer:
    """A server that answers its own pages only: known Host, same Origin, and the right token if there is one.

    Raises Unsupported where viser is another version and a host beyond this machine is asked for: then nothing would guard it.
    """
    remote = host not in LOCAL_HOSTS | {"::1"}
    if not known_version():
        if remote or token:
            raise Unsupported(
                f"viser {viser.__version__} cannot be guarded; install viser 1.1 to open the viewer to other machines"
            )
        return Server(host=host, port=port, verbose=False)
    hosts = None if remote else LOCAL_HOSTS
    with _guarded(token, hosts):
        return Server(host=host, port=port, verbose=False)


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
                    answer.headers["Set-Cookie"] = f"collinea={token}; HttpOnly; SameSite=Strict; Path=/"
                answer.headers["X-Content-Type-Options"] = "nosniff"
                answer.headers["Referrer-Policy"] = "no-referrer"
                answer.headers["X-Frame-Options"] = "SAMEORIGIN"
            return answer

        return real(handler, host, port, **{**options, "process_request": check})

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
        shown = [
            c.strip().removeprefix("collinea=") for c in said.get("cookie", "").split(";") if c.strip().startswith("collinea=")
        ]
        shown += [q.removeprefix("token=") for q in path.partition("?")[2].split("&") if q.startswith("token=")]
        if not any(secrets.compare_digest(c.encode("utf-8", "surrogateescape"), token.encode()) for c in shown):
            return HTTPStatus.FORBIDDEN, "open the address printed in the terminal"
    return None


def _response(status: HTTPStatus, why: str) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    return Response(status, status.phrase, Headers({"Content-Type": "text/plain"}), why.encode())


class Wire:
    """HTML that calls Python: elements made with `attributes` send (kind, value) when clicked or activated by keyboard."""

    def __init__(self, server: viser.ViserServer, heard: Callable[[str, Any, int | None], None]) -> None:
        self._heard = heard
        self.works = known_version()
        if not self.works:
            return
        box = server.gui.add_text("wire", "", visible=False)
        box.on_update(self._update)
        self._box = box
        from viser import _messages

        message = _messages.RunJavascriptMessage(source=SCRIPT.replace("UUID", json.dumps(box._impl.uuid)))
        server._websock_server.queue_message(message)

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
        """A small text box that says value with the text typed; without a wire the text alone. width: pixels of the page."""
        if not self.works:
            return html.escape(text)
        return (
            f'<input type="text" value="{html.escape(text)}" aria-label="{html.escape(hint)}" data-kind="{html.escape(kind)}" '
            f'data-value="{html.escape(json.dumps(value))}" {_focus(focus)}onkeydown="collinea.typed(event)" '
            f'onchange="collinea.change(event)" style="width:{width}px;font:inherit;color:inherit;text-align:right;'
            'border:1px solid rgba(128,128,128,.25);border-radius:3px;background:transparent;padding:0 2px">'
        )

    def surface(self, kind: str) -> str:
        """HTML attributes of an element that says where it was clicked: value [u, v], 0..1 from its top left corner; and what
        rectangle was dragged: value [u, v, u, v], kind with "-box" appended."""
        if not self.works:
            return ""
        return (
            f'data-kind="{html.escape(kind)}" onpointerdown="collinea.down(event)" onclick="collinea.point(event)" '
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
    except (ValueError, RecursionError):
        return None
    if not (isinstance(said, list) and len(said) == 3 and isinstance(said[0], str)):
        return None
    kind, value = said[0], said[1]
    if isinstance(value, str):
        return kind, value
    numbers = (
        isinstance(value, list)
        and len(value) in (2, 4)
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)
    )
    return (kind, tuple(map(float, value))) if numbers and all(0 <= v <= 1 for v in value) else None


SCRIPT = """
window.collinea = (() => {
  let count = 0;
  const send = (kind, value) => window.__viserMutable.sendMessage(
    {type: 'GuiUpdateMessage', uuid: UUID, updates: {value: JSON.stringify([kind, value, Date.now() + '-' + count++])}});
  const press = ev => { ev.stopPropagation(); const e = ev.currentTarget; send(e.dataset.kind, e.dataset.value); };
  const find = name => [...document.querySelectorAll('[data-focus]')].find(e => e.dataset.focus === name);
  const step = (e, by) => {
    const row = e.closest('tr'), column = e.dataset.focus?.split('/').slice(0, 2).join('/');
    const next = by > 0 ? row?.nextElementSibling : row?.previousElementSibling;
    const to = next && [...next.querySelectorAll('[data-focus]')].find(f => f.dataset.focus.startsWith(column + '/'));
    if (to) { to.focus(); to.scrollIntoView({block: 'nearest'}); }
    return !!to;
  };
  const arrows = ev => {
    const by = {ArrowDown: 1, ArrowUp: -1}[ev.key];
    if (by && ev.currentTarget.dataset.focus) { ev.preventDefault(); ev.stopPropagation(); step(ev.currentTarget, by); }
  };
  const key = ev => {
    if (ev.key === 'Enter' || ev.key === ' ') { ev.preventDefault(); press(ev); } else arrows(ev);
  };
  // what is typed, the focus and scroll positions outlive the HTML being drawn anew
  const scrolled = {}, typing = {};
  let focus = null, left = 0;  // left: when somebody last went elsewhere; a box taken off the page speaks up too
  const leaving = () => performance.now() - left < 300;
  const change = ev => { if (leaving()) commit(ev); };
  const commit = ev => {
    const e = ev.currentTarget;
    if (e.value === e.defaultValue) return;
    delete typing[e.dataset.focus];
    e.defaultValue = e.value;
    send(e.dataset.kind, JSON.stringify([...JSON.parse(e.dataset.value), e.value]));
  };
  const typed = ev => {
    const e = ev.currentTarget;
    ev.stopPropagation();
    if (ev.key === 'Enter') commit(ev);
    else if (ev.key === 'Escape') { e.value = e.defaultValue; delete typing[e.dataset.focus]; }
    else arrows(ev);
  };
  document.addEventListener('scroll', ev => {
    const name = ev.target?.dataset?.keep;
    if (name) scrolled[name] = [ev.target.scrollLeft, ev.target.scrollTop];
  }, true);
  document.addEventListener('focusin', ev => { focus = ev.target?.dataset?.focus ?? null; }, true);
  document.addEventListener('pointerdown', ev => {
    left = performance.now();
    if (!ev.target?.closest?.('[data-focus]')) focus = null;
  }, true);
  document.addEventListener('keydown', ev => { if (ev.key === 'Tab') left = performance.now(); }, true);
  document.addEventListener('input', ev => {
    if (ev.target?.dataset?.focus) typing[ev.target.dataset.focus] = ev.target.value;
  }, true);
  document.addEventListener('focusout', ev => { if (leaving()) delete typing[ev.target?.dataset?.focus]; }, true);
  new MutationObserver(records => {
    if (!records.some(r => r.addedNodes.length)) return;
    for (const e of document.querySelectorAll('[data-keep]')) {
      const to = scrolled[e.dataset.keep];
      if (to && (e.scrollLeft !== to[0] || e.scrollTop !== to[1])) { e.scrollLeft = to[0]; e.scrollTop = to[1]; }
    }
    if (focus === null || (document.activeElement && document.activeElement !== document.body)) return;
    const name = focus, e = find(name);
    if (!e) return;
    const words = typing[name];
    e.focus({preventScroll: true});
    if (words !== undefined && e.value !== words) { e.value = words; typing[name] = words; }
  }).observe(document.body, {childList: true, subtree: true});
  const clamp = t => Math.min(1, Math.max(0, t));
  const place = (ev, r) => [clamp((ev.clientX - r.left) / r.width), clamp((ev.clientY - r.top) / r.height)];
  let dragged = false;
  const point = ev => {
    const e = ev.currentTarget;
    if (!dragged) send(e.dataset.kind, place(ev, e.getBoundingClientRect()));
  };
  const down = ev => {
    if (ev.button !== 0) return;
    ev.preventDefault();
    dragged = false;
    const kind = ev.currentTarget.dataset.kind, r = ev.currentTarget.getBoundingClientRect(), from = place(ev, r);
    let box = null;
    const move = e => {
      const to = place(e, r), far = Math.hypot(e.clientX - ev.clientX, e.clientY - ev.clientY) > 5;
      if (!box && !far) return;
      dragged = true;
      if (!box) {
        box = document.body.appendChild(document.createElement('div'));
        box.style.cssText = 'position:fixed;z-index:10000;pointer-events:none;border:1.5px solid #fff;outline:1.5px dashed #000';
      }
      const at = (i, size, start) => [start + size * Math.min(from[i], to[i]), size * Math.abs(from[i] - to[i])];
      [[box.style.left, box.style.width], [box.style.top, box.style.height]] =
        [at(0, r.width, r.left), at(1, r.height, r.top)].map(p => p.map(v => v + 'px'));
    };
    const up = e => {
      removeEventListener('pointermove', move, true);
      removeEventListener('pointerup', up, true);
      removeEventListener('pointercancel', up, true);
      if (box) box.remove();
      if (dragged && e.type === 'pointerup') send(kind + '-box', [...from, ...place(e, r)]);
    };
    addEventListener('pointermove', move, true);
    addEventListener('pointerup', up, true);
    addEventListener('pointercancel', up, true);
  };
  return {press, key, change, typed, point, down};
})();
"""
