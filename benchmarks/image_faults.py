"""In which image after a fault the guard notices it, from raw and from coded sources, and how often it errs.

False alarms are counted on the drive that ships, raw and coded, and on the given videos and data sets.
"""

from __future__ import annotations

import argparse
import io
import itertools
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from benchmarks.timing import CONSOLE, RESULTS, Row, table, write_results
from foreglow.beam.camera_watch import CameraWatch
from foreglow.config import GuardConfig
from foreglow.datasets import Video, open_source, shipped_drive
from foreglow.types import Frame, Image

RATE_HZ = 18
PERIOD_NS = 10**9 // RATE_HZ

NUM_GOOD, NUM_WRONG = 40, 20
"""Images before the fault, and with it."""

LOSS_SHARE = 0.05
"""Share of the packets of a transport stream that is lost."""

WRONG_LEVELS, WRONG_SHARE = 20, 0.01
"""An image is damaged where more than this share of its pixels is off by more than so many grey levels."""


@dataclass(frozen=True, slots=True)
class Coding:
    """How a stream is encoded: FFmpeg's name of the codec, and bits per pixel and image."""

    codec: str
    bits_per_pixel: float


CODINGS: dict[str, Coding | None] = {
    "raw": None,
    "H.264, 0.36 bits a pixel": Coding("libx264", 0.36),
    "H.264, 0.045 bits a pixel": Coding("libx264", 0.045),
    "MJPEG": Coding("mjpeg", 1.0),
}
"""By name; at 1280x960 and 18 Hz the two of H.264 are 8 and 1 Mbit/s."""


def encoded(images: Sequence[Image], coding: Coding, container: str = "matroska") -> bytes:
    """A stream of grey images with a key frame a second."""
    file = io.BytesIO()
    with av.open(file, "w", format=container) as output:
        stream: Any = output.add_stream(coding.codec, rate=RATE_HZ)
        height, width = images[0].shape
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuvj420p" if coding.codec == "mjpeg" else "yuv420p"
        stream.bit_rate = round(coding.bits_per_pixel * width * height * RATE_HZ)
        if coding.codec == "libx264":
            stream.options = {"preset": "veryfast", "tune": "zerolatency", "g": str(RATE_HZ), "threads": "1"}
        for number, image in enumerate(images):
            picture = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=stream.pix_fmt)
            picture.pts, picture.time_base = number, Fraction(1, RATE_HZ)
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))
    return file.getvalue()


def as_coded(images: Sequence[Image], coding: Coding | None) -> list[Image]:
    """The images after encoder and decoder; as they are without a coding."""
    if coding is None:
        return list(images)
    container: Any = av.open(io.BytesIO(encoded(images, coding)))
    with container:
        return [picture.to_ndarray(format="gray") for picture in container.decode(video=0)]


