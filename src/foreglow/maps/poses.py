"""Poses of the vehicle over time, read from files and interpolated in between.

CSV with a header line and a row for each pose, times rising; either in the map's metres

    timestamp_s,x_m,y_m,z_m,qx,qy,qz,qw          (or timestamp_ns)

or on the earth, with optional columns in brackets

    timestamp_s,lat_deg,lon_deg,heading_deg[,height_m[,pitch_deg,roll_deg]]

heading clockwise from north, pitch upwards, roll to the right. Any other ending is TUM's format: `t x y z qx qy qz qw`
in seconds and metres, separated by blanks; `#` begins a comment. All are poses of the vehicle's frame: x forward,
y left, z up, origin on the road under the middle of the rear axle. Positions of an antenna must be converted first.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from foreglow.files import bounded_lines, read_text
from foreglow.geometry import Floats, Pose, rotation
from foreglow.maps.geographic import GeographicOrigin, check_position

MAX_GAP_S = 1.0
"""There is no interpolation between poses that are further apart in time."""

MAX_POSES = 500_000
"""Poses of a file, which take a kilobyte each while they are read: more than an hour at 100 Hz."""

MAX_LINE_CHARS = 1000
"""Longest line of a file of poses."""

TUM_COLUMNS = ("timestamp_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
METRIC_COLUMNS = TUM_COLUMNS[1:]
EARTH_COLUMNS = ("lat_deg", "lon_deg", "heading_deg")
EARTH_OPTIONS = ("height_m", "pitch_deg", "roll_deg")
TIMES = {"timestamp_ns": 1, "timestamp_s": 1_000_000_000}


class PoseTrack:
    """Poses over time.

    Attributes:
        times_ns: Shape (N,), int64, rising.
        has_attitude: Whether height, pitch and roll are known; otherwise they are 0, and should be taken from the road
            of a map.
    """

    def __init__(self, times_ns: np.ndarray, poses: list[Pose], *, has_attitude: bool) -> None:
        """Takes the poses.

        Raises:
            ValueError: If there are fewer than two, or times do not rise.
        """
        if len(poses) < 2 or len(poses) != len(times_ns):
            raise ValueError(f"expected at least two poses, got {len(poses)}")
        if not (np.diff(times_ns) > 0).all():
            raise ValueError(f"expected times that rise, pose {int(np.argmin(np.diff(times_ns) > 0)) + 2} does not")
        self.times_ns = np.asarray(times_ns, np.int64)
        self.has_attitude = has_attitude
        self.positions_m: Floats = np.array([pose.position_m for pose in poses])
        seconds = (self.times_ns - self.times_ns[0]) / 1e9
        self._turn = Slerp(seconds, Rotation.from_matrix([pose.rotation for pose in poses]))

    def pose(self, timestamp_ns: int) -> Pose | None:
        """The pose at a time, between its neighbours; None outside, and in gaps of more than `MAX_GAP_S`."""
        after = int(np.searchsorted(self.times_ns, timestamp_ns))
        if after == len(self.times_ns) or (after == 0 and self.times_ns[0] != timestamp_ns):
            return None
        before = max(after - 1, 0)
        if self.times_ns[after] - self.times_ns[before] > MAX_GAP_S * 1e9 and self.times_ns[after] != timestamp_ns:
            return None
        seconds = (timestamp_ns - int(self.times_ns[0])) / 1e9
        share = (timestamp_ns - int(self.times_ns[before])) / max(int(self.times_ns[after] - self.times_ns[before]), 1)
        position_m = self.positions_m[before] + share * (self.positions_m[after] - self.positions_m[before])
        return Pose(position_m, self._turn(seconds).as_matrix())


def read_poses(path: Path | str, origin: GeographicOrigin | None = None) -> PoseTrack:
    """The poses in the file `path`, in the frame of a map.

    Args:
        path: The file.
        origin: Position of the map's frame on the earth; None for a map in metres of its own.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing or unknown, a number is broken, times do not rise, there are fewer than two
            poses, or only the poses or only the map are on the earth; the message names path and line.
    """
    path = Path(path)
    columns, rows = _csv(path) if path.suffix.lower() == ".csv" else _tum(path)
    time_columns = [name for name in TIMES if name in columns]
    if len(time_columns) != 1:
        raise ValueError(f"{path}: header: expected one of the columns {', '.join(TIMES)}, got {', '.join(columns)}")
    kind = EARTH_COLUMNS if "lat_deg" in columns else METRIC_COLUMNS
    options = EARTH_OPTIONS if kind == EARTH_COLUMNS else ()
    missing = [name for name in kind if name not in columns]
    unknown = [name for name in columns if name not in (*kind, *options, *time_columns)]
    if missing or unknown or len(set(columns)) < len(columns):
        raise ValueError(
            f"{path}: header: expected the columns {time_columns[0]}, {', '.join(kind)}"
            f"{' and perhaps ' + ', '.join(options) if options else ''}, each once, got {', '.join(columns)}"
        )
    if (kind == EARTH_COLUMNS) != (origin is not None):
        needed = "lat_deg, lon_deg, heading_deg" if origin is not None else "x_m, y_m, z_m, qx, qy, qz, qw"
        raise ValueError(f"{path}: expected poses with {needed}, as the map is, got {', '.join(kind)}")
    times_ns, poses = [], []
    for number, words in rows:
        where = f"{path}: line {number}"
        row = _numbers(columns, words, where)
        times_ns.append(_time_ns(words[columns.index(time_columns[0])], time_columns[0], where))
        poses.append(_metric_pose(row, where) if origin is None else _earth_pose(row, origin, where))
        if len(times_ns) > 1 and times_ns[-1] <= times_ns[-2]:
            raise ValueError(
                f"{where}: {time_columns[0]}: expected times that rise, got a time not after that of the line before"
            )
    if len(poses) < 2:
        raise ValueError(f"{path}: expected at least two poses, got {len(poses)}")
    has_attitude = origin is None or all(name in columns for name in EARTH_OPTIONS)
    return PoseTrack(np.array(times_ns, np.int64), poses, has_attitude=has_attitude)


def _csv(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Names of the columns, and each row with its line number."""
    try:
        lines = list(csv.reader(_lines(path), skipinitialspace=True))
    except csv.Error as error:
        raise ValueError(f"{path}: expected CSV: {error}") from None
    if not lines:
        raise ValueError(f"{path}: expected a header line, the file is empty")
    return [name.strip() for name in lines[0]], [(k, line) for k, line in enumerate(lines[1:], start=2) if line]


