"""The report on the time benefit: Markdown with tables, its figures, and the numbers as JSON and CSV."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from foreglow.config import config_to_toml
from foreglow.lab.evaluation.ratios import mean
from foreglow.lab.evaluation.vehicles import HUMAN_DELAY_S
from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, INK, PALE, box_plot, legend_above, png, subplots
from foreglow.lab.reports.page import DASH, Figure, Page, Table, number, percent, signed
from foreglow.lab.studies.reproduction.claims import paper_value
from foreglow.lab.studies.time_benefit.metrics import (
    HUMAN_AFTER_PRODUCTION_S,
    MeanAndSpread,
    Method,
    least_delay_s,
    mean_timeline,
)
from foreglow.lab.studies.time_benefit.run import (
    FIVE_FRAMES,
    LEAST_RATE_HZ,
    PAPER_CHAIN,
    PAPER_SINGLE_FRAME,
    TimeBenefitResults,
)

COLOURS = {"single frame": AMBER, "tracker, paper": BLUE, "tracker, ours": GREEN}
CHAIN_COLOURS = {PAPER_SINGLE_FRAME: "#f0d0a8", PAPER_CHAIN: "#b5c9e6"}
MEAN = {"marker": "^", "markerfacecolor": INK, "markeredgecolor": INK}
"""How the mean of a box is drawn."""

CURVE_COLOURS = {"frames": BLUE, "m_of_n": GREY, "evidence": GREEN}
SHOWN = (*COLOURS, "first lamp in sight", "production system")
"""The methods that figures and the table of sequences show."""

AFTER_SIGHT = "human, after direct sight"
HUMAN_BEFORE_PRODUCTION_S = paper_value("human-lead")
"""Mean of the study that the paper quotes."""

PAPER_BEFORE_S = {
    "single frame": (paper_value("single-before-production"), paper_value("single-before-human")),
    "tracker": (paper_value("tracker-before-production"), paper_value("tracker-before-human")),
}
"""Mean time before the production system and before a human."""

PAPER_ROWS = (
    *((f"{name}, paper on PVDN", *map(number, seconds)) for name, seconds in PAPER_BEFORE_S.items()),
    ("human, study quoted in the paper", number(HUMAN_BEFORE_PRODUCTION_S), DASH),
)
"""Name, mean time before the production system and before a human."""

PAPER_AFTER_LIGHT_S = {
    "single frame": HUMAN_DELAY_S - PAPER_BEFORE_S["single frame"][1],
    "tracker, paper": HUMAN_DELAY_S - PAPER_BEFORE_S["tracker"][1],
    "production system": HUMAN_DELAY_S - PAPER_BEFORE_S["tracker"][1] + PAPER_BEFORE_S["tracker"][0],
}
"""Mean time after the first light that follows from these, by the name of a method here."""

PAPER_TIMELINE_S = {
    "human": HUMAN_DELAY_S,
    "production system": HUMAN_DELAY_S + HUMAN_BEFORE_PRODUCTION_S,
    AFTER_SIGHT: HUMAN_DELAY_S + HUMAN_BEFORE_PRODUCTION_S + HUMAN_AFTER_PRODUCTION_S,
}
"""The paper's timeline of a human and the production system, from the study that it quotes."""


