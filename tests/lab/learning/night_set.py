"""A small data set of night frames, on which some parameters of the proposals are plainly better than the paper's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.datasets.json_files import write_json
from foreglow.datasets.pvdn.schema import Instance, KeypointsFile, Sequence, Vehicle
from foreglow.datasets.pvdn.writer import LabelledImage, PVDNWriter
from foreglow.types import Frame

SIZE_PX = (480, 640)  # height, width; the sizes of a preset are pixels of such a frame
NUM_SEQUENCES, NUM_IMAGES = 2, 8
LAMP_PX, LAMP_DISTANCE_PX = 10, 12
"""The two lamps of a car: the paper's parameters join them to one box, and a smaller gap keeps them apart."""


def night_frame(image_id: int) -> tuple[Frame, tuple[Vehicle, ...], tuple[Instance, ...]]:
    """A car's two lamps, a weak reflection, and a light that is doubtful."""
    rng = np.random.default_rng(image_id)
    image = rng.integers(8, 12, SIZE_PX, dtype=np.uint8)
    x, y = int(rng.integers(100, 300)), int(rng.integers(100, 300))
    corners = {"left": (x, y), "right": (x + LAMP_DISTANCE_PX, y), "road": (x, y + 90), "doubtful": (x + 200, y)}
    for name, (column, row) in corners.items():
        image[row : row + LAMP_PX, column : column + LAMP_PX] = 220 if name in ("left", "right") else 90
    middle = {name: (column + LAMP_PX // 2, row + LAMP_PX // 2) for name, (column, row) in corners.items()}
    instances = (
        Instance(position_px=middle["left"], iid=0, is_direct=True),
        Instance(position_px=middle["right"], iid=1, is_direct=True),
        Instance(position_px=middle["road"], iid=2),
    )
    doubtful = (Instance(position_px=middle["doubtful"], iid=3),)
    return Frame(image, 0, image_id), (Vehicle(position_px=(x, y), oid=0, instances=instances),), doubtful


def make_night_set(folder: Path, splits: tuple[str, ...] = ("train", "val"), num_images: int = NUM_IMAGES) -> Path:
    """The data set's folder, with `NUM_SEQUENCES` sequences of `num_images` images in each of its splits."""
    for number, split in enumerate(splits):
        with PVDNWriter(folder / "night" / split) as writer:
            for sequence in range(1, NUM_SEQUENCES + 1):
                first = 1000 * number + 100 * sequence
                frames = [night_frame(first + index) for index in range(num_images)]
                writer.add_sequence(
                    Sequence.plain(sequence), [LabelledImage(frame, vehicles) for frame, vehicles, _ in frames]
                )
                for frame, vehicles, doubtful in frames:
                    path = writer.root / "labels" / "keypoints" / f"{frame.frame:06d}.json"
                    write_json(path, KeypointsFile(image_id=frame.frame, annotations=vehicles, doubtful=doubtful))
    return folder
