"""What several tests of label files use."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.datasets.tiny_pvdn import edit, labelled_vehicle, make_pvdn


@pytest.fixture
def split(tmp_path: Path) -> Path:
    """A split with all that the formats know: two vehicles in an image, doubtful light, a light outside the image."""
    root = make_pvdn(tmp_path)
    keypoints = root / "labels/keypoints"
    vehicles = [labelled_vehicle(4, (3, 5, False), (-2, 95, True)), labelled_vehicle(2)]
    edit(keypoints / "000007.json", "annotations", value=vehicles)
    edit(keypoints / "000007.json", "annotations", 0, "instances", 0, "rear", value=True)
    doubtful = [{"pos": [9, 8], "iid": 70}]
    path = keypoints / "000005.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"doubtful": doubtful}))
    return root
