"""The figures of the report on run-times."""

from __future__ import annotations

import numpy as np

from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, INK, PALE, box_plot, png, subplots
from foreglow.lab.studies.runtime.metrics import PARTS, frames_by_proposals
from foreglow.lab.studies.runtime.run import RuntimeResults

EDGES = (0, 10, 20, 30, 40, 60)
"""Numbers of proposals at which the groups begin."""

COLOURS = (AMBER, BLUE, GREEN, GREY)
WHISKERS = (1, 99)


def stage_figure(results: RuntimeResults) -> bytes:
    """The paper's figure: box plots of the parts, one group a part, one colour a network."""
    figure, (axes,) = subplots(1, width_in=9.0, height_in=4.0)
    width = 0.8 / max(1, len(results.networks))
    for index, (times, colour) in enumerate(zip(results.networks, COLOURS, strict=False)):
        shift = (index - (len(results.networks) - 1) / 2) * width
        known = {position: times.parts_ms[part] for position, part in enumerate(PARTS) if part in times.parts_ms}
        values = [column[np.isfinite(column)] for column in known.values()]
        positions = [position + shift for position in known]
        colours = [colour] * len(values)
        box_plot(axes, values, colours, alpha=0.6, positions=positions, widths=0.8 * width, whis=WHISKERS)
        axes.plot([], [], "s", color=colour, label=times.name)
    axes.axhline(1e3 * results.frame_s, color=INK, linestyle=":", linewidth=1)
    axes.set_yscale("log")
    axes.set_xticks(range(len(PARTS)), PARTS)
    axes.set(ylabel="ms", title="Run-time a frame: quartiles, whiskers 1 to 99 %; dotted: a frame's time")
    axes.grid(axis="y", color=PALE)
    axes.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.08))
    return png(figure)


def proposal_figure(results: RuntimeResults) -> bytes:
    """Box plots of the complete pipeline by number of proposals."""
    known = [times for times in results.networks if (times.num_proposals >= 0).any()]
    figure, panels = subplots(max(1, len(known)), width_in=5.5)
    for axes, times, colour in zip(panels, known, COLOURS, strict=False):
        groups = {words: complete for words, complete in frames_by_proposals(times, EDGES) if len(complete)}
        box_plot(axes, list(groups.values()), [colour] * len(groups), alpha=0.6, whis=WHISKERS)
        axes.set_xticks(range(1, len(groups) + 1), list(groups), rotation=20)
        axes.set(xlabel="proposals", ylabel="complete pipeline, ms", title=times.name)
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color=PALE)
    return png(figure)
