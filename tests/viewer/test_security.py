"""What a stranger at the socket may do: nothing that the page itself could not. Raw messages, no browser."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
import websockets
from websockets.asyncio.client import connect

from tests.viewer.conftest import make_state
from viewer_app.acting import update as update_state
from viewer_app.actions import Say
from viewer_app.app import App
from viewer_app.bridge import MAX_UPLOAD, controls
from viewer_app.bundle_actions import RunBundle
from viewer_app.bundle_state import Bundle
from viewer_app.bundle_tasks import tasks as bundle_tasks
from viewer_app.eyes import look_of, turn
from viewer_app.replay_page import with_words
from viewer_app.state import State
from viewer_app.tabs import tabs

COUNT = itertools.count()
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [0, 0, 0],
    "fov": 1.0,
    "near": 0.1,
    "far": 10.0,
    "image_height": 10,
    "image_width": 10,
    "look_at": [0, 0, 1],
    "up_direction": [0, 0, 1],
}


def speak(app: App, messages: Sequence[dict[str, Any] | bytes]) -> None:
    """Send messages as a page would, and wait until the last is taken; a socket that is closed on us is opened again."""
    mark = labelled(app, "Names of GCPs")
    todo: list[dict[str, Any] | bytes] = [*messages, update(mark, value=f"taken {next(COUNT)}")]
    last = todo[-1]["updates"]["value"]  # type: ignore[index]

    async def talk() -> None:
        while todo:
            try:
                protocol = websockets.Subprotocol("viser-v" + viser.__version__)
                address = f"ws://127.0.0.1:{app.port}/"
                async with connect(address, subprotocols=[protocol], max_size=None, close_timeout=0.2) as ws:
                    await asyncio.wait_for(ws.recv(), 60)
                    await ws.send(msgspec.msgpack.encode(CAMERA))
                    while todo:
                        for message in todo[:100]:
                            await ws.send(message if isinstance(message, bytes) else msgspec.msgpack.encode(message))
                        del todo[:100]
                        await asyncio.sleep(0)
                    for _ in range(3000):
                        if mark.value == last:
                            return
                        await asyncio.sleep(0.02)
                        await ws.ping()
            except websockets.exceptions.ConnectionClosed:
                if not todo and mark.value != last:
                    todo.append(update(mark, value=last))

    asyncio.run(talk())
    assert mark.value == last


def update(handle: Any, **updates: Any) -> dict[str, Any]:
    return {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": updates}


def labelled(app: App, label: str) -> Any:
    return next(h for h in controls(app.server.gui) if h._impl.props.label == label)  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def app() -> Any:
    with App(make_state()) as made:
        yield made


def test_a_control_takes_only_what_it_offers(app: App) -> None:
    speed, image, rays, names = (labelled(app, label) for label in ("Rows / second", "Image", "Rays", "Names of GCPs"))
    before = [h.value for h in (speed, image, rays, names)]
    wrong = [update(speed, value=v) for v in (1e308, -1, "2", None, [], True, math.nan)]
    wrong += [update(image, value=v) for v in ("../../etc/passwd", 3, None, ["left"])]
    wrong += [update(rays, value=v) for v in ("yes", 1, None)] + [update(names, value=v) for v in ("x" * 5000, 1, None)]
    speak(app, wrong)
    assert [h.value for h in (speed, image, rays)] == before[:-1] and names.value.startswith("taken")
    speak(app, [update(speed, value=3.5), update(image, value="right")])
    app._actions.join()  # between the two the page is painted with the old image
    assert speed.value == 3.5 and image.value == "right"


def test_a_value_just_given_is_not_put_back_to_what_it_was(app: App) -> None:
    """Who types faster than the viewer draws keeps what was typed; the state has the last word once it knows of it."""
    speed, gate = labelled(app, "Rows / second"), threading.Event()
    app._actions.join()
    old = app.state

    def wait() -> None:
        gate.wait(60)

    app._actions.put(wait)  # the viewer is busy
    speak(app, [update(speed, value=2.5)])
    assert app.state.speed == old.speed != 2.5
    for panel in app._panels:
        panel.draw(old)
    assert speed.value == 2.5
    gate.set()
    app._actions.join()
    assert app.state.speed == speed.value == 2.5
    for panel in app._panels:
        panel.draw(old)
    assert speed.value == old.speed
    app._paint()


def test_nobody_reaches_into_a_control(app: App) -> None:
    rays = labelled(app, "Rays")
    callbacks = list(rays._impl.update_cb)
    speak(app, [update(rays, update_cb=[]), update(rays, removed=True), update(rays, value=False, is_button=True), update(rays)])
    assert rays._impl.update_cb == callbacks and not rays._impl.removed and not rays._impl.is_button and rays.value is True


def test_a_tunnel_cannot_be_asked_for(app: App, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a tunnel was asked for")

    monkeypatch.setattr("viser._tunnel.ViserTunnel.__init__", refuse)
    speak(app, [{"type": "ShareUrlRequest"}])
    assert app.server.request_share_url() is None


def upload(handle: Any, size: int, parts: int, name: str = "../../x.sh", number: str = "t") -> list[dict[str, Any] | bytes]:
    start = {
        "type": "FileTransferStartUpload",
        "source_component_uuid": handle._impl.uuid,
        "transfer_uuid": number,
        "filename": name,
    }
    start |= {"mime_type": "x", "part_count": parts, "size_bytes": size}
    each = {"type": "FileTransferPart", "source_component_uuid": handle._impl.uuid, "transfer_uuid": number,
            "content": b"0" * 1000}
    return [start, *({**each, "part_index": i} for i in range(parts))]


def test_uploads_are_capped_and_go_nowhere_else(app: App) -> None:
    gui: Any = app.server.gui
    speak(app, upload(labelled(app, "Rays"), 3000, 3))  # not a control for files
    assert not gui._current_file_upload_states
    button = gui.add_upload_button("A file", hint="For this test.")
    speak(app, upload(button, MAX_UPLOAD + 1, 3))
    speak(app, upload(button, 1500, 3))  # more than announced
    assert not gui._current_file_upload_states and not button.value.content
    speak(app, upload(button, 3000, 3))
    assert len(button.value.content) == 3000
    for k in range(9):  # browsers that leave in the middle of it
        speak(app, upload(button, 2000, 2, number=f"left {k}")[:-1])
    speak(app, upload(button, 1000, 1))
    assert len(button.value.content) == 1000
    button.remove()


def test_a_panel_that_fails_is_said_and_the_viewer_lives_on(app: App, monkeypatch: pytest.MonkeyPatch) -> None:
    panel = app._panels[0]

    def fail(state: State) -> None:
        raise ZeroDivisionError("of a panel")

    with monkeypatch.context() as patch:
        patch.setattr(panel, "draw", fail)
        app.emit(Say(""))
        app._actions.join()
    assert app.state.message == f"The {type(panel).__name__} failed (ZeroDivisionError: of a panel); Undo may help"
    app.emit(Say(""))
    app._actions.join()
    assert app._loop.is_alive() and app.state.message == ""


WIRED = (
    "left", "G02", "G05", "points", "name", "3", "99999999", '["G01", "X"]', '["G01", "sX", "0.3"]', '["points", "X"]', "", "[]",
    '["left", "G01"]', "[[[[", '{"a": 1}', "0,0", "fly", "<img src=x>", "../../etc/passwd", "\ud800", "1e400", 7, None, True, {},
    [0.5, 0.5], [0.2, 0.3, 0.7, 0.9], [0.5, 0.5, 0.05], [1e308, 0.1], [math.nan, 0.5], [-1, 2], [0.5], [0] * 9, [True, 0.2],
)  # fmt: skip


def wired(rng: np.random.Generator, kinds: Sequence[str]) -> str:
    """What clickable HTML might send, or nearly."""
    kind, value = kinds[int(rng.integers(len(kinds)))], WIRED[int(rng.integers(len(WIRED)))]
    text = json.dumps([kind, value, int(rng.integers(1000))])
    return text if rng.random() < 0.9 else text[: int(rng.integers(len(text)))]


def mutated(rng: np.random.Generator, message: dict[str, Any]) -> dict[str, Any] | bytes:
    """The message with something in it replaced; now and then its bytes damaged."""
    strange = (
        None,
        -1,
        1e308,
        math.nan,
        math.inf,
        "",
        "x" * 300,
        "../../etc/passwd",
        [],
        {},
        True,
        [[1]],
        b"\xff\x00",
        "<img src=x>",
        2**63,
    )
    if "wire" in message:
        return {k: v for k, v in message.items() if k != "wire"} | {"updates": {"value": wired(rng, message["wire"])}}
    chance = rng.random()
    if chance < 0.003:  # closes the socket on us
        data = bytearray(msgspec.msgpack.encode(message))
        data[rng.integers(len(data))] = rng.integers(256)
        return bytes(data)
    if message["type"] == CAMERA["type"]:  # how it looks, or nearly
        field = list(CAMERA)[1 + int(rng.integers(len(CAMERA) - 1))]
        return {**CAMERA, field: (*strange, [math.nan] * 3, [1e308, 0, 0], [0, 0, 0])[int(rng.integers(len(strange) + 3))]}
    if "updates" not in message:
        return message
    if chance < 0.01:
        return {**message, ("uuid", "updates")[rng.integers(2)]: strange[rng.integers(len(strange))]}
    value = strange[rng.integers(len(strange))]
    name = ("value", "value", "value", "removed", "update_cb", "is_button", "props")[rng.integers(7)]
    return {**message, "updates": {name: value} if chance < 0.7 else {**message["updates"], name: value}}


def count_arrivals(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by one for every message that arrives; many that were sent are lost with a socket that an earlier one closed."""
    from viser.infra._messages import Message

    arrived: list[int] = []
    honest = Message.deserialize.__func__  # type: ignore[attr-defined]

    def deserialize(cls: Any, message: bytes) -> Any:
        arrived.append(len(message))
        return honest(cls, message)

    monkeypatch.setattr(Message, "deserialize", classmethod(deserialize))
    return arrived