def benefit_figure(results: TimeBenefitResults) -> bytes:
    """Box plots: seconds after the first light, as the paper draws them, and seconds before the production system."""
    measured = {method.benefit.name for method in results.methods}
    systems = COLOURS | {name: colour for name, colour in CHAIN_COLOURS.items() if name in measured}
    figure, panels = subplots(2, width_in=6.0)
    rows = {"production system": GREY} | systems
    light_s, production_s = np.array([(met.light_s, met.production_s) for met in results.encounters]).T
    detected = {name: np.array(results.method(name).benefit.detected_s) for name in (*rows, "human")}
    after = {name: detected[name] - light_s for name in rows}
    before = {name: production_s - detected[name] for name in (*systems, "human")}
    for axes, seconds, label in zip(
        panels, (after, before), ("after the first light", "before the production system"), strict=True
    ):
        values = [times[~np.isnan(times)] for times in seconds.values()]
        colours = [rows.get(name, PALE) for name in seconds]
        labels = [name.replace(", ", ",\n").replace(" whole", "\nwhole") for name in seconds]
        options: dict[str, Any] = {"tick_labels": labels, "widths": 0.5, "medianprops": None, "meanprops": MEAN}
        box_plot(axes, values, colours, alpha=0.6, showmeans=True, showfliers=True, **options)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set(ylabel=f"seconds {label}")
        axes.tick_params(axis="x", rotation=20)
    panels[0].axhline(HUMAN_DELAY_S, color=INK, linewidth=0.8, linestyle="--", label="human, mean (paper)")
    places = [list(after).index(name) + 1 for name in PAPER_AFTER_LIGHT_S]
    papers = {"marker": "D", "s": 24, "color": INK, "zorder": 3, "label": "mean, from the paper's text"}
    panels[0].scatter(places, PAPER_AFTER_LIGHT_S.values(), **papers)
    panels[0].plot([], [], linestyle="", label="mean, here", **MEAN)
    panels[0].legend(frameon=False)
    return png(figure)


def timeline_figure(results: TimeBenefitResults) -> bytes:
    """Mean times after the first light on a line, and the paper's on a line below."""
    figure, (axes,) = subplots(1, width_in=10.0, height_in=3.4)
    rows = {"here": timeline(results)[1], "paper": PAPER_TIMELINE_S}
    for row, times_s in enumerate(rows.values()):
        axes.plot((0.0, max(times_s.values())), (row, row), color=PALE, linewidth=4, zorder=1)
        ordered = sorted(times_s.items(), key=lambda item: item[1])
        for (name, time_s), height in zip(ordered, itertools.cycle((8, -8, 34, -34))):
            axes.scatter(time_s, row, s=36, color=COLOURS.get(name, INK), zorder=2)
            text, side = f"{name}\n{time_s:.2f} s", "bottom" if height > 0 else "top"
            offset: dict[str, Any] = {"xytext": (0, height), "textcoords": "offset points", "ha": "center", "va": side}
            axes.annotate(text, (time_s, row), fontsize=7, arrowprops={"arrowstyle": "-", "color": PALE}, **offset)
    axes.set_yticks(range(len(rows)), list(rows))
    axes.margins(x=0.1)
    axes.set(xlabel="mean seconds after the first annotated artifact", ylim=(len(rows) - 0.3, -0.7))
    return png(figure)


def timeline(results: TimeBenefitResults) -> tuple[int, dict[str, float]]:
    """The number of vehicles, and mean seconds after the first light by name; as `mean_timeline`."""
    names = (*COLOURS, "human", "first lamp in sight", "production system")
    num, times_s = mean_timeline(results.encounters, (results.method(name).benefit for name in names))
    return num, times_s | {AFTER_SIGHT: times_s["production system"] + HUMAN_AFTER_PRODUCTION_S}


def sequences_figure(results: TimeBenefitResults) -> bytes:
    """When each method detects, sequence by sequence, from the first annotated artifact."""
    figure, (axes,) = subplots(1, width_in=8.0, height_in=1.6 + 0.24 * len(results.encounters))
    light_s = np.array([encounter.light_s for encounter in results.encounters])
    rows = np.arange(len(results.encounters))
    markers = {"first lamp in sight": ("|", INK), "production system": ("s", GREY)}
    for name in SHOWN:
        marker, colour = markers.get(name, ("o", COLOURS.get(name, INK)))
        size = 60 if marker == "|" else 22
        delays_s = np.array(results.method(name).benefit.detected_s) - light_s
        axes.scatter(delays_s, rows, s=size, color=colour, marker=marker, label=name)
    axes.set_yticks(rows, [f"{met.sequence} {met.scenario}" for met in results.encounters], fontsize=7)
    axes.axvline(0.0, color=AMBER, linewidth=0.8)
    axes.set(xlabel="seconds after the first annotated artifact")
    axes.invert_yaxis()
    legend_above(figure, axes, fontsize=8, ncols=3)
    return png(figure)