def cut_jpeg(image: Image) -> Image:
    """What a decoder makes of the first half of the bytes of a JPEG."""
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    decoder: Any = av.CodecContext.create("mjpeg", "r")
    (picture,) = decoder.decode(av.Packet(jpeg[: len(jpeg) // 2]))
    return np.asarray(picture.to_ndarray(format="gray"))


def _half_stuck(images: Sequence[Image], latest: Image) -> list[Image]:
    middle = images[0].shape[1] // 2
    stuck = [image.copy() for image in images]
    for image in stuck:
        image[:, :middle] = latest[:, :middle]
    return stuck


def _quarter_filled(images: Sequence[Image], _: Image) -> list[Image]:
    height, width = images[0].shape
    filled = [image.copy() for image in images]
    for image in filled:
        image[: height // 2, : width // 2] = 3
    return filled


def _rows_repeated(images: Sequence[Image], _: Image) -> list[Image]:
    repeated = [image.copy() for image in images]
    for image in repeated:
        image[1::2] = image[: image.shape[0] // 2 * 2 : 2]
    return repeated


def _field_stuck(images: Sequence[Image], latest: Image) -> list[Image]:
    stuck = [image.copy() for image in images]
    for image in stuck:
        image[1::2] = latest[1::2]
    return stuck


def _field_black(images: Sequence[Image], _: Image) -> list[Image]:
    black = [image.copy() for image in images]
    for image in black:
        image[1::2] = 0
    return black


FAULTS: dict[str, Callable[[Sequence[Image], Image], list[Image]]] = {
    "frozen": lambda images, latest: [latest] * len(images),
    "black": lambda images, _: [image // 64 for image in images],
    "white": lambda images, _: [np.full_like(image, 254) for image in images],
    "half stuck": _half_stuck,
    "quarter dark": _quarter_filled,
    "rows repeated": _rows_repeated,
    "every other row stuck": _field_stuck,
    "every other row black": _field_black,
    "cut JPEG": lambda images, _: [cut_jpeg(image) for image in images],
}
"""By name, what is seen in place of the given images after a latest good one; all happen before the encoder."""


def faults_of(
    images: Iterable[Image],
    *,
    is_moving: bool | None = True,
    is_damaged: Sequence[bool] = (),
    rate_hz: float = RATE_HZ,
    white_level: int | None = None,
) -> list[list[str]]:
    """What the guard's watch says of each image of a stream."""
    watch = CameraWatch(GuardConfig(white_level=white_level))
    return [
        [
            str(fault)
            for fault in watch.faults(
                image,
                round(number * 1e9 / rate_hz),
                is_moving=is_moving,
                is_damaged=number < len(is_damaged) and is_damaged[number],
            )
        ]
        for number, image in enumerate(images)
    ]


def with_fault(images: Sequence[Image], fault: str, coding: Coding | None) -> list[list[str]]:
    """What the guard says of images of which those from `NUM_GOOD` on are wrong."""
    good, later = images[:NUM_GOOD], images[NUM_GOOD : NUM_GOOD + NUM_WRONG]
    return faults_of(as_coded([*good, *FAULTS[fault](later, good[-1])], coding))


def without_packets(stream: bytes, share: float, seed: int) -> bytes:
    """A transport stream that has lost a share of its packets, but for the first ones, with the tables."""
    size = 188
    rng = np.random.default_rng(seed)
    packets = [stream[start : start + size] for start in range(0, len(stream), size)]
    return b"".join(packet for number, packet in enumerate(packets) if number < 8 or rng.random() >= share)


def lost_packets(images: Sequence[Image], coding: Coding, folder: Path, seed: int = 1) -> dict[str, int]:
    """Of a stream that has lost packets: how many frames are damaged, flagged, and damaged without being flagged.

    Frames whose time the loss took are counted apart: nothing says with which image they should be compared.
    """
    path = folder / "lossy.ts"
    whole = encoded(images, coding, "mpegts")
    path.write_bytes(whole)
    clean = {frame.timestamp_ns: frame.image for frame in Video(path)}
    path.write_bytes(without_packets(whole, LOSS_SHARE, seed))
    frames = list(Video(path, on_error="mark"))
    faults = faults_of((frame.image for frame in frames), is_damaged=[frame.is_damaged for frame in frames])
    count = Counter(frames=len(frames), untimed=0, flagged=0, damaged=0, missed=0)
    for frame, found in zip(frames, faults, strict=True):
        expected = clean.get(frame.timestamp_ns)
        is_wrong = expected is not None and is_damaged(frame, expected)
        count.update(untimed=expected is None, flagged=bool(found), damaged=is_wrong, missed=is_wrong and not found)
    return dict(count)


def is_damaged(frame: Frame, expected: Image) -> bool:
    """Whether so many pixels of a frame are off that it counts as damaged."""
    off = np.abs(frame.image.astype(np.int16) - expected) > WRONG_LEVELS
    return float(off.mean()) > WRONG_SHARE


def reactions(images: Sequence[Image]) -> list[Row]:
    """By fault and coding, in which wrong image the guard first finds a fault, from 1; None if in none."""
    rows = []
    for fault in FAULTS:
        for name, coding in CODINGS.items():
            faults = with_fault(images, fault, coding)[NUM_GOOD:]
            first = next((number for number, found in enumerate(faults, start=1) if found), None)
            num_missed = sum(not found for found in faults[2:])
            rows.append({"fault": fault, "source": name, "first": first, "num_missed_later": num_missed})
    return rows


def false_alarms(images: Sequence[Image], sources: Sequence[Path]) -> list[Row]:
    """What the guard finds in streams where nothing is wrong, with our speed known (and high) or unknown."""
    rows = [_alarms(f"bundled drive, {name}", as_coded(images, coding), RATE_HZ) for name, coding in CODINGS.items()]
    for path in sources:
        source = open_source(path)
        rows += [
            _alarms(f"{path.name} {sequence}", (frame.image for frame in frames), source.rate_hz or RATE_HZ)
            for sequence, frames in itertools.groupby(source, key=lambda frame: frame.sequence)
        ]
    return rows


def _alarms(name: str, images: Iterable[Image], rate_hz: float) -> Row:
    watches = {True: CameraWatch(GuardConfig()), None: CameraWatch(GuardConfig())}
    row: Row = {"stream": name, "num_images": 0, "num_alarms_speed_known": 0, "num_alarms_speed_unknown": 0}
    for number, image in enumerate(images):
        row["num_images"] += 1
        for is_moving, watch in watches.items():
            faults = watch.faults(image, round(number * 1e9 / rate_hz), is_moving=is_moving)
            row["num_alarms_speed_known" if is_moving else "num_alarms_speed_unknown"] += bool(faults)
    return row


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sources", nargs="*", type=Path, help="videos and data sets in which nothing is wrong")
    parser.add_argument("--out", type=Path, default=RESULTS / "image_faults.json")
    given = parser.parse_args(arguments)
    images = [frame.image for frame in open_source(shipped_drive())]
    rows, alarms = reactions(images), false_alarms(images, given.sources)
    shown = table("First wrong image with low beam, and later ones without it", ("fault", "source"), ("first", "later"))
    for row in rows:
        shown.add_row(row["fault"], row["source"], str(row["first"] or "none"), str(row["num_missed_later"]))
    CONSOLE.print(shown)
    losses: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, coding in CODINGS.items():
            if coding is not None and coding.codec == "libx264":
                losses.append({"source": name, **lost_packets(images, coding, Path(folder))})
    columns = ("frames", "damaged", "flagged", "missed", "untimed")
    shown = table(f"Transport stream without {LOSS_SHARE:.0%} of its packets", ("source",), columns)
    for row in losses:
        shown.add_row(row["source"], *(str(row[name]) for name in columns))
    CONSOLE.print(shown)
    shown = table("False alarms", ("stream",), ("images", "speed known", "unknown"))
    for row in alarms:
        figures = (row[key] for key in ("num_images", "num_alarms_speed_known", "num_alarms_speed_unknown"))
        shown.add_row(row["stream"], *map(str, figures))
    CONSOLE.print(shown)
    write_results(given.out, {"reactions": rows, "losses": losses, "false_alarms": alarms})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
