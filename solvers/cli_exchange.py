"""The command that reads and writes other tools' files: convert."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Any

from .cli_parts import add_command, coordinate_options, emit, mapping_options, number, show_mappings, teller


def add(commands: Any) -> None:
    """Its options."""
    convert = add_command(commands, "convert", _convert, "read a file of another tool, or a project, and write one for another "
                                                         "tool")
    convert.add_argument("input", nargs="?", metavar="IN", help="a file, a model folder, or a project")
    convert.add_argument("output", nargs="?", metavar="OUT", help="a project folder or a file; its name says the format unless "
                                                                  "--to does")
    convert.add_argument("--list", action="store_true", help="list the formats by name and what they hold")
    convert.add_argument("--from", dest="source", metavar="FORMAT", help="format of IN (default: found out)")
    convert.add_argument("--to", dest="target", metavar="FORMAT", help="format of OUT (default: by its name; a folder is a "
                                                                       "project)")
    convert.add_argument("--crs", help="coordinate system of IN, over what it says: EPSG code, WKT, a .prj file, or local")
    convert.add_argument("--to-crs", metavar="CRS", help="coordinate system of OUT (default: that of IN, UTM for degrees and "
                                                         "feet)")
    coordinate_options(convert)
    convert.add_argument("--matrix", choices=("photo-to-object", "object-to-photo"), help="what the matrices of a PATB file turn "
                                                                                          "into what")
    convert.add_argument("--size", type=_size, metavar="W,H", help="width and height of the photos, where IN does not say")
    mapping_options(convert)
    convert.add_argument("--pixel-origin", choices=("center", "corner"), help="what pixel (0, 0) of a table is, of the top-left "
                                                                              "pixel")
    convert.add_argument("--camera", metavar="FILE", help="calibration for images that have none")
    convert.add_argument("--photos", metavar="FOLDER", help="the photos: joined to the project, and their GPS checks the "
                                                            "coordinates")
    convert.add_argument("--orientations", choices=("auto", "resect", "georeference", "adjust", "prior"), default="auto",
                         help="of a project: the latest adjust or resect run, else the priors (auto); or what is named")
    convert.add_argument("--lines", metavar="CSV", help="lines drawn in photos (line,image,col,row), monoplotted into a DXF")
    convert.add_argument("--dem", metavar="DEM.tif", help="ground for lines, footprints and world files")
    convert.add_argument("--z", type=number, metavar="H", help="level ground instead of a DEM [m]")
    convert.add_argument("--image", metavar="N", help="the photo of a world file")


def _size(text: str) -> tuple[int, int]:
    """WIDTH,HEIGHT."""
    parts = text.split(",")
    if len(parts) != 2 or not all(p.strip().isascii() and p.strip().isdigit() and 0 < int(p) < 10**7 for p in parts):
        raise argparse.ArgumentTypeError(f"'{text}' is not a size; write WIDTH,HEIGHT such as 5472,3648")
    return int(parts[0]), int(parts[1])


def _convert(args: argparse.Namespace) -> int:
    from .io.exchange.options import Reading
    from .workflows_exchange import Wanted, convert

    if args.list:
        return _list(args)
    reading = Reading(None, args.angles, args.angle_unit, args.size, args.map, args.pixel_origin, args.matrix)
    if args.show_mapping and args.input is not None:
        return show_mappings(args, [args.input], args.source, replace(reading, crs=args.crs))
    if args.input is None or args.output is None:
        print("collinea: convert takes IN and OUT; see collinea convert --help, or collinea convert --list", file=sys.stderr)
        return 2
    wanted = Wanted(source=args.source, target=args.target, crs=args.crs, to_crs=args.to_crs, swap_xy=args.swap_xy,
                    unit=args.unit,
                    height_unit=args.height_unit, reading=reading, camera=args.camera, photos=args.photos,
                    orientations=args.orientations, lines=args.lines, dem=args.dem, z=args.z, image=args.image)
    ask = _asker()
    done = convert(args.input, args.output, wanted, ask, None if ask else teller(args))
    notes = [n for n in done.notes if not n.startswith("columns: ")]  # they were shown
    text = "\n".join([f"{args.input}: {done.source}, {done.summary}", *notes, f"{done.out}: {done.target}"])
    return emit(args, done.to_json(), text)


def _asker() -> Any:
    from .cli_project import ask_at_terminal

    return ask_at_terminal()


def _list(args: argparse.Namespace) -> int:
    from .io.exchange.registry import FORMATS
    from .workflows_exchange import GROUND

    words = {"dxf": "DXF of monoplotted lines and points", "footprints": "footprints as GeoJSON",
             "world": "world file of a photo or raster"}
    rows = [("project", "read, write", "a project folder", "everything")]
    rows += [(k, ", ".join(w for w, yes in (("read", f.read), ("write", f.write)) if yes), f.title, ", ".join(f.holds)
              or "positions")
             for k, f in FORMATS.items()]
    rows += [(k, "write", words[k], "") for k in GROUND]
    value = [{"name": n, "does": d, "title": t, "holds": h} for n, d, t, h in rows]
    return emit(args, value, "\n".join(f"{n:15} {d:12} {t}{f' ({h})' if h else ''}" for n, d, t, h in rows))
