"""Real labels that simulated ones are compared with."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.lab.studies.simulator.run import real_statistics
from tests.datasets.tiny_pvdn import edit, labelled_vehicle, make_pvdn, write


@pytest.mark.parametrize(("rate_hz", "frames"), [(None, 1.0), (36.0, 0.5), (9.0, 2.0)])
def test_leads_of_a_set_of_any_rate_are_in_frames_of_pvdn(tmp_path: Path, rate_hz: float | None, frames: float) -> None:
    """As of a set that was imported from a video."""
    root = make_pvdn(tmp_path)
    annotations = {11: [], 12: [labelled_vehicle(7, (22, 30, False))], 13: [labelled_vehicle(7, (24, 30, True))]}
    for image_id, its in annotations.items():
        write(root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": its})
    path = root / "labels/image_annotations.json"
    if rate_hz is not None:
        edit(path, "info", value={"rate_hz": rate_hz})
        for index in range(5):
            edit(path, "images", index, "timestamp", value=None)
    found = real_statistics(root)
    assert found.num_indirect_first == 1
    assert found.lead_frames.median == pytest.approx(frames)
