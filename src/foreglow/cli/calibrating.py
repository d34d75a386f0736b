"""`calibrate`: looking at a calibration, and making our own file of another program's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app, argument, file, size_of

calibrate = typer.Typer(no_args_is_help=True, help="Calibration files: look at one on an image, or convert it.")
app.add_typer(calibrate, name="calibrate")


@calibrate.command()
def check(
    camera: Annotated[Path, argument(metavar="CAMERA", help="Calibration, TOML.")],
    image: Annotated[Path, argument(metavar="IMAGE", help="An image that the camera took.")],
    out: Annotated[Path, file(help="Picture to write, PNG.")],
) -> None:
    """Draw horizon, vanishing point and a metre grid of the flat road on IMAGE, and say what the calibration means."""
    from foreglow.calibration import read_calibration
    from foreglow.datasets import read_image
    from foreglow.display.calibration_check import check_lines, write_check

    calibrated = read_calibration(camera)
    write_check(out, calibrated, read_image(image), str(image))
    typer.echo("\n".join([*check_lines(calibrated), f"picture        {out}"]))


@calibrate.command()
def convert(
    source: Annotated[Path, argument(metavar="FILE", help="KITTI's .txt, ROS's .yaml, or TOML.")],
    out: Annotated[Path, file(help="TOML to write.")],
    mount_forward: Annotated[float, typer.Option(metavar="M", help="Camera forward of the rear axle.")],
    mount_height: Annotated[float, typer.Option(metavar="M", help="Camera above the road.")],
    mount_left: Annotated[float, typer.Option(metavar="M", help="Camera left of the vehicle's middle.")] = 0.0,
    pitch_deg: Annotated[float, typer.Option(metavar="DEG", help="How far it points upwards.")] = 0.0,
    yaw_deg: Annotated[float, typer.Option(metavar="DEG", help="How far it points to the left.")] = 0.0,
    roll_deg: Annotated[float, typer.Option(metavar="DEG", help="How far it is turned to the right.")] = 0.0,
    camera: Annotated[int, typer.Option(min=0, max=99, metavar="N", help="Number of the camera in KITTI's.")] = 0,
    rectified: Annotated[bool, typer.Option("--rectified", help="For rectified images.")] = False,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images, if FILE lacks it.")] = None,
) -> None:
    """Write a calibration of another program, with the camera's place in the vehicle, as our TOML."""
    from foreglow.calibration import ImageChoice, Mount, calibration_to_toml, read_intrinsics
    from foreglow.config import validated
    from foreglow.files import write_atomic

    position_m = (mount_forward, mount_left, mount_height)
    angles = {"yaw_deg": yaw_deg, "pitch_deg": pitch_deg, "roll_deg": roll_deg}
    mount = validated(Mount, {"position_m": position_m, **angles}, "mount")
    size_px = None if size is None else size_of(size)
    choice = validated(ImageChoice, {"camera": camera, "is_rectified": rectified, "size_px": size_px}, "images")
    write_atomic(out, calibration_to_toml(read_intrinsics(source, choice).camera(mount)).encode())
    typer.echo(f"calibration in {out}; look at it with: foreglow calibrate check {out} IMAGE --out FILE.png")
