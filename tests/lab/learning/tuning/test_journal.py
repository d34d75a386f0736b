"""`check_journal`: a file that is none, or has a wrong line, is told and stays as it is."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("optuna")

from foreglow.lab.learning.tuning import SPACES, TuningSettings
from foreglow.lab.learning.tuning.study import StudyPlan, open_study, prepare

pytestmark = pytest.mark.torch  # Optuna comes with the same extra


@pytest.fixture(autouse=True, scope="module")
def _journals_need_not_outlive_a_power_cut() -> Iterator[None]:
    """Optuna waits for the disk after each line of its journal."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The journal of a trial."""
    journal = tmp_path_factory.mktemp("begun") / "study.journal"
    plan = StudyPlan(str(journal), "name", TuningSettings())
    study = open_study(plan)
    prepare(study, plan)
    trial = study.ask()
    trial.set_user_attr("process", ["host", 7])
    SPACES["paper"].suggest(trial)
    trial.report(0.5, 0)
    trial.set_user_attr("measurement", {"q": math.nan})
    study.tell(trial, 0.5)
    open_study(plan)  # it is continued
    return journal.read_bytes()


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line.replace(b",", b"*", 1),
        lambda line: b"garbage\n",  # noqa: ARG005
        lambda line: b"\xff" + line,
        lambda line: line[:-1],  # two records in one line
        lambda line: b"[" * 100_000 + b"\n",  # noqa: ARG005
        lambda line: line.replace(b"worker_id", b"vorker_id"),
        lambda line: line.replace(b'"op_code":', b'"op_code":"'),
    ],
)
def test_a_damaged_line_of_a_journal_is_named(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    journal = tmp_path / "study.journal"
    plan = StudyPlan(str(journal), "name", TuningSettings())
    prepare(open_study(plan), plan)
    first, second, *others = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([first, damage(second), *others]))
    before = journal.read_bytes()
    expected = (
        r"study\.journal: line 2: expected a whole record of a search; choose another folder or storage, or remove"
    )
    with pytest.raises(ValueError, match=expected):
        open_study(plan)
    assert journal.read_bytes() == before


def test_a_line_of_a_journal_that_is_there_twice(begun: bytes, tmp_path: Path) -> None:
    journal = tmp_path / "study.journal"
    lines = begun.splitlines(keepends=True)
    for number, line in enumerate(lines, start=1):
        journal.write_bytes(begun + line)
        expected = rf"line {len(lines) + 1}: expected another line than line {number}; choose another folder"
        if json.loads(line)["op_code"]:  # else it begins a study, as each process does
            with pytest.raises(ValueError, match=expected):
                open_study(StudyPlan(str(journal), "name", TuningSettings()))


COUNT, FINITE = "expected a whole number of at least 0, got", "expected a finite number, got"
ATTRIBUTE = "expected one attribute as a search writes it, got"

WRONG_FIELDS: list[tuple[int, str, str, list[Any]]] = [
    (0, "study_name", "expected text, got", [None, ...]),
    (0, "directions", r"expected \[1\], .*, got", [[7], [], 1, [2], [1, 1], [2, 1], [0], [True], ...]),
    (2, "study_id", COUNT, [0.0, None, ...]),
    (4, "datetime_start", "expected a time or null, got", [3, "yesterday", ...]),
    (4, "state", "expected the number of a state, from 0 to 4, got", [7]),
    (4, "system_attrs", "expected attributes as a search writes them, got", [{"fixed_params": {"kappa": "x"}}, []]),
    (4, "intermediate_values", "expected a table of finite numbers by step, got", [{"x": 1}, {"1": "x"}]),
    (4, "params", "expected a table of finite numbers, got", [{"kappa": "x"}]),
    *((code, "trial_id", COUNT, [-1, True, "0", ...]) for code in range(5, 9)),
    (5, "param_name", "expected text, got", [[], ...]),
    (5, "param_value_internal", FINITE, ["x", math.inf, {}, ...]),
    (5, "distribution", "expected a distribution as text, got", [{}, "x", "{}", "null", ...]),
    (6, "state", "expected the number of a state, from 0 to 4, got", [9, "1", {}, True, ...]),
    (6, "values", "expected finite numbers or null, got", [1.0, ["x"], [math.nan], [], {}, ...]),
    (6, "datetime_complete", "expected a time, got", [None, 3, "yesterday", ...]),
    (7, "step", COUNT, [[1], None, ...]),
    (7, "intermediate_value", FINITE, [{}, "x", [1], None, True, math.inf, math.nan, ...]),
    (8, "user_attr", ATTRIBUTE, [{}, [], "x", {"process": ["host"]}, {"measurement": ["x"]}, ...]),
]
"""By `op_code` and field: what was expected, and wrong values; with `...` there is none."""


@pytest.mark.parametrize(
    ("code", "field", "words", "value"),
    [(code, field, words, value) for code, field, words, values in WRONG_FIELDS for value in values],
)
def test_a_wrong_field_of_a_journal_is_named(
    begun: bytes, tmp_path: Path, code: int, field: str, words: str, value: Any
) -> None:
    """The last record of the kind: an earlier one may have other fields, as of a trial that waits."""
    journal = tmp_path / "study.journal"
    records = [json.loads(line) for line in begun.splitlines()]
    number, record = next(
        (number, record)
        for number, record in reversed([*enumerate(records, start=1)])
        if record["op_code"] == code and (field != "datetime_complete" or field in record)
    )
    if value is ...:
        del record[field]
    else:
        record[field] = value
    journal.write_text("".join(f"{json.dumps(each, separators=(',', ':'))}\n" for each in records))
    before = journal.read_bytes()
    with pytest.raises(
        ValueError, match=rf"study\.journal: line {number}: {field}: {words}.*; choose another folder or storage"
    ):
        open_study(StudyPlan(str(journal), "name", TuningSettings()))
    assert journal.read_bytes() == before


def test_a_record_that_optuna_cannot_read(tmp_path: Path) -> None:
    journal = tmp_path / "study.journal"
    plan = StudyPlan(str(journal), "name", TuningSettings())
    prepare(open_study(plan), plan)
    journal.write_bytes(journal.read_bytes().replace(b'"value":null,"values":null', b'"value":1,"values":[1]'))
    with pytest.raises(ValueError, match=r"study\.journal: expected whole records of a search: .*; choose another"):
        open_study(plan)


@pytest.mark.parametrize("content", [b"my only notes\n", b'{"sequences": []}\n', b"{"])
def test_a_file_that_is_no_journal_stays_as_it_is(tmp_path: Path, content: bytes) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_bytes(content)
    with pytest.raises(ValueError, match=r"notes\.txt: expected a new file, or the journal of a search"):
        open_study(StudyPlan(str(notes), "name", TuningSettings()))
    assert notes.read_bytes() == content
    assert list(tmp_path.iterdir()) == [notes]
