"""`foreglow simulate` and `foreglow experiment simulator`, as a user types them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from foreglow.cli import app
from foreglow.lab import simulation
from foreglow.lab.simulation import DatasetConfig, Scene, Split, draw_scenes, read_scene, scene_to_toml
from foreglow.lab.simulation.preview import preview
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, VehicleSpec
from tests.cli.commands import complaint

pytestmark = pytest.mark.slow


def foreglow(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive towards a car."""
    return scene_of(tmp_path_factory.mktemp("scene"))


def scene_of(folder: Path) -> Path:
    single = Scene(
        name="mine",
        duration_s=4 / 18,
        road=RoadSpec(length_m=150.0),
        vehicles=(VehicleSpec(timetable=((0.0, 90.0), (10.0, -110.0))),),
        ego=EgoSpec(timetable=((0.0, 20.0), (10.0, 220.0))),
    )
    folder.mkdir(exist_ok=True)
    path = folder / "mine.toml"
    path.write_text(scene_to_toml(single))
    return path


def test_a_scene_of_ones_own_keeps_what_no_option_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It became 18 frames a second of 1280x960 in the short exposure, whatever it said, and nothing told."""
    made: list[tuple[Scene, DatasetConfig]] = []
    monkeypatch.setattr(
        "foreglow.cli.simulate._simulate", lambda scenes, _, config, *__: made.append((scenes[0], config))
    )
    path = scene_of(tmp_path)
    own = read_scene(path).model_dump() | {"rate_hz": 10.0, "pair_s": 0.05}
    own["camera"] |= {"width_px": 320, "height_px": 200}
    own["sensor"]["exposure"] = "night"
    path.write_text(scene_to_toml(Scene.model_validate(own)))
    foreglow("simulate", "--out", tmp_path / "a", "--scene", path)
    assert made[0][0] == read_scene(path)
    assert made[0][1].cycle == "night"
    foreglow("simulate", "--out", tmp_path / "b", "--scene", path, "--fps", 5, "--cycle", "day", "--size", "160x100")
    scene, config = made[1]
    assert (scene.rate_hz, scene.sensor.exposure, scene.camera.width_px, config.cycle) == (5.0, "day", 160, "day")
    both = ("simulate", "--out", tmp_path / "c", "--scene", path, "--scene", scene_of(tmp_path / "other"))
    assert "--cycle: expected one, as the scenes have both day and night" in complaint(*both)


@pytest.fixture(scope="module")
def data(scene_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated data set of two copies of that drive."""
    out = tmp_path_factory.mktemp("data") / "DATA"
    result = foreglow(
        "simulate", "--out", out, "--scene", scene_file, "--scene", scene_file, "--size", "160x120", "--quality", "fast"
    )
    assert "2 drives, 8 images" in result.stdout
    return out


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        (("--quality", "best"), "quality: expected one of fast, training, fine, got 'best'"),
        (("--size", "9x9"), "width_px"),
        (("--size", "large"), "size: expected WIDTHxHEIGHT"),
        (("--size", "１２８０x９６０"), "size: expected WIDTHxHEIGHT"),
        (("--size", "0x0"), "size: expected WIDTHxHEIGHT such as 1280x960, of at most 8192 px a side, got '0x0'"),
        (("--size", "99999x64"), "of at most 8192 px a side"),
        (("--pairs", "5"), "--pairs: expected below two frames of --fps, 0.111111 s, got 5"),
        (("--cycle", "dawn"), "cycle: expected one of"),
        (("--ego-beam", "none"), "--ego-beam: expected one of"),
        (("--split", "dev"), "split: expected one of"),
        (("--mixture", "mine"), "mixture: expected one of pvdn, standard, r48, got 'mine'"),
    ],
)
def test_bad_options_are_told_before_all_scenes_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: tuple[str, str], expected: str
) -> None:
    def only_a_first(num_scenes: int, seed: int, split: Split, mixture: str) -> tuple[Scene, ...]:
        assert num_scenes == 1
        return draw_scenes(num_scenes, seed, split, mixture)

    monkeypatch.setattr(simulation, "draw_scenes", only_a_first)
    assert expected in complaint("simulate", "--out", tmp_path / "out", *option)
    assert not (tmp_path / "out").exists()


