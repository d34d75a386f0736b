"""Poses of the vehicle over time, read from files and interpolated in between.

CSV with a header line and a row for each pose, times rising; either in the map's metres

    timestamp_s,x_m,y_m,z_m,qx,qy,qz,qw          (or timestamp_ns)

or on the earth, with optional columns in brackets

    timestamp_s,lat_deg,lon_deg,heading_deg[,height_m,pitch_deg,roll_deg]

heading clockwise from north, pitch upwards, roll to the right. Any other ending is TUM's format: `t x y z qx qy qz qw`
in seconds and metres, separated by blanks; `#` begins a comment. All are poses of the vehicle's frame: x forward,
y left, z up, origin on the road under the middle of the rear axle. Positions of an antenna must be converted first. A
column `reported` of a CSV file is 1 while the car's production system reports a vehicle, and 0 otherwise.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foreglow.files import bounded_lines, checked_path, number_in, read_text
from foreglow.geometry import Floats, Pose
from foreglow.maps.centre_line import check_points
from foreglow.maps.geographic import GeographicOrigin, check_position
from foreglow.types.arrays import check_optional, checked_time_ns

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

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
MAX_TILT_DEG = 30.0
"""Largest pitch and roll of a car on a road, either way: the steepest streets rise by 35 % (19 degrees), and the body
adds a few. Beyond it, the order of a quaternion or the axes are others, and the road would be turned or mirrored."""

MAX_ANGLES_DEG = {"heading_deg": 36_000.0, "pitch_deg": MAX_TILT_DEG, "roll_deg": MAX_TILT_DEG}
"""Either way; some tools count a heading on over full turns."""

REPORTED = "reported"
"""Column with 1 while the car's production system reports a vehicle, and 0 otherwise."""

TIMES = {"timestamp_ns": 1, "timestamp_s": 1_000_000_000}


