"""The closed loop on glare: its light against the simulator's own, its delays, and whole small experiments."""

from __future__ import annotations

import functools
import json
import math
import shutil
from pathlib import Path
from typing import Never

import numpy as np
import pytest

from foreglow.beam import Gap, GapWriter
from foreglow.config import BeamConfig, PipelineConfig, preset
from foreglow.files import to_json
from foreglow.geometry import Floats
from foreglow.lab.evaluation.occurrence import Sighting, lead_scores
from foreglow.lab.simulation import Drive, DriveFrame, Scene, long_drives, with_beam, without_traffic
from foreglow.lab.simulation.scenes.scenarios import mirrored
from foreglow.lab.simulation.scenes.scene import CameraSpec, EgoSpec, RoadSpec, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import SurroundingsSpec, Verge
from foreglow.lab.simulation.writing.scene_files import SceneFile, write_scenes
from foreglow.lab.studies.glare import run
from foreglow.lab.studies.glare import simulate as driving
from foreglow.lab.studies.glare.drive import read_glare_drive
from foreglow.lab.studies.glare.loop import Delays, Shone, both, closed_loops, exact_gaps
from foreglow.lab.studies.glare.page import summary_lines
from foreglow.lab.studies.glare.run import GlarePlan, named_scenes, run_experiment
from foreglow.lab.studies.glare.simulate import OurLight, Setting, seen_lamps, settings_of
from foreglow.parallel import Local
from foreglow.photometry import NUM_LEDS, read_headlamps
from foreglow.photometry.headlamps import SHIPPED
from foreglow.types import BeamCommand, BeamMode, FrameResult, Proposals
from tests.lab.studies.detector_data import make_model

pytestmark = [pytest.mark.renderer, pytest.mark.slow]

BARE = Verge(grass_per_m2=0.0, bank_m=0.0, ditch_m=0.0)
ONCOMING = VehicleSpec(timetable=((0.0, 150.0), (10.0, -50.0)))
AHEAD = VehicleSpec(lane="own", timetable=((0.0, 60.0), (10.0, 260.0)))


def scene(duration_s: float = 3 / 18, **changes: object) -> Scene:
    """A car comes towards us, another drives ahead of us; 160x120 pixels."""
    fields: dict[str, object] = {
        "duration_s": duration_s,
        "road": RoadSpec(length_m=300.0),
        "surroundings": SurroundingsSpec(left=BARE, right=BARE, delineator_spacing_m=0.0),
        "vehicles": (ONCOMING, AHEAD),
        "ego": EgoSpec(
            timetable=((0.0, 20.0), (10.0, 220.0)), brightness=1.2, yaw_aim_deg=0.4, pitch_aim_deg=-0.2, body_motion=1.0
        ),
        "camera": CameraSpec(width_px=160, height_px=120, focal_px=164.0),
    }
    return Scene(**(fields | changes))  # type: ignore[arg-type]


@functools.cache
def first_frame() -> DriveFrame:
    return next(iter(Drive(with_beam(scene(), "matrix"), "fast").frames()))


class Constant:
    """A car that always wants the same levels."""

    def __init__(self, levels: Floats) -> None:
        self._levels = levels

    def step(self, known: DriveFrame) -> tuple[FrameResult, BeamCommand]:
        now_ns = known.frame.timestamp_ns
        result = FrameResult(known.frame.frame, now_ns, Proposals(np.zeros((0, 4), np.int32)), None)
        return result, BeamCommand(now_ns, BeamMode.GLARE_FREE, self._levels)

    def lit(self, known: DriveFrame, levels: Floats) -> Floats:  # noqa: ARG002
        return levels


@pytest.mark.parametrize("driven", [scene(), mirrored(scene())], ids=["right", "left"])
def test_light_at_an_eye_is_the_simulators(driven: Scene) -> None:
    """Base and LEDs apart give what the simulator sums up, with mis-aim, brightness and body motion."""
    levels = np.random.default_rng(3).uniform(size=(2, NUM_LEDS))
    source = Drive(with_beam(driven, "matrix"), "fast")
    source.set_led_levels(levels)
    for known in source.frames():
        oncoming = known.vehicles[0]
        eye = OurLight(source.scene).at_eye(known, oncoming, levels)
        assert eye.is_in_sight
        assert eye.base_lx + (levels * eye.leds_lx).sum() == pytest.approx(oncoming.eye_lx["ego"], rel=1e-4)
        x, y, _ = known.ego_pose.to_body(oncoming.eye_world_m)
        assert (eye.range_m, eye.azimuth_rad) == pytest.approx((math.hypot(x, y), math.atan2(y, x)))


