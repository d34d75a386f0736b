"""What a drive with headlamps was like: the light at other drivers' eyes and on the road, and what each policy shone.

Light is linear in the levels of the LEDs. For each frame it is enough to know what the low beam gives, and what each
LED gives at level 1, everything in between accounted for; the light of any levels follows:

    E = E_low + sum over the LEDs of level * E_LED        lux, level from 0 to 1

A drive is stored as one .npz file: arrays by name, and all else as JSON in an array of bytes called `about`.
"""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from foreglow.datasets.images import NPY_ERRORS, npy_words
from foreglow.datasets.json_files import Record, parse_json
from foreglow.geometry import Floats
from foreglow.whole_files import open_atomic

AREAS = ("own lane", "verge")
"""What the light on the road is measured on, 40 to 120 m ahead: the order of the areas in `RoadLight`."""

MAX_DRIVE_BYTES = 1 << 30
"""Largest drive, unpacked: as many frames as a data set's drive may have, with a hundred eyes and 40 runs."""

FORMAT = 1
"""Of the files of drives; a higher number means that earlier files can no longer be read."""

_EYE_ARRAYS = ("ranges_m", "azimuths_rad", "is_in_sight", "base_lx", "leds_lx")
_ROAD_ARRAYS = ("base_lx", "leds_lx")
_RUN_ARRAYS = ("levels", "gaps_rad", "num_gaps")


@dataclass(frozen=True, slots=True, eq=False)
class DriverEye:
    """Another driver's eye over T frames: where it is, and what light of ours reaches it.

    Attributes:
        kind: What it is, such as `car`.
        is_oncoming: Whether it comes towards us; else we follow it, and the eye is what its mirrors show.
        ranges_m: Shape (T,), from our vehicle's origin to the eye; NaN where the vehicle is absent, behind or far away.
        azimuths_rad: Shape (T,), of the vehicle in our vehicle's frame, positive to the left; NaN as the range.
        is_in_sight: Shape (T,), whether the eye sees at least one of our lamps, however far away it is.
        base_lx: Shape (T,), illuminance by both low beams; 0 where they are hidden.
        leds_lx: Shape (T, 2, L), float32, by each LED at level 1, left and right lamp; 0 where it is hidden.

    Raises:
        ValueError: If shapes differ, a range is not positive, or light is negative or not finite.
    """

    vehicle_id: int
    kind: str
    is_oncoming: bool
    ranges_m: Floats
    azimuths_rad: Floats
    is_in_sight: NDArray[np.bool_]
    base_lx: Floats
    leds_lx: NDArray[np.float32]

    def __post_init__(self) -> None:
        num_frames = len(np.atleast_1d(self.ranges_m))
        for name in ("ranges_m", "azimuths_rad"):
            _keep(self, name, np.float64, (num_frames,))
        _keep(self, "is_in_sight", np.bool_, (num_frames,))
        _keep(self, "base_lx", np.float64, (num_frames,))
        _keep(self, "leds_lx", np.float32, (num_frames, 2, None))
        if (self.ranges_m <= 0).any() or np.isinf(self.ranges_m).any():
            raise ValueError("DriverEye.ranges_m: expected positive ranges, NaN where there is none")
        if np.isnan(self.azimuths_rad[~np.isnan(self.ranges_m)]).any():
            raise ValueError("DriverEye.azimuths_rad: expected an angle wherever there is a range")
        _check_light(self, "base_lx", "leds_lx")

    def illuminance_lx(self, levels: ArrayLike) -> Floats:
        """Shape (T,): the light at the eye when the lamps shine `levels`, shape (T, 2, L) or what broadcasts to it."""
        return _shone_lx(self.base_lx, self.leds_lx, levels)


