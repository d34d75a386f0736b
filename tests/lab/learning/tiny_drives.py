"""A data set of a few small images: round lights are those of vehicles, long ones are not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from foreglow.config import ProposalConfig
from foreglow.datasets import Instance, LabelledImage, PVDNWriter, Sequence, Vehicle
from foreglow.types import Frame

SIZE_PX = (120, 160)  # height, width
CONFIG = ProposalConfig(reference_width_px=160)
CONFIG_TOML = "[proposals]\nreference_width_px = 160\n"


def make_drives(data: Path, num_images: int = 4) -> Path:
    """DATA/day/train and DATA/day/val of two sequences each; the data set's folder."""
    for number, split in enumerate(("train", "val")):
        with PVDNWriter(data / "day" / split, info={"rate_hz": 4.0}) as writer:
            for sequence in (1, 2):
                first_id = 1000 * number + 100 * sequence
                images = [_labelled(first_id + index) for index in range(num_images)]
                writer.add_sequence(Sequence.plain(sequence), images)
    return data


def doubt(split: Path, image_id: int) -> None:
    """Turns the only light of an image into a doubtful one."""
    path = split / "labels" / "keypoints" / f"{image_id:06d}.json"
    content = json.loads(path.read_text())
    content["doubtful"] = content["annotations"][0]["instances"]
    content["annotations"] = []
    path.write_text(json.dumps(content))


def _labelled(image_id: int) -> LabelledImage:
    random = np.random.default_rng(image_id)
    rows, columns = np.mgrid[: SIZE_PX[0], : SIZE_PX[1]]
    image = random.normal(6, 1, SIZE_PX)
    positions = random.permutation([(30, 30), (30, 80), (30, 130), (90, 30), (90, 80), (90, 130)])[:3]
    for number, (row, column) in enumerate(positions + random.integers(-4, 5, (3, 2))):
        height, width = (3.5, 3.5) if number == 0 else (1.5, 6.0)
        image += 200 * np.exp(-(((rows - row) / height) ** 2 + ((columns - column) / width) ** 2) / 2)
        if number == 0:
            place_px = (int(column), int(row))
    light = Instance(position_px=place_px, iid=0, is_direct=image_id % 2 == 1)
    frame = Frame(np.clip(image, 0, 255).astype(np.uint8), timestamp_ns=250_000_000 * image_id, frame=image_id)
    return LabelledImage(frame, (Vehicle(position_px=place_px, oid=1, instances=(light,)),))
