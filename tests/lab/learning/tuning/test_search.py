"""A whole search on a small data set: what it finds, and that interruptions and company change nothing."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import json
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import cv2
import pytest

from foreglow.config import read_config
from foreglow.datasets import open_labelled, split_folder
from foreglow.lab.learning.tuning import SPACES, TrialRecord, Tuning, TuningSettings, tune
from foreglow.lab.learning.tuning.measurement import Bench, read_material
from foreglow.lab.learning.tuning.objectives import PAPER
from foreglow.lab.learning.tuning.study import LEFT_LOCK_S, StudyPlan, num_finished, open_study
from foreglow.parallel import Local
from tests.cli.commands import complaint, foreglow_command
from tests.lab.learning.night_set import NUM_IMAGES, NUM_SEQUENCES, make_night_set
from tests.pipes import ENDLESS, soon

pytestmark = [pytest.mark.torch, pytest.mark.slow]  # Optuna comes with the same extra


@pytest.fixture(autouse=True, scope="module")
def _journals_need_not_outlive_a_power_cut() -> Iterator[None]:
    """Optuna waits for the disk after each line of its journal."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(os, "fsync", lambda _: None)
        yield


NUM_ALL = NUM_SEQUENCES * NUM_IMAGES
SEED = 3


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_night_set(tmp_path_factory.mktemp("data"), ("train", "val", "test"))


def searched(data: Path, out: Path, num_trials: int, **settings: object) -> Tuning:
    return tune(data, out, TuningSettings(num_trials=num_trials, seed=SEED, **settings))  # type: ignore[arg-type]


def drawn(trials: tuple[TrialRecord, ...]) -> list[tuple[str, float, dict[str, object]]]:
    """What does not depend on interruptions."""
    return [(trial.state, trial.loss, dict(trial.parameters)) for trial in trials]


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `straight`."""
    return tmp_path_factory.mktemp("straight")


@pytest.fixture(scope="module")
def straight(data: Path, out: Path) -> Tuning:
    """A search in one go."""
    return searched(data, out, 24)


def test_finds_better_parameters_than_the_papers(straight: Tuning) -> None:
    assert (straight.paper.train.quality.q, straight.paper.train_loss) == (0.75, 0.25)
    assert straight.chosen.config.gap_px < 4
    assert straight.chosen.val_loss == 0.0
    for found in (straight.chosen.val, straight.chosen.test):
        assert found is not None
        assert found.quality.q == 1.0
    assert straight.paper.test is not None
    assert straight.paper.test.quality.q == 0.75


def test_paper_comes_first_and_is_a_finalist(straight: Tuning) -> None:
    assert straight.trials[0].parameters == SPACES["paper"].first
    assert straight.paper in straight.finalists
    assert len(straight.finalists) <= 11


def test_test_split_is_for_the_chosen_one_only(straight: Tuning) -> None:
    rated = [finalist.config for finalist in straight.finalists if finalist.test is not None]
    assert set(rated) == {straight.chosen.config, PAPER}


def test_bad_trials_end_early(straight: Tuning) -> None:
    pruned = [trial for trial in straight.trials if trial.state == "PRUNED"]
    assert pruned
    assert all(trial.measurement["num_images"] < NUM_ALL for trial in pruned)
    complete = [trial for trial in straight.trials if trial.state == "COMPLETE"]
    assert all(trial.measurement["num_images"] == NUM_ALL for trial in complete)
    assert min(trial.loss for trial in pruned) > min(trial.loss for trial in complete)


def test_same_seed_same_result(straight: Tuning, data: Path, tmp_path: Path) -> None:
    again = searched(data, tmp_path, 12)
    assert drawn(again.trials) == drawn(straight.trials)[:12]
    other = tune(data, tmp_path / "other", TuningSettings(num_trials=3, seed=SEED + 1))
    assert drawn(other.trials)[1:] != drawn(straight.trials)[1:3]


def test_goes_on_as_if_never_stopped(straight: Tuning, data: Path, tmp_path: Path) -> None:
    def interrupt(task: str, done: int, _: int) -> None:
        if (task, done) == ("trials", 13):
            raise KeyboardInterrupt

    searched(data, tmp_path, 5)
    with pytest.raises(KeyboardInterrupt):
        tune(data, tmp_path, TuningSettings(num_trials=24, seed=SEED), interrupt)
    _leave_a_dead_trial(data, tmp_path)
    resumed = searched(data, tmp_path, 24)
    assert drawn(resumed.trials) == drawn(straight.trials)
    assert resumed.finalists == straight.finalists


def test_trials_on_other_images_do_not_count(data: Path, tmp_path: Path) -> None:
    """Also with the same ids and labels, as a copy of the data has whose images were made brighter."""
    copy = shutil.copytree(data, tmp_path / "copy")
    for path in split_folder(copy, "train").rglob("images/*/*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(path), cv2.bitwise_not(image))
    assert plan_of(data, tmp_path / "out").name != plan_of(copy, tmp_path / "out").name


def _leave_a_dead_trial(data: Path, out: Path) -> None:
    """A trial whose process was killed in the middle of it."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    trial = open_study(plan_of(data, out)).ask()
    trial.set_user_attr("process", [socket.gethostname(), dead.pid])
    trial.suggest_int("gap_px", 1, 9)
    trial.report(0.0, 0)


