"""The benchmark of real clips, on a made-up one."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.datasets.video.test_video_file import make_video

pytest.importorskip("torch")
pytest.importorskip("onnx")

from benchmarks import own_clips
from benchmarks.own_clips import line, read_clips, write_half
from foreglow.datasets import PVDN
from foreglow.datasets.pvdn.schema import Vehicle
from foreglow.types import Proposals

pytestmark = pytest.mark.torch


def lights(vehicles: tuple[Vehicle, ...]) -> list[tuple[tuple[int, int], bool, bool]]:
    return [(each.position_px, each.is_direct, each.is_rear) for vehicle in vehicles for each in vehicle.instances]


class FourBoxes:
    """Of a headlamp, of a fixed lamp, of a part of the latter, and of what nobody marked."""

    def propose(self, image: np.ndarray[Any, Any]) -> Proposals:  # noqa: ARG002
        boxes = [[5, 15, 15, 25], [60, 20, 80, 40], [62, 22, 66, 26], [80, 50, 90, 60]]
        return Proposals(np.array(boxes, np.int32))


@pytest.mark.parametrize("has_kinds", [False, True])
def test_marks_become_labels_of_a_half(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_kinds: bool) -> None:
    monkeypatch.setattr(own_clips, "make_proposer", lambda _: FourBoxes())
    (tmp_path / "clips").mkdir()
    make_video(tmp_path / "clips" / "clip.mp4")
    folder = tmp_path / "marks" / "c1"
    folder.mkdir(parents=True)
    spots = {"8": [[10, 20], [30, 40], [50, 60], [70, 30]], "12": [[5, 5]]}
    (folder / "candidates.json").write_text(
        json.dumps({"video": "clip.mp4", "width": 96, "height": 72, "frames": spots})
    )
    classes = {"0": "headlamp", "1": "tail", "2": "unsure", "3": "fixed"}
    told = {
        "8": {"classes": classes, "missed_headlamps": [[80, 10]]},
        "12": {"classes": {"0": "own"}, "missed_headlamps": []},
    }
    (folder / "labels.json").write_text(json.dumps(told))
    (clip,) = read_clips(tmp_path / "marks", tmp_path / "clips")
    first, second = (PVDN(write_half(clip, half, tmp_path / "own", has_kinds) / "train") for half in (0, 1))
    assert (first.frame_ids, second.frame_ids) == ((8,), (12,))
    tail = [((30, 40), True, True)] if has_kinds else []
    assert sorted(lights(first.annotations(8))) == sorted([((10, 20), True, False), ((80, 10), True, False), *tail])
    assert [each.position_px for each in first.doubtful(8)] == [(50, 60), (85, 55)]
    assert lights(second.annotations(12)) == []
    assert first.read(8).earlier is not None


def test_a_row_of_the_table() -> None:
    counts = Counter({"headlamp spots": 4, "headlamp accepted": 3, "boxes right": 3, "boxes wrong": 1})
    assert line("c1 before", counts).startswith("c1 before: headlamp 0.75, reflection 0.00")
    assert line("c1 before", counts).endswith("precision 0.750 of 4 known boxes")
