"""`foreglow calibrate`, as a user types it."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.calibration import auto, read_calibration
from foreglow.cli.shared_calibration import calibrate_source
from foreglow.options import LensOptions, SourceOptions
from tests.calibration.roads import drive
from tests.calibration.test_kitti import CAM_TO_CAM, ODOMETRY
from tests.calibration.test_ros import TEXT as ROS
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.video.test_video_file import make_video
from tests.stand_ins import night_image

MOUNT = ("--mount-forward", "1.9", "--mount-height", "1.3", "--pitch-deg", "-1")


def converted(tmp_path: Path, *arguments: object) -> Path:
    out = tmp_path / "camera.toml"
    result = foreglow_command("calibrate", "convert", *arguments, "--out", out, *MOUNT)
    assert result.exit_code == 0, result.output
    return out


def test_convert_and_check(tmp_path: Path) -> None:
    (tmp_path / "front.yaml").write_text(ROS)
    camera = converted(tmp_path, tmp_path / "front.yaml")
    assert read_calibration(camera).vehicle_from_camera.position_m.tolist() == [1.9, 0, 1.3]
    image, picture = tmp_path / "image.png", tmp_path / "check.png"
    cv2.imwrite(str(image), night_image(0, 960, 1280))
    result = foreglow_command("calibrate", "check", camera, image, "--out", picture)
    assert result.exit_code == 0, result.output
    assert "1.30 m above the road, points 1.00 degrees down" in result.stdout
    assert cv2.imread(str(picture)) is not None
    cv2.imwrite(str(image), night_image(0, 400, 640))
    said = complaint("calibrate", "check", camera, image, "--out", picture)
    assert "image.png: size: expected 1280x960 px as the calibration has it, got 640x400 px" in said


def test_convert_tells_of_a_mount_that_it_leaves_out(tmp_path: Path) -> None:
    (tmp_path / "front.yaml").write_text(ROS)
    whole, out = converted(tmp_path, tmp_path / "front.yaml"), tmp_path / "other.toml"
    lens = tmp_path / "lens.toml"
    lens.write_text(whole.read_text().partition("[mount]")[0])
    for source, is_told in ((whole, True), (lens, False)):
        result = foreglow_command("calibrate", "convert", source, "--out", out, *MOUNT)
        assert result.exit_code == 0, result.output
        assert (f"warning: the mount in {source} was left out" in result.stdout) is is_told
        out.unlink()


def test_a_calibration_is_scaled_to_the_image(tmp_path: Path) -> None:
    """As `run` does with it: half as large, everything is at half the place, and in the same direction."""
    (tmp_path / "front.yaml").write_text(ROS)
    camera, image = converted(tmp_path, tmp_path / "front.yaml"), tmp_path / "image.png"
    said = []
    for height_px, width_px in ((960, 1280), (480, 640)):
        cv2.imwrite(str(image), night_image(0, height_px, width_px))
        result = foreglow_command("calibrate", "check", camera, image, "--out", tmp_path / "check.png")
        assert result.exit_code == 0, result.output
        said.append(dict(line.split(maxsplit=1) for line in result.stdout.splitlines()))
    whole, half = said
    assert half["scaled"] == "from 1280x960 px, as it is for frames of this size"
    assert "scaled" not in whole
    assert half["image"] == whole["image"].replace("1280x960", "640x480")
    assert half["camera"] == whole["camera"]
    places = [[float(text) for text in re.findall(r"[\d.]+", each["vanishing"])] for each in said]
    assert places[1] == pytest.approx([value / 2 for value in places[0]], abs=0.1)


def test_a_calibration_of_another_size_is_told(tmp_path: Path) -> None:
    """Its principal point is at the edge: the matrix is that of images twice as wide."""
    source, mount = tmp_path / "front.yaml", ("--mount-forward", 1.9, "--mount-height", 1.3)
    for text, is_told in ((ROS, False), (ROS.replace("image_width: 1280", "image_width: 640"), True)):
        source.write_text(text)
        result = foreglow_command("calibrate", "convert", source, "--out", tmp_path / "camera.toml", *mount)
        assert result.exit_code == 0, result.output
        assert ("warning: the principal point is far off the middle: cx" in result.stdout) == is_told


def test_a_mount_on_a_lorry(tmp_path: Path) -> None:
    """The options ended at 20 and 5 m, a calibration and the documentation at 30 and 10 m."""
    source = tmp_path / "front.yaml"
    source.write_text(ROS)
    convert = ("calibrate", "convert", source, "--out", tmp_path / "camera.toml")
    farthest = {"--mount-forward": 30, "--mount-left": -10, "--mount-height": 10, "--roll-deg": 45}
    result = foreglow_command(*convert, *(word for pair in farthest.items() for word in pair))
    assert result.exit_code == 0, result.output
    position_m = read_calibration(tmp_path / "camera.toml").vehicle_from_camera.position_m
    assert position_m.tolist() == [30.0, -10.0, 10.0]
    for option, limit in farthest.items():
        changed = farthest | {option: limit * 1.01}
        assert option in complaint(*convert, *(word for pair in changed.items() for word in pair))


@pytest.mark.parametrize(
    ("text", "options", "size_px"),
    [
        (CAM_TO_CAM, ("--camera", "2"), (1392, 512)),
        (CAM_TO_CAM, ("--camera", "2", "--rectified"), (1242, 375)),
        (ODOMETRY, ("--camera", "1", "--size", "1241x376"), (1241, 376)),
    ],
)
def test_convert_kitti(tmp_path: Path, text: str, options: tuple[str, ...], size_px: tuple[int, int]) -> None:
    (tmp_path / "calib.txt").write_text(text)
    camera = read_calibration(converted(tmp_path, tmp_path / "calib.txt", *options))
    assert (camera.width_px, camera.height_px) == size_px


@pytest.fixture(scope="module")
def drive_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive as images."""
    folder = tmp_path_factory.mktemp("drive")
    for frame in drive(pitch_deg=-1.0, num=24):
        cv2.imwrite(str(folder / f"{frame.frame:03d}.png"), frame.image)
    return folder


