from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.calibration import calibration_to_toml
from foreglow.geometry import Pose
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from foreglow.lab.simulation.writing.truth_files import SceneFile, SceneWriter, read_truth
from foreglow.lab.simulation.writing.truth_records import FrameTruth
from tests.lab.simulation.stub_drive import drive, scene

SCENES = [scene(1), scene(2, num_frames=2)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_dataset(tmp_path_factory.mktemp("whole"), SCENES, drive).root


@pytest.fixture
def split(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "train"))


def plain(value: Any) -> Any:
    """`value` as nested lists and dicts; NaN becomes None, so that two values compare."""
    if isinstance(value, Pose):
        return [plain(value.position_m), plain(value.rotation)]
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    return None if isinstance(value, float) and np.isnan(value) else value


def test_truth_comes_back_exactly(whole: Path) -> None:
    truth = read_truth(whole)
    assert (len(truth), truth.sequence_ids) == (2, (1, 2))
    for sequence, given in zip(truth, SCENES, strict=True):
        assert sequence.scene.model_copy(update={"sensor": given.sensor}) == given
        assert sequence.scene.sensor.exposure == "night"
        assert sequence.directory == f"S{sequence.sequence_id:05d}"
        driven = list(drive(given))
        assert calibration_to_toml(sequence.camera) == calibration_to_toml(driven[0].camera)
        for place, (frame, known) in enumerate(zip(sequence.frames, driven, strict=True)):
            image_id = sequence.sequence_id * 10000 + place
            assert plain(frame) == plain(FrameTruth.of(image_id, known, frame.street))
            assert sequence.frame(image_id) is frame


def test_a_sequence_by_its_image(whole: Path) -> None:
    assert read_truth(whole).sequence_of(20001).sequence_id == 2


def test_depth_is_the_exact_one_where_an_echo_came(whole: Path) -> None:
    sequence = read_truth(whole).sequence(1)
    for frame, known in zip(sequence.frames, drive(SCENES[0]), strict=True):
        depth_m = sequence.depth_m(frame.image_id)
        is_echo = np.isfinite(depth_m)
        assert is_echo.any()
        assert np.abs(depth_m - known.depth_m)[is_echo].max() < 0.12  # six times the noise


def test_the_road_ahead_and_the_message_agree(whole: Path) -> None:
    sequence = read_truth(whole).sequence(1)
    frame = sequence.frames[2]
    road = Road(SCENES[0].road)
    ahead = sequence.road_ahead(frame.image_id, 100.0)
    assert ahead.shape == (101, 3)
    np.testing.assert_allclose(frame.ego_pose.to_outer(ahead[60]), road.points(frame.ego_s_m + 60.0), atol=1e-9)
    assert frame.street.error_bound_m == sequence.frames[0].street.error_bound_m
    assert sum(one.length_m for one in frame.street.segments) >= 400


def test_road_file_is_the_centre_line(whole: Path) -> None:
    file = json.loads((whole / "simulation/S00001/road.json").read_text())
    assert file["s_m"] == list(range(301))
    assert file["lane_width_m"] == 3.5
    np.testing.assert_allclose(file["points_world_m"], Road(SCENES[0].road).points(np.arange(301.0)), atol=1e-4)


def test_scenes_file_has_every_scene(whole: Path) -> None:
    lines = [json.loads(line) for line in (whole / "scenes.jsonl").read_text().splitlines()]
    assert [line["sequence"] for line in lines] == [1, 2]
    assert [line["scene"]["name"] for line in lines] == ["stub 1", "stub 2"]


def test_nan_is_null(whole: Path) -> None:
    text = (whole / "simulation/S00001/frames.jsonl").read_text()
    assert "NaN" not in text
    vehicle = json.loads(text.splitlines()[1])["vehicles"][0]
    assert vehicle["lamps"][1]["position_px"] is None
    assert vehicle["artifacts"][1]["depth_m"] is None
    assert vehicle["candidates"][1][:4] == [1, *vehicle["artifacts"][1]["position_px"], "haze"]


