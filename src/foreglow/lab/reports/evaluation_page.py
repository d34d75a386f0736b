"""The report on a detector: Markdown with tables, its plots, and the numbers as JSON."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.display.summary_lines import counted
from foreglow.lab.evaluation.boxes.box_quality import BoxQuality
from foreglow.lab.evaluation.boxes.breakdown import Breakdown, FalseBoxes, ImageGroup, OperatingPoint
from foreglow.lab.evaluation.boxes.directness import Directness, KindConfusion
from foreglow.lab.evaluation.boxes.examination import Examination, Ranking
from foreglow.lab.evaluation.boxes.robustness import RobustnessRow
from foreglow.lab.evaluation.boxes.score_calibration import Calibration
from foreglow.lab.evaluation.boxes.whose_light import MIN_VEHICLE_SHARE, WhoseLight
from foreglow.lab.evaluation.vehicles import FirstFound, share_found_ahead
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, PALE, png, subplots
from foreglow.lab.reports.page import DASH, Figure, Page, Table, number
from foreglow.provenance import processor_name
from foreglow.types.kinds import KIND_WORDS

FEWEST_FALSE_BOXES = 0.01
"""Left end of the axis of false boxes a frame."""

_number = functools.partial(number, digits=3)


def _threshold(score: float) -> str:
    """A threshold to be set: rounded up, so that the box with this score still does not count, and with the digits by
    which it differs from 0 and 1.

    >>> _threshold(0.7551), _threshold(0.99998123), _threshold(0.0), _threshold(math.nan)
    ('0.756', '0.999982', '0.000', '–')
    """
    edge = min(score, 1.0 - score)
    if not edge > 0:
        return _number(score)
    digits = max(3, 1 - math.floor(math.log10(edge)))
    return number(math.ceil(score * 10**digits - 1e-6) / 10**digits, digits)


def curve_plot(ranking: Ranking, threshold: float) -> bytes:
    """Precision, recall and F over the threshold, and precision over recall."""
    figure, axes = subplots(2)
    curve = ranking.curve
    axes[0].plot(curve.thresholds, curve.precision, color=BLUE, label="precision")
    axes[0].plot(curve.thresholds, curve.recall, color=AMBER, label="recall")
    axes[0].plot(curve.thresholds, curve.f1, color=INK, label="F")
    axes[0].axvline(threshold, color=GREY, linewidth=0.8, linestyle=":")
    axes[0].set(xlabel="threshold on the score", ylim=(0, 1), xlim=(0, 1))
    axes[0].legend(frameon=False)
    axes[1].plot(curve.recall, curve.precision, color=BLUE)
    axes[1].set(xlabel="recall", ylabel="precision", ylim=(0, 1), xlim=(0, 1))
    axes[1].set_title(f"average precision {_number(ranking.average_precision)}", fontsize=10, loc="left")
    return png(figure)


def hidden_plot(ranking: Ranking, breakdown: Breakdown) -> bytes:
    """Recall of hidden vehicles' light over false boxes a frame in images without any vehicle's light."""
    figure, axes = subplots(1)
    curve = ranking.hidden
    false_boxes = np.maximum(curve.false_boxes_per_frame, FEWEST_FALSE_BOXES)
    # Between two corners, the recall of the one with fewer false boxes can be had.
    axes[0].step(false_boxes[::-1], curve.recall[::-1], color=AMBER, where="post")
    group = breakdown.group("sight", "hidden")
    if group is not None and not math.isnan(breakdown.false_boxes_empty.per_frame):
        at_threshold = max(breakdown.false_boxes_empty.per_frame, FEWEST_FALSE_BOXES)
        axes[0].plot([at_threshold], [group.recall], "o", color=INK, label=f"threshold {breakdown.threshold:g}")
        axes[0].axhline(group.ceiling, color=GREY, linewidth=0.8, linestyle=":", label="all proposals")
        axes[0].legend(frameon=False, loc="lower right")
    axes[0].set(
        xscale="log",
        ylim=(0, 1),
        xlabel="false boxes a frame, images without any vehicle's light",
        ylabel="recall, light of hidden vehicles",
    )
    return png(figure)


def reliability_plot(calibration: Calibration) -> bytes:
    """Share of light artifacts over the mean score, in bins of equal counts and in bins of a tenth."""
    figure, axes = subplots(1, width_in=4.0, height_in=3.8)
    axes[0].plot([0, 1], [0, 1], color=GREY, linewidth=0.8, linestyle=":")
    kinds = (("tenths of the score", calibration.tenths, AMBER), ("equal counts", calibration.bins, BLUE))
    for label, bins, color in kinds:
        scores, shares = [part.mean_score for part in bins], [part.share for part in bins]
        axes[0].plot(scores, shares, color=color, marker="o", markersize=4, label=label)
    axes[0].legend(frameon=False)
    axes[0].set(xlabel="mean score of a bin", ylabel="share with a light artifact", xlim=(0, 1), ylim=(0, 1))
    axes[0].set_title(f"calibration error {_number(calibration.ece)}", fontsize=10, loc="left")
    return png(figure)


def kinds_plot(breakdown: Breakdown) -> bytes:
    """Recall by kind, and by what else divides the lights, beside the ceiling of all proposals."""
    groups = breakdown.groups
    listed = [*groups["kind"], *groups["sight"], *groups["strength"]]
    figure, axes = subplots(1, width_in=7.0, height_in=0.9 + 0.3 * len(listed))
    rows = np.arange(len(listed))
    axes[0].barh(rows, [group.ceiling for group in listed], color=PALE, height=0.7, label="all proposals")
    axes[0].barh(rows, [group.recall for group in listed], color=AMBER, height=0.4, label="accepted")
    axes[0].set_yticks(rows, [f"{group.name} ({group.num})" for group in listed])
    axes[0].invert_yaxis()
    axes[0].set(xlabel="recall", xlim=(0, 1))
    axes[0].legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return png(figure)


def distance_plot(breakdown: Breakdown) -> bytes:
    """F and recall over the distance to the vehicle, with the ceiling of all proposals."""
    groups = breakdown.groups["distance"]
    figure, axes = subplots(1)
    curves = {
        "F": ("f1", INK, "-"),
        "recall": ("recall", AMBER, "-"),
        "recall of all proposals": ("ceiling", GREY, ":"),
    }
    for label, (name, color, style) in curves.items():
        values = [getattr(group, name) for group in groups]
        axes[0].plot(values, color=color, linestyle=style, marker="o", markersize=4, label=label)
    axes[0].set_xticks(range(len(groups)), [group.name.removesuffix(" m") for group in groups])
    axes[0].set(xlabel="metres to the vehicle", ylim=(0, 1))
    axes[0].legend(frameon=False)
    return png(figure)


ASPECTS = {
    "kind": "by kind",
    "source": "by source",
    "sight": "by sight of the vehicle",
    "strength": "by strength",
    "hidden kind": "hidden vehicles, by kind",
    "distance": "by distance to the vehicle",
}


REPORT = ("report.md", "results.json", "curve.png", "hidden.png", "reliability.png", "kinds.png", "distance.png")
"""All files of a report."""


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
    page = Page(f"{examination.detector} on {examination.name}")
    if not examination.is_complete:
        page.text("Incomplete: the predictions are of a run that was interrupted, or has lost frames since.")
    page.items([*examination.notes, *examination_lines(examination)])
    page.text("What every figure means: `docs/evaluation.md`.")
    _add_quality(page, examination)
    if examination.ranking is not None:
        _add_ranking(page, examination.ranking, examination.breakdown)
    _add_breakdown(page, examination.breakdown, is_scored=examination.quality.is_scored)
    if examination.whose_light is not None:
        _add_whose_light(page, examination.whose_light)
    if examination.kinds is not None:
        page.section("Kinds of light", kinds_words(examination.kinds))
        head, *rows = kinds_rows(examination.kinds)
        page.table(Table(head, rows))
    _add_vehicles(page, examination.vehicles, examination.rate_hz)
    if examination.run_time_ms:
        page.section("Run-time")
        rows = [
            [stage, *(number(times_ms[name]) for name in ("median", "p95", "p99"))]
            for stage, times_ms in examination.run_time_ms.items()
        ]
        page.table(Table(["stage, ms a frame", "median", "p95", "p99"], rows))
    if examination.robustness:
        _add_robustness(page, examination.robustness)
    made_with = {"processor": processor_name(), **origin}
    return page.write(folder / "report.md", results=examination, made_with=made_with)


def examination_lines(examination: Examination) -> list[str]:
    """The figures that matter most, one fact a line, for a terminal."""
    breakdown, lines = examination.breakdown, []
    if not examination.quality.tp + examination.quality.fn:
        images = counted(examination.quality.num_images, "image")
        lines.append(f"no key point in {images}, so that only false boxes are judged: is the split labelled?")
    if examination.num_outside:
        lights = counted(examination.num_outside, "key point")
        lines.append(
            f"outside the image, so that no box finds them: {lights}; labels for images of another size have many"
        )
    if examination.num_beyond:
        boxes = counted(examination.num_beyond, "box")
        lines.append(f"wholly beyond the image, as predictions for images of another size are: {boxes}")
    if examination.num_twin_boxes:
        boxes = counted(examination.num_twin_boxes, "box")
        lines.append(f"in the predictions again, same image and place, and counted again: {boxes}")
    if examination.num_twins:
        lights = counted(examination.num_twins, "key point")
        lines.append(f"in the labels again, same vehicle, instance and place, and counted again: {lights}")
    hidden = breakdown.group("sight", "hidden")
    if hidden is not None:
        lines.append(
            f"hidden vehicles: {_number(hidden.recall)} of {hidden.num} lights in an accepted box, "
            f"{_number(hidden.ceiling)} in any box"
        )
    lines.append(_false_boxes_line(breakdown.false_boxes, breakdown.false_boxes_empty))
    if examination.ranking is not None:
        ranking = examination.ranking
        lines.append(
            f"best F {_number(ranking.best_f1)} at threshold {_threshold(ranking.best_threshold)}; "
            f"average precision {_number(ranking.average_precision)}"
        )
        lines += [_hidden_line(point) for point in ranking.operating_points if point.limit == 0.2]
    if examination.whose_light is not None:
        lines += _whose_light_lines(examination.whose_light)
    lines += list(_directness_lines(examination.directness))
    if "total" in examination.run_time_ms:
        total = examination.run_time_ms["total"]
        lines.append(
            f"{number(total['median'])} ms a frame (median), {number(total['p99'])} ms (p99), without decoding"
        )
    return lines


def _false_boxes_line(everywhere: FalseBoxes, empty: FalseBoxes) -> str:
    return (
        f"false boxes a frame: {_number(everywhere.per_frame)} in all {everywhere.num_images} images, "
        f"{_number(empty.per_frame)} in the {empty.num_images} without vehicles"
    )


def _hidden_line(point: OperatingPoint) -> str:
    return (
        f"at {point.limit:g} false boxes a frame without vehicles (threshold {_threshold(point.threshold)}): "
        f"{_number(point.recall_hidden)} of the hidden vehicles' lights"
    )


def _whose_light_lines(found: WhoseLight) -> Iterator[str]:
    """The figures by whose light is in the boxes, or why there are none."""
    if found.false_boxes is None or found.false_boxes_empty is None:
        yield (
            f"by whose light: no figures, {found.num_unmatched} of {found.num_boxes} boxes are not among the proposals "
            f"stored with the data set (preset {found.preset}): expected the same preset and parameters"
        )
        return
    yield (
        f"by whose light, false below {MIN_VEHICLE_SHARE:g} of vehicle light: precision {_number(found.precision)}, "
        f"average precision {_number(found.average_precision)}, calibration error {_number(found.calibration_error)}"
    )
    yield f"by whose light, {_false_boxes_line(found.false_boxes, found.false_boxes_empty)}"
    for point in found.operating_points:
        if point.limit in (0.05, 0.2, 0.5):
            yield f"by whose light, {_hidden_line(point)}"


def _directness_lines(directness: Directness) -> Iterator[str]:
    """How well direct and indirect light are distinguished, and lamps grouped into vehicles, where a run does that."""
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


def kinds_rows(confusion: KindConfusion) -> list[list[str]]:
    """The table with its head: a row for each true kind, a column for each called one, and the share that is right."""
    names = [KIND_WORDS.get(kind, kind) for kind in confusion.kinds]
    rows = zip(names, confusion.counts.tolist(), confusion.recalls, strict=True)
    return [
        ["is, called", *names, "right"],
        *([name, *map(str, counts), _number(share)] for name, counts, share in rows),
    ]


def kinds_words(confusion: KindConfusion) -> str:
    """What the table leaves out."""
    return (
        f"Of the accepted boxes, {_number(confusion.right)} are of the kind that they are called. "
        f"{confusion.num_unknown} boxes without known kinds are not counted."
    )


def quality_words(quality: BoxQuality) -> list[str]:
    """Of which images the figures are, and which boxes count: one fact each, without a full stop."""
    condition = f"score > {quality.threshold:g}" if quality.is_scored else "boxes without scores, all count"
    words = [f"{counted(quality.num_images, 'image')}, {condition}"]
    if quality.num_missing:
        words.append(f"{counted(quality.num_missing, 'image')} without predictions, counted as without boxes")
    if quality.num_unknown:
        words.append(f"predictions for {counted(quality.num_unknown, 'unknown image')} ignored")
    return words


def _add_quality(page: Page, examination: Examination) -> None:
    quality = examination.quality
    page.section("The paper's metrics", f"{'; '.join(quality_words(quality))}.")
    rates = [_number(getattr(quality, name)) for name in ("precision", "recall", "f1", "q", "q_k", "q_b")]
    row = [*rates, quality.tp, quality.fp, quality.fn]
    page.table(Table(["P", "R", "F", "q", "q_K", "q_B", "TP", "FP", "FN"], [row]))


def _add_ranking(page: Page, ranking: Ranking, breakdown: Breakdown) -> None:
    page.section("Over all thresholds")
    page.figure(Figure(curve_plot(ranking, breakdown.threshold), "The metrics by threshold", "curve.png"))
    page.text(
        f"Best F {_number(ranking.best_f1)} at threshold {_threshold(ranking.best_threshold)}; average precision "
        f"{_number(ranking.average_precision)}."
    )
    page.section("Hidden vehicles against false boxes")
    page.figure(Figure(hidden_plot(ranking, breakdown), "Hidden vehicles against false boxes", "hidden.png"))
    page.table(Table.of(POINT_COLUMNS, ranking.operating_points))
    calibration = ranking.calibration
    if calibration is not None:
        page.section("Are scores probabilities?")
        page.figure(Figure(reliability_plot(calibration), "Share of light artifacts by score", "reliability.png"))
        values = (calibration.share, calibration.ece, calibration.brier, calibration.nll, calibration.temperature)
        after = (calibration.ece_at_temperature, calibration.nll_at_temperature)
        head = ["boxes", "with artifact", "ECE", "Brier", "NLL", "temperature", "ECE with it", "NLL with it"]
        page.table(Table(head, [[calibration.num, *map(_number, (*values, *after))]]))


def _add_breakdown(page: Page, breakdown: Breakdown, *, is_scored: bool) -> None:
    condition = f"At threshold {breakdown.threshold:g}" if is_scored else "All boxes count, since none has a score"
    page.section(
        "Recall by what a light is",
        f"{condition}; the ceiling is the recall of all proposals. F is that of this recall "
        f"and of the precision of all boxes, {_number(breakdown.precision)}.",
    )
    page.figure(Figure(kinds_plot(breakdown), "Recall by kind", "kinds.png"))
    if breakdown.groups["distance"]:
        page.figure(Figure(distance_plot(breakdown), "Recall by distance", "distance.png"))
    rows: list[list[Any]] = []
    for aspect, title in ASPECTS.items():
        groups = breakdown.groups[aspect]
        rows += [[f"**{title}**", "", "", "", ""]] if groups else []
        rows += [[group.name, group.num, *map(_number, (group.recall, group.ceiling, group.f1))] for group in groups]
    page.table(Table(["lights", "number", "recall", "ceiling", "F"], rows))
    page.section("False boxes")
    page.table(_false_boxes_table(breakdown.false_boxes, breakdown.false_boxes_empty))
    page.text("A minute has 18 x 60 images, whatever the rate of the data set.")
    for aspect, image_groups in (("weather", breakdown.weathers), ("scenario", breakdown.scenarios)):
        if image_groups:
            page.section(f"By {aspect}")
            page.table(Table.of({aspect: lambda group: group.name, **IMAGE_GROUP_COLUMNS}, image_groups))


def _add_whose_light(page: Page, found: WhoseLight) -> None:
    page.section("By whose light")
    if found.false_boxes is None or found.false_boxes_empty is None:
        page.items(_whose_light_lines(found))
        return
    page.text(
        f"A box is false if other vehicles make less than {MIN_VEHICLE_SHARE:g} of its light, as stored with the data "
        f"set for the proposals of `{found.preset}`. Of the accepted boxes {_number(found.precision)} are not false; "
        f"average precision {_number(found.average_precision)}, expected calibration error (ECE) of the scores "
        f"{_number(found.calibration_error)}. Recall is that of key points."
    )
    page.table(_false_boxes_table(found.false_boxes, found.false_boxes_empty))
    page.table(Table.of(POINT_COLUMNS, found.operating_points))


def _false_boxes_table(everywhere: FalseBoxes, empty: FalseBoxes) -> Table:
    return Table.of(FALSE_COLUMNS, {"all": everywhere, "without vehicles": empty}.items())


POINT_COLUMNS: Mapping[str, Callable[[OperatingPoint], str]] = {
    "false boxes a frame without vehicles, at most": lambda point: f"{point.limit:g}",
    "threshold": lambda point: _threshold(point.threshold),
    "recall hidden": lambda point: _number(point.recall_hidden),
    "P": lambda point: _number(point.precision),
    "R": lambda point: _number(point.recall),
    "F": lambda point: _number(point.f1),
}

FALSE_COLUMNS: Mapping[str, Callable[[tuple[str, FalseBoxes]], object]] = {
    "images": lambda named: named[0],
    "number": lambda named: named[1].num_images,
    "false boxes": lambda named: named[1].num,
    "with doubtful light": lambda named: named[1].num_doubtful,
    "a frame": lambda named: _number(named[1].per_frame),
    "without doubtful": lambda named: _number(named[1].per_frame_without_doubtful),
    "a minute": lambda named: number(named[1].per_minute, 0),
}

IMAGE_GROUP_COLUMNS: Mapping[str, Callable[[ImageGroup], object]] = {
    "images": lambda group: group.false_boxes.num_images,
    "lights": lambda group: group.lights.num,
    "P": lambda group: _number(group.precision),
    "R": lambda group: _number(group.lights.recall),
    "ceiling": lambda group: _number(group.lights.ceiling),
    "F": lambda group: _number(group.lights.f1),
    "false boxes a frame": lambda group: _number(group.false_boxes.per_frame),
}


def _add_vehicles(page: Page, vehicles: Sequence[FirstFound], rate_hz: float) -> None:
    delays_s = [vehicle.delay_s for vehicle in vehicles if not math.isnan(vehicle.delay_s)]
    ahead = [vehicle for vehicle in vehicles if vehicle.light_s < vehicle.lamp_s]
    num_begun = sum(vehicle.light_s == 0 for vehicle in vehicles)
    leads_s = [vehicle.lead_s for vehicle in ahead if not math.isnan(vehicle.lead_s)]
    page.section(
        "From first light to first box",
        f"{rate_hz:.3g} images a second. {len(vehicles)} oncoming vehicles, {len(delays_s)} of them found: "
        f"{_spread(delays_s)} s after their first light. The light of {len(ahead)} comes before their first lamp; "
        f"{_number(share_found_ahead(vehicles))} of these are found before the lamp is there; those that are found at "
        f"all, {_spread(leads_s)} s before it. The light of {num_begun} is there in the first "
        "image of their sequence: since when, nobody knows.",
    )
    columns: dict[str, Callable[[FirstFound], object]] = {
        "sequence": lambda vehicle: vehicle.sequence_id,
        "vehicle": lambda vehicle: vehicle.vehicle_id,
        "first light, s": lambda vehicle: _number(vehicle.light_s),
        "first box, s": lambda vehicle: _number(vehicle.found_s),
        "first lamp, s": lambda vehicle: _number(vehicle.lamp_s),
        "lead, s": lambda vehicle: _number(vehicle.lead_s),
    }
    page.table(Table.of(columns, vehicles))


def _add_robustness(page: Page, rows: Sequence[RobustnessRow]) -> None:
    words = "The same images, disturbed; the haze is drawn onto the image, not simulated."
    page.section("Robustness", words)
    head = ["images", "F", "P", "R", "ceiling", "R hidden", "false boxes a frame", "without vehicles", "proposals"]
    names = [name for name in RobustnessRow.__slots__ if name != "name"]
    page.table(Table(head, [[row.name, *(_number(getattr(row, name)) for name in names)] for row in rows]))


def _spread(values: Sequence[float]) -> str:
    if not values:
        return DASH
    low, median, high = np.percentile(values, (25, 50, 75))
    return f"{median:.2f} (quartiles {low:.2f} to {high:.2f})"
