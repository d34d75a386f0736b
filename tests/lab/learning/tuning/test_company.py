"""Searches of several machines and versions: whose trials are taken for dead, and which are compared."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from foreglow.lab.learning.tuning import TuningSettings, search, study, tune
from foreglow.lab.learning.tuning.measurement import Bench
from foreglow.lab.learning.tuning.study import StudyPlan, open_study, prepare, work
from tests.lab.learning.night_set import make_night_set

CREATE_TRIAL = 4  # in the journal of Optuna

pytestmark = [pytest.mark.torch, pytest.mark.slow]  # Optuna comes with the same extra


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_night_set(tmp_path_factory.mktemp("data"), ("train",), num_images=2)


def settings(num_trials: int) -> TuningSettings:
    return TuningSettings(num_trials=num_trials, num_images=4, seed=3)


def test_another_version_does_not_continue_a_study(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may propose other boxes: losses of both would be compared."""
    found = tune(data, tmp_path, settings(3))
    monkeypatch.setattr(search, "version", lambda _: "9.9.9")
    again = tune(data, tmp_path, settings(2))
    assert again.study_name == found.study_name.rpartition("-")[0] + "-9.9.9"
    assert len(again.trials) == 2


def test_a_search_whose_first_trial_was_killed_begins_with_the_papers_parameters_even_so(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It went on with other trials than an uninterrupted one."""
    whole = tune(data, tmp_path / "a", settings(4))

    measure = Bench.measure
    for _ in range(2):
        calls = iter(range(100))

        def stopped(self: Bench, config: Any, calls: Iterator[int] = calls) -> Any:
            if next(calls) == 1:  # the first is the reference
                raise KeyboardInterrupt
            return measure(self, config)

        with monkeypatch.context() as patch:
            patch.setattr(Bench, "measure", stopped)
            with pytest.raises(KeyboardInterrupt):
                tune(data, tmp_path / "b", settings(4))
    again = tune(data, tmp_path / "b", settings(4))
    drawn = [[(each.state, each.loss, dict(each.parameters)) for each in found.trials] for found in (whole, again)]
    assert drawn[0] == drawn[1]


def test_the_lock_of_a_killed_search_with_a_relative_path_is_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was a link to nowhere, for which the next search waited for ever."""
    monkeypatch.chdir(tmp_path)
    journal = Path("out/study.journal")
    journal.parent.mkdir()
    locks: list[str] = []
    link = os.symlink

    def noted(target: str, place: str) -> None:
        locks.append(target)
        link(target, place)

    with monkeypatch.context() as patch:
        patch.setattr(os, "symlink", noted)
        open_study(StudyPlan(str(journal), "name", settings(1)))
    assert set(locks) == {str(journal.absolute())}
    journal.with_name("study.journal.lock").symlink_to(journal)  # as an earlier version left it
    assert open_study(StudyPlan(str(journal), "name", settings(1))).get_trials() == []


@pytest.fixture
def zones(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """With which a time zone can be set that ends with the test."""
    with monkeypatch.context() as context:
        yield context
    time.tzset()


@pytest.mark.parametrize(("age_s", "state"), [(10.0, "RUNNING"), (700.0, "FAIL")])
def test_a_trial_of_a_machine_in_another_time_zone_lives_as_long(
    tmp_path: Path, zones: pytest.MonkeyPatch, age_s: float, state: str
) -> None:
    """Optuna's times are those of the zone; containers are often in another one than their machine."""
    plan = StudyPlan(str(tmp_path / "study.journal"), "name", settings(4))
    zones.setenv("TZ", "Pacific/Honolulu")
    time.tzset()
    open_study(plan).ask().set_user_attr("process", ["elsewhere", 7, time.time() - age_s])
    zones.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    opened = open_study(plan)
    prepare(opened, plan)
    assert opened.trials[0].state.name == state


def test_a_process_goes_on_whose_trial_another_machine_has_given_up(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after it stood still for ten minutes."""
    from optuna.trial import TrialState

    measure, calls = Bench.measure, iter(range(100))

    def working(plan: StudyPlan, *arguments: object) -> None:
        def stood_still(self: Bench, config: object) -> Iterator[object]:
            if next(calls) == 2:  # the first is the reference
                study = open_study(plan)
                study.tell(study.trials[-1].number, state=TrialState.FAIL)
            return measure(self, config)  # type: ignore[arg-type]

        monkeypatch.setattr(Bench, "measure", stood_still)
        work(plan, *arguments)  # type: ignore[arg-type]
        states = [trial.state.name for trial in open_study(plan).trials]
        assert (states[1], len(states)) == ("FAIL", 5)

    monkeypatch.setattr(search, "work", working)
    assert len(tune(data, tmp_path, settings(4)).trials) == 4


def test_a_trial_that_was_killed_before_it_said_whose_it_is_costs_no_trial(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For ten minutes it counted as that of another machine: later ones had other parameters, and one was missing."""
    monkeypatch.setattr(study, "UNNAMED_S", 0.0)  # as if this took longer
    whole, folder = tune(data, tmp_path / "a", settings(8)), tmp_path / "b"
    folder.mkdir()
    lines = (tmp_path / "a" / "study.journal").read_text().splitlines(keepends=True)
    begun = [number for number, line in enumerate(lines) if json.loads(line)["op_code"] == CREATE_TRIAL]
    (folder / "study.journal").write_text("".join(lines[: begun[3] + 1]))
    again = tune(data, folder, settings(8))
    drawn = [[(each.loss, dict(each.parameters)) for each in found.trials] for found in (whole, again)]
    assert drawn[0] == drawn[1]