@dataclass(frozen=True, slots=True, eq=False)
class RoadLight:
    """Mean illuminance of the road 40 to 120 m ahead, on a plane that faces the lamps.

    Attributes:
        base_lx: Shape (T, 2), by both low beams, by the areas of `AREAS`.
        leds_lx: Shape (T, 2, 2, L), float32, on each area by each LED at level 1: frame, area, lamp, LED.

    Raises:
        ValueError: If shapes differ, or light is negative or not finite.
    """

    base_lx: Floats
    leds_lx: NDArray[np.float32]

    def __post_init__(self) -> None:
        num_frames = len(np.atleast_1d(self.base_lx))
        _keep(self, "base_lx", np.float64, (num_frames, len(AREAS)))
        _keep(self, "leds_lx", np.float32, (num_frames, len(AREAS), 2, None))
        _check_light(self, "base_lx", "leds_lx")

    def illuminance_lx(self, levels: ArrayLike) -> Floats:
        """Shape (T, 2): the light on each area when the lamps shine `levels`, shape (T, 2, L)."""
        levels = np.asarray(levels)
        return _shone_lx(self.base_lx, self.leds_lx, levels[:, np.newaxis] if levels.ndim == 3 else levels)


@dataclass(frozen=True, slots=True, eq=False)
class PolicyRun:
    """What one policy made the lamps shine over T frames.

    Attributes:
        levels: Shape (T, 2, L), float32 in [0, 1], as the lamps shone at each frame, their latency included.
        gaps_rad: Shape (T, G, 2), right and left border of each dark gap, azimuth to the left in the vehicle's frame;
            rows from `num_gaps` on are NaN.
        num_gaps: Shape (T,), gaps of each frame.

    Raises:
        ValueError: If shapes differ, a level is outside [0, 1], or gaps are not as `num_gaps` says.
    """

    name: str
    levels: NDArray[np.float32]
    gaps_rad: Floats
    num_gaps: NDArray[np.int64]

    def __post_init__(self) -> None:
        num_frames = len(np.atleast_1d(self.levels))
        _keep(self, "levels", np.float32, (num_frames, 2, None))
        _keep(self, "gaps_rad", np.float64, (num_frames, None, 2))
        _keep(self, "num_gaps", np.int64, (num_frames,))
        if not ((self.levels >= 0) & (self.levels <= 1)).all():
            raise ValueError("PolicyRun.levels: expected values in [0, 1], got NaN or a value outside")
        is_gap = np.arange(self.gaps_rad.shape[1]) < self.num_gaps[:, np.newaxis]
        if (self.num_gaps < 0).any() or (self.num_gaps > self.gaps_rad.shape[1]).any():
            raise ValueError(f"PolicyRun.num_gaps: expected 0 to {self.gaps_rad.shape[1]}, the size of gaps_rad")
        if (np.isnan(self.gaps_rad) != ~is_gap[:, :, np.newaxis]).any():
            raise ValueError("PolicyRun.gaps_rad: expected borders for the first num_gaps gaps and NaN for the others")
        if not (self.gaps_rad[is_gap][:, 0] < self.gaps_rad[is_gap][:, 1]).all():
            raise ValueError("PolicyRun.gaps_rad: expected the right border to be right of the left one")

    @classmethod
    def of(cls, name: str, levels: ArrayLike, gaps_rad: Sequence[ArrayLike] | None = None) -> PolicyRun:
        """From the levels, and each frame's gaps of shape (G, 2) such as `BeamCommand.gaps_rad`; None is no gaps."""
        levels = np.asarray(levels)
        if gaps_rad is None:
            gaps_rad = [()] * len(levels)
        gaps = [np.asarray(of_frame, np.float64).reshape(-1, 2) for of_frame in gaps_rad]
        num_gaps = np.array([len(of_frame) for of_frame in gaps], np.int64)
        padded = np.full((len(gaps), num_gaps.max(initial=0), 2), math.nan)
        for row, of_frame in zip(padded, gaps, strict=True):
            row[: len(of_frame)] = of_frame
        return cls(name, levels, padded, num_gaps)