def confirmation_figure(results: TimeBenefitResults) -> bytes:
    """Mean time to confirm over false groups of confirmed tracks, a curve for each rule."""
    figure, (axes,) = subplots(1, width_in=6.5)
    for rule, curve in results.curves.items():
        judged = [(method.false, method.delay_s) for method in curve if method.false is not None]
        points = sorted((false.groups_per_minute, delay_s) for false, delay_s in judged)
        axes.plot(*np.array(points).T, marker="o", markersize=4, color=CURVE_COLOURS[rule], label=rule)
    paper = results.method("tracker, paper")
    assert paper.false is not None
    axes.plot(paper.false.groups_per_minute, paper.delay_s, "*", color=INK, markersize=11, label="the paper's tracker")
    words = "false groups of confirmed tracks a minute"
    axes.set(xlabel=words, ylabel="mean seconds after the first artifact", ylim=(0, None))
    axes.legend(frameon=False)
    return png(figure)


Columns: TypeAlias = Mapping[str, Callable[[Method], object]]


def write_report(results: TimeBenefitResults, folder: Path) -> Path:
    """Writes `results.json`, `config.toml`, `sequences.csv`, three plots and `report.md`, whose path it returns.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        OSError: If a file cannot be written.
    """
    occluded = [encounter for encounter in results.encounters if encounter.is_occluded]
    unreported = [encounter for encounter in results.encounters if math.isnan(encounter.production_s)]
    page = Page(f"Time benefit on {results.name}")
    page.text(
        f"{results.num_sequences} sequences at {_rates(results)}; in {len(results.encounters)} of them a vehicle's "
        f"light is annotated, in {len(occluded)} before its lamps. In {len(unreported)} the production system reports "
        "nothing: they are left out of what is compared with it."
    )
    page.items([*results.notes, *_begun(results)])
    if min(results.rates_hz) < LEAST_RATE_HZ:
        page.text(f"Below {LEAST_RATE_HZ:g} Hz five frames take longer than a human: these times say little.")
    table = Table.of(METHOD_COLUMNS, results.methods)
    blanks = dict.fromkeys(METHOD_COLUMNS, DASH)
    paper = [
        [*(blanks | {"method": name, "before production": production, "before human": human}).values()]
        for name, production, human in PAPER_ROWS
    ]
    page.table(Table(table.head, [*table.rows, *paper]))
    page.text(
        "Times are means (medians), seconds. *After light*: from the first annotated artifact. *Before production*, "
        "*human*, *sight*: by how much it is earlier than the production system, a human (0.8 s after the light), the "
        "vehicle's first annotated lamp (occluded vehicles). *Provident*: of the occluded vehicles that come into "
        "sight, the share detected before that lamp; a missed one counts against it. *Occluded*: before production, of "
        "occluded vehicles. *False tracks* are plausible at some time and never hold light of a vehicle; those *an "
        "empty minute* come up in an image without any. In *false groups*, tracks that come as close to one another as "
        "their boxes are long count as one, and light in one excuses all. *False vehicles* are what our tracker "
        "confirms, which has no counterpart in the others: light in one of a vehicle's tracks excuses all of them."
    )
    page.figure(Figure(benefit_figure(results), "Seconds after the first light, as in the paper", "benefit.png"))
    page.items(_plausibility(method) for method in results.methods if method.false is not None)
    page.text(
        "The paper states 0.28 s as the least, which is five frames, and a mean of 0.50 s. From the first to the fifth "
        "frame it is four frames, 0.22 s."
    )
    if timeline(results)[0]:
        page.section(
            "Timeline",
            f"Means over the {timeline(results)[0]} vehicles that every method detects. A human who waits for direct "
            f"sight is {HUMAN_AFTER_PRODUCTION_S:g} s behind the production system, and the paper's line is that of a "
            "study with a test group: both as the paper quotes them.",
        )
        page.figure(Figure(timeline_figure(results), "Mean times after the first light", "timeline.png"))
    _add_categories(page, results)
    _add_curves(page, results)
    page.section("Sequences")
    page.table(_sequence_table(results))
    page.text("Seconds from the first image of the sequence; – for never.")
    page.figure(Figure(sequences_figure(results), "When each method detects, by sequence", "sequences.png"))
    files = {"config.toml": config_to_toml(results.config), "sequences.csv": _sequences_csv(results)}
    return page.write(folder / "report.md", results=results, files=files)


