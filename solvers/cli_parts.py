"""What the commands share: the parser, types of options, and how results and refusals are told."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

PROG = "collinea"


class Parser(argparse.ArgumentParser):
    """argparse that says what is wrong in one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROG}: {message}; see {self.prog} --help\n")


def add_command(commands: Any, name: str, run: Callable[[argparse.Namespace], int], what: str) -> Parser:
    """A command with the options that every command has."""
    command = commands.add_parser(name, help=what, description=what[0].upper() + what[1:] + ".")
    command.add_argument("--json", metavar="FILE", help="write the result as JSON to FILE, or - for standard output")
    command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    command.set_defaults(run=run)
    return command


def orientation_source(command: Parser) -> None:
    """Where the orientations come from: --from."""
    command.add_argument("--from", dest="source", choices=("auto", "resect", "georeference", "adjust", "prior"), default="auto",
                         help="orientations: of the latest resect run, else resected now (auto); resected now; of the latest "
                              "georeference or adjust run; the priors of project.toml as they are")


def coordinate_options(command: Parser) -> None:
    """How coordinates and angles of a file are meant, where it does not say."""
    command.add_argument("--swap-xy", action="store_true", help="its first coordinate is north, its second east")
    command.add_argument("--unit", choices=("m", "ft", "us-ft"), help="unit of its x and y: metres, international or US survey "
                                                                      "feet")
    command.add_argument("--height-unit", choices=("m", "ft", "us-ft"), help="unit of its heights")
    command.add_argument("--angles", choices=("opk", "pok", "pok-left"),
                         help="order of its angles: omega phi kappa, phi omega kappa, or that with phi counted the other way")
    command.add_argument("--angle-unit", choices=("deg", "gon", "rad"), help="unit of its angles")


def mapping_options(command: Parser) -> None:
    """Columns of a table: said by a person, or only shown."""
    command.add_argument("--map", metavar="MAP", help="columns of a table by name or number: "
                                                      "name=ID,X=East,Y=North,Z=H[,image=..,col=..,row=..], or "
                                                      "image=..,X=..,Y=..,Z=..,omega=..,phi=..,kappa=..")
    command.add_argument("--show-mapping", action="store_true",
                         help="only show which column would be read as what, and stop: nothing is written")


def teller(args: argparse.Namespace) -> Callable[[str], None] | None:
    """Says how a table is read before it is used: on standard output, or standard error where that is JSON's."""
    if args.quiet:
        return None
    return lambda text: print(text, file=sys.stderr if args.json == "-" else sys.stdout, flush=True)


def show_mappings(args: argparse.Namespace, files: Sequence[str | Path], name: str | None, reading: Any) -> int:
    """Shows how files would be read."""
    from .workflows_exchange import show_mapping

    shown = [show_mapping(f, name, reading) for f in files]
    return emit(args, [s.to_json() for s in shown], "\n".join(
        f"{s.path}: {s.format}, {s.columns or 'a format without columns to choose'}" for s in shown))


def emit(args: argparse.Namespace, value: Any, text: str) -> int:
    """Write the JSON where it is wanted, and the text unless quiet or in the way of the JSON."""
    import json

    from .io import jsonable, write_json

    if args.json == "-":
        print(json.dumps(jsonable(value), indent=1, allow_nan=False, ensure_ascii=False), flush=True)
        return 0
    if args.json:
        write_json(Path(args.json), value)
    if text and not args.quiet:
        print(text, flush=True)
    return 0


def cannot(message: str) -> int:
    """Say it in one line on standard error; the exit code is 1."""
    print(f"{PROG}: {' '.join(message.split())}", file=sys.stderr)
    return 1


def names(text: str) -> tuple[str, ...]:
    """A,B,C."""
    names = tuple(n.strip() for n in text.split(",") if n.strip())
    if not names:
        raise argparse.ArgumentTypeError("expected names separated by commas")
    return names


def count(text: str) -> int:
    """A whole number of at least 2."""
    if not text.isascii() or not text.isdecimal() or int(text) < 2:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 2")
    return int(text)


def reach(text: str) -> int:
    """A whole number from 0 to 1000."""
    if not text.isascii() or not text.isdecimal() or int(text) > 1000:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 to 1000")
    return int(text)


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number")
    return value


def number_or_text(text: str) -> float | str:
    """A finite number, or any word."""
    try:
        return number(text)
    except argparse.ArgumentTypeError:
        return text


def number_or_control(text: str) -> float | str:
    """A number of metres, or the word control."""
    value = number_or_text(text)
    if isinstance(value, str) and value != "control":
        raise argparse.ArgumentTypeError(f"'{text}' is neither a number of metres nor control")
    return value


def pixel(text: str) -> tuple[float, float]:
    """COL,ROW."""
    col, comma, row = text.partition(",")
    if not comma:
        raise argparse.ArgumentTypeError(f"'{text}' is not a pixel; write COL,ROW such as 1200,840.5")
    return number(col), number(row)


def and_more(count: int) -> str:
    """What to append where only the first of several is told."""
    return f" (and {count} more)" if count else ""


def positive(text: str) -> float:
    """A number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number")
    return value
