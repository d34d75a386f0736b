"""The paper and what is here on one page: HTML with everything in it, Markdown with its figures beside it, and JSON."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.page import Figure, Page, Table
from foreglow.lab.studies.reproduction.claims import (
    DIFFERS,
    GIVEN,
    NEEDS,
    NO_VALUE,
    REPRODUCED,
    TOLD,
    UNMEASURED,
    Answer,
    Claim,
    Comparison,
    answer,
    filled,
    paper_value,
    read_claims,
    read_comparisons,
)
from foreglow.lab.studies.reproduction.experiments import EXPERIMENTS
from foreglow.lab.studies.reproduction.plan import TRAINED, ReproductionPlan
from foreglow.lab.studies.reproduction.run import Outcome
from foreglow.whole_files import make_folder, together, write_atomic

TITLE = "The paper, and what is here"
SOURCE = "Ewecker et al., Provident Vehicle Detection at Night for Advanced Driver Assistance Systems, arXiv 2107.11302"

NOT_PVDN = (
    "Nothing that was measured for this page is of PVDN, nor is any of its pictures. The paper measures on PVDN, "
    "which cannot be had here, since its host wants an account; our model has never seen PVDN. What stands beside "
    "the paper's values is of simulated drives: other roads, other lamps and another camera, so that agreement and "
    "difference say less than they would on PVDN. Whoever has PVDN makes this page of it with `foreglow reproduce "
    "PVDN --out DIR`. A few drives and short training show what the command gives; PVDN, or many drives, and the "
    "paper's number of epochs give figures that can be relied on."
)
ON_PVDN = (
    "DATA has no simulator's truth beside it, and is taken for PVDN: compared values count as the paper's own data."
)

BUSY = 2.0
"""More programs for each core than this make a machine busy: our own workers are at most one each."""

OURS = "preset foreglow"
"""What the claims call our pipeline, which may be another one."""

HERE = "measured here"

CHAIN = "the paper's chain"

WORDS = {
    OURS: "our pipeline with the model that ships: proposals, network, estimator road_surface, our tracker, "
    "and our beam policy",
    CHAIN: "the paper's proposals, its network as trained here, the ground plane (GP), its tracker, and its beam "
    "policy (policy paper); the paper's detector: the first two of these",
    "production system": "the car's own detection of vehicles; in simulated drives one that is modelled",
    "in process": "without ROS",
    "run-times": "of the detector's table and of section 6.5, measured apart, so that those of the same detector "
    "differ",
}

FIGURES = "images"
"""The folder of the figures, beside the page."""

WIDTH_PX, JPEG_QUALITY = 1200, 80
MAX_PNG_BYTES = 200_000
"""Plots have less, pictures of a camera more."""

VERDICTS = {
    REPRODUCED: "every value of the row that is measured here agrees with the paper's, but for what is in brackets or "
    "behind `not compared`: by a tolerance, such as 0.02 for scores and 0.2 s for times of detection; run-times, by "
    "their means, and gains are no worse (`claims.toml` has the rule of each)",
    DIFFERS: "at least one does not, and why",
    GIVEN: "they agree, and could hardly do otherwise on any data, for this reason: no evidence",
    TOLD: "both are told; there is nothing to compare, such as words, pictures, a setting that is the paper's, or "
    "parameters that the search began with and kept",
    NEEDS: "what it takes to have a value that can be compared",
    UNMEASURED: "quoted by the paper from others, or no matter of measuring",
}


def answers(plan: ReproductionPlan, outcomes: Mapping[str, Outcome]) -> tuple[Answer, ...]:
    """What our results say to every claim of the paper, in its order."""
    nothing, untrained = Outcome("", 0.0), _untrained(plan)

    def answered(claim: Claim) -> Answer:
        found = outcomes.get(claim.study, nothing)
        told = answer(
            claim,
            found.results,
            is_pvdn=not plan.is_simulated,
            is_busy=found.load > BUSY,
            reason=found.reason,
            untrained=untrained,
        )
        return dataclasses.replace(told, ours=told.ours.replace(OURS, shlex.join(plan.pipeline) or OURS))

    return tuple(map(answered, read_claims()))


def _untrained(plan: ReproductionPlan) -> dict[str, str]:
    """What the networks that were trained here lack to be compared with the paper's, by their rows of its table."""
    num_paper = int(paper_value("epochs"))
    if plan.epochs is None or plan.epochs >= num_paper or not plan.may_train:
        return {}
    on_pvdn = " on PVDN" if plan.is_simulated else ""
    reason = f"{num_paper} epochs of training{on_pvdn}; the network had {plan.epochs}"
    return {name: reason for name in TRAINED if name not in plan.models}


