from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest

from foreglow.datasets import PVDN
from foreglow.files import to_json
from foreglow.lab.evaluation.label_statistics import (
    Comparison,
    LabelledImage,
    Spread,
    compare_labels,
    label_statistics,
    labels_of_split,
    read_label_digest,
)
from tests.datasets.tiny_pvdn import make_pvdn
from tests.shared_data import shared_file

NOTHING = LabelledImage(0)


def image(num_direct: int, num_indirect: int) -> LabelledImage:
    return LabelledImage(1, ((0.5, 0.5),) * num_direct, ((0.25, 0.75),) * num_indirect)


# Indirect light for three images before the lamps; a vehicle in sight from the start; both at once; nothing.
DRIVES = (
    (NOTHING, image(0, 1), image(0, 1), image(0, 2), image(2, 3), image(2, 0), NOTHING),
    (image(2, 1), image(2, 1)),
    (NOTHING, image(1, 1)),
    (NOTHING, LabelledImage(1)),
)


def test_by_hand() -> None:
    found = label_statistics(DRIVES)
    assert (found.num_sequences, found.num_images, found.num_instances) == (4, 13, 9 + 10)
    assert found.share_without_vehicle == pytest.approx(4 / 13)
    assert found.instances_per_image == pytest.approx(19 / 13)
    assert found.share_direct == pytest.approx(9 / 19)
    assert found.share_hidden == pytest.approx(3 / 13)
    assert found.share_in_sight == pytest.approx(5 / 13)
    assert found.indirect_per_hidden_image == pytest.approx(4 / 3)
    assert found.share_one_when_hidden == pytest.approx(2 / 3)
    assert found.indirect_per_image_in_sight == pytest.approx(6 / 5)
    assert found.direct_per_image_in_sight == pytest.approx(9 / 5)
    assert (found.num_indirect_first, found.num_direct_first, found.num_begun) == (1, 1, 1)
    assert found.lead_frames == Spread(1, 3, 3, 3)
    assert found.hidden_frames == Spread(3, 0, 0, 1.5)
    assert found.in_sight_frames == Spread(3, 1.5, 2, 2)
    assert found.positions["direct_x_p50"] == 0.5
    assert found.positions["indirect_y_p90"] == 0.75


def test_a_light_whose_vehicle_never_comes() -> None:
    found = label_statistics([(NOTHING, image(0, 1)), (NOTHING, image(1, 0))])
    assert (found.num_indirect_first, found.num_direct_first) == (1, 1)
    assert found.lead_frames.num == 0


def test_nothing_is_null_in_json() -> None:
    fields = json.loads(json.dumps(to_json(label_statistics([])), allow_nan=False))
    assert fields["num_images"] == 0
    assert fields["share_direct"] is None
    assert fields["lead_frames"] == {"num": 0, "lower_quartile": None, "median": None, "upper_quartile": None}
    assert fields["positions"]["direct_x_p10"] is None


def test_labels_against_themselves_are_close() -> None:
    found = label_statistics(DRIVES)
    rows = compare_labels(found, found)
    assert {row.name for row in rows} >= {"share_direct", "lead_frames_median", "indirect_y_p10"}
    assert all(row.is_close and row.ratio == 1 for row in rows)


def test_within_a_factor() -> None:
    real = label_statistics(DRIVES)
    for factor, is_close in ((1.49, True), (1.51, False), (0.67, True), (0.66, False)):
        other = dataclasses.replace(real, share_direct=real.share_direct * factor)
        rows = {row.name: row for row in compare_labels(real, other)}
        assert rows["share_direct"].ratio == pytest.approx(factor)
        assert rows["share_direct"].is_close == is_close
        assert rows["share_hidden"].is_close


def test_what_one_side_lacks_is_not_close() -> None:
    rows = {row.name: row for row in compare_labels(label_statistics(DRIVES), label_statistics([(NOTHING,)]))}
    assert not rows["share_direct"].is_close
    assert math.isnan(rows["share_direct"].ratio)
    assert not rows["instances_per_image"].is_close


def test_rows_as_json() -> None:
    rows = [Comparison("share", 0.5, math.nan, math.nan, False)]
    assert json.loads(json.dumps(to_json(rows), allow_nan=False)) == [
        {"name": "share", "real": 0.5, "simulated": None, "ratio": None, "is_close": False}
    ]


def test_labels_of_a_split(tmp_path: Path) -> None:
    drives = labels_of_split(PVDN(make_pvdn(tmp_path)))
    assert [len(images) for images in drives] == [2, 3]
    assert drives[0] == (NOTHING, NOTHING)
    first, second, third = drives[1]
    assert first.direct == ((38 / 96, 31 / 72), (44 / 96, 31 / 72))
    assert first.indirect == ((20 / 96, 50 / 72),)
    assert (second.num_vehicles, second.direct) == (1, ())
    assert third == NOTHING


def write_digest(folder: Path, **fields: Any) -> Path:
    path = folder / "digest.json"
    entry = {"id": 4, "vehicles": [[1, 2]], "direct": [[640, 480]], "indirect": [], "more": 1} | fields
    path.write_text(json.dumps({"S1": [entry]}))
    return path


def test_digest(tmp_path: Path) -> None:
    assert read_label_digest(write_digest(tmp_path)) == ((LabelledImage(1, ((0.5, 0.5),), ()),),)
    assert read_label_digest(write_digest(tmp_path), 2560, 960)[0][0].direct == ((0.25, 0.5),)


def test_a_broken_digest_says_where(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"digest\.json: S1\.0\.direct\.0"):
        read_label_digest(write_digest(tmp_path, direct=[[1, 2, 3]]))
    with pytest.raises(FileNotFoundError, match=r"nothing\.json: no such file"):
        read_label_digest(tmp_path / "nothing.json")


def test_real_labels() -> None:
    found = label_statistics(read_label_digest(shared_file("data/pvdn_night_val_labels.json")))
    assert (found.num_images, found.num_sequences, found.num_instances) == (4322, 25, 12746)
    assert found.instances_per_image == pytest.approx(2.95, abs=0.005)
    assert found.share_direct == pytest.approx(0.598, abs=0.0005)
    assert found.share_without_vehicle == pytest.approx(0.337, abs=0.0005)
    assert found.indirect_per_hidden_image == pytest.approx(1.44, abs=0.005)
    assert found.share_one_when_hidden == pytest.approx(0.81, abs=0.005)
    assert found.indirect_per_image_in_sight == pytest.approx(1.87, abs=0.005)
    assert found.num_indirect_first + found.num_direct_first + found.num_begun == 25
