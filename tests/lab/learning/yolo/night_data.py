"""A data set with a train, a val and a test split of a few small frames, each with one lit lamp."""

from __future__ import annotations

from collections.abc import Sequence as Ids
from pathlib import Path

import numpy as np

from foreglow.datasets import Instance, LabelledImage, PVDNWriter, Sequence, Vehicle
from foreglow.types import Frame
from tests.stand_ins import night_image

HEIGHT_PX, WIDTH_PX = 240, 320


def make_night_data(folder: Path, splits: Ids[str] = ("train", "val", "test"), num_images: int = 4) -> Path:
    """The data set's folder; every split has two sequences, and in each the last image is without a vehicle."""
    for number, split in enumerate(splits):
        with PVDNWriter(folder / "day" / split) as writer:
            for sequence in (1, 2):
                first = 100 * number + 10 * sequence
                images = [labelled(first + k, is_empty=k == num_images - 1) for k in range(num_images)]
                writer.add_sequence(Sequence.plain(sequence), images)
    return folder / "day"


def labelled(image_id: int, *, is_empty: bool = False) -> LabelledImage:
    image = night_image(image_id, HEIGHT_PX, WIDTH_PX)
    y, x = np.unravel_index(int(np.argmax(image)), image.shape)
    position = (int(x), int(y))
    lamp = Instance(iid=0, position_px=position, is_direct=True, is_rear=False)
    vehicle = Vehicle(oid=0, position_px=position, is_direct=True, instances=(lamp,))
    return LabelledImage(Frame(image, timestamp_ns=0, frame=image_id), () if is_empty else (vehicle,))