def test_mirrors_of_a_vehicle_ahead_are_lit_from_behind() -> None:
    known = first_frame()
    eye = OurLight(scene()).at_eye(known, known.vehicles[1], np.ones((2, NUM_LEDS)))
    assert eye.is_in_sight
    assert known.vehicles[1].eye_lx["ego"] == 0.0  # its driver looks away from us
    assert eye.base_lx > 0.1


@pytest.mark.parametrize("is_seen", [[False, False], [True, False], [False, True], [True, True]])
def test_seen_lamps_are_told_by_their_sum(is_seen: list[bool]) -> None:
    expected_lx = np.array([0.4, 0.7])
    assert seen_lamps(expected_lx, float(expected_lx @ is_seen) * 1.01).tolist() == is_seen


def test_road_light_is_linear_and_less_far_away() -> None:
    known = first_frame()
    base, leds = OurLight(scene()).on_road(known)
    assert base.shape == (2,)
    assert leds.shape == (2, 2, NUM_LEDS)
    dark, bright = (OurLight(scene(ego=EgoSpec(brightness=one))).on_road(known)[1] for one in (0.5, 1.0))
    np.testing.assert_allclose(bright, 2.0 * dark, rtol=1e-6, atol=1e-12)


def test_road_light_is_that_of_our_own_side() -> None:
    """A mirror image of a drive has the same low beam on its own lane and verge; its LEDs are not mirrored."""
    known = first_frame()
    base, _ = OurLight(scene()).on_road(known)
    other = mirrored(scene())
    left, _ = OurLight(other).on_road(next(iter(Drive(with_beam(other, "matrix"), "fast").frames())))
    np.testing.assert_allclose(left, base, rtol=0.02)


@pytest.mark.parametrize("number", [None, 0])
def test_our_lane_is_the_one_that_we_drive_on(number: int | None) -> None:
    """Beside a median, with three lanes, it is as bright as on a road with one: it is straight ahead of us."""
    road = RoadSpec(length_m=300.0, num_lanes=3, median="rails", median_m=3.0, shoulders_m=(0.8, 2.5))
    wide = scene(road=road, ego=scene().ego.model_copy(update={"lane_number": number}), vehicles=())
    base, _ = OurLight(wide).on_road(next(iter(Drive(with_beam(wide, "matrix"), "fast").frames())))
    assert base[0] == pytest.approx(OurLight(scene()).on_road(first_frame())[0][0], rel=0.05)


def test_lamps_of_our_own_are_those_that_shine(tmp_path: Path) -> None:
    lamps = tmp_path / "lamps.toml"
    text = SHIPPED.read_text().replace("num_columns = 28", "num_columns = 14")
    lamps.write_text(text.replace("pitch_deg = 1.2", "pitch_deg = 2.4"))
    headlamps = read_headlamps(lamps)
    _, leds = OurLight(scene(), headlamps).on_road(first_frame())
    assert headlamps.num_leds < NUM_LEDS
    assert leds.shape == (2, 2, headlamps.num_leds)


@functools.cache
def loop(delays: Delays, num: int = 12) -> list[Shone]:
    car = Constant(np.full((2, NUM_LEDS), 0.6))
    return [shone for (shone,) in closed_loops(scene(num / 18), [car], delays, "fast")]


@pytest.mark.parametrize("lamp_s", [0.0, 0.1])
def test_light_follows_after_the_delays(lamp_s: float) -> None:
    """The receiver wants four commands (one to compare with, three good ones), then the lamps' latency passes."""
    shone = loop(Delays(camera_s=0.02, lamp_s=lamp_s))
    first = next(place for place, one in enumerate(shone) if one.levels.any())
    lit_s = 3 / 18 + 0.02 + lamp_s
    assert first == math.ceil(lit_s * 18 - 1e-6)
    assert shone[first].levels.max() == pytest.approx(0.6, abs=1 / 255)
    assert shone[first].levels.max() <= 0.6


def test_commands_may_take_longer_than_a_frame() -> None:
    assert loop(Delays(camera_s=0.12, lamp_s=0.0))[-1].levels.any()


def test_commands_that_come_too_late_end_in_low_beam() -> None:
    assert not any(one.levels.any() for one in loop(Delays(camera_s=0.4, lamp_s=0.0), num=14))


def test_images_are_lit_by_what_was_commanded() -> None:
    """The picture of the closed loop brightens when the light comes."""
    shone = loop(Delays(camera_s=0.02, lamp_s=0.0))
    means = [float(one.known.frame.image.mean()) for one in shone]
    first = next(place for place, one in enumerate(shone) if one.levels.any())
    assert means[first] > max(means[:first]) + 0.3