def plan_of(data: Path, out: Path, num_trials: int = 24) -> StudyPlan:
    material = read_material(open_labelled(split_folder(data, "train")), 600, out / "frames")
    name = f"q-paper-{NUM_ALL}-{material.digest}-{version('foreglow')}"
    return StudyPlan(str(out / "study.journal"), name, TuningSettings(num_trials=num_trials, space="paper", seed=SEED))


def test_interrupted_trial_is_given_up(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure, calls = Bench.measure, iter(range(100))

    def interrupted(self: Bench, config: object) -> object:
        if next(calls) == 3:  # the first is the reference
            raise KeyboardInterrupt
        return measure(self, config)  # type: ignore[arg-type]

    monkeypatch.setattr(Bench, "measure", interrupted)
    with pytest.raises(KeyboardInterrupt):
        searched(data, tmp_path, 5)
    study = open_study(plan_of(data, tmp_path))
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "COMPLETE", "FAIL"]


def test_a_line_that_was_cut_off_is_left_out(straight: Tuning, data: Path, tmp_path: Path) -> None:
    searched(data, tmp_path, 3)
    journal = tmp_path / "study.journal"
    journal.write_bytes(journal.read_bytes()[:-20])
    again = searched(data, tmp_path, 5)
    assert len(again.trials) == 5
    assert drawn(again.trials)[:2] == drawn(straight.trials)[:2]


@pytest.mark.parametrize(("code", "what"), [(0, "study 0"), (4, "trial 2")])
def test_a_lost_beginning_of_a_search_or_of_a_trial_is_told(data: Path, tmp_path: Path, code: int, what: str) -> None:
    """Optuna passes over what follows from it: the search began anew without a word."""
    searched(data, tmp_path, 3)
    journal = tmp_path / "study.journal"
    lines = journal.read_bytes().splitlines(keepends=True)
    begin = [line for line in lines if json.loads(line)["op_code"] == code]
    journal.write_bytes(b"".join(line for line in lines if line not in (begin if code == 0 else begin[-1:])))
    with pytest.raises(
        ValueError, match=rf"study\.journal: line \d+: expected a line before that begins {what}; choose"
    ):
        searched(data, tmp_path, 5)


@pytest.mark.parametrize("code", [5, 8])
def test_a_record_of_a_trial_that_is_lost_is_told(data: Path, tmp_path: Path, code: int) -> None:
    """One with a parameter, or with an attribute such as its measurement."""
    searched(data, tmp_path, 3)
    journal = tmp_path / "study.journal"
    lines = journal.read_bytes().splitlines(keepends=True)
    of_kind = [line for line in lines if json.loads(line)["op_code"] == code and (code == 5 or b"measurement" in line)]
    kept = [line for line in lines if line != of_kind[-1]]
    journal.write_bytes(b"".join(kept))
    with pytest.raises(ValueError, match=r"study\.journal: trial \d: expected all its parameters and its measurement"):
        searched(data, tmp_path, 5)


