"""Messages between the viewer and its workers: pickled values, each behind its length; a block crosses once and is kept there."""

from __future__ import annotations

import io
import pickle
import struct
from collections.abc import Callable
from typing import Any, BinaryIO

from solvers import Block

KEPT = 6
"""Blocks that both ends remember."""
_LENGTH = struct.Struct("<Q")


class _Pickler(pickle.Pickler):
    """Asks a function which values go as a number (a subclass: Python 3.13 forbids to set the method of an instance)."""

    def __init__(self, out: BinaryIO, number: Callable[[Any], Any]) -> None:
        super().__init__(out, protocol=pickle.HIGHEST_PROTOCOL)
        self._number = number

    def persistent_id(self, obj: Any) -> Any:
        return self._number(obj)


class _Unpickler(pickle.Unpickler):
    """Asks a function for the values that came as a number."""

    def __init__(self, data: BinaryIO, value: Callable[[Any], Any]) -> None:
        super().__init__(data)
        self._value = value

    def persistent_load(self, pid: Any) -> Any:
        return self._value(pid)


class Sender:
    """Writes values to a stream. A block it has sent lately goes as a number."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._known: dict[int, tuple[Block, int]] = {}
        self._count = 0

    def pack(self, value: Any) -> bytes:
        """A value that is read when the other end `unpack`s it. Raises what pickle raises for values that cannot travel."""
        out = io.BytesIO()
        _Pickler(out, self._number).dump(value)
        return out.getvalue()

    def send(self, value: Any) -> None:
        """Raises OSError where nobody listens any more, and what pickle raises for values that cannot travel."""
        data = self.pack(value)
        self._stream.write(_LENGTH.pack(len(data)))
        self._stream.write(data)
        self._stream.flush()

    def _number(self, value: Any) -> Any:
        if not isinstance(value, Block):
            return None
        known = self._known.get(id(value))
        if known is not None:
            return known[1], None
        data = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        number, self._count = self._count, self._count + 1
        self._known[id(value)] = value, number
        for key in [k for k, (_, n) in self._known.items() if n <= number - KEPT]:
            del self._known[key]
        return number, data


class Receiver:
    """Reads what a `Sender` wrote."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._known: dict[int, Block] = {}

    def receive(self) -> Any:
        """The next value. Raises EOFError at the end of the stream."""
        return self.unpack(self._read(_LENGTH.unpack(self._read(_LENGTH.size))[0]))

    def unpack(self, data: bytes) -> Any:
        """What was `pack`ed; it imports what the value is made of. In the order in which it was packed."""
        return _Unpickler(io.BytesIO(data), self._block).load()

    def _read(self, size: int) -> bytes:
        data = self._stream.read(size)
        if len(data) != size:
            raise EOFError("the other end has closed")
        return data

    def _block(self, said: Any) -> Block:
        number, data = said
        if data is not None:
            self._known[number] = pickle.loads(data)
            for old in [n for n in self._known if n <= number - KEPT]:
                del self._known[old]
        return self._known[number]
