"""The report on the time benefit: Markdown with tables, its figures, and the numbers as JSON and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from foreglow.config import config_to_toml
from foreglow.files import write_atomic, write_json_results
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, PALE, png, subplots
from foreglow.lab.reports.numbers import DASH, number, percent, signed
from foreglow.lab.studies.time_benefit.metrics import MeanAndSpread
from foreglow.lab.studies.time_benefit.run import FIVE_FRAMES, Method, TimeBenefitResults, least_delay_s
from foreglow.provenance import provenance

COLOURS = {"single frame": AMBER, "tracker, paper": BLUE, "tracker, ours": "#2c9c4b"}
CURVE_COLOURS = {"frames": BLUE, "m_of_n": GREY, "evidence": "#2c9c4b"}


def write_report(results: TimeBenefitResults, folder: Path) -> Path:
    """Writes `results.json`, `config.toml`, `sequences.csv`, three plots and `report.md`, whose path it returns.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        OSError: If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json_results(folder / "results.json", {"made_with": provenance()} | results.to_json())
    write_atomic(folder / "config.toml", config_to_toml(results.config).encode())
    write_atomic(folder / "sequences.csv", _sequences_csv(results).encode())
    write_atomic(folder / "benefit.png", _benefit_figure(results))
    write_atomic(folder / "sequences.png", _sequences_figure(results))
    write_atomic(folder / "confirmation.png", _confirmation_figure(results))
    report = folder / "report.md"
    write_atomic(report, ("\n".join(_lines(results)) + "\n").encode())
    return report


def summary_lines(results: TimeBenefitResults) -> list[str]:
    """What the command says: our tracker in three lines."""
    ours = results.method("tracker, ours")
    assert ours.false is not None
    before, num = ours.benefit.occluded_before_production_s, len(results.encounters)
    num_occluded = sum(one.is_occluded for one in results.encounters)
    return [
        f"{num} vehicle{'' if num == 1 else 's'}, {num_occluded} of them occluded at first; our tracker confirms "
        f"{percent(ours.benefit.provident_share)} of these before their first lamp",
        f"these {signed(before.mean)} s before the production system (mean of {before.num}), all "
        f"{signed(ours.benefit.before_human_s.mean)} s before a human",
        f"{number(ours.false.per_minute)} false confirmed tracks a minute, {number(ours.false.per_km)} a kilometre",
    ]


def _lines(results: TimeBenefitResults) -> Iterator[str]:
    occluded = [one for one in results.encounters if one.is_occluded]
    unreported = [one for one in results.encounters if math.isnan(one.production_s)]
    yield f"# Time benefit on {results.name}"
    yield ""
    yield (
        f"{results.num_sequences} sequences; in {len(results.encounters)} of them a vehicle's light is annotated, in "
        f"{len(occluded)} before its lamps. In {len(unreported)} the production system reports nothing: they are left "
        "out of what is compared with it."
    )
    yield ""
    yield from _method_lines(results.methods)
    yield ""
    yield (
        "Times are means (medians), seconds. *After light*: from the first annotated artifact. *Before production*, "
        "*human*, *sight*: by how much it is earlier than the production system, a human (0.8 s after the light), the "
        "vehicle's first annotated lamp (occluded vehicles). *Provident*: share of the occluded vehicles that are "
        "detected before that lamp; a missed one counts against it. *Occluded*: before production, of occluded "
        "vehicles. False tracks *an empty minute* are those that come up in an image without any vehicle's light."
    )
    yield from ("", "![benefit](benefit.png)", "")
    yield from ("## Confirmation: how soon, and how often in vain", "")
    yield from _curve_lines(results)
    yield from ("", "![confirmation](confirmation.png)", "")
    yield from ("## Sequences", "", *_sequence_lines(results), "", "![sequences](sequences.png)")