def test_check_takes_the_first_frame_of_a_drive(tmp_path: Path) -> None:
    (tmp_path / "front.yaml").write_text(ROS)
    camera, picture, folder = converted(tmp_path, tmp_path / "front.yaml"), tmp_path / "check.png", tmp_path / "drive"
    folder.mkdir()
    (folder / "000.png").write_bytes(b"broken")
    cv2.imwrite(str(folder / "001.png"), night_image(0, 480, 640))
    image = folder.with_name("image of no format")
    image.write_bytes((folder / "001.png").read_bytes())
    for source in (make_video(tmp_path / "drive.mp4"), folder, image):
        result = foreglow_command("calibrate", "check", camera, source, "--out", picture)
        assert result.exit_code == 0, result.output
        assert "scaled         from 1280x960 px" in result.stdout
    nothing = tmp_path / "nothing.mp4"
    nothing.write_bytes(b"nothing")
    said = complaint("calibrate", "check", camera, nothing, "--out", picture)
    assert "nothing.mp4: expected a video" in said
    (folder / "001.png").unlink()
    said = complaint("calibrate", "check", camera, folder, "--out", picture)
    assert "drive: expected an image or a drive, it has no frame that can be read" in said


@pytest.mark.slow
def test_auto(tmp_path: Path, drive_folder: Path) -> None:
    out = tmp_path / "camera.toml"
    result = foreglow_command("calibrate", "auto", drive_folder, "--out", out, "--focal", 450, "--mount-height", 1.3)
    assert result.exit_code == 0, result.output
    camera = read_calibration(out)
    assert 0 < camera.mount_sigmas.pitch_rad < 0.01
    assert "known to       pitch +-" in result.stdout
    assert "images have no times: taken for 18 frames a second" in result.stdout
    forward_m = camera.vehicle_from_camera.position_m[0]
    assumed = f"{forward_m:g} m in front of the rear axle, 0 m left of the middle: assumed"
    assert f"position_m     {assumed}" in result.stdout
    assert f"# position_m: {assumed}" in out.read_text()
    assert cv2.imread(str(tmp_path / "camera.png")) is not None


