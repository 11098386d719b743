"""Every control in the command palette, made from the controls themselves: what has no command of its own gets one."""

from __future__ import annotations

from typing import Any

import viser

from .bridge import Wire, controls, operate


def complete(gui: viser.GuiApi, labels: set[str], wire: Wire, tab_of: dict[str, str]) -> None:
    """Commands for the controls whose label is not among those there are. tab_of: name of the tab by a control's uuid."""
    for handle in controls(gui):
        label, tab = getattr(handle._impl.props, "label", None), tab_of.get(handle._impl.uuid, "")
        if label is None or label == "wire":
            continue
        if isinstance(handle, viser.GuiTextHandle | viser.GuiUploadButtonHandle):
            words = f"{label}: {'type' if isinstance(handle, viser.GuiTextHandle) else 'choose a file'}"
            gui.add_command(words, description=_told(handle, tab)).on_trigger(_reach(wire, tab, label))
            continue
        for words, step in _steps(handle, label):
            if words in labels:
                continue
            labels.add(words)
            gui.add_command(words, description=_told(handle, tab)).on_trigger(_act(gui, handle, step))


def _told(handle: Any, tab: str) -> str:
    """The tab, for a label may be short, and the control's hint."""
    return " · ".join(filter(None, (tab, getattr(handle._impl.props, "hint", None))))


def _steps(handle: Any, label: str) -> list[tuple[str, Any]]:
    """What can be done with a control: words and a function of its handle that gives the new value."""
    props = handle._impl.props
    if isinstance(handle, viser.GuiButtonGroupHandle):
        return [(f"{label}: {option}", lambda h, option=option: option) for option in props.options]
    if handle._impl.is_button:
        return [(label, lambda h: True)]
    if isinstance(handle, viser.GuiCheckboxHandle):
        return [(f"{label}: on or off", lambda h: not h.value)]
    if isinstance(handle, viser.GuiDropdownHandle):
        return [(f"{label}: next", _next)]
    if isinstance(handle, viser.GuiSliderHandle):
        return [(f"{label}: more", lambda h: _stepped(h, 1)), (f"{label}: less", lambda h: _stepped(h, -1))]
    if isinstance(handle, viser.GuiNumberHandle):
        return [(f"{label}: more", lambda h: _nudged(h, 1)), (f"{label}: less", lambda h: _nudged(h, -1))]
    return []


def _reach(wire: Wire, tab: str, label: str) -> Any:
    async def act(event: viser.CommandEvent) -> None:
        if event.client_id is not None:
            wire.reach(event.client_id, tab, label)

    return act


def _next(handle: Any) -> str:
    options = tuple(handle._impl.props.options)
    return options[(options.index(handle.value) + 1) % len(options)]


def _stepped(handle: Any, way: int) -> float:
    """A twentieth of the range further, at least one step, within the range."""
    props = handle._impl.props
    size = max(props.step, round((props.max - props.min) / 20 / props.step) * props.step)
    return type(handle.value)(min(max(handle.value + way * size, props.min), props.max))


def _nudged(handle: Any, way: int) -> float:
    """A tenth of the value further, at least one step, within the range where there is one."""
    props = handle._impl.props
    step = props.step or 1
    value = handle.value + way * max(step, round(abs(handle.value) / 10 / step) * step)
    low, high = (value if limit is None else limit for limit in (props.min, props.max))
    return type(handle.value)(min(max(value, low), high))


def _act(gui: viser.GuiApi, handle: Any, step: Any) -> Any:
    async def act(event: viser.CommandEvent) -> None:
        if event.client_id is not None and not handle._impl.removed:
            await operate(gui, handle, step(handle), event.client_id)

    return act
