"""Every stage of the detector on one frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.config import preset
from foreglow.datasets import shipped_drive
from foreglow.lab.reports import stage_picture
from foreglow.proposals import ReferenceProposer
from foreglow.types import Frame
from tests.cli.commands import PNG, complaint, foreglow_command
from tests.stand_ins import result_of


def test_boxes_are_kept_or_left_out_by_size_or_deviation() -> None:
    image = np.full((960, 1280), 10, np.uint8)
    image[300:330, 300:330] = 250  # a lamp
    image[600:660, 600:800] = 250  # too large
    config = preset("paper").proposals
    proposer = ReferenceProposer(config)
    stages = proposer.stages(image)
    assert stages is not None
    judged = proposer.judged(stages, 1280)
    assert sorted(verdict for _, verdict in judged) == ["kept", "size"]
    (kept,) = (np.array(box) for box, verdict in judged if verdict == "kept")
    np.testing.assert_array_equal(2 * kept, proposer.propose(image).boxes_xyxy_px[0])
    strict = ReferenceProposer(config.model_copy(update={"min_deviation": 0.9}))
    assert {verdict for _, verdict in strict.judged(stages, 1280)} == {"deviation", "size"}


def test_what_stands_still_is_told_apart_from_what_the_filters_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    sheets: list[Any] = []

    def keep(figure: Any) -> bytes:
        sheets.append(figure)
        return b""

    monkeypatch.setattr(stage_picture, "png", keep)
    image = np.full((960, 1280), 10, np.uint8)
    image[300:330, 300:330] = 250
    frame, config = Frame(image, 0), preset("paper").changed("classifier", model=None)
    for boxes, words in (([(300, 300, 330, 330)], "filters"), ([], "filters, 1 of them stand still")):
        stage_picture.stage_picture(frame, result_of(frame, boxes), config)
        assert sheets[-1].axes[6].get_title() == f"1 boxes: 1 pass the {words}"


@pytest.mark.slow
def test_the_command_draws_nine_panels(tmp_path: Path) -> None:
    out = tmp_path / "stages.png"
    assert str(out) in foreglow_command("stages", shipped_drive(), "--frame", 3, "--out", out).stdout
    picture = cv2.imread(str(out))
    assert picture is not None
    thirds = [part for rows in np.array_split(picture, 3) for part in np.array_split(rows, 3, axis=1)]
    assert min(part.std() for part in thirds) > 10  # none is empty: this drive knows its road


def test_what_cannot_be_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert "ends with .png" in complaint("stages", shipped_drive(), "--out", tmp_path / "stages.jpg")
    image = tmp_path / "night.png"
    image.write_bytes(PNG)
    told = complaint("stages", image, "--frame", 1, "--out", tmp_path / "stages.png")
    assert f"--frame: expected one of the 1 frames of {image}, counted from 0, got 1" in told
