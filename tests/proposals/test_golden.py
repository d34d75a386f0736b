"""Box for box the published implementation's results on its own real frame."""

from __future__ import annotations

import json

import numpy as np
import pytest

from foreglow import _native
from foreglow.config import preset
from foreglow.datasets import read_image
from foreglow.proposals import NativeProposer, ReferenceProposer
from foreglow.types import Image
from tests.shared_data import shared_file

GOLDEN = {"paper": "optimised", "baseline": "baseline"}


def real_frame() -> Image:
    return read_image(shared_file("data/pvdn_frame_047433.png"))


def golden_boxes(name: str) -> list[list[int]]:
    golden = json.loads(shared_file(f"reference/golden/{GOLDEN[name]}_proposals.json").read_text(encoding="utf-8"))
    return sorted(golden["proposals"], key=lambda box: (box[1], box[0], box[3], box[2]))


@pytest.mark.parametrize("name", GOLDEN)
def test_reference_finds_the_published_boxes(name: str) -> None:
    boxes = ReferenceProposer(preset(name).proposals).propose(real_frame()).boxes_xyxy_px
    assert boxes.tolist() == golden_boxes(name)


@pytest.mark.parametrize("name", GOLDEN)
def test_reference_equals_the_published_stages(name: str) -> None:
    stages = ReferenceProposer(preset(name).proposals).stages(real_frame())
    golden = np.load(shared_file(f"reference/golden/{GOLDEN[name]}_stages.npz"))
    assert stages is not None
    np.testing.assert_allclose(stages.blurred, golden["blurred"], atol=1e-6)
    assert (stages.binary == golden["binary"].astype(bool)).all()
    # Blob numbers may differ, blobs may not.
    pairs = {(int(a), int(b)) for a, b in zip(stages.labels.flat, golden["labels"].flat, strict=True)}
    assert len(pairs) == stages.labels.max() + 1 == golden["labels"].max() + 1


@pytest.mark.parametrize("name", GOLDEN)
@pytest.mark.parametrize("level", _native.available_dispatch())
def test_native_finds_the_published_boxes(name: str, level: str) -> None:
    config = preset(name).proposals.model_copy(update={"dispatch": level})
    assert NativeProposer(config).propose(real_frame()).boxes_xyxy_px.tolist() == golden_boxes(name)
