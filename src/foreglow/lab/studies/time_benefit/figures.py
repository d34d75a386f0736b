"""The figures of the report on the time benefit."""

from __future__ import annotations

from typing import Any

import numpy as np

from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, INK, PALE, box_plot, legend_above, png, subplots
from foreglow.lab.studies.time_benefit.run import TimeBenefitResults

COLOURS = {"single frame": AMBER, "tracker, paper": BLUE, "tracker, ours": GREEN}
CURVE_COLOURS = {"frames": BLUE, "m_of_n": GREY, "evidence": GREEN}
SHOWN = (*COLOURS, "first lamp in sight", "production system")
"""The methods that figures and the table of sequences show."""


def benefit_figure(results: TimeBenefitResults) -> bytes:
    """Box plots: seconds before the production system, and before a human."""
    figure, panels = subplots(2)
    production = np.array([encounter.production_s for encounter in results.encounters])
    human = np.array([encounter.human_s for encounter in results.encounters])
    rows = [*COLOURS, "human"]
    for axes, reference_s, label in zip(panels, (production, human), ("production system", "human"), strict=True):
        names = [name for name in rows if name != label]
        detected = [np.array(results.method(name).benefit.detected_s) for name in names]
        values = [(reference_s - times)[~np.isnan(reference_s - times)] for times in detected]
        colours = [COLOURS.get(name, PALE) for name in names]
        options: dict[str, Any] = {"tick_labels": names, "widths": 0.5, "medianprops": None}
        box_plot(axes, values, colours, alpha=0.6, showmeans=True, showfliers=True, **options)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set(ylabel=f"seconds before the {label}")
        axes.tick_params(axis="x", rotation=20)
    return png(figure)


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
    """Mean time to confirm over false confirmed tracks, a curve for each rule."""
    figure, (axes,) = subplots(1, width_in=6.5)
    for rule, curve in results.curves.items():
        points = sorted((method.false.per_minute, method.delay_s) for method in curve if method.false is not None)
        axes.plot(*np.array(points).T, marker="o", markersize=4, color=CURVE_COLOURS[rule], label=rule)
    paper = results.method("tracker, paper")
    assert paper.false is not None
    axes.plot(paper.false.per_minute, paper.delay_s, "*", color=INK, markersize=11, label="the paper's tracker")
    axes.set(xlabel="false confirmed tracks a minute", ylabel="mean seconds after the first artifact", ylim=(0, None))
    axes.legend(frameon=False)
    return png(figure)