def test_the_seed_is_that_of_the_draw(scene_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes of one's own were not drawn: they have their seeds themselves, in `scenes.jsonl`."""
    configs: list[DatasetConfig] = []
    monkeypatch.setattr("foreglow.cli.simulate._simulate", lambda _scenes, _out, config, *_: configs.append(config))
    foreglow("simulate", "--out", tmp_path, "--scene", scene_file)
    foreglow("simulate", "--out", tmp_path, "--scenes", 1)
    assert [config.seed for config in configs] == [None, 7]


@pytest.mark.renderer
def test_the_data_set_is_read_by_the_other_commands(data: Path, tmp_path: Path) -> None:
    assert (data / "day" / "train" / "scenes.jsonl").is_file()
    result = foreglow("run", data, "--out", tmp_path / "results")
    assert "8 frames" in result.stdout
    result = foreglow("evaluate", data, "--predictions", tmp_path / "results" / "frames.jsonl")
    assert "recall" in result.stdout


@pytest.mark.renderer
def test_running_again_keeps_what_is_there(data: Path, scene_file: Path) -> None:
    arguments = ("--scene", scene_file, "--scene", scene_file, "--size", "160x120", "--quality", "fast")
    before = (data / "day" / "train" / "images" / "S00001" / "010000.png").stat().st_mtime_ns
    assert "(2 of them were there)" in foreglow("simulate", "--out", data, *arguments).stdout
    assert (data / "day" / "train" / "images" / "S00001" / "010000.png").stat().st_mtime_ns == before


@pytest.mark.renderer
def test_other_scenes_do_not_mix_with_those_there(data: Path, scene_file: Path) -> None:
    said = complaint("simulate", "--out", data, "--scene", scene_file, "--size", "80x60", "--quality", "fast")
    assert "choose another folder" in said


@pytest.mark.renderer
def test_the_report_on_a_data_set(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    image = data / "day" / "train" / "images" / "S00001" / "010000.png"
    said = foreglow("experiment", "simulator", data, "--out", tmp_path, "--real-labels", data, "--real-image", image)
    assert "1.7 s before a production system" in said.output
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["labels"]["num_images"] == 8
    assert all(row["is_close"] for row in results["label_rows"] if row["ratio"] is not None)  # compared with itself
    assert {row["ratio"] for row in results["pixel_rows"] if row["name"] == "dark grey"} != {None}
    assert [effect["factor"] for effect in results["effects"]] == [0.5, 0.7, 1.0, 1.4, 2.0]
    report = (tmp_path / "report.md").read_text()
    assert "| instances per image |" in report
    for name in ("leads.png", "pixels.png"):
        assert cv2.imread(str(tmp_path / name)) is not None
        assert f"({name})" in report


@pytest.mark.renderer
def test_a_preview(scene_file: Path, tmp_path: Path) -> None:
    arguments = ("--preview", "mine", "--size", "160x120", "--quality", "fast")
    result = foreglow("simulate", "--scene", scene_file, "--out", tmp_path, *arguments)
    assert "4 frames of mine" in result.stdout
    sheet = cv2.imread(str(tmp_path / "contact_sheet.png"))
    assert sheet is not None
    is_coloured = np.ptp(sheet.astype(int), axis=2) > 60
    assert is_coloured.any()  # the marks
    capture = cv2.VideoCapture(str(tmp_path / "drive.mp4"))
    assert int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) == 4
    assert read_scene(tmp_path / "preview.toml").name == "mine"
    foreglow("simulate", "--scene", scene_file, "--out", tmp_path, *arguments)  # over the earlier one


@pytest.mark.parametrize("names", [("drive.mp4",), ("contact_sheet.png",), ("contact_sheet.png", "drive.mp4")])
def test_a_preview_leaves_a_film_that_is_not_of_one(names: tuple[str, ...], tmp_path: Path) -> None:
    for name in names:
        (tmp_path / name).write_text("mine")
    with pytest.raises(ValueError, match=f"{names[0]}: expected nothing there but earlier results of this command"):
        preview((), Scene(), tmp_path)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"] * len(names)


@pytest.mark.parametrize("text", ["mine", "name = 'mine'\n"])
def test_a_preview_leaves_files_of_something_else_that_have_all_its_names(text: str, tmp_path: Path) -> None:
    names = ("contact_sheet.png", "drive.mp4", "preview.toml")
    for name in names:
        (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=r"preview\.toml: expected the scene of an earlier preview, or nothing"):
        preview((), Scene(), tmp_path)
    assert [path.read_text() for path in tmp_path.iterdir()] == [text] * len(names)


def test_a_drive_that_leaves_the_map_is_told_before_anything_is_made(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("[road]\nlength_m = 400.0\n[ego]\ntimetable = [[0.0, 200.0], [10.0, 1690.0]]\n")
    for options in (("--out", tmp_path / "out"), ("--out", tmp_path / "out", "--preview", "mine")):
        words = complaint("simulate", "--scene", file, *options)
        assert f"{file}: ego.timetable: expected arc lengths on the map, -1000 to 1400 m, got 1" in words
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


@pytest.mark.parametrize(
    ("vehicle", "said"),
    [
        ("timetable = [[0.0, 900.0]]", "0 to 400 m, at some time of the drive, got 900 to 900 m"),
        ('lane = "branch"\ntimetable = [[0.0, 80.0]]', "0 to 50 m, at some time of the drive, got 80 to 80 m"),
    ],
)
def test_a_vehicle_that_is_never_on_its_road(vehicle: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(
        f"[road]\nlength_m = 400.0\nbranches = [{{ s_m = 100.0, angle_deg = 90.0, length_m = 50.0 }}]\n"
        f"[[vehicles]]\n[[vehicles]]\n{vehicle}\n"
    )
    for command in (("simulate", "--scene", file, "--out", tmp_path / "out"), ("live", f"simulate:{file}")):
        assert f"{file}: vehicles.1.timetable: expected arc lengths on its road, {said}" in complaint(*command)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


@pytest.mark.parametrize("section", ["ego", "vehicles.1"])
def test_a_low_beam_that_is_missing_is_told_before_anything_is_made(section: str, tmp_path: Path) -> None:
    """A half-made data set remained, and an error that named neither scene nor field."""
    file, lamp = tmp_path / "scene.toml", tmp_path / "none.ies"
    table = "[ego]" if section == "ego" else "[[vehicles]]\n[[vehicles]]"
    file.write_text(f'{table}\nlow_beam_file = "{lamp}"\n')
    for command in (("simulate", "--scene", file, "--out", tmp_path / "out"), ("live", f"simulate:{file}")):
        assert complaint(*command).startswith(f"foreglow: {file}: {section}.low_beam_file: {lamp}: no such file")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]
    lamp.write_text("no lamp")
    words = complaint("simulate", "--scene", file, "--out", tmp_path / "out")
    assert words.startswith(f"foreglow: {file}: {section}.low_beam_file: {lamp}: ")


def test_another_beam_says_what_of_a_scene_it_leaves_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene went into `scenes.jsonl` with a low beam that was not in the images."""
    made: list[Scene] = []
    monkeypatch.setattr("foreglow.cli.simulate._simulate", lambda scenes, *_: made.extend(scenes))
    path, other = scene_of(tmp_path), scene_of(tmp_path / "other")
    path.write_text(path.read_text().replace("carpet = 1.0", "carpet = 0.4").replace("stray = 1.0", "stray = 2.0"))
    command = ("simulate", "--out", tmp_path / "a", "--scene", path, "--scene", other)
    assert not foreglow(*command, "--ego-beam", "low").stderr
    said = foreglow(*command, "--ego-beam", "matrix").stderr
    fields = 'ego.carpet, ego.stray: left out, as only beam = "low" shows it'
    assert said == f"foreglow: {path}: {fields}, and the beam is matrix here\n"
    assert [scene.ego.carpet for scene in made] == [0.4, 1.0, 1.0, 1.0]


@pytest.mark.parametrize("inner", ["day", "day/train"])
def test_a_data_set_is_not_written_into_another_one(inner: str, tmp_path: Path) -> None:
    """It became A/day/day/train, where no command looks for it."""
    (tmp_path / "A/day/train/labels/keypoints").mkdir(parents=True)
    words = complaint("simulate", "--scene", scene_of(tmp_path), "--out", tmp_path / "A" / inner)
    assert f"{tmp_path / 'A' / inner}: expected the folder of the whole data set, {tmp_path / 'A'}, in which" in words
    assert [path.name for path in (tmp_path / "A").rglob("*")] == ["day", "train", "labels", "keypoints"]


def test_a_preview_of_a_scene_is_not_called_like_a_scenario(tmp_path: Path) -> None:
    """The scenario's name was ignored without a word."""
    path = scene_of(tmp_path)
    words = complaint("simulate", "--scene", path, "--preview", "crest", "--out", tmp_path / "out")
    assert f"--preview: expected {read_scene(path).name}, as {path} calls its scene, or a name of your own" in words
    assert not (tmp_path / "out").exists()


def test_a_drawn_scene_as_toml(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(foreglow("simulate", "--print", "crest", "--seed", 5).stdout)
    assert read_scene(path).name == "crest"
    assert foreglow("simulate", "--print", "crest", "--seed", 5).stdout == path.read_text()


@pytest.mark.renderer
def test_another_beam_and_nobody_on_the_road(scene_file: Path, tmp_path: Path) -> None:
    plain, changed = (
        foreglow("simulate", "--print", "curve", "--seed", 5, *options).stdout
        for options in ((), ("--ego-beam", "high", "--empty"))
    )
    (tmp_path / "plain.toml").write_text(plain)
    (tmp_path / "changed.toml").write_text(changed)
    before, after = read_scene(tmp_path / "plain.toml"), read_scene(tmp_path / "changed.toml")
    assert (before.ego.beam, after.ego.beam) == ("low", "high")
    assert any(vehicle.beam != "off" for vehicle in before.vehicles)
    assert all(vehicle.beam == "off" for vehicle in after.vehicles)
    assert after.road == before.road
    small = ("--scene", scene_file, "--size", "160x120", "--quality", "fast")
    result = foreglow("simulate", "--out", tmp_path / "DATA", *small, "--ego-beam", "matrix", "--empty")
    assert "1 drive, 4 images, 4 of them without any instance" in result.stdout
    (line,) = (tmp_path / "DATA" / "day" / "train" / "scenes.jsonl").read_text().splitlines()
    assert '"matrix"' in line


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--scenes", "1"), "expected --out DIR, --preview NAME, --print NAME or --print-camera NAME"),
        (("--preview", "nothing"), "scenario: expected one of curve"),
        (("--preview", "curve", "--size", "12"), "size: expected WIDTHxHEIGHT"),
        (("--preview", "curve", "--size", "8x8"), "camera.width_px"),
        (("--preview", "curve", "--cycle", "dusk"), "sensor.exposure"),
        (("--preview", "curve", "--quality", "best", "--out", "unused"), "quality: expected one of fast"),
        (
            ("--scenes", "1", "--out", "unused", "--ego-beam", "laser"),
            "--ego-beam: expected one of low, high, matrix, got 'laser'",
        ),
        (("--out", "unused", "--split", "exam"), "split: expected one of train"),
        (("--scene", "nowhere.toml", "--out", "unused"), "nowhere.toml: no such"),
        (("--out", "unused", "--camera", "pinhole"), "--camera: expected one of"),
        (("--out", "unused", "--camera", "nowhere.toml"), "nowhere.toml: no such"),
        (
            ("--out", "unused", "--camera", "phone", "--size", "640x480"),
            "--camera phone: view.focal_px: expected up to 642.6 px, as a rendering of 640x480 px has",
        ),
        (("--out", "unused", "--camera", "pvdn_day", "--shares", "best"), "preset: expected one of"),
        (("--out", "unused", "--shares", "best"), "preset: expected one of"),
        (("--out", "unused", "--shares", "paper,paper"), "--shares: expected each once, paper comes twice"),
        (("--out", "unused", "--camera", "phone,phone"), "--camera: expected different names, 'phone' comes twice"),
        (("--preview", "mine", "--scene", "a.toml", "--scene", "b.toml"), "--preview: expected one --scene, got 2"),
    ],
)
def test_bad_arguments(
    arguments: tuple[str, ...], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert expected in complaint("simulate", *arguments)


@pytest.mark.parametrize(
    ("unused", "beside"),
    [
        (("--cycle", "night"), ("--camera", "pvdn_day")),
        (("--scenes", 3), ("--scene", "mine.toml")),
        (("--mixture", "pvdn"), ("--scene", "mine.toml")),
        (("--seed", 7), ("--scene", "mine.toml")),
        (("--camera", "phone"), ("--preview", "curve")),
        (("--split", "val"), ("--preview", "curve")),
        (("--pairs", 0.25), ("--preview", "curve")),
        (("--jobs", 2), ("--preview", "curve")),
        (("--size", "640x480"), ("--print", "curve")),
        (("--preview", "curve"), ("--print", "curve")),
        (("--out", "unused"), ("--print-camera", "phone")),
        (("--empty",), ("--print-camera", "phone")),
    ],
)
def test_an_option_that_has_no_effect_is_refused(
    unused: tuple[str, ...], beside: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").touch()
    out = () if {"--out", "--preview", "--print", "--print-camera"} & {*unused, *beside} else ("--out", "unused")
    said = complaint("simulate", *unused, *beside, *out)
    assert said == f"foreglow: {unused[0]}: expected without {beside[0]}, beside which it has no effect\n"


def test_a_printed_profile_is_a_profile_of_ones_own(tmp_path: Path) -> None:
    printed = foreglow("simulate", "--print-camera", "phone").stdout
    assert 'name = "phone"' in printed
    path = tmp_path / "mine.toml"
    path.write_text(printed.replace('name = "phone"', 'name = "mine"').replace("kbps = 4000.0", "kbps = -1.0"))
    said = complaint("simulate", "--out", tmp_path / "DATA", "--camera", path)
    assert "mine.toml: encoder.kbps" in said


@pytest.mark.renderer
def test_each_camera_has_a_data_set_that_the_other_commands_read(scene_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    small = ("--scene", scene_file, "--size", "160x120", "--quality", "fast")
    cameras = ("--camera", "pvdn_day,pvdn_night", "--variants", "2", "--shares", "foreglow")
    result = foreglow("simulate", "--out", tmp_path / "DATA", *small, *cameras)
    assert result.stdout.count("2 drives, 8 images") == 2
    for folder in ("pvdn_day/day", "pvdn_night/night"):
        split = tmp_path / "DATA" / folder / "train"
        assert (split / "simulation" / "S00002" / "shares.parquet").is_file()
        assert len(list((split / "simulation" / "S00002" / "light").glob("*.png"))) == 4
        assert "8 frames" in foreglow("run", split, "--out", tmp_path / folder / "results").stdout
    assert foreglow("simulate", "--out", tmp_path / "DATA", *small, *cameras).stdout.count("were there") == 2


@pytest.mark.renderer
def test_the_camera_of_the_scene_has_shares_and_variants_as_well(scene_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    small = ("--scene", scene_file, "--size", "160x120", "--quality", "fast", "--variants", "2", "--shares", "foreglow")
    assert "2 drives, 8 images" in foreglow("simulate", "--out", tmp_path, *small).stdout
    split = tmp_path / "day" / "train"
    assert (split / "simulation" / "S00002" / "shares.parquet").is_file()
    assert "8 frames" in foreglow("run", split, "--out", tmp_path / "results").stdout


def test_what_writes_shares_is_missed_before_the_first_drive(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    arguments = ("--scenes", "1", "--camera", "pvdn_day", "--shares", "foreglow")
    said = complaint("simulate", "--out", tmp_path / "DATA", *arguments)
    assert "pip install 'foreglow[parquet]'" in said
    assert not (tmp_path / "DATA").exists()


def test_the_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch, scene_file: Path, tmp_path: Path) -> None:
    def missing(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'mitsuba'", name="mitsuba")

    monkeypatch.setattr("foreglow.lab.simulation.light.render.prepare", missing)
    said = complaint("simulate", "--scene", scene_file, "--preview", "mine", "--out", tmp_path)
    assert "pip install 'foreglow[sim]'" in said