def summary_lines(found: Sequence[Answer]) -> list[str]:
    """What the command says: how many claims there are of each verdict."""
    counts = Counter(result.verdict for result in found)
    return [f"{len(found)} claims of the paper: " + ", ".join(f"{counts[name]} {name}" for name in VERDICTS)]


def write_page(plan: ReproductionPlan, outcomes: Mapping[str, Outcome], out: Path) -> Path:
    """Writes `report.html`, whose path it returns, `report.md`, its figures in `images`, and `results.json`.

    Raises:
        OSError: If a file cannot be written.
    """
    found = answers(plan, outcomes)
    page = _page(plan, outcomes, found, dict(_figures(found, out)))
    record = {
        "data": plan.data,
        "is_simulated": plan.is_simulated,
        "experiments": {
            name: {"command": outcome.command, "seconds": outcome.seconds, "reason": outcome.reason}
            for name, outcome in outcomes.items()
        },
        "verdicts": Counter(result.verdict for result in found),
        "claims": [_record(result) for result in found],
    }
    with together():
        make_folder(out / FIGURES)
        page.write(out / "report.html", results=record)
        write_atomic(out / "report.md", page.markdown().encode())
    return out / "report.html"


def _record(result: Answer) -> dict[str, str]:
    claim = result.claim
    told = {name: getattr(claim, name) for name in ("id", "place", "says", "paper", "study")}
    return told | {"ours": result.ours, "verdict": result.verdict, "because": result.because}


def _page(
    plan: ReproductionPlan, outcomes: Mapping[str, Outcome], found: Sequence[Answer], figures: Mapping[str, Figure]
) -> Page:
    page = Page(TITLE)
    page.text(NOT_PVDN if plan.is_simulated else ON_PVDN)
    page.text(f"The paper: {SOURCE}. Every table, figure and number of it has a row below.", *summary_lines(found))
    page.items(f"{name}: {words}" for name, words in VERDICTS.items())
    data = outcomes["data"].results
    if data is not None:
        page.text(f"DATA: {data['splits']}; {data['width_px']} x {data['height_px']} pixels.")
    page.items(f"{name}: {words}" for name, words in (WORDS if not plan.pipeline else {}).items())
    page.section("In short", SHORT)
    page.table(Table.of(_comparisons(plan, outcomes), read_comparisons(), is_wordy=True))
    page.section("Experiments", "What was run; each folder has its own report.")
    columns: dict[str, Callable[[tuple[str, Outcome]], str]] = {
        "experiment": lambda item: item[0],
        "command": lambda item: f"`{item[1].command}`",
        "measured on": lambda item: filled(EXPERIMENTS[item[0]].measured_on, item[1].results) or NOTHING,
        "results": lambda item: f"none: {item[1].reason}" if item[1].reason else "yes",
    }
    page.table(Table.of(columns, outcomes.items(), is_wordy=True))
    for heading, group in itertools.groupby(found, key=lambda result: _section(result.claim.place)):
        results = list(group)
        page.section(heading)
        in_rows = [result for result in results if result.claim.row]
        if in_rows:
            notes = _notes(in_rows)
            page.table(_paper_table(in_rows, notes))
            page.items(f"({number}) {reason}" for reason, number in notes.items())
        others = [result for result in results if not result.claim.row]
        if others:
            page.table(Table.of(COLUMNS, others, is_wordy=True))
        for result in results:
            if result.claim.id in figures:
                page.text(_caption(result))
                page.figure(figures[result.claim.id])
    return page


SHORT = "Rows of our own, not of the paper: our pipeline beside the paper's chain, both measured here in the same run."


