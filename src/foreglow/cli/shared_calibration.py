"""What `calibrate auto` and `run --calibration auto` share: a calibration from the drive, its file and its picture."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from foreglow.outputs import check_kinds
from foreglow.own_files import CALIBRATION, CHECK_PICTURE, with_digest

if TYPE_CHECKING:
    from foreglow.calibration.auto import DriveCalibration
    from foreglow.datasets import FrameSource
    from foreglow.options import LensOptions, SourceOptions, VehicleOptions


def calibrate_source(source: Path, reading: SourceOptions, lens: LensOptions) -> DriveCalibration:
    """The calibration that the frames of `source` show."""
    return calibrate_frames(reading.open(source), str(source), reading.limit, lens)


def calibrate_frames(frames: FrameSource, name: str, limit: int | None, lens: LensOptions) -> DriveCalibration:
    """The calibration that the frames of the source `name` show."""
    from foreglow.calibration.auto import calibrate_drive, lens_of
    from foreglow.datasets import Video

    if isinstance(frames, Video) and frames.pixel_aspect != 1:  # one focal length would not do
        raise ValueError(f"{name}: expected square pixels, {frames.words_on_pixels}")
    first = next(iter(frames), None)
    if first is None:
        raise ValueError(f"{name}: expected a drive, it has no frame")
    known = [num for num in (limit, frames.num_frames) if num is not None]
    return calibrate_drive(
        itertools.islice(frames, limit),
        lens_of(first, name, lens.focal, lens.fov),
        name=name,
        rate_hz=frames.rate_hz,
        num_frames=min(known, default=None),
        height_m=lens.mount_height,
    )


def write_calibration(found: DriveCalibration, path: Path, picture: Path) -> None:
    """Writes the calibration as TOML, and a picture of horizon, vanishing point, grid and mask."""
    from foreglow.calibration import calibration_to_toml
    from foreglow.display.calibration_check import write_check
    from foreglow.whole_files import together, write_atomic

    with together():
        write_check(picture, found.camera, found.frame.image, found.frame.path, found.mask)
        toml = f"# position_m: {_assumed(found)}\n{calibration_to_toml(found.camera)}"
        write_atomic(path, with_digest(toml).encode())


def _assumed(found: DriveCalibration) -> str:
    """What no drive shows of the camera's position, in words."""
    forward_m, left_m, _ = found.camera.vehicle_from_camera.position_m.tolist()
    return (
        f"{forward_m:g} m in front of the rear axle, {left_m:g} m left of the middle: assumed, measure and correct them"
    )


def calibration_lines(found: DriveCalibration) -> list[str]:
    """What was found, a line each."""
    from foreglow.display.calibration_check import check_lines

    return [
        *check_lines(found.camera),
        f"position_m     {_assumed(found)}",
        f"seen in        {found.num_lines} of {found.num_views} frames by lines, turn known in {found.num_flows}",
        f"stands still   {found.mask.mean():.1%} of the image",
    ]


def calibrated(
    source: Path, out: Path, reading: SourceOptions, vehicle: VehicleOptions, lens: LensOptions
) -> VehicleOptions:
    """`vehicle` with a calibration that `source` shows; it lies in `out`, with its picture."""
    from foreglow.whole_files import naming

    folder = out / "calibration"
    path = folder / "camera.toml"
    files = {"--out": path, "the picture": path.with_suffix(".png")}
    check_kinds(files, {"--out": CALIBRATION, "the picture": CHECK_PICTURE})
    found = calibrate_source(source, dataclasses.replace(reading, limit=None), lens)
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_calibration(found, path, path.with_suffix(".png"))
    typer.echo("\n".join([*calibration_lines(found), f"calibration    {path}"]))
    return dataclasses.replace(vehicle, calibration=path)
