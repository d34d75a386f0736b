"""`run`: frames in, results out; `record`: the same as an MCAP file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from foreglow.cli.app import app
from foreglow.cli.shared_calibration import calibrated
from foreglow.cli.shared_run import (
    bits_notes,
    expectation,
    finish,
    folder_beside,
    look_sink,
    open_frames,
    picture_sink,
    progress_sink,
    recorded_lux,
    recording_sinks,
    run_frames,
    run_in_parallel,
    source_notes,
    unused_lines,
    viewer_sinks,
)
from foreglow.command_line import flag, folder, output_file, with_options
from foreglow.options import (
    AUTO,
    LensOptions,
    PipelineOptions,
    RecordOption,
    SourceArgument,
    SourceOptions,
    VehicleOptions,
    ViewOptions,
    WorkerOptions,
)
from foreglow.outputs import check_unnamed_outputs
from foreglow.own_files import RECORDING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from foreglow.runtime import OutputFolder, ResultSink


@app.command()
@with_options
def run(
    source: SourceArgument,
    pipeline: PipelineOptions,
    reading: SourceOptions,
    vehicle: VehicleOptions,
    viewer: ViewOptions,
    lens: LensOptions,
    work: WorkerOptions,
    out: Annotated[
        Path | None, folder("Folder for the results (default: beside SOURCE and named after it, such as my_foreglow).")
    ] = None,
    video: Annotated[bool, flag("--video", "Also write annotated pictures: MP4, or PNG of a single image.")] = False,
    record: RecordOption = None,
) -> None:
    """Find the light artifacts in SOURCE, track them, and write the results to a folder.

    With `--calibration auto`, SOURCE is read twice: first to calibrate its camera, which needs --focal or --fov.
    """
    from foreglow.pipeline import Pipeline
    from foreglow.runtime import Opening

    workers, configuration = work.workers(), pipeline.configuration()
    white_level = configuration.guard.white_level
    if out is None:
        out = folder_beside(source)
        files = {"--record": record, "--save": viewer.save}
        check_unnamed_outputs({name: path for name, path in files.items() if path is not None}, {"the folder": out})
    if vehicle.calibration == AUTO:
        vehicle = calibrated(source, out, reading, vehicle, lens)
    elif lens != LensOptions():
        raise ValueError("--focal, --fov, --mount-height: expected with --calibration auto")
    opening = Opening(open_frames, (source, reading, vehicle))
    if work.is_parallel:
        if video or viewer.view or any(value is not None for value in (reading.limit, record, viewer.save)):
            raise ValueError(
                "run: expected --video, --record, --view, --save and --limit without --jobs and --cluster: they go "
                "frame by frame"
            )
        frames = opening()
        looks = look_sink(frames, None, configuration)
        summary = run_in_parallel(opening, str(source), out, configuration, workers, looks)
        notes = [*source_notes(frames), *unused_lines(vehicle, summary), *bits_notes(looks.brightest, white_level)]
        finish(summary, out, *notes, expectation(looks.profile, configuration))
        return
    frames = opening()
    looks = look_sink(frames, reading.limit, configuration)

    def make_sinks(results: OutputFolder) -> Iterator[ResultSink]:
        yield looks
        yield from recording_sinks(record, source, configuration)
        yield from viewer_sinks(viewer, configuration, recorded_lux(frames))
        if video:
            yield picture_sink(frames, results, "overlay")

    stepper = Pipeline(configuration)
    summary = run_frames(frames, str(source), out, stepper, make_sinks=make_sinks, limit=reading.limit)
    notes = [*source_notes(frames), *unused_lines(vehicle, summary), *bits_notes(looks.brightest, white_level)]
    finish(summary, out, *notes, expectation(looks.profile, configuration))


@app.command()
@with_options
def record(
    source: SourceArgument,
    out: Annotated[Path, output_file("The recording: FILE.mcap.", RECORDING)],
    pipeline: PipelineOptions,
    reading: SourceOptions,
    vehicle: VehicleOptions,
    ros2: Annotated[bool, flag("--ros2", "Record ROS 2's messages, which `ros2 bag play` replays.")] = False,
) -> None:
    """Record SOURCE and what is found in it as MCAP, for replay and for Foxglove."""
    from foreglow import runtime
    from foreglow.pipeline import Pipeline

    stepper = Pipeline(pipeline.configuration())
    frames = vehicle.equip(reading.open(source), reading.limit)
    looks, white_level = look_sink(frames, reading.limit, stepper.config), stepper.config.guard.white_level

    def make_sinks() -> Iterator[ResultSink]:
        yield progress_sink(frames, reading.limit)
        yield looks
        if ros2:
            from foreglow.runtime.ros2.bag import BagRecorder

            yield BagRecorder(out, config=stepper.config, source_name=str(source))
        else:
            yield from recording_sinks(out, source, stepper.config)

    summary = runtime.run(frames, stepper, None, sinks=make_sinks(), limit=reading.limit, source_name=str(source))
    notes = [*source_notes(frames), *unused_lines(vehicle, summary), *bits_notes(looks.brightest, white_level)]
    finish(summary, out, *notes)
