"""`live`: from a camera, or what stands in for one, to commands in real time."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.beam import lamp_bus
from foreglow.cli.shared_run import boxes_notes, recording_sinks, source_notes, unused_lines, viewer_sinks
from foreglow.command_line import argument, folder, option, output_file, refuse_unused, with_options
from foreglow.options import (
    RECORD_HELP,
    BeamOptions,
    CaptureOptions,
    LimitOption,
    PipelineOptions,
    QualityOption,
    TopicOption,
    VehicleOptions,
    ViewOptions,
)
from foreglow.own_files import RECORDING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from foreglow.config import PipelineConfig
    from foreglow.datasets import VehicleData
    from foreglow.runtime.health import LiveSink
    from foreglow.runtime.live import BeamOutput, LiveEndedError, LiveSource, LiveSummary
    from foreglow.runtime.live.vehicle_bus import VehicleBus

SOURCE_HELP = (
    "A camera (camera:0, camera:/dev/video0 or gstreamer:PIPELINE), an address such as rtsp://..., a simulated drive "
    "in closed loop (simulate:curve or simulate:FILE.toml), or a source as for `run`, played at its own rate."
)


def _dated(pattern: Path | None) -> Path | None:
    """The file of a pattern such as `drive_%Y.mcap`; a recording of that time stays, and the new one gets a number.

    The clock of a computer without a battery begins anew with each start.
    """
    dated = None if pattern is None else Path(time.strftime(str(pattern)))
    if dated is None or dated == pattern:
        return dated
    names = (dated.with_stem(f"{dated.stem}_{number}") for number in itertools.count(2))
    return next(name for name in itertools.chain([dated], names) if not os.path.lexists(name))


@app.command()
@with_options
def live(
    source: Annotated[str, argument("SOURCE", SOURCE_HELP)],
    capture: CaptureOptions,
    pipeline: PipelineOptions,
    lamps: BeamOptions,
    vehicle: VehicleOptions,
    viewer: ViewOptions,
    can: Annotated[
        str | None, option("CHANNEL", "CAN bus of the headlamps: can0, or python-can's INTERFACE:CHANNEL.")
    ] = None,
    can_in: Annotated[
        str | None, option("CHANNEL", "With a camera: CAN bus with the motion of the car and the road.")
    ] = None,
    out: Annotated[Path | None, folder("Also write results, summary and faults to this folder.")] = None,
    record: Annotated[Path | None, output_file(RECORD_HELP, RECORDING, callback=_dated)] = None,
    topic: TopicOption = None,
    limit: LimitOption = None,
    speed: Annotated[
        float,
        option(
            "X",
            "Replay X times as fast, from 0.01 on; 0 is as fast as possible, without dropping a frame.",
            min=0.0,
            max=1000.0,
        ),
    ] = 1.0,
    camera_delay: Annotated[
        float, option("S", "Time from the exposure until the frame arrives.", min=0.0, max=1.0)
    ] = 0.0,
    give_up: Annotated[
        float | None, option("S", "End after S seconds without a frame (default: wait for ever).", min=0.1, max=1e6)
    ] = None,
    seed: Annotated[int, option("N", "Seed of a simulated drive.", min=0)] = 0,
    quality: QualityOption = "training",
) -> None:
    """Run on SOURCE in real time: tracks and beam commands, and low beam whenever something is wrong."""
    from foreglow.runtime.live import ClosedLoop, Paced
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_live, options_of
    from foreglow.wording import without_password

    given = {
        "--size": capture.size is not None,
        "--rate": capture.rate is not None,
        "--camera-delay": camera_delay != 0.0,
        "--can-in": can_in is not None,
        "--calibration": vehicle.calibration is not None,
        "--can-log": vehicle.can_log is not None,
        "--map": vehicle.road_map is not None,
        "--topic": topic is not None,
        "--speed": speed != 1.0,
        "--seed": seed != 0,
        "--quality": quality != "training",
    }
    known = options_of(source)
    refuse_unused(source, {name: is_given for name, is_given in given.items() if name not in known})
    configuration = lamps.commanding(pipeline.configuration())
    has_lamps = configuration.beam.headlamps is not None  # a simulated drive is lit by those that ship
    refuse_unused(source, {"--lamps": has_lamps and "--lamps" not in known})
    with contextlib.ExitStack() as closing:
        data: VehicleData | None = None
        bus: VehicleBus | None = None
        if can_in is None:
            data = vehicle.read()
        else:
            data, bus = _bus_data(vehicle, can_in, closing)
        options = CameraOptions(
            size_px=capture.size_px,
            rate_hz=capture.rate,
            delay_s=camera_delay,
            data=data,
            seed=seed,
            quality=quality,
        )
        opened = open_live(source, options, speed=speed or float("inf"), topic=topic, limit=limit)
        outputs: list[BeamOutput] = [opened] if isinstance(opened, ClosedLoop) else []
        if can is not None:
            outputs.append(lamp_bus(can, configuration))

        def make_sinks() -> Iterator[LiveSink]:
            yield from recording_sinks(record, without_password(source), configuration)
            yield from viewer_sinks(viewer, configuration, opened.lux if isinstance(opened, ClosedLoop) else None)

        summary, error = _run(opened, configuration, out, outputs, make_sinks(), limit, give_up)
    notes = source_notes(opened.source) if isinstance(opened, Paced) else []
    notes += [] if bus is None else bus.lines
    _finish(summary, out, error, [*notes, *unused_lines(vehicle, summary.run), *boxes_notes(configuration)])


def _bus_data(vehicle: VehicleOptions, channel: str, closing: contextlib.ExitStack) -> tuple[VehicleData, VehicleBus]:
    """What the car's bus and the calibration say about each frame, and the bus."""
    from foreglow.calibration import read_calibration
    from foreglow.datasets.vehicle_logs import VehicleFiles
    from foreglow.runtime.live.vehicle_bus import VehicleBus

    if any(path is not None for path in (vehicle.can_log, vehicle.road_map, vehicle.poses)):
        raise ValueError("--can-in: expected neither --can-log nor --map with it: motion and road come from the bus")
    vehicle.check()
    camera = None if vehicle.calibration is None else read_calibration(vehicle.calibration)
    bus = closing.enter_context(contextlib.closing(VehicleBus(channel, vehicle.dbc, vehicle.mapping)))
    names = str(vehicle.calibration), channel, ""
    return VehicleFiles(camera=camera, log=bus.log, names=names, is_live=True), bus


