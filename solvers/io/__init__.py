"""Everything that is read from and written to a disk: project folders, tables, photos, traces."""

from . import assemble, crs
from .arrays import ArrayFolder
from .bal import read_bal
from .cog import Coding, Part, TileFolder, encode_tile, full_disk, no_space, to_picture, to_preview, write_cog
from .corners import WrittenCorners, read_corners, write_corners
from .demo import demo_assets, demo_copy
from .exif import Exif, read_exif
from .files import jsonable, write_json
from .gcp import Ask, ControlList, read_control
from .geojson import areas_of, write_areas, write_world_file
from .geotiff import write_heights
from .heights import read_heights
from .metadata import photo_time, read_onboard
from .motion import read_motion
from .photos import (
    Thumbnail,
    check_photos,
    photo_path,
    photo_size,
    photo_state,
    photo_window,
    read_photo,
    surface_path,
    thumbnail,
    write_image,
)
from .photostore import PhotoStore
from .priors import write_priors
from .project import read_project, read_truth, write_observation_table, write_observations, write_project, write_tables
from .rows import RowReader, RowWriter
from .runs import OBSERVATIONS, latest_run, load_residuals, load_trace, new_run, save_arrays, save_trace, trace_name
from .surface import find_geoid, read_surface
from .telemetry import read_flight_log, read_mrk, read_positions

__all__ = [
    "OBSERVATIONS",
    "ArrayFolder",
    "Ask",
    "Coding",
    "ControlList",
    "Exif",
    "Part",
    "PhotoStore",
    "RowReader",
    "RowWriter",
    "Thumbnail",
    "TileFolder",
    "WrittenCorners",
    "areas_of",
    "assemble",
    "check_photos",
    "crs",
    "demo_assets",
    "demo_copy",
    "encode_tile",
    "find_geoid",
    "full_disk",
    "jsonable",
    "latest_run",
    "load_residuals",
    "load_trace",
    "new_run",
    "no_space",
    "photo_path",
    "photo_size",
    "photo_state",
    "photo_time",
    "photo_window",
    "read_bal",
    "read_control",
    "read_corners",
    "read_exif",
    "read_flight_log",
    "read_heights",
    "read_motion",
    "read_mrk",
    "read_onboard",
    "read_photo",
    "read_positions",
    "read_project",
    "read_surface",
    "read_truth",
    "save_arrays",
    "save_trace",
    "surface_path",
    "thumbnail",
    "to_picture",
    "to_preview",
    "trace_name",
    "write_areas",
    "write_cog",
    "write_corners",
    "write_heights",
    "write_image",
    "write_json",
    "write_observation_table",
    "write_observations",
    "write_priors",
    "write_project",
    "write_tables",
    "write_world_file",
]