def test_a_lock_that_a_killed_process_left_is_broken_without_a_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    import optuna

    journal, clock = tmp_path / "study.journal", itertools.count()
    journal.touch()
    journal.with_name("study.journal.lock").symlink_to(journal)
    module = importlib.import_module("optuna.storages.journal._file")
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: next(clock), sleep=lambda _: None))
    monkeypatch.setattr(optuna.logging.get_logger("optuna"), "propagate", True)  # to caplog
    study = open_study(StudyPlan(str(journal), "name", TuningSettings()))
    assert study.get_trials() == []
    assert next(clock) > LEFT_LOCK_S  # it has waited
    assert caplog.messages == []


def test_finished_study_runs_no_trial(straight: Tuning, data: Path, tmp_path: Path) -> None:
    searched(data, tmp_path, 4)
    again = searched(data, tmp_path, 3)
    assert drawn(again.trials) == drawn(straight.trials)[:4]


def test_another_seed_is_not_mixed_in(data: Path, tmp_path: Path) -> None:
    searched(data, tmp_path, 2, num_images=4)
    before = (tmp_path / "study.journal").read_bytes()
    with pytest.raises(
        ValueError, match=rf"study\.journal: seed: expected .* begun here, {SEED}, got {SEED + 1}; choose"
    ):
        tune(data, tmp_path, TuningSettings(num_trials=3, num_images=4, seed=SEED + 1))
    assert (tmp_path / "study.journal").read_bytes().startswith(before)
    assert len(searched(data, tmp_path, 3, num_images=4).trials) == 3


def test_processes_share_a_study(data: Path, tmp_path: Path) -> None:
    tuning = tune(data, tmp_path, TuningSettings(num_trials=14, seed=SEED), workers=Local(2))
    assert len(tuning.trials) == 14
    assert len({tuple(trial.parameters.items()) for trial in tuning.trials}) > 10
    study = open_study(plan_of(data, tmp_path))
    assert num_finished(study) == 14


def test_machines_share_a_database(data: Path, tmp_path: Path) -> None:
    storage = f"sqlite:///{tmp_path}/study.db"
    searched(data, tmp_path / "one", 2, num_images=4, storage=storage)
    second = searched(data, tmp_path / "two", 3, num_images=4, storage=storage)
    assert len(second.trials) == 3
    assert not list(tmp_path.glob("*/study.journal"))


@pytest.mark.parametrize("storage", ["nosuch://me:se@cret@host/x", "nosuch://:se@cret@host:1/x?y=z"])
def test_the_password_of_a_storage_is_not_shown(storage: str) -> None:
    with pytest.raises(ValueError, match=r"^storage: nosuch://(me)?:\*\*\*@host") as refused:
        open_study(StudyPlan(storage, "name", TuningSettings()))
    assert "se@cret" not in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("storage", ["sqlite:///{}", "{}"])
@pytest.mark.parametrize("kind", ENDLESS)
def test_a_pipe_is_no_storage(tmp_path: Path, kind: str, storage: str) -> None:
    ENDLESS[kind](tmp_path / "study")
    plan = StudyPlan(storage.format(tmp_path / "study"), "name", TuningSettings())
    with soon(), pytest.raises(ValueError, match=r"study: expected a file for a .*, got something else"):
        open_study(plan)


@pytest.mark.parametrize("content", [b"my only notes\n", None])
def test_a_database_of_something_else_stays_as_it_is(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "drive.db3"
    if content is None:
        with contextlib.closing(sqlite3.connect(path)) as database:
            database.execute("CREATE TABLE messages (id INTEGER)")
            database.commit()
    else:
        path.write_bytes(content)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"drive\.db3: expected a new file, or a database of searches"):
        open_study(StudyPlan(f"sqlite:///{path}", "name", TuningSettings()))
    assert path.read_bytes() == before


IN_MEMORY = ("://", ":///", ":///:memory:", "+pysqlite://")
"""What makes URLs of databases that are gone with their connection."""