def test_a_browser_that_says_it_looks_from_nowhere_is_left_alone(app: App) -> None:
    told: list[Any] = []
    app.server.on_client_connect(told.append)
    speak(app, [{**CAMERA, "fov": "wide"}, CAMERA])
    camera = told[0].camera
    assert look_of(camera) is not None
    turn(told[0], np.array([1.0, 2.0, 3.0]), np.zeros(3))
    assert camera.position[2] == 3
    nowhere: list[dict[str, Any]] = [{"position": np.array([math.inf, 0, 0])}, {"look_at": np.zeros(2)}, {"wxyz": np.ones(3)}]
    for wrong in ({"fov": math.nan}, {"fov": "wide"}, *nowhere):
        camera._state, honest = replace(camera._state, **wrong), camera._state
        assert look_of(camera) is None or "wxyz" in wrong
        turn(told[0], np.array([4.0, 5.0, 6.0]), np.zeros(3))  # between reading and turning, the camera may say so
        camera._state = honest
    turn(told[0], np.array([1e300, 0, 0]), np.zeros(3))
    assert (np.abs(camera.position) < 10).all()


@pytest.mark.filterwarnings("ignore::UserWarning")  # viser says what it is told
def test_ten_thousand_mutated_messages_leave_the_server_alive_and_the_state_valid(
    app: App, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    rng = np.random.default_rng(17)
    handles = controls(app.server.gui)
    seeds = [update(h, value=h.value) for h in handles if not isinstance(h, viser.GuiUploadButtonHandle)]  # type: ignore[attr-defined]
    kinds_heard = sorted({kind for tab in tabs() for kind in tab.heard} | {"tab", "sizes", "nobody"})
    seeds += [{**update(labelled(app, "wire"), value=""), "wire": kinds_heard}] * (len(seeds) // 2)
    seeds += [{"type": "GuiButtonHoldMessage", "uuid": "x", "frequency": 10.0}, {"type": "ShareUrlRequest"}]
    seeds += [{"type": "CommandTriggerMessage", "uuid": "x"}, CAMERA, CAMERA]
    kinds = {id(h): type(h.value) for h in handles}  # type: ignore[attr-defined]
    arrived = count_arrivals(monkeypatch)
    for _ in range(200):
        speak(app, [mutated(rng, seeds[rng.integers(len(seeds))]) for _ in range(300)])
        if len(arrived) >= 10_000:
            break
    assert len(arrived) >= 10_000
    app._actions.join()
    state = app.state
    said = [r.getMessage() for r in caplog.records if r.name == "collinea" and r.levelname == "ERROR"]
    assert said == [], set(said)  # no panel and no action failed
    assert app._loop.is_alive() and state.work.off <= set(state.block.points.names)
    assert state.image in ("left", "right") and 0 <= state.row and state.point in (None, *state.block.points.names)
    now = [h for h in controls(app.server.gui) if id(h) in kinds]  # a message may also have opened the recording beside the scene
    assert all(type(h.value) is kinds[id(h)] for h in now)  # type: ignore[attr-defined]
    speak(app, [update(labelled(app, "Image"), value="left"), update(labelled(app, "Image"), value="right")])
    app._actions.join()
    assert app.state.image == "right"


EVIL = """<img src=x onerror="alert(1)">' onmouseover='alert(2)"""


def hostile() -> State:
    """A project whose names and messages are HTML."""
    state = make_state()
    points = state.block.points
    points = replace(points, names=tuple(EVIL + n for n in points.names), group=tuple(EVIL + g for g in points.group))
    images = tuple(replace(image, name=EVIL + image.name) for image in state.block.images)
    block = replace(state.block, name=EVIL, points=points, images=images)
    return replace(state, work=replace(state.work, block=block), image=images[0].name, point=points.names[0], message=EVIL)


class Tags(HTMLParser):
    """What HTML holds: how often the text is shown as text, and elements and attributes that came out of it."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.shown, self.alive = 0, []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.alive += [tag for name, value in attrs if name in ("onerror", "onmouseover") or (name, value) == ("src", "x")]
        self.shown += any(EVIL in value for _, value in attrs if value)

    def handle_data(self, data: str) -> None:
        self.shown += EVIL in data


def pages(gui: Any) -> list[str]:
    """The HTML of every panel."""
    every = [child for box in gui._container_handle_from_uuid.values() for child in box._children.values()]
    return [child.content for child in every if isinstance(child, viser.GuiHtmlHandle)]


def test_names_of_a_project_are_text_in_every_panel() -> None:
    state = update_state(hostile(), RunBundle())
    (task,) = bundle_tasks(state)
    for value in task.call(*task.arguments):
        state = update_state(state, task.arrive(value))
    assert state.room(Bundle).result is not None
    with App(state) as made:
        while not made.settled():
            time.sleep(0.01)
        found = [Tags(page) for page in pages(made.server.gui)]
    assert [tag for page in found for tag in page.alive] == []
    assert sum(page.shown > 0 for page in found) > 8


def test_names_of_a_project_are_text_in_the_replay() -> None:
    page = with_words("<html><head><title>Viser</title></head><body></body></html>", hostile(), 1)
    found = Tags(page.replace("<title>", "<p>").replace("</title>", "</p>"))
    assert found.alive == [] and found.shown == 2 and "Viser" not in page
