"""Opens the live source that a user names: a camera, a stream, a simulated drive, or a recording at its own rate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from foreglow.datasets import Equipped, open_source
from foreglow.plugins import imported
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.runtime.live.sources import LiveSource, Paced


class Opener(Protocol):
    """A function that opens live sources of one kind."""

    def __call__(self, address: str, options: CameraOptions, /) -> LiveSource:
        """The source at `address`, the text after the scheme and its colon."""
        ...


STREAM = "://"
"""Stands for the scheme of any address with `://` in it, which is passed on as a whole."""

SOURCES = {
    "camera": "runtime.live.cameras:open_v4l2",
    "gstreamer": "runtime.live.cameras:open_gstreamer",
    STREAM: "runtime.live.cameras:open_stream",
    "simulate": "lab.simulation.live_drive:open_drive",
}
"""The `Opener` of each scheme, as `module:name` without the package: it is imported when it is needed."""

CAMERA_OPTIONS = frozenset(
    ("--size", "--rate", "--camera-delay", "--can-in", "--calibration", "--can-log", "--map", "--lamps")
)
"""Options of `foreglow live` that mean something to a camera."""

OPTIONS: Mapping[str | None, frozenset[str]] = {
    STREAM: CAMERA_OPTIONS - {"--size"},
    "simulate": frozenset(("--seed", "--quality")),
    None: frozenset(("--topic", "--speed", "--calibration", "--can-log", "--map", "--lamps")),
}
"""Likewise for other sources by their scheme, None for a path; all schemes that are not here are cameras."""


def options_of(text: str) -> frozenset[str]:
    """The options of `foreglow live` that have an effect on the source called `text`."""
    return OPTIONS.get(_scheme(text), CAMERA_OPTIONS)


def open_live(
    text: str, options: CameraOptions, *, speed: float = 1.0, topic: str | None = None, limit: int | None = None
) -> LiveSource:
    """The live source called `text`.

    `camera:0` and `camera:/dev/video0` are cameras of this machine, `gstreamer:PIPELINE` ends in an appsink; an address
    with `://` in it is a stream; `simulate:NAME` is a drawn scenario, `simulate:FILE.toml` a scene, in closed loop;
    anything else is a path for `open_source`, replayed at its own rate; what is damaged in it is marked, or left out.

    Args:
        text: What the user names.
        options: How it is read; vehicle data are also put beside replayed frames.
        speed: Replay so many times as fast; infinite for as fast as possible, without dropping a frame.
        topic: The image topic of a recording; None for the first.
        limit: So many frames will be read; None for all.

    Raises:
        FileNotFoundError: If there is nothing at the path.
        ValueError: If what is there cannot be used, or the scenario is unknown.
    """
    opened = _opened(text, options)
    if opened is not None:
        return opened
    frames = open_source(text, topic=topic, on_error="mark")  # it goes on, as a camera does
    if options.data is None:
        return Paced(frames, speed)
    equipped = Equipped(frames, options.data)
    equipped.check(limit)
    return Paced(equipped, speed)


def open_camera(text: str, options: CameraOptions) -> LiveSource | None:
    """The camera or stream called `text`; None if it is neither."""
    opened = _opened(text, options)
    return opened if opened is not None and opened.is_endless else None


def _opened(text: str, options: CameraOptions) -> LiveSource | None:
    """The source of a scheme in `SOURCES`; None for other schemes."""
    scheme = _scheme(text)
    if scheme is None:
        return None
    opener: Opener = imported("source", f"foreglow.{SOURCES[scheme]}")
    return opener(text if scheme == STREAM else text.removeprefix(f"{scheme}:"), options)


def _scheme(text: str) -> str | None:
    """The scheme in `SOURCES` of the source called `text`; None for a path."""
    scheme, colon, rest = text.partition(":")
    if colon and scheme in SOURCES and not rest.startswith("//"):  # also if there is an address in a pipeline
        return scheme
    return STREAM if STREAM in text else None
