from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets.simulated.shares import SOURCES, BoxShares, read_shares, write_shares
from foreglow.lab.simulation.labels.shares import box_shares

pytest.importorskip("pyarrow")


def shares_of(num: int, seed: int, preset: str = "foreglow") -> BoxShares:
    rng = np.random.default_rng(seed)
    low = rng.integers(0, 100, (num, 2))
    boxes = np.concatenate([low, low + rng.integers(1, 30, (num, 2))], 1).astype(np.int32)
    return BoxShares(preset, boxes, rng.dirichlet(np.ones(6), num).astype(np.float32))


def test_what_is_written_is_read(tmp_path: Path) -> None:
    rows = [
        (10000, shares_of(3, 1)),
        (10000, shares_of(2, 2, "paper")),
        (10001, shares_of(0, 3)),
        (10002, shares_of(1, 4)),
    ]
    write_shares(tmp_path / "shares.parquet", rows)
    back = list(read_shares(tmp_path / "shares.parquet"))
    assert [(image_id, found.preset) for image_id, found in back] == [
        (10000, "foreglow"),
        (10000, "paper"),
        (10002, "foreglow"),
    ]
    for (_, found), given in zip(back, (rows[0][1], rows[1][1], rows[3][1]), strict=True):
        assert np.array_equal(found.boxes_xyxy_px, given.boxes_xyxy_px)
        assert np.array_equal(found.shares, given.shares)


def test_nothing_proposed_is_an_empty_file(tmp_path: Path) -> None:
    write_shares(tmp_path / "shares.parquet", [])
    assert list(read_shares(tmp_path / "shares.parquet")) == []


def test_bad_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"shares\.parquet: no such file; .*--shares PRESET"):
        list(read_shares(tmp_path / "shares.parquet"))
    (tmp_path / "shares.parquet").write_bytes(b"PAR1 but not really")
    with pytest.raises(ValueError, match=r"shares\.parquet: expected a Parquet file"):
        list(read_shares(tmp_path / "shares.parquet"))


def test_shares_sum_to_one() -> None:
    with pytest.raises(ValueError, match="sum to 1"):
        BoxShares("paper", np.array([[0, 0, 2, 2]], np.int32), np.full((1, 6), 0.1, np.float32))


def test_vehicle_light_is_the_first_four_sources() -> None:
    found = BoxShares(
        "paper", np.array([[0, 0, 2, 2]], np.int32), np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.1]], np.float32)
    )
    assert found.vehicle_shares == pytest.approx([0.7])


def test_the_share_of_a_source_by_hand() -> None:
    light = np.zeros((len(SOURCES), 20, 20), np.float32)
    light[0, 8:12, 8:12] = 3.0  # a lamp of 16 pixels
    light[4] = 2.0  # even light, which makes no contrast
    light[4, 8:12, 8:12] = 3.0
    box = np.array([[6, 6, 14, 14]], np.int32)  # 64 pixels, the brightest quarter of which are the lamp's
    assert box_shares(light, box)[0] == pytest.approx([0.75, 0, 0, 0, 0.25, 0])


def test_a_source_that_is_brighter_around_the_box_makes_none_of_its_contrast() -> None:
    light = np.zeros((len(SOURCES), 20, 20), np.float32)
    light[2, 8:12, 8:12] = 1.0
    light[5] = 5.0
    light[5, 6:14, 6:14] = 1.0
    assert box_shares(light, np.array([[6, 6, 14, 14]], np.int32))[0] == pytest.approx([0, 0, 1, 0, 0, 0])


def test_a_box_without_contrast_has_the_shares_of_its_light() -> None:
    light = np.zeros((len(SOURCES), 20, 20), np.float32)
    light[4], light[5] = 3.0, 1.0
    assert box_shares(light, np.array([[6, 6, 14, 14]], np.int32))[0] == pytest.approx([0, 0, 0, 0, 0.75, 0.25])


def test_wrong_bits_are_refused_or_change_nothing(tmp_path: Path) -> None:
    """Parquet finds some of them only; five in a hundred gave other figures of `evaluate` without a word."""
    path, rows = tmp_path / "shares.parquet", [(10000, shares_of(30, 1)), (10001, shares_of(20, 2))]
    write_shares(path, rows)
    whole = path.read_bytes()
    refused: list[str] = []
    for position in range(0, len(whole), 7):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << position % 8
        path.write_bytes(damaged)
        try:
            back = list(read_shares(path))
        except ValueError as error:
            refused.append(str(error))
            continue
        for (image_id, found), (wanted_id, wanted) in zip(back, rows, strict=True):
            assert (image_id, found.preset) == (wanted_id, wanted.preset), position
            assert np.array_equal(found.boxes_xyxy_px, wanted.boxes_xyxy_px), position
            assert np.array_equal(found.shares, wanted.shares), position
    assert len(refused) > 100
    assert all(message.startswith(f"{path}: expected ") for message in refused)
