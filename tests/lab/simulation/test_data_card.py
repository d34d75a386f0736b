"""The data card counts what the scenes say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from foreglow.lab.simulation.data_card import FILE, write_data_card
from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene, VehicleSpec, WeatherSpec
from foreglow.lab.simulation.writing.dataset import DatasetConfig, simulate_dataset
from tests.lab.simulation.stub_drive import drive

SHORT: dict[str, Any] = {"duration_s": 1.0, "rate_hz": 4.0}


def scenes(*lengths_m: float) -> list[Scene]:
    """One of them rainy with a car, the others dark."""
    dark = [Scene(name="town", road=RoadSpec(length_m=length_m), **SHORT) for length_m in lengths_m[1:]]
    car = VehicleSpec(timetable=((0.0, 300.0), (10.0, 100.0)))
    lit = Scene(
        name="queue",
        road=RoadSpec(length_m=lengths_m[0], traffic="left"),
        vehicles=(car, car.model_copy(update={"beam": "off"})),
        weather=WeatherSpec(rain_mm_h=2.0),
        **SHORT,
    )
    return [lit, *dark]


def write(out: Path, split: str, drawn: list[Scene], seed: int | None = 5) -> None:
    simulate_dataset(out, drawn, drive, DatasetConfig(split=split, seed=seed))


def test_the_card_counts_drives_images_and_minutes(tmp_path: Path) -> None:
    write(tmp_path, "train", scenes(400, 500, 600))
    write(tmp_path, "val", scenes(410, 510))
    text = write_data_card(tmp_path).read_text()
    assert "20 images, 60% of the minutes without any vehicle's light" in text
    assert "| `night/train` | 3 | 12 |" in text
    assert "| town | 3 |" in text
    assert "| car | 2 |" in text
    assert "| left-hand traffic | 2 |" in text
    assert "seed 5" in text


def test_scenes_of_ones_own_have_no_seed_of_a_draw(tmp_path: Path) -> None:
    write(tmp_path, "train", scenes(400, 500), seed=None)
    assert ", of scenes that were not drawn; no two" in write_data_card(tmp_path).read_text()


def test_cameras_of_the_same_drives_are_counted_once(tmp_path: Path) -> None:
    for camera in ("phone", "dashcam"):
        write(tmp_path / camera, "train", scenes(400, 500))
    text = write_data_card(tmp_path).read_text()
    assert "16 images" in text
    assert "| queue | 1 |" in text


def test_a_road_in_two_splits_is_an_error(tmp_path: Path) -> None:
    write(tmp_path, "train", scenes(400, 500))
    write(tmp_path / "other", "test", scenes(450, 500))
    (tmp_path / "other" / "night" / "test").rename(tmp_path / "night" / "test")
    with pytest.raises(ValueError, match="expected roads of its own"):
        write_data_card(tmp_path)
    assert not (tmp_path / FILE).exists()


def test_nothing_to_describe(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected simulated splits"):
        write_data_card(tmp_path)


def test_a_drive_that_is_missing(tmp_path: Path) -> None:
    write(tmp_path, "train", scenes(400, 500))
    folder = tmp_path / "night" / "train" / "simulation" / "S00002"
    folder.rename(folder.with_name(".S00002.partial"))
    with pytest.raises(ValueError, match="expected all 2 drives, 1 are missing"):
        write_data_card(tmp_path)
