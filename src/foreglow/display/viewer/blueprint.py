"""How the viewer opens: what is shown where."""

from __future__ import annotations

import math

import rerun as rr
import rerun.blueprint as rrb

from foreglow.display.overlay import CAPTION_GROUND_BGR
from foreglow.numbers import checked_number

GROUND_RGB = CAPTION_GROUND_BGR[::-1]

TIMELINE = "time"

EYE_M = (-42.0, 0.0, 62.0)
"""From where the bird's-eye view looks at first, in the vehicle's frame."""

LOOKS_AT_M = (46.0, 0.0, 0.0)

PLOTS = {
    "ranges": "range of tracks, m",
    "confidences": "confidence of tracks",
    "scores": "scores of proposals, the 16 highest",
    "lux": "light at other drivers' eyes, lx",
    "ms": "stage times, ms",
}
"""What is plotted over time: names of entities, and titles."""


def blueprint(*, has_lux: bool, window_s: float | None = None) -> rrb.Blueprint:
    """The arrangement.

    Args:
        has_lux: Whether light at other drivers' eyes is known.
        window_s: The plots show so much of the latest time; None, for recordings, shows all of it.

    Raises:
        ValueError: If the time is no positive number.
    """
    ranges = None
    if window_s is not None:
        window_s = checked_number("window_s", window_s)
        if not 0 < window_s < math.inf:
            raise ValueError(f"window_s: expected a positive number of seconds or None, got {window_s}")
        start, end = rr.TimeRangeBoundary.cursor_relative(seconds=-window_s), rr.TimeRangeBoundary.cursor_relative()
        ranges = [rrb.VisibleTimeRange(TIMELINE, start=start, end=end)]
    plots = [
        rrb.TimeSeriesView(
            origin=f"plots/{name}",
            name=title,
            time_ranges=ranges,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=name in ("lux", "ms")),
        )
        for name, title in PLOTS.items()
        if has_lux or name != "lux"
    ]
    lamps = [rrb.Spatial2DView(origin=f"lamps/{side}", name=f"{side} lamp", background=GROUND_RGB) for side in SIDES]
    eye = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=EYE_M, look_target=LOOKS_AT_M, eye_up=(0.0, 0.0, 1.0))
    camera = rrb.Vertical(
        rrb.Spatial2DView(origin="camera", name="camera", background=GROUND_RGB),
        rrb.Horizontal(*lamps),
        rrb.StateTimelineView(origin="states", name="beam and faults"),
        rrb.TextLogView(origin="log", name="log"),
        row_shares=[5.5, 1.1, 1.3, 1.2],
    )
    birds_eye = rrb.Spatial3DView(
        origin="map",
        name="bird's-eye view",
        background=GROUND_RGB,
        eye_controls=eye,
        line_grid=rrb.LineGrid3D(visible=False),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            camera,
            birds_eye,
            rrb.Vertical(*plots, row_shares=[1.6 if plot.origin == "plots/ms" else 1.0 for plot in plots]),
            column_shares=[5.0, 3.0, 3.0],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
        auto_layout=False,
    )


SIDES = ("left", "right")
