"""The experiments behind the page, and the page: on two simulated drives of three images each."""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from foreglow.config import preset
from foreglow.files import write_json_results
from foreglow.lab.simulation.scenes.scene import VehicleSpec
from foreglow.lab.simulation.writing.scene_files import read_scenes
from foreglow.lab.studies.reproduction import page, run
from foreglow.lab.studies.reproduction.claims import DIFFERS, NEEDS, NO_VALUE, Answer, read_claims
from foreglow.lab.studies.reproduction.experiments import EXPERIMENTS, Experiment, write_oncoming_scenes
from foreglow.lab.studies.reproduction.page import NOT_PVDN, answers, write_page
from foreglow.lab.studies.reproduction.plan import ReproductionPlan
from foreglow.lab.studies.reproduction.run import Outcome, run_experiments
from foreglow.outputs import check_outputs, running
from foreglow.photometry.headlamps_file import SHIPPED
from tests.cli.commands import complaint, foreglow_command
from tests.lab.studies.detector_data import make_model
from tests.lab.studies.ranged_drives import make_split

SMALL = ("settings", "data", "distance", "drive")
"""What runs within seconds on a few images."""


@pytest.fixture(name="data", scope="module")
def fixture_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_split(tmp_path_factory.mktemp("drives")).parents[1]


def quiet(step: str, num_done: int, num_all: int) -> None: ...


def only(names: tuple[str, ...]) -> Mapping[str, Experiment]:
    """The experiments of these names; the others have a reason."""
    return {
        name: experiment if name in names else dataclasses.replace(experiment, needs=("train",))
        for name, experiment in EXPERIMENTS.items()
    }


def stubs(calls: list[str], broken: str = "") -> Mapping[str, Experiment]:
    """In place of each experiment one that says that it ran."""

    def stub(name: str) -> Any:
        def write(_: ReproductionPlan, folder: Path, *__: object) -> None:
            calls.append(name)
            if name == broken:
                raise ValueError(f"{folder}: expected something else")
            write_json_results(folder / EXPERIMENTS[name].results, {})

        return write

    return {name: dataclasses.replace(experiment, run=stub(name), needs=()) for name, experiment in EXPERIMENTS.items()}