def _run(
    source: LiveSource,
    configuration: PipelineConfig,
    out: Path | None,
    outputs: Sequence[BeamOutput],
    made_sinks: Iterator[LiveSink],
    limit: int | None,
    give_up_s: float | None,
) -> tuple[LiveSummary, LiveEndedError | None]:
    """Runs the loop, which sends to the lamps in `outputs`, and shows its status on the screen.

    Until the loop has begun, an error discards the sinks, which are made one by one.

    Returns:
        What came of the run, and why it could not go on, if so.
    """
    from foreglow.display.live_status import LiveStatus
    from foreglow.pipeline import Pipeline
    from foreglow.runtime import OutputFolder
    from foreglow.runtime.live import LiveEndedError, LiveLoop
    from foreglow.runtime.live.kept_results import KeptResults
    from foreglow.runtime.live.notify import ServiceNotifier
    from foreglow.runtime.run import PATIENCE_S, InterruptFlag, discarding, open_each
    from foreglow.whole_files import entered

    with contextlib.nullcontext() if out is None else entered(lambda: OutputFolder(out)) as results:
        sinks: list[LiveSink] = []
        error = None
        with discarding(sinks):
            open_each(made_sinks, sinks)
            notifier = ServiceNotifier()
            kept = None if results is None else KeptResults(results)
            loop = LiveLoop(
                source,
                lambda: Pipeline(configuration),
                configuration,
                outputs=outputs,
                sinks=[LiveStatus(), *sinks, *([] if kept is None else [kept])],
                beat=notifier.beat,
                at_begin=sinks.clear,
                at_end=notifier.close,
                give_up_s=give_up_s,
            )
            try:
                summary = loop.run(limit)
            except LiveEndedError as ended:
                summary, error = ended.summary, ended
        with InterruptFlag(PATIENCE_S):
            notifier.stop()
            if results is not None and kept is not None:
                results.publish(configuration, kept.summary(summary, configuration))
    return summary, error


def _finish(summary: LiveSummary, out: Path | None, error: LiveEndedError | None, notes: Sequence[str]) -> None:
    """Prints what came of the run, and what is to be said of its source and of the car's data.

    Exits with 130 if it was interrupted, with 2 if it or a sink failed.
    """
    from foreglow.display.live_status import live_lines

    lines = [*live_lines(summary), *notes]
    if error is None and summary.run.is_interrupted:
        lines.append("interrupted")
    typer.echo("\n".join([*lines, *([] if out is None else [f"look in {out}"])]))
    if error is not None:
        cause = error.__cause__
        raise error if cause is None or isinstance(cause, (ValueError, OSError)) else cause
    if summary.sink_errors:
        raise OSError(f"not recorded: {'; '.join(summary.sink_errors)}")
    if summary.run.is_interrupted:
        raise typer.Exit(130)