def _comparisons(plan: ReproductionPlan, outcomes: Mapping[str, Outcome]) -> dict[str, Callable[[Comparison], str]]:
    """The columns of the table of our own rows."""

    def told(row: Comparison, text: str) -> str:
        results = outcomes[row.study].results if row.study in outcomes else None
        return (filled(text, results) if results is not None else "") or NO_VALUE

    return {
        "measured here": lambda row: row.says,
        shlex.join(plan.pipeline) or OURS: lambda row: told(row, row.ours),
        CHAIN: lambda row: told(row, row.chain),
        "on": lambda row: told(row, row.on),
    }


NOTHING = "nothing: settings and files"

NO_NETWORK = "no network"
"""What the labelled boxes have in the columns of a network."""


def _paper_table(results: Sequence[Answer], notes: Mapping[str, int]) -> Table:
    """The paper's table: for each of its rows the paper's values, those measured here, and the verdicts."""
    columns = list(dict.fromkeys(result.claim.column for result in results))
    rows: list[list[object]] = []
    for row, group in itertools.groupby(results, key=lambda result: result.claim.row):
        by_column = {result.claim.column: result for result in group}

        def cells(of: Callable[[Answer], str], known: Mapping[str, Answer] = by_column) -> list[str]:
            return [of(known[column]) if column in known else NO_NETWORK for column in columns]

        rows.append([f"{row}: paper", *cells(lambda result: result.claim.paper)])
        rows.append([HERE, *cells(lambda result: result.ours)])
        rows.append(["verdict", *cells(functools.partial(_noted, notes=notes))])
    return Table(["detector", *columns], rows)


def _noted(result: Answer, notes: Mapping[str, int]) -> str:
    """The verdict, and the number of its note."""
    return f"{result.verdict} ({notes[result.because]})" if result.because else result.verdict


def _notes(results: Sequence[Answer]) -> dict[str, int]:
    """The reasons behind the verdicts of a table, numbered."""
    reasons = dict.fromkeys(result.because for result in results if result.because)
    return {reason: number for number, reason in enumerate(reasons, start=1)}


def _section(place: str) -> str:
    """The heading that a place belongs under.

    >>> _section("6.2: training"), _section("Table 3: detectors"), _section("Fig. 7")
    ('Section 6.2', 'Table 3: detectors', 'Figures')
    """
    if place.startswith("Fig."):
        return "Figures"
    return place if place.startswith("Table") else f"Section {place.partition(':')[0]}"


def _says(result: Answer) -> str:
    claim = result.claim
    if claim.place.startswith("Table"):
        return claim.says
    return f"{claim.place.partition(': ')[2] or claim.place}: {claim.says}"


def _caption(result: Answer) -> str:
    claim = result.claim
    here = f" Here: {claim.why}." if claim.why else ""
    return f"{claim.place}. {claim.says}. Paper: {claim.paper}.{here}"


COLUMNS: Mapping[str, Callable[[Answer], str]] = {
    "the paper says": _says,
    "paper": lambda result: result.claim.paper,
    HERE: lambda result: result.ours,
    "verdict": lambda result: ": ".join(filter(None, (result.verdict, result.because))),
    "experiment": lambda result: result.claim.study or "none",
}


def _figures(found: Sequence[Answer], out: Path) -> Iterator[tuple[str, Figure]]:
    """Our figures that are there, by their claim, reduced to the page's width."""
    for result in found:
        claim = result.claim
        file = out / claim.study / claim.image
        if claim.image and result.ours != NO_VALUE and file.is_file():
            data, suffix = _reduced(file)
            name = f"reproduction_{claim.id.removeprefix('figure-')}.{suffix}"
            yield claim.id, Figure(data, f"{claim.place}, made here", f"{FIGURES}/{name}")


def _reduced(file: Path) -> tuple[bytes, str]:
    """The picture's file and its suffix: a plot as it is, a larger picture as a smaller JPEG."""
    data = file.read_bytes()
    if file.suffix == ".png" and len(data) <= MAX_PNG_BYTES:
        return data, "png"
    return jpeg(np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR), np.uint8), WIDTH_PX, JPEG_QUALITY), "jpg"