def _rates(results: TimeBenefitResults) -> str:
    return " and ".join(f"{rate_hz:.3g} Hz" for rate_hz in dict.fromkeys(results.rates_hz))


def _begun(results: TimeBenefitResults) -> list[str]:
    """A line if there is light in the first image of sequences: from when on is not known."""
    if not results.num_begun:
        return []
    return [
        f"in {results.num_begun} of {len(results.encounters)} sequences with a vehicle's light, it is there in the "
        "first image: times after the light are too short there, and those before a human too long"
    ]


def summary_lines(results: TimeBenefitResults) -> list[str]:
    """What the command says: our tracker in three lines."""
    ours = results.method("tracker, ours")
    assert ours.false is not None
    before, num = ours.benefit.occluded_before_production_s, len(results.encounters)
    num_occluded = sum(encounter.is_occluded for encounter in results.encounters)
    return [
        *results.notes,
        *_begun(results),
        f"{num} vehicle{'' if num == 1 else 's'} at {_rates(results)}, {num_occluded} of them occluded at first; our "
        f"tracker confirms {percent(ours.benefit.provident_share)} of these before their first lamp",
        f"these {signed(before.mean)} s before the production system (mean of {before.num}), all "
        f"{signed(ours.benefit.before_human_s.mean)} s before a human",
        f"a minute: {number(ours.false.per_minute)} false tracks, {number(ours.false.groups_per_minute)} false groups "
        f"of close tracks, {number(ours.false.vehicles_per_minute)} false vehicles",
    ]


METHOD_COLUMNS: Columns = {
    "method": lambda method: method.benefit.name,
    "after light": lambda method: _mean_and_median(method.benefit.delays_s),
    "before production": lambda method: _mean_and_median(method.benefit.before_production_s),
    "occluded": lambda method: _mean_and_median(method.benefit.occluded_before_production_s),
    "before human": lambda method: _mean_and_median(method.benefit.before_human_s),
    "before sight": lambda method: _mean_and_median(method.benefit.before_sight_s),
    "provident": lambda method: percent(method.benefit.provident_share),
    "missed": lambda method: method.benefit.num_missed,
    "false tracks a minute": lambda method: number(getattr(method.false, "per_minute", None)),
    "a km": lambda method: number(getattr(method.false, "per_km", None)),
    "an empty minute": lambda method: number(getattr(method.false, "per_empty_minute", None)),
    "false groups a minute": lambda method: number(getattr(method.false, "groups_per_minute", None)),
    "false vehicles a minute": lambda method: number(getattr(method.false, "vehicles_per_minute", None)),
}

CURVE_FALSE = ("false tracks a minute", "false groups a minute", "false vehicles a minute")
CURVE_COLUMNS: Columns = {
    "setting": METHOD_COLUMNS["method"],
    "mean after light, s": lambda method: number(method.delay_s),
    **{head: METHOD_COLUMNS[head] for head in (*CURVE_FALSE, "provident", "missed")},
}


def _plausibility(method: Method) -> str:
    """By how much the tracker is later than a single frame."""
    waits_s = method.plausibility_s
    if not waits_s:
        return f"{method.benefit.name}: no vehicle that a single frame detects as well"
    least_s, mean_s = number(min(waits_s)), number(mean(waits_s))
    return f"{method.benefit.name}: {least_s} s at least, {mean_s} s on average after a single frame"