def _edit_frame(root: Path, *keys: str | int, value: object) -> None:
    path = root / "simulation/S00001/frames.jsonl"
    lines = path.read_text().splitlines()
    document = json.loads(lines[1])
    target = document
    for key in keys[:-1]:
        target = target[key]
    if value is None:
        del target[keys[-1]]
    else:
        target[keys[-1]] = value
    path.write_text("\n".join([lines[0], json.dumps(document), *lines[2:]]))


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("ego_speed_mps",), None, r"frames\.jsonl: line 2: ego_speed_mps: field is missing"),
        (("ego_speed_mps",), "fast", r"line 2: ego_speed_mps: expected a valid number, got 'fast'"),
        (("ego_speed",), 3.0, r"line 2: ego_speed: Extra inputs are not permitted, got 3\.0"),
        (("image_id",), 10007, r"line 2: image_id: expected 10001, got 10007"),
        (("category",), 9, r"line 2: category: expected 0, 1, 2.*, got 9"),
        (("vehicles", 0, "artifacts", 0, "kind"), "moon", r"artifacts\.0\.kind: expected one of lamp, .*, got 'moon'"),
        (("vehicles", 0, "candidates", 0), [1, 2.0], r"vehicles\.0\.candidates\.0\.2: field is missing"),
        (("street", "error_class"), 6, r"street\.error_class: .* less than 6, got 6"),
    ],
)
def test_a_broken_line_names_path_line_and_field(
    split: Path, keys: tuple[str | int, ...], value: object, message: str
) -> None:
    _edit_frame(split, *keys, value=value)
    with pytest.raises(ValueError, match=message):
        read_truth(split).sequence(1)


@pytest.mark.parametrize("name", ["scene.json", "camera.toml", "frames.jsonl"])
def test_a_missing_file_is_named(split: Path, name: str) -> None:
    (split / "simulation/S00002" / name).unlink()
    truth = read_truth(split)
    assert truth.sequence(1).sequence_id == 1
    with pytest.raises(FileNotFoundError, match=f"S00002/{name}"):
        truth.sequence(2)


def test_a_split_without_truth(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"simulation/info\.json: no such file"):
        read_truth(tmp_path)


def test_unknown_sequences_and_images(whole: Path) -> None:
    truth = read_truth(whole)
    with pytest.raises(ValueError, match=r"sequence: expected one of \(1, 2\), got 3"):
        truth.sequence(3)
    for image_id in (9999, 10003, 20000):
        with pytest.raises(ValueError, match=f"S00001: image_id: expected an image of this sequence, got {image_id}"):
            truth.sequence(1).frame(image_id)


def test_broken_depth_images(split: Path) -> None:
    folder = split / "simulation/S00001/depth"
    sequence = read_truth(split).sequence(1)
    (folder / "000000.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"depth/000000\.png"):
        sequence.depth_m(10000)
    shutil.copy(split / "images/S00001/010001.png", folder / "000001.png")
    with pytest.raises(ValueError, match=r"000001\.png: expected an image of 16 bits, got uint8"):
        sequence.depth_m(10001)
    resized = dataclasses.replace(sequence, camera=sequence.camera.scaled(48, 36))
    with pytest.raises(ValueError, match=r"000002\.png: image size: expected 48x36 px as in camera\.toml, got 96x72"):
        resized.depth_m(10002)


def test_a_calibration_that_changes_is_refused(whole: Path, tmp_path: Path) -> None:
    file = SceneFile.model_validate_json((whole / "simulation/S00001/scene.json").read_text())
    writer = SceneWriter(tmp_path, file)
    frame = read_truth(whole).sequence(1).frames[0]
    camera = next(drive(SCENES[0])).camera
    depth = np.zeros((camera.height_px, camera.width_px), np.uint16)
    writer.add(frame, camera, depth)
    other = dataclasses.replace(camera, focal_px=(99.0, 99.0))
    with pytest.raises(ValueError, match="image 10000: camera: expected the drive's calibration to stay"):
        writer.add(frame, other, depth)


def test_a_number_that_is_not_finite_is_refused(whole: Path, tmp_path: Path) -> None:
    file = SceneFile.model_validate_json((whole / "simulation/S00001/scene.json").read_text())
    frame = dataclasses.replace(read_truth(whole).sequence(1).frames[0], ego_speed_mps=float("nan"))
    camera = next(drive(SCENES[0])).camera
    with pytest.raises(ValueError, match="ego_speed_mps"):
        SceneWriter(tmp_path, file).add(frame, camera, np.zeros((72, 96), np.uint16))
    with pytest.raises(ValueError, match="frames: expected at least one, the drive had none"):
        SceneWriter(tmp_path, file).close()
