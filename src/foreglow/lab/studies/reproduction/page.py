"""The paper and what is here on one page: HTML with everything in it, Markdown with its figures beside it, and JSON."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from foreglow.display.summary_lines import counted
from foreglow.files import write_atomic
from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.page import DASH, Figure, Missing, Page, Table
from foreglow.lab.studies.reproduction.claims import (
    DIFFERS,
    NEEDS,
    NO_VALUE,
    REPRODUCED,
    TOLD,
    UNMEASURED,
    Answer,
    answer,
    filled,
    read_claims,
)
from foreglow.lab.studies.reproduction.experiments import EXPERIMENTS, ReproductionPlan
from foreglow.lab.studies.reproduction.run import Outcome

TITLE = "The paper, and what is here"
SOURCE = "Ewecker et al., Provident Vehicle Detection at Night for Advanced Driver Assistance Systems, arXiv 2107.11302"

NOT_PVDN = (
    "No number and no picture on this page is of PVDN. The paper measures on PVDN, which cannot be had here: its host "
    "wants an account, and our model has never seen it. What stands beside the paper's values is of simulated drives: "
    "other roads, other lamps and another camera, so that agreement and difference say less than they would on PVDN. "
    "Whoever has PVDN makes this page of it with `foreglow reproduce PVDN --out DIR`."
)
ON_PVDN = (
    "DATA has no simulator's truth beside it, and is taken for PVDN: compared values count as the paper's own data."
)

BUSY = 2.0
"""More programs for each core than this make a machine busy: our own workers are at most one each."""

FIGURES = "images"
"""The folder of the figures, beside the page."""

WIDTH_PX, JPEG_QUALITY = 1200, 80
MAX_PNG_BYTES = 200_000
"""Plots have less, pictures of a camera more."""

VERDICTS = {
    REPRODUCED: "our value agrees with the paper's by the rule of its claim",
    DIFFERS: "it does not, and why",
    TOLD: "both are told; there is nothing to compare, such as words, or a constant of the paper's",
    NEEDS: "what it takes to have a value of ours",
    UNMEASURED: "quoted by the paper from others, or no matter of measuring",
}


def answers(plan: ReproductionPlan, outcomes: Mapping[str, Outcome]) -> tuple[Answer, ...]:
    """What our results say to every claim of the paper, in its order."""
    is_pvdn, nothing = not plan.is_simulated, Outcome("", 0.0)
    asked = ((claim, outcomes.get(claim.study, nothing)) for claim in read_claims())
    return tuple(
        answer(claim, found.results, is_pvdn=is_pvdn, is_busy=found.load > BUSY, reason=found.reason)
        for claim, found in asked
    )


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
    (out / FIGURES).mkdir(parents=True, exist_ok=True)
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
    if plan.epochs is not None:
        page.text(
            f"Where they are not given, the networks of the baseline and of the paper were trained for "
            f"{counted(plan.epochs, 'epoch')} here, and for 300 in the paper. Their P, R, F and q show that the chain "
            "works; they do not test the paper."
        )
    page.section("Experiments", "What was run; each folder has its own report.")
    columns: dict[str, Callable[[tuple[str, Outcome]], str]] = {
        "experiment": lambda item: item[0],
        "command": lambda item: f"`{item[1].command}`",
        "measured on": lambda item: filled(EXPERIMENTS[item[0]].measured_on, item[1].results) or DASH,
        "seconds": lambda item: f"{item[1].seconds:.0f}",
        "without results, since": lambda item: item[1].reason or DASH,
    }
    page.table(Table.of(columns, outcomes.items(), is_wordy=True))
    for heading, group in itertools.groupby(found, key=lambda result: _section(result.claim.place)):
        results = list(group)
        page.section(heading)
        in_rows = [result for result in results if result.claim.row]
        if in_rows:
            page.table(_paper_table(in_rows))
            page.items(_differences(in_rows))
        page.table(Table.of(COLUMNS, [result for result in results if not result.claim.row], is_wordy=True))
        for result in results:
            if result.claim.id in figures:
                page.text(f"{result.claim.place}. {result.claim.says}. Paper: {result.claim.paper}.")
                page.figure(figures[result.claim.id])
    return page


def _paper_table(results: Sequence[Answer]) -> Table:
    """The paper's table: for each of its rows the paper's values, ours, and the verdicts."""
    columns = list(dict.fromkeys(result.claim.column for result in results))
    rows: list[list[object]] = []
    for row, group in itertools.groupby(results, key=lambda result: result.claim.row):
        by_column = {result.claim.column: result for result in group}

        def cells(of: Callable[[Answer], str], known: Mapping[str, Answer] = by_column) -> list[str]:
            return [of(known[column]) if column in known else DASH for column in columns]

        rows.append([f"{row}: paper", *cells(lambda result: result.claim.paper)])
        reasons = dict.fromkeys(result.because for result in by_column.values() if result.ours == NO_VALUE)
        if len(reasons) == 1 and all(result.ours == NO_VALUE for result in by_column.values()):
            rows.append(["ours", Missing(f"{NEEDS}: {next(iter(reasons))}")])
        else:
            rows.append(["ours", *cells(lambda result: result.ours)])
            rows.append(["verdict", *cells(lambda result: result.verdict)])
    return Table(["detector", *columns], rows)


def _differences(results: Sequence[Answer]) -> Iterator[str]:
    """Why values of a table differ, or do not count: a line for each reason."""
    told = (result for result in results if result.verdict in (DIFFERS, NEEDS) and result.ours != NO_VALUE)
    for (verdict, because), num in Counter((result.verdict, result.because) for result in told).items():
        yield f"{verdict}: {because} ({counted(num, 'value')})"
    yield "no value: nothing is found that it could be of"


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


COLUMNS: Mapping[str, Callable[[Answer], str]] = {
    "the paper says": _says,
    "paper": lambda result: result.claim.paper,
    "ours": lambda result: result.ours,
    "verdict": lambda result: ": ".join(filter(None, (result.verdict, result.because))),
    "experiment": lambda result: result.claim.study or DASH,
}


def _figures(found: Sequence[Answer], out: Path) -> Iterator[tuple[str, Figure]]:
    """Our figures that are there, by their claim, reduced to the page's width."""
    for result in found:
        claim = result.claim
        file = out / claim.study / claim.image
        if claim.image and result.ours != NO_VALUE and file.is_file():
            data, suffix = _reduced(file)
            name = f"reproduction_{claim.id.removeprefix('figure-')}.{suffix}"
            yield claim.id, Figure(data, f"Ours for {claim.place}", f"{FIGURES}/{name}")


def _reduced(file: Path) -> tuple[bytes, str]:
    """The picture's file and its suffix: a plot as it is, a larger picture as a smaller JPEG."""
    data = file.read_bytes()
    if file.suffix == ".png" and len(data) <= MAX_PNG_BYTES:
        return data, "png"
    return jpeg(np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR), np.uint8), WIDTH_PX, JPEG_QUALITY), "jpg"
