from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path
from typing import Any, Never

import numpy as np
import pytest

from foreglow.calibration import calibration_to_toml
from foreglow.datasets.simulated import FrameTruth, has_truth, read_truth
from foreglow.datasets.simulated.files import TruthWriter, decoded_depth_m, encoded_depth
from foreglow.datasets.simulated.vehicle import RecordedLux
from foreglow.geometry import Pose
from foreglow.lab.simulation.data_card import write_data_card
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from foreglow.lab.simulation.writing.scene_files import road_file, scene_of
from foreglow.lab.simulation.writing.street_data import road_ahead
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
        made_from = scene_of(sequence)
        assert made_from.model_copy(update={"sensor": given.sensor}) == given
        assert made_from.sensor.exposure == "night"
        assert sequence.scenario == given.name
        assert sequence.directory == f"S{sequence.sequence_id:05d}"
        driven = list(drive(given))
        assert calibration_to_toml(sequence.camera) == calibration_to_toml(driven[0].camera)
        for number, (frame, known) in enumerate(zip(sequence.frames, driven, strict=True)):
            image_id = sequence.sequence_id * 10000 + number
            expected = dataclasses.replace(known, image_id=image_id, street=frame.street)
            assert plain(frame) == {name: value for name, value in plain(expected).items() if name in plain(frame)}
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
    ahead = road_ahead(Road(scene_of(sequence).road), frame.ego_s_m, frame.ego_pose, 100.0)
    assert ahead.shape == (101, 3)
    np.testing.assert_allclose(frame.ego_pose.to_outer(ahead[60]), road.points(frame.ego_s_m + 60.0), atol=1e-9)
    assert frame.street.error_bound_m == sequence.frames[0].street.error_bound_m
    assert sum(segment.length_m for segment in frame.street.segments) >= 400


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
        (("ego_speed",), 3.0, r"line 2: ego_speed: field is unknown, got 3\.0"),
        (("image_id",), 10007, r"line 2: image_id: expected 10001, got 10007"),
        (("category",), 9, r"line 2: category: expected 0, 1, 2.*, got 9"),
        (("vehicles", 0, "artifacts", 0, "kind"), "moon", r"artifacts\.0\.kind: expected 'lamp', .*, got 'moon'"),
        (("vehicles", 0, "candidates", 0), [1, 2.0], r"vehicles\.0\.candidates\.0\.2: expected one more entry"),
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


@pytest.mark.parametrize("content", [None, "", "{}", "[1]", '{"seed": 1'])
def test_what_reads_a_split_says_that_its_info_is_gone_or_damaged(split: Path, content: str | None) -> None:
    """It counted as another data set: figures lost their scenarios, and a data card the whole split."""
    path = split / "simulation" / "info.json"
    path.unlink() if content is None else path.write_text(content)
    assert has_truth(split)
    words = re.escape(str(path)) + ".*`foreglow simulate`, as it made this split, writes it again and keeps the drives"
    for read in (read_truth, RecordedLux, write_data_card):
        with pytest.raises((FileNotFoundError, ValueError), match=words):
            read(split)


def test_a_lost_info_is_written_again_and_the_drives_are_kept(tmp_path: Path) -> None:
    root = simulate_dataset(tmp_path, SCENES, drive).root
    info = root / "simulation" / "info.json"
    content = info.read_bytes()
    info.unlink()

    def fail(_: object) -> Never:
        raise AssertionError("driven again")

    assert simulate_dataset(tmp_path, SCENES, fail).root == root
    assert info.read_bytes() == content


def test_unknown_sequences_and_images(whole: Path) -> None:
    truth = read_truth(whole)
    with pytest.raises(ValueError, match=r"sequence: expected one of \(1, 2\), got 3"):
        truth.sequence(3)
    for image_id in (9999, 10003, 20000):
        with pytest.raises(ValueError, match=rf"S00001/frames\.jsonl: expected a line about image {image_id}, got \d"):
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
    writer = TruthWriter(tmp_path)
    frame = read_truth(whole).sequence(1).frames[0]
    camera = next(drive(SCENES[0])).camera
    depth = np.zeros((camera.height_px, camera.width_px), np.uint16)
    writer.add(frame, camera, depth)
    other = dataclasses.replace(camera, focal_px=(99.0, 99.0))
    with pytest.raises(ValueError, match="image 10000: camera: expected the drive's calibration to stay"):
        writer.add(frame, other, depth)


def test_a_number_that_is_not_finite_is_refused(whole: Path) -> None:
    frame = read_truth(whole).sequence(1).frames[1]
    (vehicle,) = frame.vehicles
    hazy, lamp = vehicle.artifacts[1], vehicle.lamps[0]
    for wrong, message in (
        (dataclasses.replace(frame, ego_speed_mps=float("nan")), "image 10001: ego_speed_mps: expected a finite"),
        (dataclasses.replace(frame, ego_eye_lx={"0": float("inf")}), r"ego_eye_lx\.0: expected a finite"),
        (_with_vehicle(frame, artifacts=(dataclasses.replace(hazy, depth_m=float("inf")),)), r"0\.depth_m: .* finite"),
        (
            _with_vehicle(frame, candidates=(dataclasses.replace(hazy, grey=float("nan")),)),
            r"candidates\.0\.8: .* valid",
        ),
        (
            _with_vehicle(frame, lamps=(dataclasses.replace(lamp, position_world_m=np.full(3, np.nan)),)),
            r"lamps\.0\.position_world_m\.0: .* finite",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            wrong.to_line()


def _with_vehicle(frame: FrameTruth, **fields: Any) -> FrameTruth:
    return dataclasses.replace(frame, vehicles=(dataclasses.replace(frame.vehicles[0], **fields),))


def test_a_drive_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="frames: expected at least one, the drive had none"):
        TruthWriter(tmp_path).close("{}", road_file(SCENES[0]))


def test_a_number_of_numpy_is_written_as_a_number(whole: Path) -> None:
    frame = read_truth(whole).sequence(1).frames[1]
    given = _with_vehicle(frame, speed_mps=np.float64(2), size_m=(4, 2, 1), range_m=np.float32(8))
    stored = json.loads(given.to_line())["vehicles"][0]
    assert [stored["speed_mps"], stored["range_m"], *stored["size_m"]] == [2.0, 8.0, 4.0, 2.0, 1.0]
    assert b'"size_m":[4.0,2.0,1.0]' in given.to_line()


def test_codes_of_depth() -> None:
    metres = np.array([0.25, 1.0, 200.0])
    np.testing.assert_array_equal(decoded_depth_m(encoded_depth(metres)), metres)
    assert np.isnan(decoded_depth_m(encoded_depth([np.nan]))).all()
    assert encoded_depth([300.0, -1.0]).tolist() == [65535, 0]
