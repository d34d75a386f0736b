"""The figures of the report on a simulated data set."""

from __future__ import annotations

import itertools

import numpy as np

from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, png, subplots
from foreglow.lab.studies.simulator.metrics import LAMP_RADII_PX, PERCENTILES
from foreglow.lab.studies.simulator.run import SimulatorResults

BIN_S = 0.25
PROVIDENT, PRODUCTION, REAL = AMBER, BLUE, GREY


def leads_figure(results: SimulatorResults) -> bytes:
    """Histograms of both leads."""
    figure, (axes,) = subplots(1)
    times = [*results.leads_s, *results.production_delays_s, 0.0]
    edges = np.arange(np.floor(min(times) / BIN_S) * BIN_S, max(times) + 2 * BIN_S, BIN_S)
    axes.hist(results.leads_s, edges, color=PROVIDENT, alpha=0.75, label="first lamp")
    axes.hist(results.production_delays_s, edges, color=PRODUCTION, alpha=0.55, label="modelled production system")
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set(xlabel="seconds after the first indirect light", ylabel="drives")
    axes.legend(frameon=False)
    return png(figure)


def pixels_figure(results: SimulatorResults) -> bytes:
    """Grey levels over their share of the image, and over the distance from a lamp."""
    figure, axes = subplots(2)
    radii = [(low + high) / 2 for low, high in itertools.pairwise(LAMP_RADII_PX)]
    axes[0].plot(PERCENTILES, results.pixels.percentiles_grey, color=PROVIDENT, marker="o", label="simulated")
    axes[1].plot(radii, results.pixels.lamp_grey, color=PROVIDENT, marker="o", label="simulated")
    if results.pixel_rows is not None:
        real = {row.name: row.real for row in results.pixel_rows}
        axes[0].plot(
            PERCENTILES, [real[f"grey level, percentile {share:g}"] for share in PERCENTILES], color=REAL, label="real"
        )
        rings = [value for name, value in real.items() if name.startswith("lamp, ")]
        axes[1].plot(radii, rings, color=REAL, label="real")
    axes[0].set(xlabel="percentile of the pixels", ylabel="grey level")
    axes[1].set(xlabel="pixels from a lamp", ylabel="grey level", xscale="log")
    axes[0].legend(frameon=False)
    return png(figure)