def test_what_is_finished_is_not_run_again(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    plan = ReproductionPlan(data)
    run_experiments(plan, tmp_path / "out", progress=quiet)
    assert calls == [name for wave in run.WAVES for name in wave]
    run_experiments(plan, tmp_path / "out", progress=quiet)
    assert len(calls) == len(EXPERIMENTS)
    run_experiments(dataclasses.replace(plan, trials=7), tmp_path / "out", progress=quiet)
    assert calls[len(EXPERIMENTS) :] == ["tune"]
    (tmp_path / "out" / "glare" / "results.json").unlink()
    (tmp_path / "out" / "detector" / "results.json").write_bytes(b"")
    (tmp_path / "out" / "distance" / "results.json").write_text("[]")
    calls.clear()
    run_experiments(dataclasses.replace(plan, trials=7), tmp_path / "out", progress=quiet)
    assert calls == ["detector", "distance", "glare"]
    calls.clear()
    monkeypatch.setattr("importlib.metadata.version", lambda _: "another one")
    run_experiments(dataclasses.replace(plan, trials=7), tmp_path / "out", progress=quiet)
    assert len(calls) == len(EXPERIMENTS)


@pytest.mark.parametrize("interrupted", ["settings", "tune", "detector", "glare"])
def test_the_same_command_goes_on_after_an_interruption(
    interrupted: str, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What had begun had no `seconds` yet, so that the folder counted as something else's."""
    calls: list[str] = []
    made = dict(stubs(calls))

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "EXPERIMENTS", made | {interrupted: dataclasses.replace(made[interrupted], run=stopped)})
    words = ("reproduce", data, "--out", tmp_path / "out", "--epochs", 1)
    assert foreglow_command(*words).exit_code == 130
    begun = [*calls]
    monkeypatch.setattr(run, "EXPERIMENTS", made)
    with running("reproduce"):
        check_outputs({}, {}, {"--out": tmp_path / "out"})
    run_experiments(ReproductionPlan(data, epochs=1), tmp_path / "out", progress=quiet)
    assert set(calls[len(begun) :]) == EXPERIMENTS.keys() - set(begun)


def test_another_network_of_the_paper(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What uses it is run again when it changes, and nothing else."""
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    model = make_model(tmp_path / "paper.onnx")
    plan = ReproductionPlan(data, models={"paper": model})
    run_experiments(plan, tmp_path / "out", progress=quiet)
    calls.clear()
    make_model(model, bias=2.0)
    run_experiments(plan, tmp_path / "out", progress=quiet)
    assert {"detector", "time-benefit", "glare", "runtime"} <= set(calls)
    assert not {"settings", "data", "distance"} & set(calls)


def test_other_files_of_the_configuration(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lamps under the same name as before: the results of the former ones were read again."""
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    lamps = Path(shutil.copy(SHIPPED, tmp_path / "lamps.toml"))
    plan = ReproductionPlan(data, config=preset("foreglow").changed("beam", headlamps=lamps))
    for text in ("", "\n"):
        calls.clear()
        lamps.write_text(lamps.read_text() + text)
        run_experiments(plan, tmp_path / "out", progress=quiet)
    assert {"time-benefit", "glare", "drive", "runtime"} <= set(calls)
    assert not {"settings", "data", "distance", "detector"} & set(calls)


def test_data_that_were_moved_are_the_same(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    shutil.copytree(data, tmp_path / "straight")
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    run_experiments(ReproductionPlan(data, straight=(tmp_path / "straight", data)), tmp_path / "out", progress=quiet)
    calls.clear()
    monkeypatch.chdir(shutil.copytree(data, tmp_path / "elsewhere"))
    moved = (tmp_path / "straight").rename(tmp_path / "moved")
    run_experiments(ReproductionPlan(Path(), straight=(moved, Path())), tmp_path / "out", progress=quiet)
    assert calls == []


def test_the_other_cycle_counts_among_the_data_alone(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    for cycles in (("day",), ("day", "night")):
        calls.clear()
        shutil.copytree(ReproductionPlan(data).split("test"), tmp_path / "data" / cycles[-1] / "test")
        run_experiments(ReproductionPlan(tmp_path / "data"), tmp_path / "out", progress=quiet)
    assert calls == ["data"]


def test_another_yolo_in_the_same_folder(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    monkeypatch.setattr("foreglow.lab.learning.yolo.check_usable", lambda _: None)  # whose library may be missing
    folder = tmp_path / "yolo"
    folder.mkdir()
    training = {"backend": "libreyolo", "size": "s", "image_size_px": 64}
    (folder / "config.json").write_text(json.dumps({"training": training, "boxes": "x", "export_size_px": 64}))
    counts = {"num_parameters": 1, "num_multiply_adds": 1, "seconds": 1.0}
    (folder / "results.json").write_text(json.dumps({"weights": "best.pt"} | counts))
    for content in (b"one", b"two"):
        calls.clear()
        (folder / "best.pt").write_bytes(content)
        run_experiments(ReproductionPlan(data, models={"yolo-small": folder}), tmp_path / "out", progress=quiet)
    assert calls == ["detector"]


def test_an_experiment_that_the_data_do_not_allow(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has a reason, the others go on, and it is tried again."""
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls, broken="drive"))
    outcomes = run_experiments(ReproductionPlan(data), tmp_path / "out", progress=quiet)
    assert outcomes["drive"].reason.endswith("expected something else")
    assert outcomes["drive"].results is None
    assert all(outcome.results == {} for name, outcome in outcomes.items() if name != "drive")
    assert [name for name, outcome in outcomes.items() if outcome.has_failed] == ["drive"]
    run_experiments(ReproductionPlan(data), tmp_path / "out", progress=quiet)
    assert calls[len(EXPERIMENTS) :] == ["drive"]


@pytest.mark.parametrize("broken", ["", "drive"])
def test_a_script_sees_that_an_experiment_could_not_be_finished(
    data: Path, broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page is complete but for that; of what these data do not have, such as a split, it only says so."""
    monkeypatch.setattr(run, "EXPERIMENTS", stubs([], broken=broken))
    monkeypatch.setattr(page, "answers", lambda *_: [])  # the stubs' results are empty
    monkeypatch.setattr(page, "write_page", lambda *_: tmp_path / "out" / "report.md")
    result = foreglow_command("reproduce", data, "--out", tmp_path / "out")
    assert result.exit_code == (2 if broken else 0), result.output
    line = f"drive could not be finished: {tmp_path / 'out' / 'drive'}: expected something else\n"
    assert result.stderr == (line if broken else "")
    assert "look in " in result.stdout


def test_results_stay_until_there_are_others(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of an experiment that fails with other options, or that was begun with other epochs."""
    monkeypatch.setattr(run, "EXPERIMENTS", stubs([]))
    plan, out = ReproductionPlan(data, epochs=1), tmp_path / "out"
    run_experiments(plan, out, progress=quiet)
    kept = {path: path.read_bytes() for path in out.rglob("*.json")}
    with pytest.raises(ValueError, match=r"out: --epochs: expected that of the networks trained here, 1, got 2; name"):
        run_experiments(dataclasses.replace(plan, epochs=2), out, progress=quiet)
    assert {path: path.read_bytes() for path in out.rglob("*.json")} == kept
    monkeypatch.setattr(run, "EXPERIMENTS", stubs([], broken="tune"))
    outcomes = run_experiments(dataclasses.replace(plan, trials=7), out, progress=quiet)
    assert outcomes["tune"].results is None
    results = out / "tune" / EXPERIMENTS["tune"].results
    assert results.read_bytes() == kept[results]


def test_a_state_of_another_shape_is_said(data: Path, tmp_path: Path) -> None:
    (tmp_path / run.STATE).write_text('{"distance": 3}')
    with pytest.raises(ValueError, match=rf"{run.STATE}: distance: .*, got 3"):
        run_experiments(ReproductionPlan(data), tmp_path, progress=quiet)


@pytest.mark.parametrize("field", ["key", "results", "seconds", "load", "reason", "has_failed"])
def test_a_damaged_state_is_made_anew_or_said(
    field: str, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damaged results whose digest was lost with it ended in an internal error."""
    calls: list[str] = []
    monkeypatch.setattr(run, "EXPERIMENTS", stubs(calls))
    plan, state = ReproductionPlan(data), tmp_path / run.STATE
    run_experiments(plan, tmp_path, progress=quiet)
    whole = json.loads(state.read_text())
    results = tmp_path / "detector" / EXPERIMENTS["detector"].results
    for content in ("[]", '{"rows": 1}', '{"rows": [{"load": "x"}]}', "junk", ""):
        results.write_text(content)
        state.write_text(json.dumps(whole | {"detector": {k: v for k, v in whole["detector"].items() if k != field}}))
        calls.clear()
        assert run_experiments(plan, tmp_path, progress=quiet)["detector"].results == {}
        assert calls == ["detector"]
    state.write_text(json.dumps(whole | {"detector": {k: v for k, v in whole["detector"].items() if k != field}}))
    assert run_experiments(plan, tmp_path, progress=quiet)["detector"].results == {}
    values: list[Any] = [None, [], {}, math.nan, "x" if field in ("seconds", "load", "has_failed") else 1]
    for value in values:
        state.write_text(json.dumps(whole | {"detector": whole["detector"] | {field: value}}))
        with pytest.raises(ValueError, match=rf"{run.STATE}: "):
            run_experiments(plan, tmp_path, progress=quiet)


@pytest.mark.parametrize("name", ["tune", "images"])
def test_folders_of_something_else_stay(name: str, data: Path, tmp_path: Path) -> None:
    """They have names of experiments, whose files would be overwritten there."""
    (tmp_path / name).mkdir()
    with pytest.raises(ValueError, match=f"{name}: expected nothing there but what `reproduce` has begun"):
        run_experiments(ReproductionPlan(data), tmp_path, progress=quiet)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_resumed_run_was_as_busy_as_its_rows(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run-times that an interrupted call measured on a busy machine are no better after an idle one has gone on."""
    made = dict(stubs([]))

    def resumed(_: ReproductionPlan, folder: Path, *__: object) -> None:
        rows = [{"name": "paper", "load": 4.9}, {"name": "ours", "load": 0.2}]
        write_json_results(folder / "results.json", {"rows": rows})

    made["detector"] = dataclasses.replace(made["detector"], run=resumed)
    monkeypatch.setattr(run, "EXPERIMENTS", made)
    monkeypatch.setattr("os.getloadavg", lambda: (0.0, 0.0, 0.0))
    outcomes = run_experiments(ReproductionPlan(data), tmp_path / "out", progress=quiet)
    assert (outcomes["detector"].load, outcomes["distance"].load) == (4.9, 0.0)


@dataclass(frozen=True)
class Reproduced:
    """A reproduction of which the small experiments are finished."""

    plan: ReproductionPlan
    outcomes: Mapping[str, Outcome]
    out: Path

    @property
    def answers(self) -> tuple[Answer, ...]:
        return answers(self.plan, self.outcomes)


@pytest.fixture(name="reproduced", scope="module")
def fixture_reproduced(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Reproduced:
    pytest.importorskip("matplotlib")
    hasty = preset("foreglow").changed(
        "tracker", confirmation="frames", min_hits=1, min_confidence=0.0, vehicle_gate=0.0
    )
    plan, out = ReproductionPlan(data, hasty), tmp_path_factory.mktemp("reproduced")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "EXPERIMENTS", only(SMALL))
        return Reproduced(plan, run_experiments(plan, out, progress=quiet), out)


@pytest.mark.slow
def test_no_claim_is_without_an_answer(reproduced: Reproduced) -> None:
    assert [name for name, outcome in reproduced.outcomes.items() if outcome.results] == list(SMALL)
    assert [found.claim for found in reproduced.answers] == list(read_claims())
    assert all(found.ours and found.verdict for found in reproduced.answers)
    assert all(found.because for found in reproduced.answers if found.ours == NO_VALUE)


def test_what_is_short_of_the_papers_training(data: Path, tmp_path: Path) -> None:
    """The verdict of each network that is trained here, and of none that is given."""
    rows = [{"name": name, "examination": {"quality": {"f1": 0.5}}} for name in ("baseline", "paper")]
    outcomes = {"detector": Outcome("", 0.0, results={"rows": rows})}
    plan = ReproductionPlan(with_splits(data, tmp_path), epochs=2, models={"paper": tmp_path})

    def verdict(plan: ReproductionPlan, row: str) -> tuple[str, str]:
        found = {found.claim.id: found for found in answers(plan, outcomes)}[f"table3-{row}-f1"]
        return found.verdict, found.because

    assert verdict(plan, "baseline") == (NEEDS, "300 epochs of training on PVDN; the network had 2")
    assert verdict(plan, "optimised")[0] == DIFFERS
    assert verdict(dataclasses.replace(plan, epochs=None), "baseline")[0] == DIFFERS


def with_splits(data: Path, root: Path) -> Path:
    """The test drives, as train and val as well."""
    for split in ("train", "val", "test"):
        shutil.copytree(ReproductionPlan(data).split("test"), root / split)
    return root


def test_our_pipeline_goes_by_its_name(data: Path) -> None:
    methods = [{"name": "tracker, ours", "before_human_s": {"mean": 0.5, "num": 3}}]
    outcomes = {"time-benefit": Outcome("", 0.0, results={"methods": methods})}

    def words(*pipeline: str) -> str:
        found = answers(ReproductionPlan(data, pipeline=pipeline), outcomes)
        return next(told.ours for told in found if told.claim.id == "tracker-before-human")

    assert words() == "no value; not compared: +0.50 s, preset foreglow (vehicles: 3)"
    assert words("--preset", "paper") == "no value; not compared: +0.50 s, --preset paper (vehicles: 3)"


def test_only_scenes_with_an_oncoming_driver_are_driven(data: Path, tmp_path: Path) -> None:
    (tmp_path / "glare").mkdir()
    _, scene = read_scenes(ReproductionPlan(data).split("test") / "scenes.jsonl")[0]
    lanes = {1: (), 2: (VehicleSpec(lane="own"),), 3: (VehicleSpec(lane="own"), VehicleSpec(lane="oncoming"))}
    lines = [
        {"sequence": number, "scene": scene.model_copy(update={"vehicles": vehicles}).model_dump(mode="json")}
        for number, vehicles in lanes.items()
    ]
    (tmp_path / "scenes.jsonl").write_text("\n".join(map(json.dumps, lines)))
    chosen = write_oncoming_scenes(tmp_path, tmp_path / "glare")
    assert [number for number, _ in read_scenes(chosen)] == [3]
    (tmp_path / "scenes.jsonl").write_text(json.dumps(lines[0]))
    with pytest.raises(ValueError, match="expected a scene with an oncoming vehicle"):
        write_oncoming_scenes(tmp_path, tmp_path / "glare")


@pytest.mark.slow
def test_the_page(reproduced: Reproduced) -> None:
    report = write_page(reproduced.plan, reproduced.outcomes, reproduced.out)
    html, markdown = report.read_text(), report.with_suffix(".md").read_text()
    assert markdown.split("\n\n")[1] == NOT_PVDN
    assert not re.search(r"\| *\|", markdown)
    assert all(claim.paper in markdown for claim in read_claims())
    errors = [row for row in markdown.splitlines() if row.startswith("| median range error")]
    assert [len(re.findall(r"\d+%", row)) for row in errors] == [4]
    shown = re.findall(r'src="data:image/(?:png|jpeg);base64,([^"]+)"', html)
    files = {path.name: path.read_bytes() for path in (reproduced.out / "images").iterdir()}
    assert {base64.b64decode(data) for data in shown} == set(files.values())
    assert {"reproduction_7.png", "reproduction_8.png", "reproduction_9.png"} <= set(files)
    own = re.findall(r"^Fig\. (\d+)\..*\n\n!\[.*\]\(images/reproduction_(\w+)\.", markdown, re.MULTILINE)
    assert {"1", "3", "4", "12"} <= {number for number, _ in own}
    assert all(number == file for number, file in own)
    record = json.loads((reproduced.out / "results.json").read_text())
    assert [found["id"] for found in record["claims"]] == [claim.id for claim in read_claims()]


@pytest.mark.slow
def test_fields_of_claims_are_fields_of_results(reproduced: Reproduced) -> None:
    """A claim without a value is one whose results do not have it, and no slip in the table."""
    without = {found.claim.id for found in reproduced.answers if found.claim.study in SMALL and found.ours == NO_VALUE}
    scene = {f"scene-{what}" for what in ("single", "tracker", "production", "benefit", "delay")}
    assert without <= {*scene, "scene-gap", "table1-motion", "psd-curves"}


@pytest.mark.parametrize("option", ["--model", "--paper-model", "--published", "--yolo-small"])
def test_a_model_that_cannot_be_used_ends_it_before_it_begins(data: Path, tmp_path: Path, option: str) -> None:
    model = tmp_path / "model.onnx"
    model.write_text("nothing of the kind")
    assert str(model) in complaint("reproduce", data, "--out", tmp_path / "out", option, model)
    assert list(tmp_path.iterdir()) == [model] or not any((tmp_path / "out").iterdir())


def test_a_link_in_place_of_a_folder_for_an_experiment(data: Path, tmp_path: Path) -> None:
    link = tmp_path / "out" / "drive"
    link.parent.mkdir()
    link.symlink_to(tmp_path / "gone")
    line = complaint("reproduce", data, "--out", link.parent)
    assert line == f"foreglow: {link}: expected a folder, got a link to {tmp_path / 'gone'}, which is not there\n"
    assert list(link.parent.iterdir()) == [link]


def test_what_has_no_effect_on_the_data_is_refused(data: Path, tmp_path: Path) -> None:
    options = ("--baseline-small-model", "--baseline-model", "--paper-model")
    given = [word for option in options for word in (option, tmp_path / "model.onnx")]
    line = complaint("reproduce", data, "--out", tmp_path / "out", *given, "--epochs", 3)
    assert "--epochs: expected with a network that is trained" in line
    line = complaint("reproduce", data, "--out", tmp_path / "out", "--production-category", 5)
    assert "--production-category: expected with labels as PVDN's" in line


def test_the_command(tmp_path: Path) -> None:
    error = complaint("reproduce", tmp_path, "--out", tmp_path / "out")
    assert "expected the split test" in error
    missing = complaint("reproduce", tmp_path, "--out", tmp_path / "out", "--paper-model", tmp_path / "no.onnx")
    assert "expected" in missing or "no such" in missing
    assert foreglow_command("reproduce", "--help").exit_code == 0
