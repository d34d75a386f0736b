"""The paper and what is here on one page: HTML with everything in it, Markdown with its figures beside it, and JSON."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from foreglow.files import fields_to_json, write_atomic
from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.page import DASH, Figure, Page, Table
from foreglow.lab.studies.reproduction.claims import DIFFERS, NEEDS, REPRODUCED, TOLD, Answer, answer, read_claims
from foreglow.lab.studies.reproduction.run import Outcome, ReproductionPlan

TITLE = "The paper, and what is here"
SOURCE = "Ewecker et al., Provident Vehicle Detection at Night for Advanced Driver Assistance Systems, arXiv 2107.11302"

NOT_PVDN = (
    "No figure of PVDN on this page was measured by us. The paper measures on PVDN, which cannot be had here: its host "
    "wants an account, and our model has never seen it. What stands beside the paper's values is of simulated drives: "
    "other roads, other lamps and another camera, so that agreement and difference say less than they would on PVDN. "
    "Whoever has PVDN makes this page of it with `foreglow reproduce PVDN --out DIR`."
)
ON_PVDN = (
    "DATA has no simulator's truth beside it, and is taken for PVDN: compared values count as the paper's own data."
)

FIGURES = "images"
"""The folder of the figures, beside the page."""

WIDTH_PX, JPEG_QUALITY = 1200, 80
VERDICTS = {
    REPRODUCED: "our value agrees with the paper's by the rule of its claim",
    DIFFERS: "it does not, and why",
    TOLD: "both are told; there is nothing to compare, such as words, or a constant of the paper's",
    NEEDS: "what it takes to have a value of ours",
}


def answers(plan: ReproductionPlan, outcomes: Mapping[str, Outcome]) -> tuple[Answer, ...]:
    """What our results say to every claim of the paper, in its order."""
    is_pvdn = not plan.is_simulated

    def of(study: str) -> Outcome:
        return outcomes.get(study, Outcome("", 0.0))

    return tuple(
        answer(claim, of(claim.study).results, is_pvdn=is_pvdn, reason=of(claim.study).reason)
        for claim in read_claims()
    )


def write_page(plan: ReproductionPlan, outcomes: Mapping[str, Outcome], out: Path) -> Path:
    """Writes `report.html`, whose path it returns, `report.md`, its figures in `images`, and `results.json`.

    Raises:
        OSError: If a file cannot be written.
    """
    found = answers(plan, outcomes)
    figures = dict(_figures(found, out))
    page = _page(plan, outcomes, found, figures)
    record = {
        "data": str(plan.data),
        "is_simulated": plan.is_simulated,
        "experiments": {name: fields_to_json(outcome) | {"results": None} for name, outcome in outcomes.items()},
        "verdicts": Counter(one.verdict for one in found),
        "claims": [fields_to_json(one.claim) | {**fields_to_json(one), "claim": one.claim.id} for one in found],
    }
    (out / FIGURES).mkdir(parents=True, exist_ok=True)
    page.write(out / "report.html", results=record)
    write_atomic(out / "report.md", page.markdown().encode())
    return out / "report.html"


def summary_lines(found: Sequence[Answer]) -> list[str]:
    """What the command says: how many claims there are of each verdict."""
    counts = Counter(one.verdict for one in found)
    return [f"{len(found)} claims of the paper: " + ", ".join(f"{counts[name]} {name}" for name in VERDICTS)]


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
    page.section("Experiments", "What was run; each folder has its own report.")
    page.table(
        Table(["experiment", "command", "seconds", "without results, since"], list(_experiments(outcomes)), True)
    )
    for place, group in itertools.groupby(found, key=lambda one: _section(one.claim.place)):
        page.section(place)
        rows = list(group)
        head = ["the paper says", "paper", "ours", "verdict", "experiment"]
        page.table(Table(head, [_row(one) for one in rows], is_wordy=True))
        for one in rows:
            if one.claim.id in figures:
                page.figure(figures[one.claim.id])
    return page


def _section(place: str) -> str:
    """The heading that a place belongs under.

    >>> _section("6.2: training"), _section("Table 3: detectors"), _section("Fig. 7")
    ('6.2', 'Table 3: detectors', 'Figures')
    """
    if place.startswith("Fig."):
        return "Figures"
    return place if place.startswith("Table") else place.partition(":")[0]


def _experiments(outcomes: Mapping[str, Outcome]) -> Iterator[list[str]]:
    for name, outcome in outcomes.items():
        yield [name, f"`{outcome.command}`", f"{outcome.seconds:.0f}", outcome.reason or DASH]


def _row(one: Answer) -> list[str]:
    claim = one.claim
    parts = claim.place.partition(": ")
    says = f"{parts[2]}: {claim.says}" if parts[2] and not claim.place.startswith("Table") else claim.says
    if claim.is_figure:
        says = f"{claim.place}: {says}"
    return [
        says,
        claim.paper,
        one.ours,
        f"{one.verdict}: {one.because}" if one.because else one.verdict,
        claim.study or DASH,
    ]


def _figures(found: Sequence[Answer], out: Path) -> Iterator[tuple[str, Figure]]:
    """The figures of ours that are there, reduced to the page's width."""
    for one in found:
        claim = one.claim
        file = out / claim.study / claim.image
        if claim.image and one.verdict != NEEDS and file.is_file():
            number = claim.id.removeprefix("figure-")
            data, suffix = _reduced(file)
            caption = f"{claim.place}. {claim.says}. Paper: {claim.paper}"
            yield claim.id, Figure(data, caption, f"{FIGURES}/reproduction_{number}.{suffix}")


def _reduced(file: Path) -> tuple[bytes, str]:
    """The picture's file and its suffix: a plot as it is, a larger picture as a smaller JPEG."""
    data = file.read_bytes()
    picture = np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR), np.uint8)
    if file.suffix == ".png" and len(data) < MAX_PNG_BYTES:
        return data, "png"
    return jpeg(picture, WIDTH_PX, JPEG_QUALITY), "jpg"


MAX_PNG_BYTES = 200_000
"""Plots have less, pictures of a camera more."""