@pytest.mark.parametrize(
    ("storage", "reason"),
    [
        (
            "http://x",
            "http://x: expected the URL of a database that can be opened, such as sqlite:///FILE, or a file: ",
        ),
        ("redis://localhost", "redis://localhost: expected the URL of a database"),
        *((f"sqlite{url}", f"sqlite{url}: expected a database that keeps what is written") for url in IN_MEMORY),
        ("sqlite:///file:notes?mode=memory&cache=shared&uri=true", "expected sqlite:///FILE"),
        ("sqlite+pysqlite:///{notes}", "notes.txt: expected a new file, or a database of searches"),
        ("sqlite:////proc/none/x", "sqlite:////proc/none/x: expected the URL of a database"),
        ("sqlite:///{notes}", "notes.txt: expected a new file, or a database of searches"),
        ("{notes}", "notes.txt: expected a new file, or the journal of a search"),
    ],
)
def test_a_storage_is_looked_at_before_frames_are_decoded(
    data: Path, tmp_path: Path, storage: str, reason: str
) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("my only notes\n")
    refused = complaint(
        "tune", data, "--trials", 2, "--out", tmp_path / "out", "--storage", storage.format(notes=notes)
    )
    assert reason in refused
    assert list(tmp_path.iterdir()) == [notes]


def test_a_search_without_a_finished_trial_is_no_success(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("foreglow.lab.learning.tuning.search._run_trials", lambda *_: None)
    refused = complaint("tune", data, "--trials", 2, "--images", 4, "--out", tmp_path / "out")
    assert f"{tmp_path / 'out' / 'study.journal'}: expected a finished trial, found none" in refused
    assert not (tmp_path / "out" / "best.toml").exists()


@pytest.mark.parametrize("name", ["val", "test"])
def test_a_split_that_is_train_by_another_name_judges_nothing(name: str, tmp_path: Path) -> None:
    data = make_night_set(tmp_path / "data", ("train",), num_images=2)
    (split,) = data.rglob("train")
    (split.parent / name).symlink_to(split)
    with pytest.raises(ValueError, match="train: expected a split to train on, got one that judges what is learnt"):
        searched(data, tmp_path / "out", 1)


def test_labels_are_no_storage(data: Path, tmp_path: Path) -> None:
    labels = next(path for path in data.rglob("sequences.json") if "val" in path.parts)
    before = labels.read_bytes()
    result = foreglow_command("tune", data, "--trials", 2, "--out", tmp_path / "out", "--storage", labels)
    assert result.exit_code == 2
    assert f"--storage {labels}: expected a file that does not overwrite a part of DATA" in result.stderr
    assert labels.read_bytes() == before


@pytest.mark.parametrize("is_cut", [True, False])
def test_damaged_frames_are_decoded_again(data: Path, tmp_path: Path, *, is_cut: bool) -> None:
    out = tmp_path / "out"
    first = searched(data, out, 2, num_images=4)
    (frames,) = (out / "frames").glob("*.bin")
    content = frames.read_bytes()
    frames.write_bytes(content[:10] if is_cut else bytes(len(content)))
    done = foreglow_command("tune", data, "--trials", 3, "--images", 4, "--seed", 3, "--out", out)
    assert done.exit_code == 0, done.output
    assert f"foreglow: {frames}: the frames kept here are damaged, and are decoded again\n" in done.stderr
    assert frames.read_bytes() == content
    assert drawn(searched(data, out, 3, num_images=4).trials)[:2] == drawn(first.trials)


def test_other_data_or_objective_is_another_study(data: Path, tmp_path: Path) -> None:
    names = {
        searched(data, tmp_path, 1, num_images=num_images, objective=objective).study_name
        for num_images in (4, 5)
        for objective in ("q", "light")
    }
    assert len(names) == 4


def test_without_val_the_best_on_train_is_chosen(tmp_path: Path) -> None:
    tuning = searched(make_night_set(tmp_path, ("train",), num_images=2), tmp_path / "out", 12)
    assert tuning.chosen.val is None
    assert tuning.chosen.train_loss == min(finalist.train_loss for finalist in tuning.finalists)


def test_bad_settings(data: Path, tmp_path: Path) -> None:
    for name in ("num_trials", "num_images", "num_finalists"):
        with pytest.raises(ValueError, match=f"{name}: expected at least 1, got 0"):
            TuningSettings(**{name: 0})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="objective: expected one of"):
        TuningSettings(objective="best")
    with pytest.raises(ValueError, match="storage: nodatabase://x"):
        searched(data, tmp_path, 1, storage="nodatabase://x")


