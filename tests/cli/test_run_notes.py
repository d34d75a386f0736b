"""What `run` and its like say of their source, their model and the car's data, beside the counts."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.config import config_to_toml, preset
from foreglow.datasets import Video, shipped_drive
from foreglow.datasets.vehicle_logs import write_can_log
from foreglow.models import model_path
from foreglow.runs.recorded_run import read_run
from foreglow.runs.summary_file import read_summary
from foreglow.types import EgoMotion
from tests.cli.commands import foreglow_command
from tests.datasets.video.test_damage import GOP, packets_of, write_h264
from tests.datasets.video.test_video_file import make_video
from tests.stand_ins import night_image


def test_a_run_says_what_to_expect(tmp_path: Path, folder: Path, config: Path) -> None:
    shipped = foreglow_command("run", shipped_drive(), "--out", tmp_path / "a", "--limit", 4)
    (line,) = [line for line in shipped.stdout.splitlines() if line.startswith("camera: ")]
    assert line.startswith("camera: like pvdn_")
    assert "the model has seen simulated drives only, so look at the result" in line
    others = foreglow_command("run", folder, "--out", tmp_path / "c", "--config", config)
    assert "the model has seen simulated drives only, and other boxes, so look at the result" in others.stdout
    made_up = foreglow_command("run", folder, "--out", tmp_path / "b", "--config", config, "--preset", "paper")
    assert "camera: unknown, like no profile of the simulator\n" in made_up.stdout, "and no model of ours ran"


def test_a_run_on_other_boxes_than_those_of_its_model_says_so(tmp_path: Path, folder: Path) -> None:
    """That was said of the model that ships only, not of one that was trained."""
    model, own, out = tmp_path / "model.onnx", tmp_path / "own.toml", tmp_path / "out"
    shutil.copyfile(model_path(Path("foreglow")), model)
    (tmp_path / "config.toml").write_text(config_to_toml(preset("foreglow").changed("classifier", model=model)))
    line = "the model has seen other boxes, so look at the result before you trust it"
    for fields, is_said in (("kappa = 0.4", True), ('backend = "reference"', False)):
        own.write_text(f"[proposals]\n{fields}\n")
        given = foreglow_command("run", folder, "--config", own, "--model", model, "--out", out)
        assert given.exit_code == 0, given.output
        assert (line in given.stdout) == is_said
    own.write_text(f'[proposals]\nkappa = 0.4\n[classifier]\nmodel = "{model}"\n')
    assert line in foreglow_command("run", folder, "--config", own, "--out", out).stdout
    live = foreglow_command("live", folder, "--speed", 0, "--config", own, "--out", tmp_path / "live")
    assert "the model has seen other boxes than those of this configuration" in live.stdout
    (tmp_path / "config.toml").write_text("broken")  # the run is done: what cannot be read says nothing
    assert foreglow_command("run", folder, "--config", own, "--out", out).exit_code == 0


@pytest.mark.parametrize("jobs", [1, 2])
def test_frames_that_are_kept_although_damaged_are_counted_and_marked(tmp_path: Path, jobs: int) -> None:
    """Nothing told boxes of broken pictures from others."""
    film, out = tmp_path / "night.mp4", tmp_path / "out"
    write_h264(film, "yuv420p", "slices=1")
    position, size = packets_of(film)[GOP + 3]
    data = bytearray(film.read_bytes())
    data[position + size // 2 : position + size * 3 // 4] = bytes(size * 3 // 4 - size // 2)
    film.write_bytes(bytes(data))
    done = foreglow_command("run", film, "--on-error", "mark", "--jobs", jobs, "--out", out)
    assert (f"{film}: a single sequence, so that one job does all of the work" in done.stderr) == (jobs == 2)
    assert done.exit_code == 0, done.output
    num_damaged = sum(frame.is_damaged for frame in Video(film, on_error="mark"))
    assert num_damaged > 1
    assert read_summary(out / "summary.json").num_damaged == num_damaged
    lines = [json.loads(line) for line in (out / "frames.jsonl").read_text().splitlines()]
    assert [line["is_damaged"] for line in lines if "is_damaged" in line] == [True] * num_damaged
    assert f"{num_damaged} frames are damaged, marked by is_damaged in their lines" in done.stdout
    assert read_run(out).sequences.keys() == {""}
    assert foreglow_command("report", out).exit_code == 0
    page = (out / "report.html").read_text()
    assert re.search(rf"damaged frames, marked</t[hd]>\s*<td[^>]*>{num_damaged}<", page)


@pytest.mark.parametrize(
    ("factor", "white_level", "is_told"),
    [(16, None, True), (16, 4080, False), (64, None, True), (257, None, False), (257, 4095, False)],
)
@pytest.mark.parametrize(("command", "out"), [("run", "out"), ("record", "out.mcap")])
def test_images_that_seem_to_have_fewer_bits_than_their_type_are_told(
    command: str, out: str, factor: int, white_level: int | None, is_told: bool, tmp_path: Path, config: Path
) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for number in range(3):
        cv2.imwrite(str(images / f"{number:06d}.png"), night_image(number).astype(np.uint16) * np.uint16(factor))
    if white_level is not None:
        config.write_text(f"{config.read_text()}\n[guard]\nwhite_level = {white_level}\n")
    ran = foreglow_command(command, images, "--out", tmp_path / out, "--config", config)
    assert ran.exit_code == 0
    assert ("images of 16 bits, none brighter than" in ran.stdout) is is_told
    is_beyond = white_level is not None and factor > 16
    assert ("far beyond the white level of" in ran.stdout) is is_beyond, "all is white, as with the white of a PGM"


def test_a_log_of_another_time_is_told(tmp_path: Path, folder: Path, config: Path) -> None:
    pytest.importorskip("can")
    log = tmp_path / "drive.log"
    write_can_log(log, [], [(k * 10_000_000, EgoMotion(20.0, 0.0)) for k in range(50)])
    words = ("run", folder, "--preset", "paper", "--config", config, "--can-log", log)
    told = f"{log} says nothing of any frame: expected data of their times (--time-offset)"
    few = f"{log}: our motion is known in 1 of 3 frames, and at most 0.5 s after a message: it begins later, ends "
    for number, (offset_s, is_told, is_few) in enumerate([(0, False, False), (0.1, False, True), (100, True, False)]):
        result = foreglow_command(*words, "--out", tmp_path / f"{number}", "--time-offset", offset_s)
        assert result.exit_code == 0, result.output
        assert ((told in result.stdout), (few in result.stdout)) == (is_told, is_few)


def with_poses(folder: Path, times_s: tuple[float, ...]) -> tuple[str | Path, ...]:
    road, poses = folder / "road.geojson", folder / "drive.csv"
    road.write_text(json.dumps({"type": "LineString", "coordinates": [[9.0, 48.0], [9.0, 48.1]]}))
    rows = [f"{time_s},48.05,9.0,0.0" for time_s in times_s]
    poses.write_text("\n".join(["timestamp_s,lat_deg,lon_deg,heading_deg", *rows]))
    return "--map", road, "--poses", poses


@pytest.mark.parametrize(
    ("times_s", "offset_s", "num_known"),
    [((0.0, 0.1, 0.2), 0, 3), ((0.0, 100.0, 200.0), 0, 1), ((0.0, 0.06), 0, 2), ((0.0, 0.1, 0.2), 100, 0)],
)
def test_poses_of_few_frames_are_told(
    times_s: tuple[float, ...], offset_s: float, num_known: int, tmp_path: Path, folder: Path, config: Path
) -> None:
    """Such as those whose times are milliseconds, or that end early: the road was unknown with nothing said."""
    given = (*with_poses(tmp_path, times_s), "--time-offset", offset_s)
    result = foreglow_command("run", folder, "--preset", "paper", "--config", config, *given, "--out", tmp_path / "out")
    poses = tmp_path / "drive.csv"
    assert result.exit_code == 0, result.output
    assert read_summary(tmp_path / "out" / "summary.json").num_with_road == num_known
    few = f"{poses}: the road is known in {num_known} of 3 frames: the poses begin later, end earlier (--time-offset)"
    assert (few in result.stdout) is (num_known in (1, 2))
    assert (f"{poses} says nothing of any frame" in result.stdout) is (num_known == 0)


@pytest.mark.slow
def test_a_replay_tells_it_as_a_run_does(tmp_path: Path, folder: Path) -> None:
    given = with_poses(tmp_path, (0.0, 100.0, 200.0))
    result = foreglow_command("live", folder, "--speed", 0, *given)
    assert result.exit_code == 0, result.output
    assert f"{tmp_path / 'drive.csv'}: the road is known in 1 of 3 frames" in result.stdout


def test_a_log_of_another_time_beside_poses_is_told(tmp_path: Path, folder: Path, config: Path) -> None:
    """The roads of the poses were taken for what it says."""
    pytest.importorskip("can")
    log = tmp_path / "drive.log"
    write_can_log(log, [], [(100_000_000_000 + k * 10_000_000, EgoMotion(20.0, 0.0)) for k in range(50)])
    given = (*with_poses(tmp_path, (0.0, 0.1, 0.2)), "--can-log", log)
    result = foreglow_command("run", folder, "--preset", "paper", "--config", config, *given, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert f"{log}: our motion is known in 0 of 3 frames, and at most 0.5 s after a message" in result.stdout


def test_images_that_are_missing_are_told(tmp_path: Path, folder: Path, config: Path) -> None:
    images = sorted(folder.iterdir())
    drive = tmp_path / "numbered"
    drive.mkdir()
    for number, image in zip((1, 2, 4, 5, 6, 7), images * 6, strict=False):
        shutil.copyfile(image, drive / f"{number:04}{image.suffix}")
    result = foreglow_command("run", drive, "--config", config, "--preset", "paper", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert f"{drive}: 1 image is missing by the numbers of the others, first between 2 and 4" in result.stdout


def test_a_raw_stream_says_its_rate(tmp_path: Path, config: Path) -> None:
    path = make_video(tmp_path / "drive.h264", codec="libx264", num_frames=4, rate_hz=50)
    for command in (("run", path), ("run", path, "--jobs", "2"), ("demo", path)):
        given = ("--config", config) if command[0] == "run" else ()
        result = foreglow_command(*command, *given, "--out", tmp_path / "out")
        assert result.exit_code == 0, result.output
        assert f"{path}: a raw stream has no times: taken for 50 frames a second" in result.stdout
        shutil.rmtree(tmp_path / "out")


@pytest.mark.slow
def test_a_replay_of_images_says_which_rate_is_assumed_as_a_run_does(tmp_path: Path, folder: Path) -> None:
    for command in (("run",), ("live", "--speed", 0)):
        result = foreglow_command(*command, folder, "--out", tmp_path / command[0])
        assert result.exit_code == 0, result.output
        assert f"{folder}: images have no times: taken for 18 frames a second; " in result.stdout
