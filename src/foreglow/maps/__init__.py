"""Maps of roads, the road ahead on them, and the poses of a vehicle on them.

road_map = read_road_map("town.geojson")
poses = read_poses("drive.csv", road_map.origin)
pose = poses.pose(frame.timestamp_ns)
road = road_map.ahead(pose)          # a RoadAhead, or None
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from foreglow.files import checked_path
from foreglow.maps.centre_line import CentreLine
from foreglow.maps.geographic import GeographicOrigin
from foreglow.maps.geojson import read_geojson
from foreglow.maps.lanelet2 import read_lanelet2
from foreglow.maps.opendrive import read_opendrive
from foreglow.maps.poses import PoseTrack, read_poses
from foreglow.maps.road_map import RoadMap

__all__ = ["CentreLine", "GeographicOrigin", "PoseTrack", "RoadMap", "read_poses", "read_road_map"]

READERS: dict[str, Callable[[Path], RoadMap]] = {
    ".geojson": read_geojson,
    ".json": read_geojson,
    ".osm": read_lanelet2,
    ".xodr": read_opendrive,
}
"""Readers by the ending of the file."""


def read_road_map(path: Path | str) -> RoadMap:
    """The roads in the file `path`: GeoJSON, OpenDRIVE (.xodr) or Lanelet2 (.osm).

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If its ending is unknown, it is broken, or it has no road; the message names path and element.
    """
    path = checked_path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a map that ends in {', '.join(READERS)}, got {path.suffix!r}")
    return reader(path)