@pytest.mark.usefixtures("straight")
def test_command(data: Path, out: Path) -> None:
    """It finds a search that is finished; `test_command_with_too_few_trials_for_importances` begins one."""
    result = foreglow_command("tune", data, "--trials", 24, "--seed", SEED, "--out", out)
    assert result.exit_code == 0, result.output
    assert "chosen: " in result.stdout
    assert "test: q 1.000 (paper 0.750)" in result.stdout
    assert "s: final value (search space, step): 0.01 ([0, 0.1], 0.01); here " in result.stdout
    assert "in the same space by the same step" in result.stdout
    assert (
        "the formula; here the same and penalties for lost recall and more false boxes (objective q)" in result.stdout
    )
    names = {path.name for path in out.iterdir()}
    assert names >= {"best.toml", "trials.csv", "summary.json", "parallel.png", "report.md", "study.journal"}
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["num_finished"], summary["settings"]["seed"]) == (24, SEED)
    assert summary["version"]
    chosen = read_config(out / "best.toml").proposals
    assert chosen.model_dump(include=set(summary["chosen"]["parameters"])) == summary["chosen"]["parameters"]
    rows = (out / "trials.csv").read_text().splitlines()
    assert len(rows) == 25
    assert rows[1].startswith("0,COMPLETE,0.25,0.4,19,0.01,4,16,48,0.75,")
    assert "| test, paper | – | 0.750 |" in (out / "report.md").read_text()


def test_command_with_too_few_trials_for_importances(data: Path, tmp_path: Path) -> None:
    arguments = ("--trials", 2, "--images", 4, "--objective", "light", "--out", tmp_path)
    result = foreglow_command("tune", data, *arguments)
    assert result.exit_code == 0, result.output
    assert "same space" not in result.stdout
    assert "in another space, `wide`" in result.stdout
    assert "the formula; here another one, of recall by kind of light, q and the number of boxes" in result.stdout
    assert not (tmp_path / "importance.png").exists()
    assert "Too few finished trials" in (tmp_path / "report.md").read_text()


def test_command_says_what_was_done(data: Path, tmp_path: Path) -> None:
    """The trials that are there, and the images: not what the options of the last call ask for."""
    arguments = ("--images", 100_000, "--objective", "light", "--out", tmp_path)
    foreglow_command("tune", data, "--trials", 2, *arguments)
    done = foreglow_command("tune", data, "--trials", 1, *arguments)
    assert "2 trials (0 ended early)" in done.stdout
    assert f"the same, by Optuna; 2 trials on {NUM_ALL} images of train" in done.stdout
    assert f"2 trials on {NUM_ALL} images of train" in (tmp_path / "report.md").read_text()


def test_a_study_of_another_program_in_a_database_is_told(data: Path, tmp_path: Path) -> None:
    """Two directions were an internal error, and another one a search for the worst parameters."""
    import optuna

    searched(data, tmp_path / "out", 1, storage=f"sqlite:///{tmp_path}/ours.db")
    (name,) = optuna.get_all_study_names(f"sqlite:///{tmp_path}/ours.db")
    for number, directions in enumerate((["maximize"], ["minimize", "minimize"])):
        storage = f"sqlite:///{tmp_path}/{number}.db"
        optuna.create_study(storage=storage, study_name=name, directions=directions)  # type: ignore[arg-type]
        with pytest.raises(
            ValueError, match=rf"study {name}: expected one that minimises one loss, got .*{directions[-1]}"
        ):
            searched(data, tmp_path / "out", 1, storage=storage)


def test_command_complains(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "expected the split train" in complaint("tune", data / "night" / "val", "--out", tmp_path)
    assert "space: expected one of paper, wide" in complaint("tune", data, "--space", "all", "--out", tmp_path)
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert "pip install 'foreglow[train]'" in complaint("tune", data, "--out", tmp_path)
    assert not list(tmp_path.iterdir())
