"""The table of what the paper says, and what results say to it."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from foreglow.lab.studies.reproduction.claims import (
    DIFFERS,
    NEEDS,
    REPRODUCED,
    TOLD,
    UNMEASURED,
    Answer,
    Claim,
    answer,
    beside_paper,
    paper_value,
    paper_words,
    read_claims,
    value_at,
)
from foreglow.lab.studies.reproduction.experiments import EXPERIMENTS
from tests.shared_data import shared_file

CLAIM = Claim(
    id="f", place="Table 3", says="F", paper="0.82", value=0.82, rule="close", tolerance=0.02,
    study="detector", ours=("{rows[name=paper].f1:.2f}",), reason="needs a model",
)  # fmt: skip


def told(f1: float | None, **changes: Any) -> Answer:
    is_pvdn = changes.pop("is_pvdn", False)
    results = {"rows": [{"name": "ours", "f1": 0.1}, {"name": "paper", "f1": f1}]}
    return answer(dataclasses.replace(CLAIM, **changes), results, is_pvdn=is_pvdn)


def test_no_claim_lacks_anything() -> None:
    for claim in read_claims():
        assert all((claim.id, claim.place, claim.says, claim.paper, claim.reason)), claim.id
        assert not claim.study or claim.study in EXPERIMENTS, claim.id


def test_all_tables_and_figures_are_there() -> None:
    places = " ".join(claim.place for claim in read_claims())
    assert {f"Table {number}" for number in (1, 2, 3)} <= set(re.findall(r"Table \d", places))
    assert [claim.place for claim in read_claims() if claim.is_figure] == [f"Fig. {number}" for number in range(1, 13)]


def test_each_value_of_a_row_is_a_claim() -> None:
    row = {claim.id: claim for claim in read_claims() if claim.id.startswith("table3-optimised")}
    assert len(row) == 16
    assert row["table3-optimised-f1"].ours == ("{rows[name=paper].examination.quality.f1:.2f}",)
    assert row["table3-optimised-runtime"].value == 21.98
    assert math.isnan(row["table3-optimised-size"].value)
    assert {claim.column for claim in row.values() if claim.network} == {"precision", "recall", "F", "q", "q_K", "q_B"}
    assert {claim.row for claim in row.values()} == {"Optimised, 640 x 480", "Optimised, 640 x 480, labelled boxes"}


@pytest.mark.parametrize(
    "changes",
    [{"reason": ""}, {"paper": ""}, {"ours": ()}, {"study": ""}, {"value": math.nan}, {"rule": ""}, {"rule": "least"}],
    ids=lambda changes: next(iter(changes)),
)
def test_a_claim_with_something_missing(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"claims\.toml: f: expected"):
        dataclasses.replace(CLAIM, **changes)


def test_verdicts() -> None:
    assert (told(0.83).verdict, told(0.83).because) == (REPRODUCED, "on simulated drives")
    assert told(0.83, is_pvdn=True).because == ""
    assert (told(0.7).ours, told(0.7).verdict) == ("0.70", DIFFERS)
    assert told(0.7, rule="at most").verdict == REPRODUCED
    assert told(0.7, rule="at least").verdict == DIFFERS
    assert told(0.9, rule="at least").verdict == REPRODUCED
    assert told(0.7, rule="", value=math.nan).verdict == TOLD
    assert told(0.83, holds_by="by construction").because == "by construction"
    assert (told(0.83, study="settings").verdict, told(0.7, study="settings").verdict) == (TOLD, DIFFERS)
    assert told(0.83, only_pvdn=True).verdict == NEEDS
    assert told(0.83, only_pvdn=True, is_pvdn=True).verdict == REPRODUCED


def test_the_least_of_several() -> None:
    least = {"rule": "least", "value": math.nan, "ours": ("{rows[name=ours].f1}, {rows[name=paper].f1}",)}
    assert told(0.83, **least).verdict == REPRODUCED
    assert (told(0.05, **least).verdict, told(0.05, **least).because[:21]) == (DIFFERS, "contradicts the paper")
    assert told(0.05, tolerance=0.06, **least).verdict == REPRODUCED


def test_without_a_value_there_is_a_reason() -> None:
    assert (told(None).verdict, told(None).because) == (NEEDS, "a model")
    not_run = answer(CLAIM, None, is_pvdn=True, reason="DATA has no train")
    assert not_run.because == "a model; DATA has no train"
    assert not_run.ours


def test_times_of_a_busy_machine() -> None:
    results = {"rows": [{"name": "paper", "f1": 0.82}]}
    assert answer(CLAIM, results, is_pvdn=True, is_busy=True).verdict == REPRODUCED
    timed = answer(dataclasses.replace(CLAIM, is_timed=True), results, is_pvdn=True, is_busy=True)
    assert (timed.ours, timed.verdict) == ("0.82", NEEDS)


def test_a_network_that_was_trained_for_less() -> None:
    """Its value is shown, and what it takes to compare it; where it finds nothing, that is no other reason."""
    claim = dataclasses.replace(CLAIM, network="paper")
    short = {"paper": "300 epochs of training; the network had 1"}

    def found(f1: float | None, **untrained: str) -> Answer:
        return answer(claim, {"rows": [{"name": "paper", "f1": f1}]}, is_pvdn=False, untrained=untrained)

    assert found(0.1).verdict == DIFFERS
    assert found(0.1, baseline="").verdict == DIFFERS
    assert (found(0.1, **short).ours, found(0.1, **short).verdict) == ("0.10", NEEDS)
    assert found(0.1, **short).because == found(None, **short).because == short["paper"]
    not_run = answer(claim, None, is_pvdn=False, untrained=short, reason="DATA has no train")
    assert not_run.because == "a model; DATA has no train"


def test_what_is_quoted_needs_nothing() -> None:
    quoted = dataclasses.replace(CLAIM, study="", ours=(), reason="quoted from others")
    assert answer(quoted, None, is_pvdn=True).verdict == UNMEASURED


def test_of_several_values_those_that_are_there() -> None:
    found = told(0.8, ours=("{rows[name=nobody].f1}", "{rows[name=paper].f1 - rows[name=ours].f1:+.1f}"))
    assert found.ours == "+0.7"
    assert found.verdict == DIFFERS


def test_paths() -> None:
    results = {"parts": {"CP": {"mean": 3}}, "times": [1.0, 2.0], "groups": [{"group": "200-400 m", "num": 2}]}
    assert value_at(results, "parts.CP.mean") == 3
    assert value_at(results, "times.min") == 1.0
    assert value_at(results, "groups[group=200-400 m].num") == 2
    assert value_at(results, "parts.DE.mean") is None
    assert value_at(results, "groups[group=all].num") is None
    assert value_at({"times": []}, "times.mean") is None


def test_what_a_command_says(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps({"mean_range_m": {"direct": 80.0}}))
    assert beside_paper("distance", tmp_path / "results.json") == [
        "the paper's values, and those here:",
        "Mean range of direct light: 83 m; here 80 m",
    ]
    (tmp_path / "results.json").write_text("{}")
    assert beside_paper("distance", tmp_path / "results.json") == []


def test_one_value() -> None:
    assert (paper_value("gp-indirect"), paper_words("runtime-share")) == (-0.32, "90 %")


LATEX = (
    r"\\(?:parencite|textcite|cite|includegraphics|ref|label|figref|secref|subsecref|tabref|Eqref|hspace\*?|raisebox)"
    r"\s*(?:\[[^\]]*\])*(?:\{[^}]*\})*",
    r"[mp]\{[^}]*\}",
    r"\\,",
)
"""What holds numbers that the paper does not print: references, sizes of pictures and columns, thin spaces."""


def test_every_number_of_the_paper_is_in_a_claim() -> None:
    text = shared_file("paper/provident_vehicle_detection.tex.txt").read_text(encoding="utf-8")
    text = text[text.index(r"\begin{abstract}") :]
    for pattern in LATEX:
        text = re.sub(pattern, "", text)
    claims = " ".join(f"{claim.place} {claim.says} {claim.paper}" for claim in read_claims())
    told = claims + re.sub(r"(?<=\d) (?=\d{3})", "", claims)
    numbers = set(re.findall(r"(?<![A-Za-z\d.])\d+(?:\.\d+)?", text))
    assert len(numbers) > 100
    assert not {number for number in numbers if not re.search(rf"(?<![\d.]){re.escape(number)}(?!\d|\.\d)", told)}