def _method_lines(methods: Iterable[Method]) -> Iterator[str]:
    yield (
        "| method | after light | before production | occluded | before human | before sight | provident | missed "
        "| false tracks a minute | a km | an empty minute |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for one in methods:
        benefit, false = one.benefit, one.false
        yield (
            f"| {benefit.name} | {_spread(benefit.delays_s)} | {_spread(benefit.before_production_s)} "
            f"| {_spread(benefit.occluded_before_production_s)} | {_spread(benefit.before_human_s)} "
            f"| {_spread(benefit.before_sight_s)} | {percent(benefit.provident_share)} | {benefit.num_missed} "
            f"| {number(false.per_minute) if false else DASH} | {number(false.per_km) if false else DASH} "
            f"| {number(false.per_empty_minute) if false else DASH} |"
        )


def _curve_lines(results: TimeBenefitResults) -> Iterator[str]:
    five = next(one for one in results.curves["frames"] if one.benefit.name == FIVE_FRAMES)
    paper = results.method("tracker, paper")
    yield (
        "All rules with our tracker's association. The least mean time after the light, with at most as many false "
        "confirmed tracks as"
    )
    yield ""
    for name, one in (("five frames with our association", five), ("the paper's tracker", paper)):
        assert one.false is not None
        limit = one.false.per_minute
        delays_s = {rule: least_delay_s(curve, limit) for rule, curve in results.curves.items()}
        rules = ", ".join(
            f"{rule} {number(delay_s)} s ({signed(one.delay_s - delay_s)} s earlier)"
            for rule, delay_s in delays_s.items()
        )
        yield f"- {name} ({number(limit)} a minute, {number(one.delay_s)} s): {rules}"
    yield ""
    yield (
        "Here a vehicle that a rule does not confirm before the production system reports it, or the sequence ends, "
        "counts as confirmed then."
    )
    yield ""
    yield "| rule | setting | mean after light, s | false tracks a minute | a km | provident | missed |"
    yield "|---|---|---|---|---|---|---|"
    for rule, curve in results.curves.items():
        for one in curve:
            assert one.false is not None
            yield (
                f"| {rule} | {one.benefit.name} | {number(one.delay_s)} | {number(one.false.per_minute)} "
                f"| {number(one.false.per_km)} | {percent(one.benefit.provident_share)} | {one.benefit.num_missed} |"
            )


def _sequence_lines(results: TimeBenefitResults) -> Iterator[str]:
    shown = _shown(results)
    yield "| sequence | scenario | vehicle | light | " + " | ".join(one.benefit.name for one in shown) + " |"
    yield "|---|---|---|---|" + "---|" * len(shown)
    for place, one in enumerate(results.encounters):
        times = " | ".join(number(method.benefit.detected_s[place]) for method in shown)
        yield f"| {one.sequence} | {one.scenario or DASH} | {one.vehicle} | {number(one.light_s)} | {times} |"
    yield ""
    yield "Seconds from the first image of the sequence; – for never."


def _sequences_csv(results: TimeBenefitResults) -> str:
    """One row a sequence; empty for never."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = ["sequence", "scenario", "vehicle", "is_occluded", "duration_s", "light_s"]
    writer.writerow([*head, *(f"{one.benefit.name} s" for one in results.methods)])
    for place, one in enumerate(results.encounters):
        times = [one.light_s, *(method.benefit.detected_s[place] for method in results.methods)]
        cells = ["" if math.isnan(time_s) else f"{time_s:.4f}" for time_s in times]
        writer.writerow(
            [one.sequence, one.scenario, one.vehicle, int(one.is_occluded), f"{one.duration_s:.4f}", *cells]
        )
    return text.getvalue()


def _shown(results: TimeBenefitResults) -> list[Method]:
    """The methods that figures and the table of sequences show."""
    names = (*COLOURS, "first lamp in sight", "production system")
    return [results.method(name) for name in names]


def _benefit_figure(results: TimeBenefitResults) -> bytes:
    """Box plots: seconds before the production system, and before a human."""
    figure, axes = subplots(2)
    production = np.array([one.production_s for one in results.encounters])
    human = np.array([one.human_s for one in results.encounters])
    rows = [*COLOURS, "human"]
    for axis, reference_s, label in zip(axes, (production, human), ("production system", "human"), strict=True):
        names = [name for name in rows if name != label]
        detected = [np.array(results.method(name).benefit.detected_s) for name in names]
        values = [(reference_s - times)[~np.isnan(reference_s - times)] for times in detected]
        boxes = axis.boxplot(values, tick_labels=names, showmeans=True, patch_artist=True, widths=0.5)
        for patch, name in zip(boxes["boxes"], names, strict=True):
            patch.set(facecolor=COLOURS.get(name, PALE), alpha=0.6)
        axis.axhline(0.0, color=INK, linewidth=0.8)
        axis.set(ylabel=f"seconds before the {label}")
        axis.tick_params(axis="x", rotation=20)
    return png(figure)


def _sequences_figure(results: TimeBenefitResults) -> bytes:
    """When each method detects, sequence by sequence, from the first annotated artifact."""
    figure, (axis,) = subplots(1, width_in=8.0, height_in=1.6 + 0.24 * len(results.encounters))
    light_s = np.array([one.light_s for one in results.encounters])
    places = np.arange(len(results.encounters))
    markers = {"first lamp in sight": ("|", INK), "production system": ("s", GREY)}
    for method in _shown(results):
        name = method.benefit.name
        marker, colour = markers.get(name, ("o", COLOURS.get(name, INK)))
        size = 60 if marker == "|" else 22
        delays_s = np.array(method.benefit.detected_s) - light_s
        axis.scatter(delays_s, places, s=size, color=colour, marker=marker, label=name)
    axis.set_yticks(places, [f"{one.sequence} {one.scenario}" for one in results.encounters], fontsize=7)
    axis.axvline(0.0, color=AMBER, linewidth=0.8)
    axis.set(xlabel="seconds after the first annotated artifact")
    axis.invert_yaxis()
    figure.legend(frameon=False, fontsize=8, loc="outside upper center", ncols=3)
    return png(figure)


def _confirmation_figure(results: TimeBenefitResults) -> bytes:
    """Mean time to confirm over false confirmed tracks, a curve for each rule."""
    figure, (axis,) = subplots(1, width_in=6.5)
    for rule, curve in results.curves.items():
        points = sorted((one.false.per_minute, one.delay_s) for one in curve if one.false is not None)
        axis.plot(*np.array(points).T, marker="o", markersize=4, color=CURVE_COLOURS[rule], label=rule)
    paper = results.method("tracker, paper")
    assert paper.false is not None
    axis.plot(paper.false.per_minute, paper.delay_s, "*", color=INK, markersize=11, label="the paper's tracker")
    axis.set(xlabel="false confirmed tracks a minute", ylabel="mean seconds after the first artifact", ylim=(0, None))
    axis.legend(frameon=False)
    return png(figure)


def _spread(values: MeanAndSpread) -> str:
    return f"{number(values.mean)} ({number(values.median)})" if values.num else DASH
