"""python -m viewer_app [PROJECT] [options]: as `collinea view PROJECT`, or `collinea` alone for the demo project."""

from __future__ import annotations

import sys

from solvers.cli import main

if __name__ == "__main__":
    words = sys.argv[1:]
    sys.exit(main(["view", *words] if words and not words[0].startswith("-") else ["demo", *words]))
