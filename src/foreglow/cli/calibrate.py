"""`calibrate`: checks calibration files, converts those of other programs, and makes one from a drive."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_calibration import calibrate_frames, calibration_lines, write_calibration
from foreglow.cli.shared_run import source_notes
from foreglow.command_line import argument, flag, option, output_file, with_options
from foreglow.options import LensOptions, SourceArgument, SourceOptions, size_from
from foreglow.outputs import check_kinds, check_unnamed_outputs
from foreglow.own_files import CALIBRATION, CHECK_PICTURE, with_digest

if TYPE_CHECKING:
    from foreglow.types import Image

calibrate = typer.Typer(
    no_args_is_help=True, help="Check a calibration file on an image, convert one, or make one from a drive."
)
app.add_typer(calibrate, name="calibrate")


@calibrate.command()
@with_options
def check(
    camera: Annotated[Path, argument("CAMERA", "Calibration (TOML).")],
    image: Annotated[Path, argument("IMAGE", "An image that the camera took, or a drive, for its first frame.")],
    out: Annotated[Path, output_file("PNG file to write.", CHECK_PICTURE)],
) -> None:
    """Draw horizon, vanishing point and a metre grid of the flat road on IMAGE, and print the calibration in words."""
    from foreglow.calibration import read_calibration
    from foreglow.display.calibration_check import check_lines, write_check

    calibrated, pixels, lines = read_calibration(camera), _first_image(image), []
    own_px, (height_px, width_px) = (calibrated.width_px, calibrated.height_px), pixels.shape
    if own_px != (width_px, height_px) and calibrated.has_shape_of(width_px, height_px):
        calibrated = calibrated.scaled(width_px, height_px)
        lines.append(f"scaled         from {own_px[0]}x{own_px[1]} px, as it is for frames of this size")
    write_check(out, calibrated, pixels, str(image))
    typer.echo("\n".join([*check_lines(calibrated), *lines, f"picture        {out}"]))


def _first_image(path: Path) -> Image:
    """The image in a file, whatever its name, or the first frame of a drive that can be read."""
    from foreglow.datasets import open_source, read_image
    from foreglow.datasets.formats import format_of

    kind = format_of(path) if path.exists() else "images"
    if kind == "images" and not path.is_dir():
        return read_image(path)
    if kind == "video":
        with contextlib.suppress(ValueError):
            return read_image(path)
    first = next(iter(open_source(path, on_error="skip")), None)
    if first is None:
        raise ValueError(f"{path}: expected an image or a drive, it has no frame that can be read")
    return first.image


@calibrate.command()
@with_options
def auto(
    source: SourceArgument,
    out: Annotated[Path, output_file("TOML file to write.", CALIBRATION)],
    lens: LensOptions,
    reading: SourceOptions,
    picture: Annotated[
        Path | None, output_file("PNG file to write (default: beside the TOML file).", CHECK_PICTURE)
    ] = None,
) -> None:
    """Calibrate a camera from a drive: where lanes and lights vanish, with standard deviations, and what stands still.

    The picture shows horizon, vanishing point, a metre grid of the road, and the mask.
    """
    if picture is None:
        picture = out.with_suffix(".png")
        check_unnamed_outputs({"--picture": picture}, {})
        check_kinds({"--picture": picture}, {"--picture": CHECK_PICTURE})
    frames = reading.open(source)
    found = calibrate_frames(frames, str(source), reading.limit, lens)
    write_calibration(found, out, picture)
    typer.echo(
        "\n".join(
            [*source_notes(frames), *calibration_lines(found), f"picture        {picture}", f"calibration    {out}"]
        )
    )


@calibrate.command()
@with_options
def convert(
    source: Annotated[Path, argument("FILE", "Calibration in the format of KITTI (.txt) or ROS (.yaml), or TOML.")],
    out: Annotated[Path, output_file("TOML file to write.", CALIBRATION)],
    mount_forward: Annotated[
        float, option("M", "Position of the camera: metres in front of the rear axle.", min=-30.0, max=30.0)
    ],
    mount_height: Annotated[float, option("M", "Position of the camera: metres above the road.", min=0.1, max=10.0)],
    mount_left: Annotated[
        float, option("M", "Position of the camera: metres left of the car's centre line.", min=-10.0, max=10.0)
    ] = 0.0,
    pitch_deg: Annotated[float, option("DEG", "Angle by which the camera points upwards.", min=-45.0, max=45.0)] = 0.0,
    yaw_deg: Annotated[
        float, option("DEG", "Angle by which the camera points to the left.", min=-45.0, max=45.0)
    ] = 0.0,
    roll_deg: Annotated[
        float, option("DEG", "Angle by which the camera is rolled to the right.", min=-45.0, max=45.0)
    ] = 0.0,
    camera: Annotated[int, option("N", "Number of the camera in a KITTI file.", min=0, max=99)] = 0,
    rectified: Annotated[bool, flag("--rectified", "The images are rectified.")] = False,
    size: Annotated[str | None, option("WxH", "Size of the images, if FILE does not say it.")] = None,
) -> None:
    """Convert the calibration of another program to TOML, with the position of the camera in the car."""
    from foreglow.calibration import ImageChoice, Mount, calibration_to_toml, read_intrinsics
    from foreglow.config import read_toml, validated
    from foreglow.display.calibration_check import warnings_of
    from foreglow.whole_files import write_atomic

    position_m = (mount_forward, mount_left, mount_height)
    angles = {"yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
    mount = validated(Mount, {"position_m": position_m, **angles}, "mount")
    size_px = None if size is None else size_from(size)
    choice = validated(ImageChoice, {"camera": camera, "is_rectified": rectified, "size_px": size_px}, "images")
    calibrated = read_intrinsics(source, choice).camera(mount)
    write_atomic(out, with_digest(calibration_to_toml(calibrated)).encode())
    if source.suffix.lower() == ".toml" and "mount" in read_toml(source):
        typer.echo(
            f"warning: the mount in {source} was left out, with its standard deviations, for that of the options"
        )
    for warning in warnings_of(calibrated):
        typer.echo(f"warning: {warning}")
    typer.echo(f"calibration in {out}; look at it with: foreglow calibrate check {out} IMAGE --out FILE.png")
