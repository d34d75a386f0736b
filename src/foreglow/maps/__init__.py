"""Maps of roads, the road ahead on them, and the poses of a vehicle on them.

road_map = read_road_map("town.geojson")
poses = read_poses("drive.csv", road_map.origin)
pose = poses.pose(frame.timestamp_ns)
road = road_map.ahead(pose)          # a RoadAhead, or None
"""

from foreglow.maps.centre_line import CentreLine
from foreglow.maps.geographic import GeographicOrigin
from foreglow.maps.poses import PoseTrack, read_poses
from foreglow.maps.reading import read_road_map
from foreglow.maps.road_map import RoadMap

__all__ = ["CentreLine", "GeographicOrigin", "PoseTrack", "RoadMap", "read_poses", "read_road_map"]