def test_exact_gaps_hold_the_body() -> None:
    known = first_frame()
    (gap,) = exact_gaps(known, known.vehicles[:1])
    x, y, _ = known.ego_pose.to_body(known.vehicles[0].eye_world_m)
    assert gap.right_rad < math.atan2(y, x) < gap.left_rad
    assert gap.near_m < math.hypot(x, y) < gap.far_m


def test_the_papers_lamps_obey_the_production_system_while_it_reports() -> None:
    writer = GapWriter(BeamConfig(), read_headlamps())
    production = writer.command(1, [Gap(0.0, 0.1, 50.0, 60.0)]).levels
    provident = np.full((2, NUM_LEDS), 0.5)
    assert both(production, True, provident) is production
    assert (both(production, False, provident) <= provident).all()


def config() -> PipelineConfig:
    return preset("foreglow")


def write_scenes_of(folder: Path, *scenes: Scene) -> Path:
    folder.mkdir(exist_ok=True)
    from foreglow.lab.simulation.writing.lidar import LidarConfig
    from foreglow.lab.simulation.writing.scene_files import Making
    from foreglow.lab.simulation.writing.street_data import StreetDataError

    making = Making(generator="test", lidar=LidarConfig(), street=StreetDataError())
    files = [SceneFile(sequence=place, made_with=making, scene=one) for place, one in enumerate(scenes, start=1)]
    write_scenes(folder, files)
    return folder / "scenes.jsonl"


def test_a_small_experiment_and_its_resumption(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_in_s = 0.5
    monkeypatch.setattr(driving, "RUN_IN_S", run_in_s)
    scenes = write_scenes_of(tmp_path, scene(run_in_s + 4 / 18))
    plan, out = GlarePlan(num_empty=1, quality="fast"), tmp_path / "out"
    told: list[tuple[int, int, int]] = []
    experiment = run_experiment(scenes, config(), plan, out, progress=lambda *one: told.append(one))
    assert [policy.name for policy in experiment.results.policies] == [
        "low", "high", "production", "paper", "foreglow", "oracle",
    ]  # fmt: skip
    assert len(experiment.results.sensitivity) == len(settings_of(plan.delays))
    drive = read_glare_drive(out / "drives" / "S00001.npz")
    assert drive.times_s[0] >= run_in_s
    assert {eye.is_oncoming for eye in drive.eyes} == {True, False}
    assert not read_glare_drive(out / "drives" / "S00001-empty.npz").eyes
    assert (drive.eyes[0].illuminance_lx(1.0) > drive.eyes[0].illuminance_lx(0.0)).all()
    told.clear()
    again = run_experiment(scenes, config(), plan, out, progress=lambda *one: told.append(one))
    assert len(told) == 2  # both are there
    assert to_json(again.results) == to_json(experiment.results)
    other = PipelineConfig(**(config().model_dump() | {"beam": BeamConfig(margin_deg=2.0).model_dump()}))
    with pytest.raises(ValueError, match=r"plan\.json: expected the configuration and delays of this run"):
        run_experiment(scenes, other, plan, out, progress=lambda *_: None)
    told.clear()
    scenes = write_scenes_of(tmp_path / "other", scene(run_in_s + 4 / 18, seed=5))
    with pytest.raises(ValueError, match=r"plan\.json: scenes: expected S00001 as it was here before"):
        run_experiment(scenes, config(), plan, out, progress=lambda *one: told.append(one))
    assert not told


def test_every_policy_has_a_row_of_its_own() -> None:
    names = [driving.own_name(config().commanding(policy=name)) for name in ("foreglow", "paper", "low", "mine:Mine")]
    assert names == ["foreglow", "our pipeline, paper", "our pipeline, low", "mine:Mine"]


def test_a_policy_that_is_plugged_in_has_a_row_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving, "RUN_IN_S", 0.1)
    setting = Setting("margin", "deg", 2.0, 0.0, {"margin_deg": 2.0})
    monkeypatch.setattr(driving, "settings_of", lambda _: (setting,))
    monkeypatch.setattr(run, "settings_of", lambda _: (setting,))
    scenes = write_scenes_of(tmp_path, scene(0.1 + 3 / 18))
    plugged = config().commanding(policy="tests.test_plugins:AllLight")
    plan = GlarePlan(quality="fast")
    experiment = run_experiment(scenes, plugged, plan, tmp_path / "out", progress=lambda *_: None)
    names = [policy.name for policy in experiment.results.policies]
    assert names == ["low", "high", "production", "paper", "oracle", "tests.test_plugins:AllLight"]
    assert [point.policy for point in experiment.results.sensitivity] == ["tests.test_plugins:AllLight"]
    assert summary_lines(experiment.results)[0].startswith("tests.test_plugins:AllLight: glare dose of ")
    setting_run = read_glare_drive(tmp_path / "out" / "drives" / "S00001.npz").runs[setting.name]
    assert (setting_run.levels == 1.0).all()  # it is the plug-in whose settings are tried, too


