"""Whole small experiments on glare."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Never

import numpy as np
import pytest

from foreglow.beam import BeamPolicy
from foreglow.config import BeamConfig, PipelineConfig, preset
from foreglow.files import to_json
from foreglow.lab.evaluation.occurrence import Sighting, lead_scores
from foreglow.lab.simulation import Scene, long_drives, without_traffic
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec, VehicleSpec
from foreglow.lab.studies.glare import run
from foreglow.lab.studies.glare import simulate as driving
from foreglow.lab.studies.glare.drive import read_glare_drive
from foreglow.lab.studies.glare.loop import Delays
from foreglow.lab.studies.glare.page import summary_lines
from foreglow.lab.studies.glare.run import GlarePlan, NamedScene, named_scenes, remarks_on, run_experiment
from foreglow.lab.studies.glare.simulate import Setting, settings_of
from foreglow.parallel import Local
from foreglow.photometry import NUM_LEDS, Headlamps
from foreglow.photometry.headlamps_file import SHIPPED
from foreglow.types import BeamCommand, BeamMode, Frame, Tracks
from tests.lab.studies.detector_data import make_model
from tests.lab.studies.glare_scenes import AHEAD, scene, write_scenes_of

pytestmark = [pytest.mark.renderer, pytest.mark.slow]


def config() -> PipelineConfig:
    return preset("foreglow")


def test_a_small_experiment_and_its_resumption(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_in_s = 0.5
    monkeypatch.setattr(driving, "RUN_IN_S", run_in_s)
    driven = scene(run_in_s + 4 / 18)
    old_lamps = driven.ego.model_copy(update={"carpet": 0.4})
    scenes = write_scenes_of(tmp_path, driven.model_copy(update={"ego": old_lamps}))
    plan, out = GlarePlan(num_empty=1, quality="fast"), tmp_path / "out"
    told: list[tuple[int, int, int]] = []
    experiment = run_experiment(scenes, config(), plan, out, progress=lambda *one: told.append(one))
    assert [policy.name for policy in experiment.results.policies] == [
        "low", "high", "production", "paper", "foreglow", "oracle",
    ]  # fmt: skip
    assert len(experiment.results.sensitivity) == len(settings_of(plan.delays))
    assert [line[:60] for line in experiment.remarks] == [
        "The scenes of 2 of 2 drives (S00001, S00001-empty) have a lo"
    ]
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
    with pytest.raises(ValueError, match=r"plan\.json: expected the configurations as they were here before"):
        run_experiment(scenes, other, plan, out, progress=lambda *_: None)
    with pytest.raises(ValueError, match=r"plan\.json: plan\.quality: expected 'fast' as here before, got 'fine'"):
        run_experiment(scenes, config(), plan.model_copy(update={"quality": "fine"}), out, progress=lambda *_: None)
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
    words = "glare dose of 1 oncoming driver with tests.test_plugins:AllLight: "
    assert summary_lines(experiment.results)[0].startswith(words)
    setting_run = read_glare_drive(tmp_path / "out" / "drives" / "S00001.npz").runs[setting.name]
    assert (setting_run.levels == 1.0).all()  # it is the plug-in whose settings are tried, too


class Looking(BeamPolicy):
    """High beam for an image with light in it."""

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        pass

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:  # noqa: ARG002
        if not frame.image.any():
            return BeamCommand.low(frame.timestamp_ns, NUM_LEDS)
        return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, NUM_LEDS)))


def test_other_settings_see_the_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy may look at them, such as the paper's for the brightest track."""
    monkeypatch.setattr(driving, "RUN_IN_S", 0.1)
    setting = Setting("margin", "deg", 2.0, 0.0, {"margin_deg": 2.0})
    monkeypatch.setattr(driving, "settings_of", lambda _: (setting,))
    drives = GlarePlan(quality="fast").drives(config().commanding(policy=f"{__name__}:Looking"))
    driven = scene(0.1 + 3 / 18)
    drive, _ = drives.driven(driven, "S00001", drives.frames(driven))
    assert (drive.runs[setting.name].levels == 1.0).all()


