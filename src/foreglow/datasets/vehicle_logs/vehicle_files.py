"""What the car knew at each frame of a drive, from its files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from foreglow.calibration import read_calibration
from foreglow.datasets.vehicle_data import VehicleData, fitting
from foreglow.datasets.vehicle_logs.can_log import CanLog, read_can_log
from foreglow.geometry import Camera
from foreglow.maps import PoseTrack, RoadMap, read_poses, read_road_map
from foreglow.maps.centre_line import MAX_HEIGHT_OFFSET_M, MIN_ALONG
from foreglow.numbers import checked_number
from foreglow.street import road_from_message
from foreglow.types import EgoMotion, Frame, RoadAhead

MAX_CLOCK_GAP_S = 3600.0
"""A frame that is further than this from all data has another clock, and is not merely before or after them."""

POSE_ERROR_M = 5.0
"""Largest error of ordinary satellite positioning in the open."""

MAX_STANDING_M = 1.0
"""Largest median height of the poses above or below the road under them: a camera is little more above it, so that
ranges by a road that lies deeper would be far too long."""

NUM_TRIED_POSES = 100
"""So many poses along the drive are tried on the map when it is opened."""


class VehicleFiles(VehicleData):
    """What files say, looked up by the time and the size of a frame."""

    def __init__(
        self,
        *,
        camera: Camera | None = None,
        log: CanLog | None = None,
        road_map: RoadMap | None = None,
        poses: PoseTrack | None = None,
        time_offset_s: float = 0.0,
        pose_error_m: float = POSE_ERROR_M,
        names: Sequence[str] = ("calibration", "CAN log", "poses"),
        is_live: bool = False,
    ) -> None:
        """Takes the contents of the files; `open_vehicle_data` describes the arguments.

        Args:
            camera: The calibration.
            log: The CAN log.
            road_map: The map; needs `poses`.
            poses: Poses on it.
            time_offset_s: Is added to the times of log and poses to get the frames' times.
            pose_error_m: Largest error of a pose along the road.
            names: The paths of calibration, log and poses, for messages.
            is_live: Whether the log grows by the frames' own clock, however long its bus is silent.
        """
        self._camera, self._log, self._road_map, self._poses = camera, log, road_map, poses
        self._offset_ns = round(time_offset_s * 1e9)
        self._pose_error_m = pose_error_m
        self._names = names
        self._is_live = is_live
        self._scaled: dict[tuple[int, int], Camera | None] = {}  # one for all frames: estimators keep results by camera

    @property
    def of_one_drive(self) -> Sequence[str]:
        """The log and the poses, unless the log is of the frames' own drive."""
        if self._is_live:
            return ()
        log = [] if self._log is None else [f"--can-log {self._names[1]}"]
        return log if self._poses is None else [*log, f"--poses {self._names[2]}"]

    @property
    def tells_motion(self) -> bool:
        """Whether there is a log of the speed: a bus that has fallen silent says that the speed is unknown."""
        return self._log is not None and self._log.tells_speed

    def camera(self, frame: Frame) -> Camera | None:
        """The calibration, scaled to the frame's size; None if there is no calibration.

        Raises:
            ValueError: If the frame's sides have another ratio than the calibration's.
        """
        size_px = frame.width_px, frame.height_px
        if size_px not in self._scaled:
            camera = self._camera
            self._scaled[size_px] = None if camera is None else fitting(camera, *size_px, self._names[0])
        return self._scaled[size_px]

    def motion(self, frame: Frame) -> EgoMotion | None:
        """The latest motion in the log; None where there is none.

        Raises:
            ValueError: If the log has another clock.
        """
        if self._log is None or self._log.is_empty:
            return None
        return self._log.motion(self._log_time_ns(frame, self._log))

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road ahead by map and pose, or else by the latest street message in the log; None where there is none.

        Raises:
            ValueError: If poses or log have another clock.
        """
        return self._road_by_map(frame) or self._road_by_message(frame)

    def is_reported(self, frame: Frame) -> bool | None:
        """Whether the production system reports a vehicle: by the poses, or the log's latest message; None if unknown.

        Raises:
            ValueError: If poses or log have another clock.
        """
        if self._poses is not None and self._poses.reports is not None:
            first_ns, last_ns = int(self._poses.times_ns[0]), int(self._poses.times_ns[-1])
            return self._poses.is_reported(self._time_ns(frame, first_ns, last_ns, self._names[2]))
        if self._log is None or self._log.is_empty:
            return None
        return self._log.is_reported(self._log_time_ns(frame, self._log))

    def _road_by_map(self, frame: Frame) -> RoadAhead | None:
        if self._poses is None or self._road_map is None:
            return None
        first_ns, last_ns = int(self._poses.times_ns[0]), int(self._poses.times_ns[-1])
        pose = self._poses.pose(self._time_ns(frame, first_ns, last_ns, self._names[2]))
        if pose is None:
            return None
        is_on_road = not self._poses.has_attitude
        return self._road_map.ahead(pose, error_bound_m=self._pose_error_m, is_on_road=is_on_road)

    def _road_by_message(self, frame: Frame) -> RoadAhead | None:
        if self._log is None or self._log.is_empty:
            return None
        found = self._log.street_with_age(self._log_time_ns(frame, self._log))
        if found is None:
            return None
        message, age_s = found
        motion = self.motion(frame) or (None if self.tells_motion else frame.motion)
        return road_from_message(message, 0.0 if motion is None else max(motion.speed_mps, 0.0) * age_s)

    def _log_time_ns(self, frame: Frame, log: CanLog) -> int:
        return self._time_ns(frame, log.first_ns, log.last_ns, self._names[1])

    def _time_ns(self, frame: Frame, first_ns: int, last_ns: int, name: str) -> int:
        time_ns = frame.timestamp_ns - self._offset_ns
        if not self._is_live and max(first_ns - time_ns, time_ns - last_ns) > MAX_CLOCK_GAP_S * 1e9:
            raise ValueError(
                f"{name}: time: expected data of the frames' time, got data from {first_ns / 1e9:.3f} to "
                f"{last_ns / 1e9:.3f} s and a frame at {time_ns / 1e9:.3f} s; give the time offset between the clocks"
            )
        return time_ns


def open_vehicle_data(
    calibration: Path | str | None = None,
    can_log: Path | str | None = None,
    dbc: Path | str | None = None,
    mapping: Path | str | None = None,
    road_map: Path | str | None = None,
    poses: Path | str | None = None,
    *,
    time_offset_s: float = 0.0,
    pose_error_m: float = POSE_ERROR_M,
) -> VehicleFiles:
    """What the car knew at each frame of a drive, from files; at least one is needed.

    Args:
        calibration: Of the camera, with its mount: TOML.
        can_log: CAN log with street messages, motion, or both: .asc, .blf or .log.
        dbc: Description of its frames; None for our own.
        mapping: Meaning of its signals; goes with `dbc`.
        road_map: GeoJSON, OpenDRIVE (.xodr) or Lanelet2 (.osm); goes with `poses`. Where it has no road, the log may.
        poses: Positions of the vehicle over time: CSV, or TUM's format.
        time_offset_s: Is added to the times of log and poses to get the frames' times.
        pose_error_m: Largest error of a pose along the road; infinite where unknown: then `road_surface` does not use
            the road.

    Raises:
        FileNotFoundError: If one of the files is missing.
        ModuleNotFoundError: If a CAN log is given, and the extra `can` is not installed.
        ValueError: If a file is broken, a file is missing that goes with another, no pose is on a road of the map, or
            they are not at its height.
    """
    if all(path is None for path in (calibration, can_log, dbc, mapping, road_map, poses)):
        raise ValueError("vehicle data: expected a calibration, a CAN log, or a map with poses, got none of them")
    if can_log is None and (dbc or mapping) is not None:
        raise ValueError(f"{dbc or mapping}: expected a CAN log with it, got none")
    if (road_map is None) != (poses is None):
        other = "poses on it" if poses is None else "a map with them"
        raise ValueError(f"{road_map or poses}: expected {other}, got none")
    time_offset_s = checked_number("time offset", time_offset_s)
    pose_error_m = checked_number("pose error", pose_error_m)
    if not math.isfinite(time_offset_s):
        raise ValueError(f"time offset: expected a finite number of seconds, got {time_offset_s}")
    if not pose_error_m >= 0:
        raise ValueError(f"pose error: expected a number of metres of at least 0, got {pose_error_m}")
    roads = None if road_map is None else read_road_map(road_map)
    track = None if poses is None or roads is None else read_poses(poses, roads.origin)
    if track is not None and roads is not None:
        _check_on_road(track, roads, f"{poses}", f"{road_map}")
    return VehicleFiles(
        camera=None if calibration is None else read_calibration(calibration),
        log=None if can_log is None else read_can_log(can_log, dbc, mapping),
        road_map=roads,
        poses=track,
        time_offset_s=time_offset_s,
        pose_error_m=pose_error_m,
        names=(f"{calibration}", f"{can_log}", f"{poses}"),
    )


def _check_on_road(track: PoseTrack, roads: RoadMap, name: str, map_name: str) -> None:
    """ValueError if no pose has a road ahead, or they are not at its height."""
    times_ns = track.times_ns[:: max(1, len(track.times_ns) // NUM_TRIED_POSES)].tolist()
    found = [pose for time_ns in times_ns if (pose := track.pose(time_ns)) is not None]
    is_on_road = not track.has_attitude
    ahead = [road for pose in found if (road := roads.ahead(pose, is_on_road=is_on_road)) is not None]
    above_m = -float(np.median([road.points_m[0, 2] for road in ahead])) if ahead else 0.0
    if abs(above_m) > MAX_STANDING_M:
        side = "above" if above_m > 0 else "below"
        raise ValueError(
            f"{name}: expected the heights of points on the road, under the rear axle, got poses {abs(above_m):.1f} m "
            f"{side} the roads of {map_name} in the median: are they those of an antenna, or of another kind?"
        )
    if not ahead:
        hindrances = {roads.hindrance(pose, is_on_road=is_on_road) for pose in found}
        expected = f"{name}: expected poses along the roads of {map_name}"
        if "heading" in hindrances:
            limit_deg = f"{math.degrees(math.acos(MIN_ALONG)):.0f} degrees"
            raise ValueError(f"{expected}; none is, those near a road head across it, by more than {limit_deg}")
        if "height" in hindrances:
            words = f"those near a road are more than {MAX_HEIGHT_OFFSET_M:g} m above or below it"
            raise ValueError(f"{expected}, with heights of one kind; none is, {words}")
        nearest_m = min(roads.distance_m(pose.position_m) for pose in found)
        raise ValueError(
            f"{expected}, with heights of one kind; none is, the nearest is {nearest_m:.0f} m from a point of the map"
        )
