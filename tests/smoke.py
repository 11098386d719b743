"""Run the README's first command without a display: the page must answer and the whole scene be sent.

It says how long that took (3 s on a quiet machine is the aim) and gives up after 30 s.

    python -m tests.smoke 'pip install ... && collinea'
"""

from __future__ import annotations

import asyncio
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator

LIMIT_S = 30.0
NEEDED = (b"/ground/terrain", b"/points/", b"/images/DSC00229/perspective", b"/images/DSC00229/orthogonal")


def main(command: str) -> int:
    """Install, start, fetch the page, read the scene from the socket; 0 when all of it came in time."""
    *install, start = command.split("&&")
    for step in install:
        subprocess.run(step, shell=True, check=True)
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "BROWSER": "echo %s", "XDG_DATA_HOME": home, "XDG_CACHE_HOME": home}
        began = time.monotonic()
        process = subprocess.Popen(shlex.split(start), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                   env=environment)
        assert process.stdout is not None
        try:
            port = _port(process.stdout)
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=LIMIT_S) as answer:
                page = answer.read()
            missing = asyncio.run(_missing(port, began + LIMIT_S))
            took = time.monotonic() - began
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(20)
    print(f"smoke: page of {len(page)} bytes and scene after {took:.2f} s" + (f", missing {missing}" if missing else ""))
    return 1 if missing or not page else 0


def _port(lines: Iterator[str]) -> int:
    for line in lines:
        print(line, end="")
        if found := re.search(r"at http://127\.0\.0\.1:(\d+)", line):
            return int(found[1])
    raise SystemExit("smoke: the viewer ended before it said where it is")


async def _missing(port: int, deadline: float) -> list[bytes]:
    """Scene nodes that were not sent before the deadline."""
    import viser
    from websockets.asyncio.client import connect

    missing: list[bytes] = list(NEEDED)
    async with connect(f"ws://127.0.0.1:{port}", origin=f"http://127.0.0.1:{port}", max_size=None,  # type: ignore[arg-type]
                       subprotocols=[f"viser-v{viser.__version__}"]) as socket:  # type: ignore[list-item]
        while missing and (left := deadline - time.monotonic()) > 0:
            try:
                message = await asyncio.wait_for(socket.recv(), left)
            except TimeoutError:
                break
            assert isinstance(message, bytes)
            text = _unpacked(message)
            missing = [name for name in missing if name not in text]
    return missing


def _unpacked(message: bytes) -> bytes:
    """The msgpack part of a viser message: 8 bytes of its size, 8 of its compressed size, then zstd."""
    import zstandard

    size, packed = (int.from_bytes(message[i:i + 8], "little") for i in (0, 8))
    return zstandard.ZstdDecompressor().decompress(message[16:16 + packed], max_output_size=size)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
