"""The report on a detector: Markdown with tables, its plots, and the numbers as JSON."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.files import write_atomic, write_json_results
from foreglow.lab.evaluation.boxes.breakdown import FalseBoxes, ImageGroup, LightGroup
from foreglow.lab.evaluation.boxes.directness import Directness
from foreglow.lab.evaluation.boxes.examination import Examination, Ranking
from foreglow.lab.evaluation.boxes.first_found import share_found_ahead
from foreglow.lab.evaluation.boxes.robustness import RobustnessRow
from foreglow.lab.reports.evaluation_plots import evaluation_plots
from foreglow.lab.reports.numbers import number
from foreglow.provenance import checkout_state, processor_name

ASPECTS = {
    "kind": "by kind",
    "source": "by source",
    "sight": "by sight of the vehicle",
    "strength": "by strength",
    "hidden kind": "hidden vehicles, by kind",
    "distance": "by distance to the vehicle",
}


_number = functools.partial(number, digits=3)


def write_report(examination: Examination, folder: Path, origin: Mapping[str, Any]) -> Path:
    """Writes `results.json`, the plots and `report.md` to `folder`, and returns the last one's path.

    Args:
        examination: What is reported.
        folder: Made if need be.
        origin: How it came about, such as the options and the seed; goes into `results.json` with version and commit.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    commit, has_local_changes = checkout_state()
    made_with = {
        "version": metadata.version("foreglow"),
        "commit": commit,
        "has_local_changes": has_local_changes,
        "processor": processor_name(),
        **origin,
    }
    results = {"made_with": made_with, **examination.to_json()}
    plots = evaluation_plots(examination)
    for name, plot in plots.items():
        write_atomic(folder / name, plot)
    report = folder / "report.md"
    write_atomic(report, ("\n".join(_lines(examination, set(plots))) + "\n").encode())
    write_json_results(folder / "results.json", results)
    return report


def examination_lines(examination: Examination) -> list[str]:
    """The figures that matter most, one fact a line, for a terminal."""
    lines = []
    hidden = examination.breakdown.group("sight", "hidden")
    if hidden is not None:
        lines.append(
            f"hidden vehicles: {_number(hidden.recall)} of {hidden.num} lights in an accepted box, "
            f"{_number(hidden.ceiling)} in any box"
        )
    lines.append(f"false boxes a frame: {_false_boxes_in_words(examination)}")
    if examination.ranking is not None:
        ranking = examination.ranking
        lines.append(
            f"best F {_number(ranking.best_f1)} at threshold {_number(ranking.best_threshold)}; "
            f"average precision {_number(ranking.average_precision)}"
        )
        lines += [
            f"at {point.limit:g} false boxes a frame without vehicles (threshold {_number(point.threshold)}): "
            f"{_number(point.recall_hidden)} of the hidden vehicles' lights"
            for point in ranking.operating_points
            if point.limit == 0.2
        ]
    lines += list(_directness_lines(examination.directness))
    if "total" in examination.run_time_ms:
        total = examination.run_time_ms["total"]
        lines.append(
            f"{number(total['median'])} ms a frame (median), {number(total['p99'])} ms (p99), without decoding"
        )
    return lines


def _directness_lines(directness: Directness) -> Iterator[str]:
    """How well lamps are told from their light, and grouped into vehicles, where a run says so."""
    for name, quality in (("accepted boxes", directness.boxes), ("plausible tracks", directness.tracks)):
        if quality is not None:
            yield (
                f"direct or indirect, {name}: balanced accuracy {_number(quality.balanced_accuracy)} "
                f"({_number(quality.recall_direct)} of {quality.num_direct} direct, "
                f"{_number(quality.recall_indirect)} of {quality.num_indirect} indirect)"
            )
    vehicles = directness.vehicles
    if vehicles is not None:
        yield (
            f"pairs of tracks as vehicles: precision {_number(vehicles.precision)} of {vehicles.num_pairs}, "
            f"recall {_number(vehicles.recall)} of {vehicles.num_vehicles} with two lamps in tracks of their own"
        )


def _lines(examination: Examination, plots: set[str]) -> Iterator[str]:
    breakdown = examination.breakdown
    yield f"# {examination.detector} on {examination.name}"
    yield ""
    yield from (f"- {line}" for line in examination_lines(examination))
    yield ""
    yield "What every figure means: `docs/evaluation.md`."
    yield ""
    yield from _quality_lines(examination)
    if examination.ranking is not None:
        yield from _ranking_lines(examination.ranking)
    yield "## Recall by what a light is"
    yield ""
    yield (
        f"At threshold {breakdown.threshold:g}; the ceiling is the recall of all proposals. F is that of this recall "
        f"and of the precision of all boxes, {_number(breakdown.precision)}."
    )
    yield ""
    yield "![kinds](kinds.png)"
    yield ""
    if "distance.png" in plots:
        yield "![distance](distance.png)"
        yield ""
    yield from _table(["lights", "number", "recall", "ceiling", "F"], _group_rows(breakdown.groups))
    yield "## False boxes"
    yield ""
    rows = [_false_row("all", breakdown.false_boxes), _false_row("without vehicles", breakdown.false_boxes_empty)]
    head = ["images", "number", "false boxes", "with doubtful light", "a frame", "without doubtful", "a minute"]
    yield from _table(head, rows)
    yield "A minute has 18 x 60 images, whatever the rate of the data set."
    yield ""
    yield "## By weather"
    yield ""
    head = ["weather", "images", "lights", "P", "R", "ceiling", "F", "false boxes a frame"]
    yield from _table(head, [_weather_row(one) for one in breakdown.weathers])
    yield from _vehicle_lines(examination)
    if examination.run_time_ms:
        yield "## Run-time"
        yield ""
        times = [
            [stage, *(number(its[p]) for p in ("median", "p95", "p99"))]
            for stage, its in examination.run_time_ms.items()
        ]
        yield from _table(["stage, ms a frame", "median", "p95", "p99"], times)
    if examination.robustness:
        yield from _robustness_lines(examination.robustness)