class PoseTrack:
    """Poses over time.

    Attributes:
        times_ns: Shape (N,), int64, rising.
        has_attitude: Whether height, pitch and roll are known; otherwise they are 0, and should be taken from the road
            of a map.
        reports: Shape (N,), bool, whether the car's production system reports a vehicle then; None where unknown.
    """

    def __init__(
        self,
        times_ns: NDArray[np.int64],
        positions_m: Floats,
        turns: Rotation,
        *,
        has_attitude: bool,
        reports: NDArray[np.bool_] | None = None,
    ) -> None:
        """Takes the poses: positions of shape (N, 3), and as many rotations.

        Raises:
            ValueError: If there are fewer than two, or times do not rise.
        """
        from scipy.spatial.transform import Slerp

        if len(times_ns) < 2:
            raise ValueError(f"expected at least two poses, got {len(times_ns)}")
        if not (np.diff(times_ns) > 0).all():
            raise ValueError(f"expected times that rise, pose {int(np.argmin(np.diff(times_ns) > 0)) + 2} does not")
        self.times_ns = np.asarray(times_ns, np.int64)
        self.has_attitude = has_attitude
        self.positions_m = positions_m
        self.reports = reports
        self._turn = Slerp((self.times_ns - self.times_ns[0]) / 1e9, turns)

    def is_reported(self, timestamp_ns: int) -> bool | None:
        """Whether the production system reports a vehicle, by the latest pose; None where unknown, outside, in gaps.

        Raises:
            ValueError: If the time is none.
        """
        timestamp_ns = checked_time_ns("timestamp_ns", timestamp_ns)
        latest = int(np.searchsorted(self.times_ns, timestamp_ns, side="right")) - 1
        if self.reports is None or latest < 0 or timestamp_ns - self.times_ns[latest] > MAX_GAP_S * 1e9:
            return None
        return bool(self.reports[latest])

    def pose(self, timestamp_ns: int) -> Pose | None:
        """The pose at a time, between its neighbours; None outside, and in gaps of more than `MAX_GAP_S`.

        Raises:
            ValueError: If the time is none.
        """
        timestamp_ns = checked_time_ns("timestamp_ns", timestamp_ns)
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
        ValueError: If a column is missing or unknown, a number is broken, a pose is tilted by more than `MAX_TILT_DEG`,
            times do not rise, there are fewer than two poses, or only the poses or only the map are on the earth; the
            message names path and line.
    """
    path = checked_path(path)
    check_optional("origin", origin, GeographicOrigin)
    columns, rows = _csv(path) if path.suffix.lower() == ".csv" else _tum(path)
    time_columns = [name for name in TIMES if name in columns]
    if len(time_columns) != 1:
        raise ValueError(f"{path}: header: expected one of the columns {', '.join(TIMES)}, got {', '.join(columns)}")
    kind = EARTH_COLUMNS if "lat_deg" in columns else METRIC_COLUMNS
    options = (*(EARTH_OPTIONS if kind == EARTH_COLUMNS else ()), REPORTED)
    missing = [name for name in kind if name not in columns]
    unknown = [name for name in columns if name not in (*kind, *options, *time_columns)]
    if missing or unknown or len(set(columns)) < len(columns):
        raise ValueError(
            f"{path}: header: expected the columns {time_columns[0]}, {', '.join(kind)}"
            f" and perhaps {', '.join(options)}, each once, got {', '.join(columns)}"
        )
    lacking = [name for name in EARTH_OPTIONS if name not in columns]
    if kind == EARTH_COLUMNS and 0 < len(lacking) < len(EARTH_OPTIONS):  # what is there would change nothing
        raise ValueError(
            f"{path}: header: expected {', '.join(EARTH_OPTIONS)} together, {lacking[0]} is missing; without any of "
            "them the car is taken to stand on the map's road"
        )
    if (kind == EARTH_COLUMNS) != (origin is not None):
        needed = "lat_deg, lon_deg, heading_deg" if origin is not None else "x_m, y_m, z_m, qx, qy, qz, qw"
        raise ValueError(f"{path}: expected poses with {needed}, as the map is, got {', '.join(kind)}")
    if len(rows) < 2:
        raise ValueError(f"{path}: expected at least two poses, got {len(rows)}")
    values = dict(zip(columns, _numbers(path, columns, rows).T, strict=True))
    index = columns.index(time_columns[0])
    times_ns = np.array([_time_ns(words[index], f"{path}: line {line}: {columns[index]}") for line, words in rows])
    lines = [line for line, _ in rows]
    for row in np.flatnonzero(np.diff(times_ns) <= 0)[:1].tolist():
        expected = "expected times that rise, got a time not after that of the line before"
        raise ValueError(f"{path}: line {lines[row + 1]}: {columns[index]}: {expected}")
    positions_m, turned = _metric(path, values, lines) if origin is None else _on_earth(path, values, lines, origin)
    has_attitude = origin is None or all(name in columns for name in EARTH_OPTIONS)
    return PoseTrack(times_ns, positions_m, turned, has_attitude=has_attitude, reports=_reports(path, values, lines))


def _reports(path: Path, values: Mapping[str, Floats], lines: Sequence[int]) -> NDArray[np.bool_] | None:
    reports = values.get(REPORTED)
    if reports is None:
        return None
    for row in np.flatnonzero((reports != 0) & (reports != 1))[:1].tolist():
        raise ValueError(f"{path}: line {lines[row]}: {REPORTED}: expected 0 or 1, got {reports[row]:g}")
    return np.asarray(reports == 1)


def _csv(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
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
    for number, line in enumerate(bounded_lines(io.StringIO(read_text(path)), path, MAX_LINE_CHARS)):
        if number > MAX_POSES:
            raise ValueError(f"{path}: expected at most {MAX_POSES} poses, got more")
        yield line


def _numbers(path: Path, columns: list[str], rows: list[tuple[int, list[str]]]) -> Floats:
    values = np.empty((len(rows), len(columns)))
    for index, (line, words) in enumerate(rows):
        if len(words) != len(columns):
            raise ValueError(f"{path}: line {line}: expected {len(columns)} numbers, got {len(words)}")
        try:
            values[index] = [number_in(word) for word in words]
        except ValueError as error:
            raise ValueError(f"{path}: line {line}: expected numbers: {error}") from None
    for row, column in np.argwhere(~np.isfinite(values))[:1].tolist():
        raise ValueError(
            f"{path}: line {rows[row][0]}: {columns[column]}: expected a finite number, got {values[row, column]}"
        )
    return values


def _time_ns(word: str, origin: str) -> int:
    """A time in nanoseconds, exact also for seconds since 1970, which as a float are exact to hundreds only."""
    try:
        time_ns = Decimal(word if word.isascii() else "") * TIMES[origin.rpartition(" ")[2]]
        if abs(time_ns) < 1 << 63:
            return int(time_ns)
    except InvalidOperation:
        pass
    raise ValueError(f"{origin}: expected a time, got {word!r}")


def _metric(path: Path, values: dict[str, Floats], lines: list[int]) -> tuple[Floats, Rotation]:
    from scipy.spatial.transform import Rotation

    quaternions = np.stack([values[name] for name in ("qx", "qy", "qz", "qw")], -1)
    for row in np.flatnonzero(np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > 0.01)[:1].tolist():
        raise ValueError(
            f"{path}: line {lines[row]}: qx, qy, qz, qw: expected a quaternion of length 1, got "
            f"{quaternions[row].tolist()}"
        )
    positions_m = np.stack([values[name] for name in ("x_m", "y_m", "z_m")], -1)
    check_points(positions_m, str(path))
    turned = Rotation.from_quat(quaternions)
    forward_z, left_z, up_z = turned.as_matrix()[:, 2].T  # as `geometry.rotation_angles_rad`, of all at once
    pitches_deg, rolls_deg = np.degrees([np.arcsin(np.clip(forward_z, -1, 1)), np.arctan2(left_z, up_z)])
    for row in np.flatnonzero(np.maximum(np.abs(pitches_deg), np.abs(rolls_deg)) > MAX_TILT_DEG)[:1].tolist():
        raise ValueError(
            f"{path}: line {lines[row]}: qx, qy, qz, qw: expected a car on a road, pitch and roll of at most "
            f"{MAX_TILT_DEG:g} degrees, got {pitches_deg[row]:.0f} and {rolls_deg[row]:.0f}; is the order qx, qy, "
            "qz, qw, with axes x forward, y left, z up?"
        )
    return positions_m, turned


def _on_earth(
    path: Path, values: dict[str, Floats], lines: list[int], origin: GeographicOrigin
) -> tuple[Floats, Rotation]:
    from scipy.spatial.transform import Rotation

    latitudes, longitudes = values["lat_deg"], values["lon_deg"]
    for row in np.flatnonzero((np.abs(latitudes) > 90) | (np.abs(longitudes) > 180))[:1].tolist():
        check_position(latitudes[row], longitudes[row], f"{path}: line {lines[row]}")
    for name, limit_deg in MAX_ANGLES_DEG.items():
        for row in np.flatnonzero(np.abs(values.get(name, np.zeros(0))) > limit_deg)[:1].tolist():
            expected = f"expected -{limit_deg:g} to {limit_deg:g} degrees"
            if limit_deg == MAX_TILT_DEG:
                expected += ", as a car on a road with x forward, y left, z up"
            raise ValueError(f"{path}: line {lines[row]}: {name}: {expected}, got {values[name][row]:g}")
    level = np.zeros(len(lines))
    heights_m = values.get("height_m", level)
    check_points(np.column_stack([level, level, heights_m]), str(path))
    pitches_rad, rolls_rad = (np.radians(values.get(name, level)) for name in ("pitch_deg", "roll_deg"))
    yaws_rad = origin.yaw_rad(latitudes, longitudes, values["heading_deg"])
    # As `geometry.rotation`, whose pitch is upwards: a negative turn about y.
    turned = Rotation.from_euler("ZYX", np.stack([yaws_rad, -pitches_rad, rolls_rad], -1))
    return np.column_stack([origin.local(latitudes, longitudes), heights_m]), turned
