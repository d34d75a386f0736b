from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.datasets import open_labelled, shipped_drive
from foreglow.datasets.exchange import labels_of, write_labels_file, write_split
from foreglow.lab.studies.simulator.run import real_statistics


def test_times_are_compared_whatever_part_of_the_real_images_is_labelled(tmp_path: Path) -> None:
    """The shipped drive beside every third of its own images."""
    dataset = open_labelled(shipped_drive())
    write_labels_file(tmp_path / "third.xml", labels_of(dataset, set(dataset.frame_ids[::3])), "cvat")
    (tmp_path / "images").symlink_to(dataset.root / "images")
    write_split(open_labelled(tmp_path / "third.xml"), tmp_path / "third")
    whole, part = real_statistics(shipped_drive()), real_statistics(tmp_path / "third")
    assert part.lead_frames.median == pytest.approx(whole.lead_frames.median, abs=3)
    assert part.in_sight_frames.median == pytest.approx(whole.in_sight_frames.median, abs=3)