def _add_categories(page: Page, results: TimeBenefitResults) -> None:
    """How much earlier the methods are than each image category."""
    page.section(
        "Image categories",
        "The first image in each category, seconds after the first annotated artifact, and by how much each method is "
        "earlier; means of the sequences with such an image. PVDN does not document which category is the report of "
        "the production system, and which, if any, the recognition by the driver.",
    )
    light_s = np.array([met.light_s for met in results.encounters])
    rows = []
    for category, times_s in results.categories.items():
        detected = [np.array(results.method(name).benefit.detected_s) for name in COLOURS]
        leads = [mean(np.array(times_s) - method_s) for method_s in detected]
        num = int(np.count_nonzero(~np.isnan(times_s)))
        rows.append([category, num, number(mean(np.array(times_s) - light_s)), *map(number, leads)])
    page.table(Table(["category", "sequences", "after light", *(f"{name}, before" for name in COLOURS)], rows))


def _add_curves(page: Page, results: TimeBenefitResults) -> None:
    page.section(
        "Confirmation: how soon, and how often in vain",
        "All rules with our tracker's association. The least mean time after the light, with at most as many false "
        "groups of tracks as",
    )
    five = next(method for method in results.curves["frames"] if method.benefit.name == FIVE_FRAMES)
    compared = {"five frames with our association": five, "the paper's tracker": results.method("tracker, paper")}
    page.items(_comparison(name, method, results) for name, method in compared.items())
    page.text(
        "Here a vehicle that a rule does not confirm before the production system reports it, or the sequence ends, "
        "counts as confirmed then."
    )
    rows = [
        [rule, *(cell(method) for cell in CURVE_COLUMNS.values())]
        for rule, curve in results.curves.items()
        for method in curve
    ]
    page.table(Table(["rule", *CURVE_COLUMNS], rows))
    page.figure(Figure(confirmation_figure(results), "Time to confirm over false groups of tracks", "confirmation.png"))


def _comparison(name: str, method: Method, results: TimeBenefitResults) -> str:
    """How much earlier each rule confirms than `method` does, at its rate of false groups."""
    assert method.false is not None
    limit = method.false.groups_per_minute
    delays_s = {rule: least_delay_s(curve, limit) for rule, curve in results.curves.items()}
    rules = ", ".join(
        f"{rule} {number(delay_s)} s ({signed(method.delay_s - delay_s)} s earlier)"
        for rule, delay_s in delays_s.items()
    )
    return f"{name} ({number(limit)} a minute, {number(method.delay_s)} s): {rules}"


def _sequence_table(results: TimeBenefitResults) -> Table:
    times_s = zip(*(results.method(name).benefit.detected_s for name in SHOWN), strict=True)
    rows = [
        [
            encounter.sequence,
            encounter.scenario or DASH,
            encounter.vehicle,
            *map(number, (encounter.light_s, *detected)),
        ]
        for encounter, detected in zip(results.encounters, times_s, strict=True)
    ]
    return Table(["sequence", "scenario", "vehicle", "light", *SHOWN], rows)


def _sequences_csv(results: TimeBenefitResults) -> str:
    """A row for each sequence; empty for never."""
    head = ["sequence", "scenario", "vehicle", "is_occluded", "duration_s", "light_s"]
    detected_s = zip(*(method.benefit.detected_s for method in results.methods), strict=True)
    rows = [
        [
            *(encounter.sequence, encounter.scenario, encounter.vehicle, int(encounter.is_occluded)),
            *(number(time_s, 4, "") for time_s in (encounter.duration_s, encounter.light_s, *times_s)),
        ]
        for encounter, times_s in zip(results.encounters, detected_s, strict=True)
    ]
    return Table([*head, *(f"{method.benefit.name} s" for method in results.methods)], rows).csv()


def _mean_and_median(values: MeanAndSpread) -> str:
    return f"{number(values.mean)} ({number(values.median)})" if values.num else DASH
