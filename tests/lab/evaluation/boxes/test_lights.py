"""The labelled lights: groups that a detector is measured in."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from foreglow.datasets import PVDN, Selection
from foreglow.lab.evaluation.boxes.lights import Light, empty_images, read_lights, unsaid
from foreglow.lab.simulation.writing.dataset import DatasetConfig, simulate_dataset
from tests.datasets.tiny_pvdn import edit, make_pvdn
from tests.lab.simulation.stub_drive import drive, scene


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lights")
    return simulate_dataset(folder, [scene(1), scene(2)], drive, DatasetConfig(split="val")).root


def all_lights(dataset: PVDN) -> list[Light]:
    return [light for lights in read_lights(dataset).values() for light in lights]


def test_every_keypoint_is_a_light(simulated: Path) -> None:
    dataset = PVDN(simulated)
    lights = read_lights(dataset)
    assert tuple(lights) == dataset.frame_ids
    for image_id, its in lights.items():
        assert [light.position_px for light in its] == [tuple(map(float, p)) for p in dataset.keypoints_px(image_id)]


def test_truth_fills_in_kind_range_and_strength(simulated: Path) -> None:
    lights = all_lights(PVDN(simulated))
    assert any(not light.is_direct for light in lights)
    for light in lights:
        assert (light.kind == "lamp") == light.is_direct
        assert light.kind != "indirect"
        assert light.range_m > 0
        assert light.grey > 0


def test_ranks_follow_the_strength(simulated: Path) -> None:
    for lights in read_lights(PVDN(simulated)).values():
        indirect = sorted((light for light in lights if not light.is_direct), key=lambda light: light.rank)
        assert [light.rank for light in indirect] == list(range(len(indirect)))
        assert [light.grey for light in indirect] == sorted((light.grey for light in indirect), reverse=True)
        assert all(light.rank == -1 for light in lights if light.is_direct)


def test_labels_alone(tmp_path: Path) -> None:
    lights = all_lights(PVDN(make_pvdn(tmp_path)))
    assert {light.kind for light in lights} <= {"lamp", "indirect"}
    assert all(math.isnan(light.range_m) and math.isnan(light.grey) for light in lights)


def test_hidden_until_the_first_lamp(tmp_path: Path) -> None:
    split = make_pvdn(tmp_path)
    dataset = PVDN(split)
    image_ids = sorted(dataset.sequences[0].image_ids)
    instance = {"pos": [5, 5], "iid": 1, "direct": False, "rear": False}
    for index, image_id in enumerate(image_ids):
        vehicle = {"pos": [5, 5], "oid": 3, "direct": False, "instances": [instance | {"direct": index == 1}]}
        edit(split / "labels" / "keypoints" / f"{image_id:06d}.json", "annotations", value=[vehicle])
    assert len(image_ids) >= 2
    lights = read_lights(PVDN(split))
    assert [lights[image_id][0].is_hidden for image_id in image_ids] == [True] + [False] * (len(image_ids) - 1)
    # The rest of the sequence counts also where it is not selected.
    later = PVDN(split, select=Selection(scenes=[dataset.sequences[0].id]))
    later.frame_ids = tuple(image_ids[-1:])
    assert [light.is_hidden for light in read_lights(later)[image_ids[-1]]] == [False]


def test_doubtful_light_is_no_light_but_no_emptiness(simulated: Path) -> None:
    dataset = PVDN(simulated)
    empty = set(empty_images(dataset))
    for image_id in dataset.frame_ids:
        has_none = not dataset.annotations(image_id) and not dataset.doubtful(image_id)
        assert (image_id in empty) == has_none


def test_truth_that_does_not_know_an_instance(tmp_path: Path) -> None:
    split = simulate_dataset(tmp_path, [scene(1)], drive, DatasetConfig(split="val")).root
    image_id = next(frame_id for frame_id in PVDN(split).frame_ids if PVDN(split).annotations(frame_id))
    path = split / "labels" / "keypoints" / f"{image_id:06d}.json"
    edit(path, "annotations", 0, "instances", 0, "iid", value=999)
    words = rf"S00001/frames\.jsonl: image {image_id}: expected instance 999 of vehicle \d+, as the labels have it"
    with pytest.raises(ValueError, match=words):
        read_lights(PVDN(split))


def test_truth_that_ends_before_the_labels(tmp_path: Path) -> None:
    split = simulate_dataset(tmp_path, [scene(1)], drive, DatasetConfig(split="val")).root
    path = split / "simulation" / "S00001" / "frames.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]))
    words = rf"frames\.jsonl: expected a line about image {9999 + len(lines)}, got {len(lines) - 1} from image 10000 on"
    with pytest.raises(ValueError, match=words):
        read_lights(PVDN(split))


@pytest.mark.parametrize(
    ("lights", "said"),
    [
        ((), []),
        (((1, 5, True),), []),
        (((1, 5, False),), ["no light is marked as direct"]),
        (((1, 5, True), (2, 5, False)), []),
        (((1, 5, True), (1, 6, False), (2, 7, False)), ["no vehicle has light in two images"]),
        (((1, 5, False), (2, 6, False)), ["no light is marked as direct", "no vehicle has light in two images"]),
        (((1, 5, True), (11, 6, True)), []),
    ],
)
def test_what_labels_do_not_say(lights: tuple[tuple[int, int, bool], ...], said: list[str]) -> None:
    """Image, vehicle and whether it is a lamp; images from 10 on are of another sequence."""
    found: dict[int, tuple[Light, ...]] = dict.fromkeys((1, 2, 3, 11), ())
    for image_id, vehicle_id, is_direct in lights:
        light = Light(
            image_id, image_id // 10, vehicle_id, (5.0, 5.0), "lamp", is_direct, is_rear=False, is_hidden=True
        )
        found[image_id] += (light,)
    lines = unsaid(found)
    assert len(lines) == len(said)
    assert all(line.startswith(words) for line, words in zip(lines, said, strict=True))
