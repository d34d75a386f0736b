"""`live`: from a camera, or what stands in for one, to commands in real time."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import (
    DEFAULT_PRESET,
    CalibrationOption,
    CanLogOption,
    ConfigOption,
    DbcOption,
    LimitOption,
    MapOption,
    MappingOption,
    ModelOption,
    PoseErrorOption,
    PosesOption,
    PresetOption,
    RecordOption,
    TimeOffsetOption,
    TopicOption,
    app,
    configuration_of,
    file,
    folder,
    recording_sinks,
    size_of,
)
from foreglow.cli.beaming import lamp_bus, with_beam
from foreglow.cli.viewing import SaveOption, ViewOption, viewer_sinks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from foreglow.config import PipelineConfig
    from foreglow.datasets import VehicleData
    from foreglow.runtime.health import LiveSink
    from foreglow.runtime.live import BeamOutput, LiveSource, LiveSummary

SOURCE_HELP = (
    "camera:0, camera:/dev/video0, gstreamer:PIPELINE; an address such as rtsp://...; simulate:curve or "
    "simulate:FILE.toml in closed loop; or what `run` takes, at its own rate."
)


@app.command()
def live(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help=SOURCE_HELP)],
    can: Annotated[
        str | None,
        typer.Option(metavar="CHANNEL", help="CAN bus for the lamps: can0, or python-can's INTERFACE:CHANNEL."),
    ] = None,
    out: Annotated[Path | None, folder(help="Also write results, summary and faults to this folder.")] = None,
    record: RecordOption = None,
    view: ViewOption = False,
    save: SaveOption = None,
    limit: LimitOption = None,
    speed: Annotated[
        float, typer.Option(metavar="X", help="Replay so many times as fast; 0 as fast as it goes, dropping nothing.")
    ] = 1.0,
    topic: TopicOption = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size to ask a camera for.")] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Rate to ask a camera for, and to expect.")] = None,
    camera_delay: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="S", help="From a camera's exposure to a frame's arrival.")
    ] = 0.0,
    policy: Annotated[
        str | None, typer.Option(metavar="foreglow|paper|low|high", help="Who decides about the beam.")
    ] = None,
    lamps: Annotated[Path | None, file(help="TOML of the headlamps (default: those that ship).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of a simulated drive.")] = 0,
    quality: Annotated[str, typer.Option(metavar="fast|training|fine", help="How finely it is rendered.")] = "training",
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: ConfigOption = None,
    calibration: CalibrationOption = None,
    can_in: Annotated[
        str | None, typer.Option(metavar="CHANNEL", help="CAN bus that tells our motion and the road, with a camera.")
    ] = None,
    can_log: CanLogOption = None,
    dbc: DbcOption = None,
    mapping: MappingOption = None,
    road_map: MapOption = None,
    poses: PosesOption = None,
    time_offset: TimeOffsetOption = 0.0,
    pose_error: PoseErrorOption = 5.0,
) -> None:
    """Run on SOURCE as it happens: tracks and beam commands in real time, low beam whenever something is wrong."""
    from foreglow.runtime.live import ClosedLoop
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_live

    configuration = with_beam(configuration_of(preset, config, model), policy, lamps)
    files = (calibration, can_log, dbc, mapping, road_map, poses)
    with contextlib.ExitStack() as closing:
        data = _vehicle_data(files, can_in, time_offset, pose_error, closing)
        size_px = None if size is None else size_of(size)
        options = CameraOptions(
            size_px=size_px, rate_hz=rate, delay_s=camera_delay, data=data, seed=seed, quality=quality
        )
        opened = open_live(source, options, speed=speed or float("inf"), topic=topic)
        outputs: list[BeamOutput] = [opened] if isinstance(opened, ClosedLoop) else []
        if can is not None:
            outputs.append(lamp_bus(can, configuration))
        named = None if record is None else Path(time.strftime(str(record)))
        sinks = recording_sinks(named, Path(source), configuration)
        lux_of = opened.lux if isinstance(opened, ClosedLoop) else None
        sinks += viewer_sinks(view, save, configuration, lux_of)
        summary = _run(opened, configuration, out, outputs, sinks, limit)
    _finish(summary, out)


def _vehicle_data(
    files: Sequence[Path | None],
    can_in: str | None,
    time_offset_s: float,
    pose_error_m: float,
    closing: contextlib.ExitStack,
) -> VehicleData | None:
    """What is known of each frame: by the files, in the order of `open_vehicle_data`, and by the car's bus."""
    from foreglow.calibration import read_calibration
    from foreglow.datasets.vehicle_logs import VehicleFiles, open_vehicle_data
    from foreglow.runtime.live.vehicle_bus import VehicleBus

    calibration, can_log, dbc, mapping, road_map, poses = files
    if can_in is None:
        is_any = any(one is not None for one in files)
        return open_vehicle_data(*files, time_offset_s=time_offset_s, pose_error_m=pose_error_m) if is_any else None
    if any(one is not None for one in (can_log, road_map, poses)):
        raise ValueError("--can-in: expected neither --can-log nor --map with it: the bus tells motion and road")
    camera = None if calibration is None else read_calibration(calibration)
    bus = closing.enter_context(contextlib.closing(VehicleBus(can_in, dbc, mapping)))
    return VehicleFiles(camera=camera, log=bus.log, names=(str(calibration), can_in, ""))


def _run(
    source: LiveSource,
    configuration: PipelineConfig,
    out: Path | None,
    outputs: Sequence[BeamOutput],
    sinks: Sequence[LiveSink],
    limit: int | None,
) -> LiveSummary:
    """Runs the loop, which sends to the lamps in `outputs`, and shows its status on the screen."""
    from foreglow.display.live_status import LiveStatus
    from foreglow.pipeline import Pipeline
    from foreglow.runtime import OutputFolder
    from foreglow.runtime.health import ResultsOnly
    from foreglow.runtime.live import LiveLoop
    from foreglow.runtime.live.notify import ServiceNotifier

    all_sinks: list[LiveSink] = [LiveStatus(), *sinks]
    notifier = ServiceNotifier()
    with contextlib.nullcontext() if out is None else OutputFolder(out) as results:
        if results is not None:
            all_sinks += [ResultsOnly(sink) for sink in results.line_sinks()]
        loop = LiveLoop(
            source, lambda: Pipeline(configuration), configuration, outputs=outputs, sinks=all_sinks, beat=notifier.beat
        )
        summary = loop.run(limit)
        notifier.stop()
        if results is not None:
            results.publish(configuration, summary)
    return summary


def _finish(summary: LiveSummary, out: Path | None) -> None:
    """Says what came of it; exits with 130 where it was interrupted, and with 2 where something was not recorded."""
    from foreglow.display.live_status import live_lines

    typer.echo("\n".join([*live_lines(summary), *([] if out is None else [f"look in {out}"])]))
    if summary.sink_errors:
        raise typer.Exit(2)
    if not summary.run.is_complete:
        raise typer.Exit(130)