def test_who_passed_during_the_run_in_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is its light on our road to the end of the drive."""
    monkeypatch.setattr(driving, "RUN_IN_S", 0.8)
    monkeypatch.setattr(driving, "settings_of", lambda _: ())
    passing = VehicleSpec(timetable=((0.0, 45.0), (10.0, -155.0)))
    driven = scene(0.8 + 3 / 18, vehicles=(passing, AHEAD))
    plan = GlarePlan(quality="fast")
    drives = plan.drives(plan.delays.known_to(config()))
    drive, _ = drives.driven(driven, "S00001", drives.frames(driven))
    assert [eye.vehicle_id for eye in drive.eyes] == [1]
    assert 0.3 < drive.gone_s[0] < 0.8


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
    with pytest.raises(ValueError, match=r"plan\.json: plan\.also: expected .*wide.* as here before, got .*wide"):
        run_experiment(scenes, cars, again, tmp_path / "out", progress=lambda *_: None)
    oracle = tmp_path / "oracle.toml"
    oracle.write_text("")
    with pytest.raises(ValueError, match=r"oracle\.toml: expected a file that is called unlike any other row"):
        GlarePlan(also=(oracle,)).others(cars)
    latency = Path(shutil.copy(oracle, tmp_path / "latency 0.toml"))
    with pytest.raises(ValueError, match=r"latency 0\.toml: expected a file that is called unlike any other row"):
        GlarePlan(also=(latency,)).others(cars)


def test_the_latency_is_that_of_the_delays(tmp_path: Path) -> None:
    """A policy knows of the delays that there are: another latency in its configuration was ignored."""
    other = tmp_path / "other.toml"
    other.write_text("[beam]\nlatency_s = 0.3\n")
    expected = r"beam\.latency_s: expected 0\.15, the sum of camera delay and lamp delay, or its default, got 0\.3"
    with pytest.raises(ValueError, match=rf"other\.toml: {expected}"):
        GlarePlan(also=(other,)).others(config())
    with pytest.raises(ValueError, match=f"^{expected}"):
        GlarePlan().delays.known_to(config().changed("beam", latency_s=0.3))
    slow = Delays(camera_s=0.2, lamp_s=0.1)
    for given_s in (0.15, 0.3):
        assert slow.known_to(config().changed("beam", latency_s=given_s)).beam.latency_s == pytest.approx(0.3)


def test_all_cars_have_the_same_lamps(tmp_path: Path) -> None:
    """The light of every row is computed with those of ours."""
    shutil.copy(SHIPPED, tmp_path / "lamps.toml")
    other = tmp_path / "other.toml"
    other.write_text('[beam]\nheadlamps = "lamps.toml"\n')
    with pytest.raises(ValueError, match=r"other\.toml: beam\.headlamps: expected None, .* got .*lamps\.toml"):
        GlarePlan(also=(other,)).others(config())


def test_scenes_in_which_there_is_never_light_are_refused(tmp_path: Path) -> None:
    """Too slow for a guard or the lamps, even if it is another car's, or between two pairs alone."""
    strict = tmp_path / "strict.toml"
    strict.write_text("[guard]\nmax_gap_s = 0.05\n")
    patient = config().model_copy(update={"guard": config().guard.model_copy(update={"max_gap_s": 5.0})})
    for driven, car, also, limit in (
        (scene(rate_hz=4.0), config(), (), "0.2 s .* got 4 Hz with up to 0.25 s"),
        (scene(rate_hz=4.0), patient, (), "0.2 s .* got 4 Hz"),
        (scene(rate_hz=8.0, pair_s=0.04), config(), (), "0.2 s .* got 8 Hz with up to 0.21 s"),
        (scene(), config(), (strict,), "0.05 s .* got 18 Hz"),
    ):
        plan = GlarePlan(quality="fast", also=also)
        with pytest.raises(ValueError, match=rf"^S00001: rate_hz: expected at most {limit}"):
            run_experiment(write_scenes_of(tmp_path, driven), car, plan, tmp_path / "out", progress=lambda *_: None)
    assert not (tmp_path / "out").exists()


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
    with pytest.raises(
        ValueError, match=r"plan\.json: plan\.paper_model: expected None as here before, got .*all\.onnx"
    ):
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


def test_drives_with_other_lamps_of_vehicles_are_not_added(tmp_path: Path) -> None:
    class Stopped(Local):
        def each(self, *_: object, **__: object) -> Never:
            raise KeyboardInterrupt

    lamp, out = tmp_path / "l.ies", tmp_path / "out"
    lamp.write_text("one")
    first, *others = scene().vehicles
    vehicles = (first.model_copy(update={"low_beam_file": str(lamp)}), *others)
    ego = scene().ego.model_copy(update={"low_beam_file": "nowhere.ies"})  # is not used here
    scenes = write_scenes_of(tmp_path, scene().model_copy(update={"vehicles": vehicles, "ego": ego}))

    def begin() -> None:
        run_experiment(scenes, config(), GlarePlan(quality="fast"), out, workers=Stopped(), progress=lambda *_: None)

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            begin()
    lamp.write_text("another")
    with pytest.raises(
        ValueError, match=r"models: expected vehicles\.0\.low_beam_file of S00001 as it was here before"
    ):
        begin()


def test_low_beams_that_the_lamps_replace_are_told() -> None:
    def named(name: str, **fields: object) -> NamedScene:
        return NamedScene(name, Scene(ego=EgoSpec.model_validate(fields)))

    plain = named("S00001")
    assert not list(remarks_on([plain]))
    (line,) = remarks_on([plain, named("S00002", carpet=0.4), named("S00003", stray=2.0)])
    assert line == (
        "The scenes of 2 of 3 drives (S00002, S00003) have a low beam of their own (ego.carpet, ego.stray); here that "
        "of the headlamps (--lamps) is in its place."
    )
    (line,) = remarks_on([named(f"S0000{number}", carpet=0.4) for number in range(4)])
    assert "4 of 4 drives (S00000, S00001, S00002 and others)" in line


def test_low_beams_made_for_the_other_side_of_traffic_are_told() -> None:
    def named(road: str, ego: str) -> NamedScene:
        made = Scene(road=RoadSpec.model_validate({"traffic": road}), ego=EgoSpec.model_validate({"traffic": ego}))
        return NamedScene(f"{road}-{ego}", made)

    assert not list(remarks_on([named("left", "left"), named("right", "right")]))
    (line,) = remarks_on([named("left", "left"), named("left", "right")])
    assert line == (
        "The scenes of 1 of 2 drives (left-right) have traffic on the left, and a car whose low beam is made for "
        'traffic on the right (ego.traffic = "right"): it shines highest at oncoming drivers.'
    )
    (line,) = remarks_on([named("right", "left")])
    assert "traffic on the right, and a car whose low beam is made for traffic on the left" in line


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
    quiet = write_scenes_of(tmp_path / "quiet", without_traffic(scene()), scene(seed=5))
    names = [one.name for one in named_scenes(quiet, GlarePlan(num_empty=2))]
    assert names == ["S00001", "S00002", "S00002-empty"]  # the same drive would count twice
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
