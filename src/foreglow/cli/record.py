"""`record`: a run as an MCAP file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from foreglow.cli.app import app
from foreglow.cli.offline import finish
from foreglow.cli.sinks import progress_sink, recording_sinks
from foreglow.options import PipelineOptions, SourceArgument, SourceOptions, VehicleOptions, output_file, with_options


@app.command()
@with_options
def record(
    source: SourceArgument,
    out: Annotated[Path, output_file("The recording: FILE.mcap.")],
    pipeline: PipelineOptions,
    reading: SourceOptions,
    vehicle: VehicleOptions,
) -> None:
    """Record SOURCE and what is found in it as MCAP, for replay and for Foxglove."""
    from foreglow.pipeline import Pipeline
    from foreglow.runtime import run

    stepper = Pipeline(pipeline.configuration())
    frames = vehicle.equip(reading.open(source))
    sinks = [progress_sink(frames, reading.limit), *recording_sinks(out, source, stepper.config)]
    finish(run(frames, stepper, None, sinks=sinks, limit=reading.limit, source_name=str(source)), out)
