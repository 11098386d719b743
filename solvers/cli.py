"""The command `collinea`: arguments -> workflow -> exit code (0 done, 1 cannot, 2 usage)."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from . import cli_bundle, cli_exchange, cli_matching, cli_monitoring, cli_mosaic, cli_orientation, cli_project, cli_report
from .cli_parts import PROG, Parser, cannot
from .errors import PhotogrammetryError


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; every error becomes one sentence on standard error."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or (words[0].startswith("-") and words[0] not in ("-h", "--help", "--version")):
        words = ["demo", *words]
    args = None
    try:
        args = parser().parse_args(words)
        code = args.run(args)
        sys.stdout.flush()
        return code
    except SystemExit as stop:  # argparse: help, version, usage
        return stop.code if isinstance(stop.code, int) else 0
    except PhotogrammetryError as error:
        return cannot(str(error))
    except KeyboardInterrupt:
        return cannot("stopped by Ctrl+C")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing more can be written there, not even at exit
        return cannot("the output was closed before it was complete")
    except OSError as error:
        return cannot(f"{error.filename or 'input or output'}: {error.strerror or error}; check the path, its permissions and "
                       "the space left")
    except MemoryError:
        return cannot("the memory is not enough; close other programs or give fewer or smaller photos")
    except Exception as error:
        return _unexpected(error, getattr(args, "project", None))


def parser() -> Parser:
    """All commands and their options."""
    top = Parser(PROG, description="See how an image finds its place: exterior orientation, step by step in the browser.",
                 epilog="Without a command the viewer opens on the demo project.")
    top.add_argument("--version", action="version", version=f"{PROG} {_version()}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    for room in (cli_project, cli_orientation, cli_bundle, cli_matching, cli_mosaic, cli_monitoring, cli_report, cli_exchange):
        room.add(commands)
    return top


def _unexpected(error: Exception, project: str | None) -> int:
    """One sentence for what nobody foresaw; its traceback goes to a file."""
    import tempfile
    import traceback

    runs = Path(project) / "runs" if project else None
    folder = runs if runs is not None and runs.is_dir() and os.access(runs, os.W_OK) else None
    handle, path = tempfile.mkstemp(prefix=f"{PROG}-error-", suffix=".log", dir=folder)
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(" ".join([PROG, *sys.argv[1:]]) + "\n" + "".join(traceback.format_exception(error)))
    return cannot(f"something unforeseen happened ({type(error).__name__}: {error}); please report it with {path}")


def _version() -> str:
    from . import __version__

    return __version__


if __name__ == "__main__":
    sys.exit(main())