def _quality_lines(examination: Examination) -> Iterator[str]:
    quality = examination.quality
    yield "## The paper's metrics"
    yield ""
    yield f"{quality.num_images} images; boxes count with a score above {quality.threshold:g}."
    yield ""
    names = ["precision", "recall", "f1", "q", "q_k", "q_b"]
    row = [*(_number(getattr(quality, name)) for name in names), quality.tp, quality.fp, quality.fn]
    yield from _table(["P", "R", "F", "q", "q_K", "q_B", "TP", "FP", "FN"], [row])


def _ranking_lines(ranking: Ranking) -> Iterator[str]:
    yield "## Over all thresholds"
    yield ""
    yield "![curve](curve.png)"
    yield ""
    yield (
        f"Best F {_number(ranking.best_f1)} at threshold {_number(ranking.best_threshold)}; average precision "
        f"{_number(ranking.average_precision)}."
    )
    yield ""
    yield "## Hidden vehicles against false boxes"
    yield ""
    yield "![hidden](hidden.png)"
    yield ""
    head = ["false boxes a frame without vehicles, at most", "threshold", "recall hidden", "P", "R", "F"]
    points = [
        [f"{one.limit:g}", *map(_number, (one.threshold, one.recall_hidden, one.precision, one.recall, one.f1))]
        for one in ranking.operating_points
    ]
    yield from _table(head, points)
    calibration = ranking.calibration
    if calibration is None:
        return
    yield "## Are scores probabilities?"
    yield ""
    yield "![reliability](reliability.png)"
    yield ""
    values = (calibration.ece, calibration.brier, calibration.nll, calibration.temperature)
    after = (calibration.ece_at_temperature, calibration.nll_at_temperature)
    head = ["boxes", "with artifact", "ECE", "Brier", "NLL", "temperature", "ECE with it", "NLL with it"]
    yield from _table(head, [[calibration.num, *map(_number, (calibration.share, *values, *after))]])


def _vehicle_lines(examination: Examination) -> Iterator[str]:
    vehicles = examination.vehicles
    yield "## From first light to first box"
    yield ""
    delays = [one.delay_s for one in vehicles if not math.isnan(one.delay_s)]
    ahead = [one for one in vehicles if one.light_s < one.lamp_s]
    leads = [one.lead_s for one in ahead if not math.isnan(one.lead_s)]
    yield (
        f"{examination.rate_hz:g} images a second. {len(vehicles)} oncoming vehicles, {len(delays)} of them found: "
        f"{_spread(delays)} s after their first light. The light of {len(ahead)} comes before their first lamp; "
        f"{_number(share_found_ahead(vehicles))} of these are found before the lamp is there; those that are found at "
        f"all, {_spread(leads)} s before it."
    )
    yield ""
    rows = [
        [one.sequence_id, one.vehicle_id, *map(_number, (one.light_s, one.found_s, one.lamp_s, one.lead_s))]
        for one in vehicles
    ]
    yield from _table(["sequence", "vehicle", "first light, s", "first box, s", "first lamp, s", "lead, s"], rows)


def _robustness_lines(rows: Sequence[RobustnessRow]) -> Iterator[str]:
    yield "## Robustness"
    yield ""
    yield "The same images, disturbed; the haze is drawn onto the image, not simulated."
    yield ""
    head = ["images", "F", "P", "R", "ceiling", "R hidden", "false boxes a frame", "without vehicles", "proposals"]
    names = [name for name in RobustnessRow.__slots__ if name != "name"]
    yield from _table(head, [[row.name, *(_number(getattr(row, name)) for name in names)] for row in rows])


def _group_rows(groups: Mapping[str, Sequence[LightGroup]]) -> Iterator[list[Any]]:
    for aspect, title in ASPECTS.items():
        if groups[aspect]:
            yield [f"**{title}**", "", "", "", ""]
        for one in groups[aspect]:
            yield [one.name, one.num, *map(_number, (one.recall, one.ceiling, one.f1))]


def _false_row(name: str, boxes: FalseBoxes) -> list[Any]:
    rates = (boxes.per_frame, boxes.per_frame_without_doubtful)
    return [name, boxes.num_images, boxes.num, boxes.num_doubtful, *map(_number, rates), f"{boxes.per_minute:.0f}"]


def _weather_row(group: ImageGroup) -> list[Any]:
    lights, false = group.lights, group.false_boxes
    rates = (group.precision, lights.recall, lights.ceiling, lights.f1, false.per_frame)
    return [group.name, false.num_images, lights.num, *map(_number, rates)]


def _false_boxes_in_words(examination: Examination) -> str:
    breakdown = examination.breakdown
    everywhere, empty = breakdown.false_boxes, breakdown.false_boxes_empty
    return (
        f"{_number(everywhere.per_frame)} in all {everywhere.num_images} images, "
        f"{_number(empty.per_frame)} in the {empty.num_images} without vehicles"
    )


def _table(head: Sequence[str], rows: Iterator[list[Any]] | Sequence[Sequence[Any]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|---" * len(head) + "|"
    for row in rows:
        yield "| " + " | ".join(str(cell) for cell in row) + " |"
    yield ""


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "–"
    low, median, high = np.percentile(values, (25, 50, 75))
    return f"{median:.2f} (quartiles {low:.2f} to {high:.2f})"