@pytest.mark.slow
def test_a_run_calibrates_its_camera(tmp_path: Path, drive_folder: Path) -> None:
    said = foreglow_command(
        "run", drive_folder, "--out", tmp_path, "--calibration", "auto", "--focal", 450, "--limit", 1
    )
    assert said.exit_code == 0, said.output
    camera = tmp_path / "calibration" / "camera.toml"
    again = foreglow_command("run", drive_folder, "--out", tmp_path / "again", "--calibration", camera, "--limit", 1)
    assert again.exit_code == 0, again.output
    assert (tmp_path / "frames.jsonl").read_bytes() == (tmp_path / "again" / "frames.jsonl").read_bytes()


def test_auto_complains(tmp_path: Path) -> None:
    image, out = tmp_path / "image.png", tmp_path / "camera.toml"
    cv2.imwrite(str(image), night_image())
    assert "expected a focal length" in complaint("calibrate", "auto", image, "--out", out)
    assert "expected a drive of at least 10 frames" in complaint("calibrate", "auto", image, "--out", out, "--fov", 60)
    same = complaint("calibrate", "auto", image, "--out", tmp_path / "own.png", "--fov", 60)
    assert f"--out {tmp_path / 'own.png'}: expected a file whose name ends with .toml" in same
    assert not out.exists()
    run = ("run", image, "--out", tmp_path / "run")
    assert "expected a focal length" in complaint(*run, "--calibration", "auto")
    assert "expected with --calibration auto" in complaint(*run, "--fov", 60)
    said = complaint("live", f"replay:{image}", "--calibration", "auto")
    assert "--calibration auto: expected with `foreglow run`" in said


def test_complaints(tmp_path: Path) -> None:
    (tmp_path / "front.yaml").write_text(ROS)
    out = ("--out", tmp_path / "camera.toml")
    assert "nowhere.yaml: no such file" in complaint("calibrate", "convert", tmp_path / "nowhere.yaml", *out, *MOUNT)
    said = complaint("calibrate", "convert", tmp_path / "front.yaml", *out, *MOUNT[:-1], "-91")
    assert "--pitch-deg" in said
    said = complaint("calibrate", "convert", tmp_path / "front.yaml", *out, *MOUNT, "--size", "big")
    assert "size: expected WIDTHxHEIGHT" in said
    said = complaint("calibrate", "check", tmp_path / "front.yaml", tmp_path / "a.png", "--out", tmp_path / "c.png")
    assert "front.yaml: mount: missing" in said
    assert not (tmp_path / "camera.toml").exists()


def test_a_limit_beyond_the_drive_thins_nothing_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a long drive every n-th frame is looked at: how long it is says the source."""
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((64, 64), np.uint8))
    nums: list[int] = []
    monkeypatch.setattr(auto, "calibrate_drive", lambda *_, num_frames, **__: nums.append(num_frames))
    for limit in (2, 100_000, None):
        calibrate_source(tmp_path, SourceOptions(limit=limit), LensOptions(fov=60.0))
    assert nums == [2, 3, 3]


def test_a_video_without_square_pixels_has_no_single_focal_length(tmp_path: Path) -> None:
    path = make_video(tmp_path / "hdv.mp4", pixel_aspect=Fraction(4, 3))
    said = complaint("calibrate", "auto", path, "--fov", 65, "--out", tmp_path / "camera.toml")
    assert f"{path}: expected square pixels, its pixels are 1.33 times as wide as high (" in said
    said = complaint("run", path, "--calibration", "auto", "--fov", 65, "--out", tmp_path / "out")
    assert f"{path}: expected square pixels" in said
    result = foreglow_command("run", path, "--out", tmp_path / "out")
    assert f"{path}: its pixels are 1.33 times as wide as high (" in result.stdout