def test_further_cars_drive_at_the_same_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each shines its own light, sees the image that belongs to it, and has a row called as its file."""
    monkeypatch.setattr(driving, "RUN_IN_S", 0.5)
    wide, low = tmp_path / "wide.toml", tmp_path / "dark.toml"
    wide.write_text("[beam]\nmargin_deg = 2.0\n")
    low.write_text('[beam]\npolicy = "low"\n')
    plan = GlarePlan(quality="fast", also=(wide, low))
    cars = config().commanding(policy="high")
    last = list(plan.drives(plan.delays.known_to(cars)).frames(scene(12 / 18)))[-1]
    ours, _, same, dark = (shone.known.frame.image for shone in last)
    assert last[2].levels.max() == last[0].levels.max() > last[3].levels.max() == 0.0
    assert (ours == same).all()
    assert ours.mean() > dark.mean()
    scenes = write_scenes_of(tmp_path, scene(0.5 + 4 / 18))
    experiment = run_experiment(scenes, cars, plan, tmp_path / "out", progress=lambda *_: None)
    assert [policy.name for policy in experiment.results.policies][-2:] == ["wide", "dark"]
    again = GlarePlan(quality="fast", also=(wide,))
    with pytest.raises(ValueError, match=r"plan\.json: expected the configuration and delays of this run"):
        run_experiment(scenes, cars, again, tmp_path / "out", progress=lambda *_: None)
    oracle = tmp_path / "oracle.toml"
    oracle.write_text("")
    with pytest.raises(ValueError, match=r"oracle\.toml: expected a file that is called unlike any other row"):
        GlarePlan(also=(oracle,)).others(cars)


def test_the_papers_car_has_its_whole_chain(tmp_path: Path) -> None:
    """Its detector accepts above 0.5 and all of its boxes, ours above its threshold; without its model it has ours."""
    pytest.importorskip("onnx")
    model = make_model(tmp_path / "all.onnx")
    own = config().classifier.score_threshold
    for given, threshold in ((model, 0.5), (None, own)):
        plan = GlarePlan(quality="fast", paper_model=given)
        ours, paper = next(plan.drives(plan.delays.known_to(config())).frames(scene()))
        assert paper.result.detections is not None
        assert ours.result.detections is not None
        assert paper.result.detections.score_threshold == threshold
        assert ours.result.detections.score_threshold == own
        assert len(paper.command.levels) == 2


def test_a_folder_is_of_one_paper_chain(tmp_path: Path) -> None:
    pytest.importorskip("onnx")

    class Stopped(Local):
        def each(self, *_: object, **__: object) -> Never:
            raise KeyboardInterrupt

    scenes, out, model = write_scenes_of(tmp_path, scene()), tmp_path / "out", make_model(tmp_path / "all.onnx")

    def begin(paper_model: Path | None) -> None:
        plan = GlarePlan(quality="fast", paper_model=paper_model)
        run_experiment(scenes, config(), plan, out, workers=Stopped(), progress=lambda *_: None)

    for given in (None, None):
        with pytest.raises(KeyboardInterrupt):
            begin(given)
    with pytest.raises(ValueError, match=r"plan\.json: expected the configuration and delays of this run"):
        begin(model)


def test_drives_of_other_lamps_are_not_added(tmp_path: Path) -> None:
    """Their file may be edited between two calls; its name is the same."""

    class Stopped(Local):
        def each(self, *_: object, **__: object) -> Never:
            raise KeyboardInterrupt

    scenes, out = write_scenes_of(tmp_path, scene()), tmp_path / "out"
    lamps = Path(shutil.copy(SHIPPED, tmp_path / "lamps.toml"))
    car = config().commanding(headlamps=lamps)

    def begin() -> None:
        run_experiment(scenes, car, GlarePlan(quality="fast"), out, workers=Stopped(), progress=lambda *_: None)

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            begin()
    lamps.write_text(lamps.read_text() + "\n")
    with pytest.raises((ValueError, KeyboardInterrupt), match=r"models: expected .*lamps\.toml as it was here before"):
        begin()


def test_drives_of_another_version_are_not_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stopped(Local):
        def each(self, *_: object, **__: object) -> Never:
            raise KeyboardInterrupt

    scenes, out = write_scenes_of(tmp_path, scene()), tmp_path / "out"
    for version, commit in (("1", "a"), ("1", "b"), ("1", "a"), ("2", "c")):
        monkeypatch.setattr(run, "provenance", lambda made={"version": version, "commit": commit}: made)
        with pytest.raises((ValueError, KeyboardInterrupt)) as stopped:
            run_experiment(
                scenes, config(), GlarePlan(quality="fast"), out, workers=Stopped(), progress=lambda *_: None
            )
    assert "plan.json: version: expected 1, which drove the scenes here, got 2; choose another folder" in str(stopped)
    assert json.loads((out / "plan.json").read_text())["commits"] == ["a", "b"]


def test_a_car_that_cannot_be_made_leaves_no_folder(tmp_path: Path) -> None:
    """What it left would keep the corrected command out."""
    scenes, out = write_scenes_of(tmp_path, scene()), tmp_path / "out"
    plan = GlarePlan(quality="fast")
    with pytest.raises(ValueError, match=r"beam\.policy: .*os:getcwd"):
        run_experiment(scenes, config().commanding(policy="os:getcwd"), plan, out, progress=lambda *_: None)
    other = tmp_path / "other.toml"
    other.write_text('[beam]\npolicy = "os:getcwd"\n')
    with pytest.raises(ValueError, match=r"beam\.policy: .*os:getcwd"):
        run_experiment(scenes, config(), GlarePlan(quality="fast", also=(other,)), out, progress=lambda *_: None)
    assert not out.exists()


def test_an_experiment_that_drove_nothing_leaves_no_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the renderer, for example, whose absence is only noticed where it is needed."""
    scenes, out = write_scenes_of(tmp_path, scene()), tmp_path / "out"

    def missing(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'mitsuba'", name="mitsuba")

    monkeypatch.setattr("foreglow.lab.studies.glare.simulate.Drives.frames", missing)
    for kept in ([], ["mine.txt"]):
        for name in kept:
            out.mkdir()
            (out / name).touch()
        with pytest.raises(ModuleNotFoundError, match="mitsuba"):
            run_experiment(scenes, config(), GlarePlan(quality="fast"), out, progress=lambda *_: None)
        assert out.exists() == bool(kept)
        assert not out.exists() or [path.name for path in out.iterdir()] == kept


def test_scenes_come_from_a_split_or_its_file(tmp_path: Path) -> None:
    file = write_scenes_of(tmp_path, scene(), scene(seed=5))
    plan = GlarePlan(num_empty=1)
    named = named_scenes(tmp_path, plan)
    assert [one.name for one in named] == ["S00001", "S00002", "S00001-empty"]
    assert named == named_scenes(file, plan)
    assert named[2].scene == without_traffic(scene())
    with pytest.raises(FileNotFoundError, match=r"nowhere: no such file; expected the scenes\.jsonl"):
        named_scenes(tmp_path / "nowhere", plan)
    file.write_text(json.dumps({"sequence": 1}) + "\n")
    with pytest.raises(ValueError, match=r"scenes\.jsonl: line 1: scene"):
        named_scenes(file, plan)
    file.write_text("")
    with pytest.raises(ValueError, match="expected at least one scene"):
        named_scenes(file, plan)


def test_a_split_without_a_data_set_stands_for_long_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    named = named_scenes(Path("val"), GlarePlan(num_scenes=1, num_empty=1))
    assert [each.name for each in named] == ["S00001", "S00001-empty"]
    assert named[0].scene == long_drives(1, run.LONG_SEED, "val")[0]
    write_scenes_of((tmp_path / "val").resolve(), scene())
    assert named_scenes(Path("val"), GlarePlan())[0].scene == scene()  # a folder of this name is what is meant


def test_lead_scores_leave_out_what_was_not_told() -> None:
    told = Sighting(0, 1.0, 1.0, 0.2, 3.0, is_covered=True)
    untold = Sighting.from_json(to_json(Sighting(1, 1.0, math.nan, math.nan, math.nan, is_covered=False)))
    (score,) = lead_scores([told, untold])
    assert (score.num, score.num_told, score.median_deg, score.covered_share) == (2, 1, 1.0, 1.0)
    (nothing,) = lead_scores([untold])
    assert nothing.num_told == 0
    assert math.isnan(nothing.median_deg)
