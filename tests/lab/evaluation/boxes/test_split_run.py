"""A pipeline over a split: order, resets, and the same boxes as frame by frame."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.config import PipelineConfig, ProposalConfig
from foreglow.datasets import PVDN
from foreglow.lab.evaluation import read_split_labels, run_split
from foreglow.lab.evaluation.boxes.robustness import UNDISTURBED, blur, gain, robustness
from foreglow.lab.evaluation.boxes.split_run import run_variants
from foreglow.pipeline import Pipeline
from foreglow.types import Frame, FrameResult
from tests.datasets.tiny_pvdn import IDS, SIZE_PX, edit, make_pvdn
from tests.stand_ins import night_image

CONFIG = PipelineConfig(proposals=ProposalConfig(reference_width_px=96, backend="reference"))


@pytest.fixture(name="dataset", scope="module")
def fixture_dataset(tmp_path_factory: pytest.TempPathFactory) -> PVDN:
    """A lamp in every image, labelled in one that had no label."""
    root = make_pvdn(tmp_path_factory.mktemp("split"))
    for name, ids in IDS.items():
        for image_id in ids:
            image = night_image(image_id, *SIZE_PX)
            assert cv2.imwrite(str(root / "images" / name / f"{image_id:06d}.png"), image)
    row, column = np.unravel_index(night_image(5, *SIZE_PX).argmax(), SIZE_PX)
    lamp = {"pos": [int(column), int(row)], "iid": 0, "direct": True}
    vehicle = {"pos": lamp["pos"], "oid": 1, "direct": True, "instances": [lamp]}
    edit(root / "labels/keypoints/000005.json", "annotations", value=[vehicle])
    return PVDN(root)


class Noting(Pipeline):
    """Notes what it is asked to do."""

    def __init__(self) -> None:
        super().__init__(CONFIG)
        self.notes: list[int | str] = []

    def step(self, frame: Frame | np.ndarray, **context: Any) -> FrameResult:
        assert isinstance(frame, Frame)
        self.notes.append(frame.frame)
        return super().step(frame, **context)

    def reset(self) -> None:
        self.notes.append("reset")


def test_all_images_in_order_after_a_reset(dataset: PVDN) -> None:
    pipeline = Noting()
    seen: list[int] = []
    run = run_split(dataset, pipeline, lambda frame, result: seen.append(frame.frame + result.frame))
    first, second = sorted(IDS["S00001"]), sorted(IDS["S00003"])
    assert pipeline.notes == ["reset", *first, *second]
    assert run.image_ids == dataset.frame_ids == (*first, *second)
    assert seen == [2 * image_id for image_id in run.image_ids]


def test_the_same_as_frame_by_frame(dataset: PVDN) -> None:
    run, pipeline = run_split(dataset, Pipeline(CONFIG)), Pipeline(CONFIG)
    assert not run.predictions.is_scored
    assert sum(map(len, run.predictions.scores.values())) > 0
    for frame in dataset:
        result = pipeline.step(frame)
        assert np.array_equal(run.predictions.boxes_xyxy_px[frame.frame], result.proposals.boxes_xyxy_px)
    assert set(run.stage_ms) == {"proposals"}
    assert run.total_ms.shape == (len(dataset),)
    assert (run.total_ms > 0).all()


def test_variants_do_not_meet(dataset: PVDN) -> None:
    runs = run_variants(dataset, {"a": (Pipeline(CONFIG), blur(40.0)), "b": (Pipeline(CONFIG), UNDISTURBED)})
    alone = run_split(dataset, Pipeline(CONFIG)).predictions.boxes_xyxy_px
    assert all(np.array_equal(runs["b"].predictions.boxes_xyxy_px[each], alone[each]) for each in alone)
    assert any(not np.array_equal(runs["a"].predictions.boxes_xyxy_px[each], alone[each]) for each in alone)


def test_robustness_has_a_row_a_disturbance(dataset: PVDN) -> None:
    labels = read_split_labels(dataset)
    chosen = (UNDISTURBED, gain(0.25), blur(40.0))
    rows = robustness(dataset, labels, CONFIG, disturbances=chosen)
    assert [row.name for row in rows] == ["as it is", "gain x0.25", "blur 40 px"]
    assert rows[0].recall == rows[0].ceiling > 0  # nothing scores the boxes
    assert rows[0].proposals_per_frame == 1.0
    assert rows[0].false_boxes_per_frame == 0.8
    again = robustness(dataset, labels, CONFIG, disturbances=chosen)
    assert [str(row) for row in again] == [str(row) for row in rows]  # NaN is no NaN's equal
    with pytest.raises(ValueError, match="each name once"):
        robustness(dataset, labels, CONFIG, disturbances=(gain(2.0), gain(2.0)))
