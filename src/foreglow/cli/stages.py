"""`stages`: every stage of the detector on one frame, as a picture."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import open_frames
from foreglow.command_line import option, output_file, with_options
from foreglow.options import PipelineOptions, SourceArgument, SourceOptions, VehicleOptions
from foreglow.own_files import STAGE_PICTURE, STAGES, named_png


@app.command()
@with_options
def stages(
    source: SourceArgument,
    out: Annotated[Path, output_file("PNG file to write.", STAGE_PICTURE)],
    pipeline: PipelineOptions,
    reading: SourceOptions,
    vehicle: VehicleOptions,
    frame: Annotated[int, option("N", "Which frame, counted from 0; those before it are run, too.", min=0)] = 0,
) -> None:
    """Draw what every stage of the detector makes of one frame, and where the road ahead is in it."""
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.reports.stage_picture import stage_picture
    from foreglow.pipeline import Pipeline
    from foreglow.whole_files import write_atomic

    require_matplotlib()
    if out.suffix.lower() != ".png":
        raise ValueError(f"{out}: expected a picture that ends in .png, got {out.suffix!r}")
    if reading.limit is not None:
        raise ValueError(f"--limit: expected none: the frames until --frame {frame} are read")
    stepper = Pipeline(pipeline.configuration().detector_only)
    latest, num_frames = None, 0
    first_frames = dataclasses.replace(reading, limit=frame + 1)
    for taken in itertools.islice(open_frames(source, first_frames, vehicle), frame + 1):
        latest, num_frames = (taken, stepper.step(taken)), num_frames + 1
    if latest is None or num_frames <= frame:
        raise ValueError(f"--frame: expected one of the {num_frames} frames of {source}, counted from 0, got {frame}")
    write_atomic(out, named_png(stage_picture(*latest, stepper.config), STAGES))
    typer.echo(f"frame {latest[0].frame}: {out}")
