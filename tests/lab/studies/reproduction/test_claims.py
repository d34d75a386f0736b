"""The table of what the paper says, and what results say to it."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import pytest

from foreglow.lab.studies.reproduction.claims import (
    DIFFERS,
    GIVEN,
    MIN_TRIALS,
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
    id="f", place="Table 3", says="F", paper="0.82", values=(0.82,), rule="close", tolerances=(0.02,),
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
    assert row["table3-optimised-runtime"].values == (21.98,)
    assert row["table3-optimised-size"].values == ()
    assert {claim.column for claim in row.values() if claim.network} == {"precision", "recall", "F", "q", "q_K", "q_B"}
    assert {claim.row for claim in row.values()} == {"Optimised, 640 x 480", "Optimised, 640 x 480, labelled boxes"}


@pytest.mark.parametrize(
    "changes",
    [
        *({"reason": ""}, {"paper": ""}, {"ours": ()}, {"study": ""}, {"values": ()}, {"rule": ""}),
        *({"rule": "least"}, {"tolerances": (0.1, 0.2)}),
    ],
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
    assert told(0.7, rule="", values=()).verdict == TOLD
    assert told(0.83, rule="at least").because == "no less than the paper's; on simulated drives"
    by_construction = told(0.83, holds_by="the same network")
    assert (by_construction.verdict, by_construction.because) == (GIVEN, "the same network")
    assert told(0.7, holds_by="the same network").verdict == DIFFERS
    assert (told(0.83, study="settings").verdict, told(0.7, study="settings").verdict) == (TOLD, DIFFERS)
    assert told(0.83, only_pvdn=True).verdict == NEEDS
    assert told(0.83, only_pvdn=True, is_pvdn=True).verdict == REPRODUCED


def test_the_least_of_several() -> None:
    least = {"rule": "least", "values": (), "ours": ("{rows[name=ours].f1}, {rows[name=paper].f1}",)}
    assert told(0.83, **least).verdict == REPRODUCED
    assert (told(0.05, **least).verdict, told(0.05, **least).because[:21]) == (DIFFERS, "contradicts the paper")
    assert told(0.05, tolerances=(0.06,), **least).verdict == REPRODUCED


def test_every_value_is_compared() -> None:
    """A row of two was judged by its first alone."""
    two = {"values": (0.82, 0.12), "ours": ("{rows[name=paper].f1}, from {rows[name=ours].f1}",)}
    assert told(0.83, **two).verdict == REPRODUCED
    assert told(0.83, **two | {"values": (0.82, 0.5)}).verdict == DIFFERS
    assert told(0.83, tolerances=(0.02, 0.4), **two | {"values": (0.82, 0.5)}).verdict == REPRODUCED
    each = ("{rows[name=paper].f1}, paper's chain", "{rows[name=ours].f1}, preset foreglow")
    assert (told(0.83, ours=each).verdict, told(0.83, ours=each, rule="at least").verdict) == (DIFFERS, DIFFERS)
    assert told(0.9, ours=each[::-1], rule="at most").verdict == DIFFERS
    assert told(0.8, ours=each, rule="at most").verdict == REPRODUCED


def test_no_number_of_a_row_is_left_out_of_its_rule() -> None:
    """But for brackets, words, and the spread of a run-time."""
    for claim in read_claims():
        for text in claim.ours if claim.rule else ():
            fields = re.sub(r"\{[^{}]*\.space\}", "", text)
            fields = re.sub(r"\{[^{}]*\}", "{}", fields)
            fields = re.sub(r" ± \{\}" if claim.rule == "at most" else r"\([^()]*\)", "", fields)
            fields = re.sub(r"\([^()]*\)", "", fields)
            num = fields.count("{}")
            assert num > 1 if claim.rule == "least" else num == len(claim.values), claim.id


def test_both_values_of_a_row_of_the_paper() -> None:
    claims = {claim.id: claim for claim in read_claims()}
    assert claims["lidar-truth"].values == (0.12, -0.32)
    assert (claims["q-gain"].values, claims["f-gain"].values) == ((0.70, 0.50), (0.93, 0.84))
    assert claims["table3-optimised-q-k"].values == (0.69, 0.30)
    lights = [
        {"axis": "lidar", "estimator": "gp", "light": light, "median": median, "num": 9}
        for light, median in (("direct", 0.15), ("indirect", -0.03))
    ]
    found = answer(claims["lidar-truth"], {"findings": lights}, is_pvdn=False)
    assert (found.ours, found.verdict) == ("+0.15, -0.03 (9 direct, 9 indirect)", DIFFERS)


def test_only_the_maximum_helps() -> None:
    """Also where another heuristic helps a little, the paper is contradicted."""
    (claim,) = (claim for claim in read_claims() if claim.id == "heuristics")

    def found(mean: float) -> str:
        medians = {"maximum": 0.3, "centre": 0.5, "minimum": 0.6, "lowest": 0.6, "mean": mean, "median": 0.6}
        findings = [
            {"axis": "range", "estimator": "gp", "group": "all", "light": "indirect"}
            | {"heuristic": name, "median_absolute": error}
            for name, error in medians.items()
        ]
        return answer(claim, {"findings": findings}, is_pvdn=False).verdict

    assert (found(0.6), found(0.4)) == (REPRODUCED, DIFFERS)


def test_what_is_told_beside_is_not_compared() -> None:
    beside = ("{rows[name=ours].f1}, preset foreglow",)
    found = told(0.83, beside=beside)
    assert (found.ours, found.verdict) == ("0.83; not compared: 0.1, preset foreglow", REPRODUCED)
    alone = told(None, beside=beside)
    assert (alone.ours, alone.verdict) == ("no value; not compared: 0.1, preset foreglow", NEEDS)


@pytest.mark.parametrize("parameter", ["kappa", "w", "s", "d"])
def test_a_search_that_ends_where_it_began_reproduces_nothing(parameter: str) -> None:
    """Its first trial has the paper's parameters, so that with few trials they were the best again."""
    (claim,) = (claim for claim in read_claims() if claim.id == f"table2-{parameter}")
    papers = {"kappa": 0.4, "window_px": 19, "min_deviation": 0.01, "gap_px": 4}

    def found(num_trials: int, **chosen: float) -> tuple[str, str]:
        of = {"val": {"q": 0.8}}
        results = {
            "chosen": {"parameters": papers | chosen, **of}, "paper": {"parameters": papers, **of},
            "num_finished": num_trials, "beside_paper": {"space": "in the same space"},
        }  # fmt: skip
        told = answer(claim, results, is_pvdn=True)
        return told.verdict, told.because

    assert found(3) == (NEEDS, "a search of at least 20 trials; this one had 3")
    assert found(3, gap_px=5)[0] == NEEDS
    kept = "the search begins with the paper's parameters, and found none better in 200 trials"
    assert found(200) == (TOLD, kept)
    others = {"kappa": 0.45, "window_px": 18, "gap_px": 5}
    assert found(MIN_TRIALS, **others)[0] == REPRODUCED
    assert found(MIN_TRIALS, **others | {"min_deviation": 0.0})[0] == (DIFFERS if parameter == "s" else REPRODUCED)


def test_one_driver() -> None:
    (claim,) = (claim for claim in read_claims() if claim.id == "glare-none")
    policies = [
        {"name": name, "oncoming": {"first_occluded": {"num": 1, "dark_share": 1.0}}}
        for name in ("foreglow", "paper", "production")
    ]
    found = answer(claim, {"policies": policies}, is_pvdn=False).ours
    assert found.endswith(" 100% with the production system's, of 1 driver coming out of hiding")


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
