"""A `GlareDrive` as one .npz file: arrays by name, and all else as JSON in an array of bytes called `about`."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.images import NPY_ERRORS
from foreglow.datasets.json_files import Record, parse_json
from foreglow.files import open_atomic
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight

FORMAT = 1
"""Counts up when files of before can no longer be read."""

_EYE_ARRAYS = ("ranges_m", "azimuths_rad", "is_in_sight", "base_lx", "leds_lx")
_ROAD_ARRAYS = ("base_lx", "leds_lx")
_RUN_ARRAYS = ("levels", "gaps_rad", "num_gaps")


class _Eye(Record):
    vehicle_id: int
    kind: str
    is_oncoming: bool


class _About(Record):
    format: int
    name: str
    scenario: str
    rate_hz: float
    eyes: tuple[_Eye, ...]
    runs: tuple[str, ...]
    light_s: dict[str, float]
    pictures: dict[str, str]


def write_glare_drive(path: Path, drive: GlareDrive) -> None:
    """Writes `drive` to `path`, whole or not at all; `read_glare_drive` reads it back equal.

    Raises:
        OSError: If it cannot be written; `path` is then as it was before.
    """
    about = {
        "format": FORMAT,
        "name": drive.name,
        "scenario": drive.scenario,
        "rate_hz": drive.rate_hz,
        "eyes": [{name: getattr(one, name) for name in _Eye.model_fields} for one in drive.eyes],
        "runs": list(drive.runs),
        "light_s": {str(vehicle_id): float(time_s) for vehicle_id, time_s in drive.light_s.items()},
        "pictures": dict(drive.pictures),
    }
    text = json.dumps(about, allow_nan=False).encode()
    arrays: dict[str, NDArray[Any]] = {"about": np.frombuffer(text, np.uint8)}
    arrays |= {"times_s": drive.times_s, "speeds_mps": drive.speeds_mps}
    arrays |= {f"road.{name}": getattr(drive.road, name) for name in _ROAD_ARRAYS}
    for place, eye in enumerate(drive.eyes):
        arrays |= {f"eyes.{place}.{name}": getattr(eye, name) for name in _EYE_ARRAYS}
    for place, run in enumerate(drive.runs.values()):
        arrays |= {f"runs.{place}.{name}": getattr(run, name) for name in _RUN_ARRAYS}
    with open_atomic(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read_glare_drive(path: Path) -> GlareDrive:
    """The drive in the file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not a whole file of a drive; the message names the path, the field and what was expected.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    arrays = _arrays(path)
    about = parse_json(_array(arrays, "about", path).tobytes(), _About, f"{path}: about")
    if about.format != FORMAT:
        raise ValueError(f"{path}: about.format: expected {FORMAT}, got {about.format}")

    def part(prefix: str, names: tuple[str, ...]) -> dict[str, Any]:
        return {name: _array(arrays, f"{prefix}.{name}", path) for name in names}

    try:
        eyes = (
            DriverEye(one.vehicle_id, one.kind, one.is_oncoming, **part(f"eyes.{place}", _EYE_ARRAYS))
            for place, one in enumerate(about.eyes)
        )
        return GlareDrive(
            name=about.name,
            scenario=about.scenario,
            rate_hz=about.rate_hz,
            times_s=_array(arrays, "times_s", path),
            speeds_mps=_array(arrays, "speeds_mps", path),
            eyes=tuple(eyes),
            road=RoadLight(**part("road", _ROAD_ARRAYS)),
            runs={name: PolicyRun(name, **part(f"runs.{place}", _RUN_ARRAYS)) for place, name in enumerate(about.runs)},
            light_s={_vehicle_id(key): time_s for key, time_s in about.light_s.items()},
            pictures=about.pictures,
        )
    except ValueError as error:
        reason = str(error)
        raise ValueError(reason if reason.startswith(str(path)) else f"{path}: {reason}") from None


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                raise ValueError("it holds one array, not an archive of arrays")
            with loaded:
                return {name: loaded[name] for name in loaded.files}
    except (zipfile.BadZipFile, zlib.error, RuntimeError, *NPY_ERRORS) as error:  # RuntimeError: an unknown compression
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{path}: expected a whole .npz file of a drive: {reason}") from error
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error


def _array(arrays: dict[str, NDArray[Any]], name: str, path: Path) -> NDArray[Any]:
    if name not in arrays:
        raise ValueError(f"{path}: {name}: expected an array, there is none")
    return arrays[name]


def _vehicle_id(key: str) -> int:
    try:
        return int(key)
    except ValueError:
        raise ValueError(f"about.light_s: expected vehicle ids, got {key!r}") from None
