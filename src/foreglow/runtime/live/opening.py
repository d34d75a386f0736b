"""What a user names: a camera, a stream, a simulated drive, or anything that `open_source` knows."""

from __future__ import annotations

from pathlib import Path

import cv2

from foreglow.datasets import Equipped, open_source
from foreglow.lab.simulation import read_scene, scenario
from foreglow.runtime.live.cameras import CameraOptions, CaptureCamera, StreamCamera
from foreglow.runtime.live.sources import DriveAround, LiveSource, Paced


def open_live(
    text: str,
    camera: CameraOptions,
    *,
    speed: float = 1.0,
    topic: str | None = None,
    seed: int = 0,
    quality: str = "training",
) -> LiveSource:
    """The live source called `text`.

    `camera:0` and `camera:/dev/video0` are cameras of this machine, `gstreamer:PIPELINE` ends in an appsink; what has
    `://` in it is a stream; `simulate:NAME` is a drawn scenario, `simulate:FILE.toml` a scene, in closed loop; all else
    is a path for `open_source`, replayed at its own rate.

    Args:
        text: What the user names.
        camera: How a camera or a stream is read; its vehicle data are put beside replayed frames, too.
        speed: Replayed so many times as fast; infinite for as fast as it goes, without dropping a frame.
        topic: Of a recording: the images' topic; None for the first.
        seed: Of a drawn scenario.
        quality: How finely a drive is rendered.

    Raises:
        FileNotFoundError: If there is nothing at the path.
        ValueError: If what is there cannot be used, or the scenario is unknown.
    """
    opened = open_camera(text, camera)
    if opened is not None:
        return opened
    kind, _, rest = text.partition(":")
    if kind == "simulate":
        scene = read_scene(Path(rest)) if rest.endswith(".toml") else scenario(rest, seed)
        return DriveAround(scene, quality)
    frames = open_source(text, topic=topic)
    return Paced(frames if camera.data is None else Equipped(frames, camera.data), speed)


def open_camera(text: str, options: CameraOptions) -> LiveSource | None:
    """The camera or the stream called `text`; None where it is neither."""
    kind, _, rest = text.partition(":")
    if "://" in text:
        return StreamCamera(text, options)
    if kind == "camera":
        return CaptureCamera(text, int(rest) if rest.isdecimal() else rest, cv2.CAP_V4L2, options)
    if kind == "gstreamer":
        return CaptureCamera(text, rest, cv2.CAP_GSTREAMER, options)
    return None
