"""What commands share that show a run while it goes on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import file

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.display.viewer import RerunSink
    from foreglow.display.viewer.sink import LuxOf

WINDOW_S = 20.0
"""The plots of a window show so much of the latest time."""

ViewOption = Annotated[
    bool, typer.Option("--view", help="Show it in a window of Rerun's viewer while it goes on (foreglow[view]).")
]
SaveOption = Annotated[Path | None, file(help="Keep what --view shows as a recording, FILE.rrd, for Rerun's viewer.")]


def viewer_sinks(
    view: bool, save: Path | None, configuration: PipelineConfig, lux_of: LuxOf | None = None
) -> list[RerunSink]:
    """The sink for the viewer, a live one; none where nothing was asked for.

    Args:
        view: Whether to open a window.
        save: The recording to write.
        configuration: Of the run, for the layout of its lamps.
        lux_of: The light at other drivers' eyes, where it is known.

    Raises:
        ModuleNotFoundError: If Rerun is not installed (extra `view`).
        ValueError: If there is no display for a window.
        OSError: If the recording cannot be written.
    """
    if not view and save is None:
        return []
    from foreglow.display.viewer import RerunSink, RrdFile, ViewerWindow
    from foreglow.display.viewer.blueprint import blueprint
    from foreglow.photometry import read_headlamps

    has_lux = lux_of is not None
    num_columns = read_headlamps(configuration.beam.headlamps).num_columns
    outputs: list[RrdFile | ViewerWindow] = []
    if save is not None:
        outputs.append(RrdFile(save, blueprint(has_lux=has_lux)))
    if view:
        outputs.append(ViewerWindow(blueprint(has_lux=has_lux, window_s=WINDOW_S), _note))
    return [RerunSink(outputs, num_columns=num_columns, lux_of=lux_of)]


def lux_as_driven(frames: FrameSource) -> LuxOf | None:
    """The light at other drivers' eyes as the simulated drive was recorded; None for other sources."""
    from foreglow.datasets import PVDN, Equipped
    from foreglow.datasets.simulated.lux import RecordedLux

    if isinstance(frames, Equipped):
        frames = frames.source
    if not isinstance(frames, PVDN) or not (frames.root / "simulation" / "info.json").is_file():
        return None
    return RecordedLux(frames.root)


def _note(line: str) -> None:
    typer.echo(f"foreglow: {line}", err=True)
