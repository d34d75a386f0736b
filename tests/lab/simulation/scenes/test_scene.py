from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from foreglow.lab.simulation.drivable import read_drivable
from foreglow.lab.simulation.scenes.scenarios import (
    SCENARIOS,
    draw_scenes,
    long_drives,
    mirrored,
    scenario,
    without_traffic,
)
from foreglow.lab.simulation.scenes.scene import LOW_BEAM_FIELDS, EgoBeam, EgoSpec, RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.scene_file import read_scene, scene_to_toml


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_survives_toml_and_json(name: str, tmp_path: Path) -> None:
    scene = scenario(name, seed=3)
    path = tmp_path / "scene.toml"
    path.write_text(scene_to_toml(scene))
    assert read_scene(path) == scene
    assert Scene.model_validate_json(scene.model_dump_json()) == scene


def test_an_empty_file_is_the_default_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text("")
    assert read_scene(path) == Scene()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[road]\nlenght_m = 3.0\n", "road.lenght_m: unknown, expected one of length_m"),
        ("[[vehicles]]\ntimetable = [[1.0, 2.0], [0.0, 3.0]]\n", r"timetable: expected growing times, got 0 s after"),
        (
            "[[vehicles]]\ntimetable = [[0.0, 100.0], [0.001, 90.0]]\n",
            r"vehicles\.0\.timetable: expected at most 150 m/s, got 1e\+04 m/s from 100 m at 0 s to 90 m at 0\.001 s",
        ),
        ("[ego]\ntimetable = [[0.0, 20.0], [1.0, 171.0]]\n", r"ego\.timetable: expected at most 150 m/s, got 151 m/s"),
        ("[camera]\nfocal_px = -1.0\n", "camera.focal_px"),
        ("[camera]\nfocal_px = nan\n", "camera.focal_px"),
        ("[camera]\nfocal_px = 1e7\n", "camera.focal_px: .*less than or equal to 1000000"),
        ("[camera]\ncentre_px = [1e6, 480.0]\n", "camera.centre_px: expected a principal point at most 2560 px"),
        ("[camera]\ndistortion = [-3.0, 0.0, 0.0, 0.0, 0.0]\n", "camera.distortion: expected one that can be undone"),
        ("[camera]\ndistortion = [0.0, 1e7, 0.0, 0.0, 0.0]\n", "camera.distortion.1: .*less than or equal to"),
        ("[road]\ncurvature_per_m = [[0.0, 0.2]]\n", "radii of at least 20 m, got 5.0 m"),
        (
            '[[vehicles]]\nlane = "branch"\n',
            r"vehicles\.0\.lane: expected .*, as there is no side road in road\.branches",
        ),
        (
            '[ego]\nbeam = "matrix"\nlow_beam_file = "l.ies"\n',
            r'ego\.low_beam_file: expected only with beam = "low": the m',
        ),
        ('[ego]\nbeam = "matrix"\ncarpet = 0.4\n', r'ego\.carpet: .* own, got 0\.4 with beam = "matrix"'),
        ('[ego]\nbeam = "high"\nstray = 3.0\n', r'ego\.stray: expected only with beam = "low": the high beam'),
        (
            '[[vehicles]]\nbeam = "high"\nlow_beam_file = "l.ies"\n',
            r"vehicles\.0\.low_beam_file: expected only with beam = \"low\" .*, got 'l\.ies' with beam = \"high\"",
        ),
        ('[[vehicles]]\nkind = "bicycle"\nlow_beam_file = "l.ies"\n', r"vehicles\.0\.low_beam_file: .* a bicycle"),
        ("[road]\nbarrier_m = 1.1\n", r'road\.barrier_m: .* median = "barrier", got 1\.1 with median = "none"'),
        ("[road]\nnum_lanes = 2\nedge_line_m = 0.2\n", r"road\.edge_line_m: .* above 0, got 0\.2 with median_m = 0"),
        (
            "[[surroundings.rails]]\nside = 'left'\nspan_m = [1000.0, 1900.0]\n",
            r"surroundings\.rails\.0\.span_m: expected a part of the road, 0 to 500 m, got \(1000\.0, 1900\.0\)",
        ),
        (
            "[[surroundings.woods]]\nside = 'left'\nspan_m = [-90.0, 0.0]\n",
            r"surroundings\.woods\.0\.span_m: expected a part of the road",
        ),
        ("[[vehicles]]\nbranch = 2\n", r'vehicles\.0\.branch: .* lane = "branch", got 2 with lane = "oncoming"'),
        ("[[vehicles]]\nis_towards = false\n", r'\.is_towards: expected .*, got False with lane = "oncoming"'),
        ('[[vehicles]]\nlane = "parked_left"\nlane_number = 0\n', r'lane_number: .* got 0 with lane = "parked_left"'),
        ("[[vehicles]]\nlane_number = 0\nlateral_m = 1.0\n", r"lane_number: expected .*, got 0 with lateral_m"),
        ('[[vehicles]]\nkind = "bicycle"\nbeam = "high"\n', r"\.beam: expected low or off, got 'high' with a bicycle"),
        ('[[vehicles]]\nkind = "bicycle"\nbrakes_s = [[0.0, 1.0]]\n', r"brakes_s: expected .* with a bicycle"),
        ('[[vehicles]]\nbeam = "off"\nbrakes_s = [[0.0, 1.0]]\n', r'brakes_s: expected .* with beam = "off"'),
        ("[[vehicles]]\n[[vehicles]]\ntimetable = [[0.0, 90.0], [1.0, 95.0]]\n", r"vehicles\.1\.timetable: .* falling"),
        ('[[vehicles]]\nlane = "own"\n', r"timetable: expected growing arc lengths.* with lane = \"own\""),
        ('[[vehicles]]\nlane = "parked_left"\n', r"timetable: expected a single place"),
        ("[road\n", "expected TOML"),
        ("[surroundings]\nrails = [{side = 'up', span_m = [1.0, 2.0]}]\n", "surroundings.rails.0.side"),
        (
            "[surroundings]\nrails = [{side = 'left', span_m = [2.0, 1.0]}]\n",
            r"toml: surroundings\.rails\.0\.span_m: expected a span from",
        ),
        (
            "[[vehicles]]\nbrakes_s = [[3.0, 1.0]]\n",
            r"brakes_s\.0: expected a span from a smaller to a larger time in s",
        ),
        ("sensor = 3\n", "sensor: Input should be a table, got 3"),
        ("vehicles = 3\n", "vehicles: Input should be a list, got 3"),
        ("[road]\nshoulders_m = [1.0]\n", "road.shoulders_m.1: expected one more value"),
        ("[[vehicles]]\nlane_number = 1\n", r"toml: vehicles\.0\.lane_number: expected a lane below 1, got 1"),
        ("rate_hz = 10.0\npair_s = 0.3\n", r"toml: pair_s: expected below 2 / rate_hz"),
        ("duration_s = true\n", "duration_s"),
    ],
)
def test_errors_name_file_and_field(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        read_scene(path)
    assert str(path) in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize("draw", [lambda: draw_scenes(8, 7, "val", "standard"), lambda: long_drives(6, 1, "val")])
def test_drawn_scenes_and_their_mirror_images_say_nothing_without_effect(
    draw: Callable[[], tuple[Scene, ...]], tmp_path: Path
) -> None:
    path = tmp_path / "scene.toml"
    for scene in draw():
        for each in (scene, mirrored(scene), without_traffic(scene)):
            path.write_text(scene_to_toml(each))
            assert read_drivable(path) == each


def test_scenes_of_data_sets_are_read_whatever_has_no_effect() -> None:
    scene = Scene(road=RoadSpec(barrier_m=1.2), vehicles=(VehicleSpec(lane="own", branch=2, is_towards=False),))
    assert Scene.model_validate_json(scene.model_dump_json()) == scene


@pytest.mark.parametrize(("start_m", "is_inside"), [(20.0, True), (23.9, True), (26.0, False), (15.0, False)])
def test_a_vehicle_in_our_place(start_m: float, is_inside: bool, tmp_path: Path) -> None:
    """The camera was inside of its body."""
    path = tmp_path / "scene.toml"
    path.write_text(
        f"[[vehicles]]\nlane = 'own'\ntimetable = [[0.0, {start_m}], [1.0, {start_m + 10.0}]]\n"
        "[ego]\ntimetable = [[0.0, 20.0], [1.0, 30.0]]\n"
    )
    if is_inside:
        words = rf"scene\.toml: vehicles\.0: expected .*, but at 0 s both are at {start_m:g} m along the road"
        with pytest.raises(ValueError, match=words):
            read_drivable(path)
    else:
        read_drivable(path)


def test_files_of_a_scene_are_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were looked for in the working directory, and not found again from another one."""
    folder = tmp_path / "scenes"
    folder.mkdir()
    path = folder / "scene.toml"
    path.write_text(
        f'[ego]\nlow_beam_file = "lamps/l.ies"\n[[vehicles]]\nlow_beam_file = "{tmp_path}/m.ies"\n[[vehicles]]\n'
    )
    monkeypatch.chdir(tmp_path)
    for name in (path, Path("scenes/scene.toml")):
        scene = read_scene(name)
        assert scene.ego.low_beam_file == str(folder / "lamps/l.ies")
        assert [vehicle.low_beam_file for vehicle in scene.vehicles] == [f"{tmp_path}/m.ies", None]
    other = tmp_path / "other.toml"
    other.write_text(scene_to_toml(scene))
    assert read_scene(other) == scene


@pytest.mark.parametrize("beam", ["matrix", "high"])
def test_scenes_of_before_may_change_a_low_beam_that_does_not_shine(beam: EgoBeam) -> None:
    ego = EgoSpec(beam=beam, low_beam_file="l.ies", carpet=0.4, stray=2.0)
    assert EgoSpec.model_validate_json(ego.model_dump_json()) == ego
    assert ego.changed_low_beam == LOW_BEAM_FIELDS
    assert ego.with_beam(beam) == EgoSpec(beam=beam)
    assert ego.with_beam("low") == ego.model_copy(update={"beam": "low"})


def test_missing_file() -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.toml"):
        read_scene(Path("nowhere.toml"))


def test_number_of_frames() -> None:
    assert Scene(duration_s=2.0, rate_hz=18.0).num_frames == 36
    assert Scene(duration_s=0.001, rate_hz=18.0).num_frames == 1


def test_frames_may_come_in_pairs() -> None:
    scene = Scene(duration_s=4.0, rate_hz=1.25, pair_s=0.25)
    times_s = [scene.time_s(number) for number in range(scene.num_frames)]
    assert times_s == pytest.approx([0.0, 0.25, 1.6, 1.85, 3.2])
    with pytest.raises(ValueError, match=r"pair_s: expected below 2 / rate_hz, 1.6 s, got 2"):
        Scene(rate_hz=1.25, pair_s=2.0)


def test_the_example_of_the_guide_is_a_scene(tmp_path: Path) -> None:
    guide = (Path(__file__).parents[4] / "docs" / "scenes.md").read_text(encoding="utf-8")
    path = tmp_path / "scene.toml"
    path.write_text(guide.split("```toml\n")[1].split("```")[0])
    assert read_scene(path).name == "my_bend"


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[camera]\nmount_m = [1.9, 0.0, 12.0]", "camera.mount_m.2"),
        ("[camera]\nmount_m = [1e11, 0.0, 1.3]", "camera.mount_m.0"),
        ("[camera]\nyaw_deg = 100.0", "camera.yaw_deg"),
        ("[camera]\nfocal_px = 20.0", "camera.focal_px"),
        ("[sensor]\ncore_px = 30000.0", "sensor.core_px"),
        ("[sensor]\nmiddle_px = 21.0", "sensor.middle_px"),
        ("[surroundings.left]\ngrass_per_m2 = 1e11", "surroundings.left.grass_per_m2"),
    ],
)
def test_what_no_camera_or_road_has_is_refused_when_the_scene_is_read(text: str, field: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path}: {field}: ')}"):
        read_scene(path)