@dataclass(frozen=True, slots=True, eq=False)
class GlareDrive:
    """One drive through one scene, with what every policy shone on the way.

    Attributes:
        scenario: What was drawn, such as `crest`.
        rate_hz: Frames a second.
        times_s: Shape (T,), growing, from the first frame on.
        speeds_mps: Shape (T,), of our vehicle; NaN where unknown.
        eyes: One for each other driver; their ids differ.
        runs: What was shone, by the policy's name.
        light_s: By vehicle id, when its first light is labelled, be it a reflection; without entry, never.
        gone_s: By vehicle id, when it was last in range, of those that had passed before the first frame: no eyes.
        is_lit: Shape (T,), whether lamps on posts light the road; an empty array becomes False throughout.
        pictures: Pictures or videos of the drive, by caption: paths relative to the folder of the report.

    Raises:
        ValueError: If frames or LEDs differ in number, times do not grow or are not finite, or an id is there twice.
    """

    name: str
    scenario: str
    rate_hz: float
    times_s: Floats
    speeds_mps: Floats
    eyes: tuple[DriverEye, ...]
    road: RoadLight
    runs: Mapping[str, PolicyRun]
    light_s: Mapping[int, float] = field(default_factory=dict)
    gone_s: Mapping[int, float] = field(default_factory=dict)
    is_lit: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    pictures: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        num_frames = len(np.atleast_1d(self.times_s))
        if not len(self.is_lit):
            object.__setattr__(self, "is_lit", np.zeros(num_frames, np.bool_))
        _keep(self, "is_lit", np.bool_, (num_frames,))
        for name in ("times_s", "speeds_mps"):
            _keep(self, name, np.float64, (num_frames,))
        if not num_frames or not (np.diff(self.times_s) > 0).all() or not np.isfinite(self.times_s).all():
            raise ValueError("GlareDrive.times_s: expected at least one frame, and times that grow")
        if not (self.rate_hz > 0 and math.isfinite(self.rate_hz)):
            raise ValueError(f"GlareDrive.rate_hz: expected a positive number, got {self.rate_hz}")
        shape = (num_frames, 2, self.num_leds)
        parts = [("road", self.road.leds_lx[:, 0].shape)]
        parts += [(f"eyes: vehicle {eye.vehicle_id}", eye.leds_lx.shape) for eye in self.eyes]
        parts += [(f"runs: {name}", run.levels.shape) for name, run in self.runs.items()]
        for what, found in parts:
            if found != shape:
                raise ValueError(f"GlareDrive.{what}: expected frames, lamps and LEDs {shape}, got {found}")
        for name in ("light_s", "gone_s"):
            if not np.isfinite(list(getattr(self, name).values())).all():
                raise ValueError(f"GlareDrive.{name}: expected finite times, no entry for a vehicle that has none")
        ids = [*(eye.vehicle_id for eye in self.eyes), *self.gone_s]
        if len(set(ids)) < len(ids):
            raise ValueError(f"GlareDrive.eyes: expected each vehicle once, got {ids}")
        for name, run in self.runs.items():
            if run.name != name:
                raise ValueError(f"GlareDrive.runs: expected {name!r} to be called that, its name is {run.name!r}")
        for name in ("runs", "light_s", "gone_s", "pictures"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        object.__setattr__(self, "eyes", tuple(self.eyes))

    @property
    def num_leds(self) -> int:
        """LEDs of each lamp."""
        return int(self.road.leds_lx.shape[-1])

    def eye(self, vehicle_id: int) -> DriverEye:
        """That of a vehicle.

        Raises:
            ValueError: If there is no such vehicle.
        """
        for eye in self.eyes:
            if eye.vehicle_id == vehicle_id:
                return eye
        raise ValueError(f"drive {self.name}: no eye of vehicle {vehicle_id}")


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
    gone_s: dict[str, float] = Field(default_factory=dict)  # without it: from before these were known
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
        "eyes": [{name: getattr(eye, name) for name in _Eye.model_fields} for eye in drive.eyes],
        "runs": list(drive.runs),
        "light_s": {str(vehicle_id): float(time_s) for vehicle_id, time_s in drive.light_s.items()},
        "gone_s": {str(vehicle_id): float(time_s) for vehicle_id, time_s in drive.gone_s.items()},
        "pictures": dict(drive.pictures),
    }
    text = json.dumps(about, allow_nan=False).encode()
    arrays: dict[str, NDArray[Any]] = {"about": np.frombuffer(text, np.uint8)}
    arrays |= {"times_s": drive.times_s, "speeds_mps": drive.speeds_mps, "is_lit": drive.is_lit}
    arrays |= {f"road.{name}": getattr(drive.road, name) for name in _ROAD_ARRAYS}
    for index, eye in enumerate(drive.eyes):
        arrays |= {f"eyes.{index}.{name}": getattr(eye, name) for name in _EYE_ARRAYS}
    for index, run in enumerate(drive.runs.values()):
        arrays |= {f"runs.{index}.{name}": getattr(run, name) for name in _RUN_ARRAYS}
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
            DriverEye(eye.vehicle_id, eye.kind, eye.is_oncoming, **part(f"eyes.{index}", _EYE_ARRAYS))
            for index, eye in enumerate(about.eyes)
        )
        return GlareDrive(
            name=about.name,
            scenario=about.scenario,
            rate_hz=about.rate_hz,
            times_s=_array(arrays, "times_s", path),
            speeds_mps=_array(arrays, "speeds_mps", path),
            eyes=tuple(eyes),
            road=RoadLight(**part("road", _ROAD_ARRAYS)),
            runs={name: PolicyRun(name, **part(f"runs.{index}", _RUN_ARRAYS)) for index, name in enumerate(about.runs)},
            light_s={_vehicle_id("light_s", key): time_s for key, time_s in about.light_s.items()},
            gone_s={_vehicle_id("gone_s", key): time_s for key, time_s in about.gone_s.items()},
            is_lit=arrays.get("is_lit", np.zeros(0, np.bool_)),  # without it: from before lit roads were known
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
                if sum(part.file_size for part in loaded.zip.infolist()) > MAX_DRIVE_BYTES:
                    raise ValueError(f"at most {MAX_DRIVE_BYTES} bytes unpacked, got more")
                return {name: loaded[name] for name in loaded.files}
    except (zipfile.BadZipFile, zlib.error, RuntimeError, *NPY_ERRORS) as error:  # RuntimeError: an unknown compression
        raise ValueError(f"{path}: expected a whole .npz file of a drive: {npy_words(error)}") from error
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error


def _array(arrays: dict[str, NDArray[Any]], name: str, path: Path) -> NDArray[Any]:
    if name not in arrays:
        raise ValueError(f"{path}: {name}: expected an array, there is none")
    return arrays[name]


def _vehicle_id(field_name: str, key: str) -> int:
    try:
        return int(key)
    except ValueError:
        raise ValueError(f"about.{field_name}: expected vehicle ids, got {key!r}") from None


def _shone_lx(base_lx: Floats, leds_lx: NDArray[np.float32], levels: ArrayLike) -> Floats:
    """Base plus LEDs: the last two axes of `leds_lx` are lamps and LEDs."""
    levels = np.broadcast_to(np.asarray(levels, np.float64), leds_lx.shape)
    return np.asarray(base_lx + np.einsum("...le,...le->...", leds_lx, levels))


def _keep(owner: Any, name: str, dtype: type[np.generic], shape: tuple[int | None, ...]) -> None:
    """Replaces a field by a read-only array of `dtype`, once its shape is right; None is any length."""
    array: NDArray[Any] = np.asarray(getattr(owner, name))
    label = f"{type(owner).__name__}.{name}"
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        words = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{label}: expected shape ({words}), got {array.shape}")
    if array.dtype.kind not in ("b" if dtype is np.bool_ else "fiu"):
        raise ValueError(f"{label}: expected {np.dtype(dtype).name}, got {array.dtype}")
    array = array.astype(dtype)
    array.flags.writeable = False
    object.__setattr__(owner, name, array)


def _check_light(owner: Any, *names: str) -> None:
    for name in names:
        values = getattr(owner, name)
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError(f"{type(owner).__name__}.{name}: expected finite values of at least 0")