def _tum(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    lines = (line.partition("#")[0].split() for line in _lines(path))
    return list(TUM_COLUMNS), [(k, line) for k, line in enumerate(lines, start=1) if line]


def _lines(path: Path) -> Iterator[str]:
    """The lines of a file of poses, which are not too many."""
    for number, line in enumerate(bounded_lines(io.StringIO(read_text(path)), path, MAX_LINE_CHARS)):
        if number > MAX_POSES:
            raise ValueError(f"{path}: expected at most {MAX_POSES} poses, got more")
        yield line


def _numbers(columns: list[str], words: list[str], where: str) -> dict[str, float]:
    """A row's numbers by the names of the columns."""
    if len(words) != len(columns):
        raise ValueError(f"{where}: expected {len(columns)} numbers, got {len(words)}")
    try:
        row = dict(zip(columns, map(float, words), strict=True))
    except ValueError as error:
        raise ValueError(f"{where}: expected numbers: {error}") from None
    for name, value in row.items():
        if not np.isfinite(value):
            raise ValueError(f"{where}: {name}: expected a finite number, got {value}")
    return row


def _time_ns(word: str, column: str, where: str) -> int:
    """A time in nanoseconds, exact also for seconds since 1970, which as a float are exact to hundreds only."""
    try:
        return int(Decimal(word) * TIMES[column])
    except (InvalidOperation, ValueError, OverflowError):
        raise ValueError(f"{where}: {column}: expected a time, got {word!r}") from None


def _metric_pose(row: dict[str, float], where: str) -> Pose:
    quaternion = np.array([row[name] for name in ("qx", "qy", "qz", "qw")])
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 0.01:
        raise ValueError(f"{where}: qx, qy, qz, qw: expected a quaternion of length 1, got {quaternion.tolist()}")
    position_m = np.array([row[name] for name in ("x_m", "y_m", "z_m")])
    return Pose(position_m, Rotation.from_quat(quaternion).as_matrix())


def _earth_pose(row: dict[str, float], origin: GeographicOrigin, where: str) -> Pose:
    latitude_deg, longitude_deg = row["lat_deg"], row["lon_deg"]
    check_position(latitude_deg, longitude_deg, where)
    yaw_rad = origin.yaw_rad(latitude_deg, longitude_deg, row["heading_deg"])
    angles = np.radians([row.get("pitch_deg", 0.0), row.get("roll_deg", 0.0)])
    position_m = [*origin.local(latitude_deg, longitude_deg), row.get("height_m", 0.0)]
    return Pose(np.array(position_m), rotation(yaw_rad, *angles))
