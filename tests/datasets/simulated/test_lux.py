"""Light at other drivers' eyes, as a simulated drive has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import shipped_drive
from foreglow.datasets.simulated import read_truth
from foreglow.datasets.simulated.vehicle import RecordedLux
from foreglow.types import Frame

IMAGE = np.zeros((2, 2), np.uint8)


def test_it_is_that_of_the_truth() -> None:
    lux_of, truth = RecordedLux(shipped_drive()), read_truth(shipped_drive()).sequence(1)
    for each in (truth.frames[0], truth.frames[80]):
        (vehicle,) = each.vehicles
        assert lux_of(Frame(IMAGE, each.timestamp_ns, each.image_id)) == {"car 0": vehicle.eye_lx["ego"]}
    assert lux_of(Frame(IMAGE, 0, truth.frames[80].image_id))["car 0"] > 0


def test_of_other_frames_nothing_is_known(tmp_path: Path) -> None:
    assert RecordedLux(shipped_drive())(Frame(IMAGE, 0, 7)) == {}
    with pytest.raises(FileNotFoundError):
        RecordedLux(tmp_path)
