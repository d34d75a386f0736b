"""`beam`: from frames or tracks to what the headlamps shall shine."""

from __future__ import annotations

import importlib
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
    OnErrorOption,
    PoseErrorOption,
    PosesOption,
    TimeOffsetOption,
    TopicOption,
    app,
    argument,
    beam_sink,
    configuration_of,
    equipped,
    file,
    finish,
    folder,
    opened,
    run_frames,
)
from foreglow.cli.viewing import SaveOption, ViewOption, lux_as_driven, viewer_sinks

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.photometry import Headlamps
    from foreglow.runtime import OutputFolder, ResultSink, Stepper
    from foreglow.runtime.can_output import CanBus
    from foreglow.runtime.replay import Replay


@app.command()
def beam(
    source: Annotated[
        Path, argument(metavar="RUN|SOURCE", help="A folder of `run` with its tracks, or what it takes.")
    ],
    out: Annotated[Path, folder(help="Folder for the results; made if need be.")],
    lamps: Annotated[Path | None, file(help="TOML of the headlamps (default: those that ship).")] = None,
    policy: Annotated[
        str | None, typer.Option(metavar="foreglow|paper|low|high", help="Who decides (default: foreglow).")
    ] = None,
    can: Annotated[
        str | None, typer.Option(metavar="asc|blf|log", help="Also write a CAN log of this kind; log is candump's.")
    ] = None,
    compact: Annotated[bool, typer.Option("--compact", help="In it only the gaps, for cars that take these.")] = False,
    video: Annotated[
        bool, typer.Option("--video", help="Also write pictures of the beam: MP4, or PNG of one image.")
    ] = False,
    view: ViewOption = False,
    save: SaveOption = None,
    limit: LimitOption = None,
    preset: Annotated[
        str | None, typer.Option(metavar="foreglow|paper|baseline", help="Parameters to start from, with SOURCE.")
    ] = None,
    model: ModelOption = None,
    config: ConfigOption = None,
    calibration: CalibrationOption = None,
    can_log: CanLogOption = None,
    dbc: DbcOption = None,
    mapping: MappingOption = None,
    road_map: MapOption = None,
    poses: PosesOption = None,
    time_offset: TimeOffsetOption = 0.0,
    pose_error: PoseErrorOption = 5.0,
    topic: TopicOption = None,
    on_error: OnErrorOption = "stop",
) -> None:
    """Say for every frame what the headlamps shall shine: levels of all LEDs, dark gaps, and why there is low beam."""
    from foreglow.photometry import read_headlamps
    from foreglow.pipeline import Pipeline

    is_run = (source / "frames.jsonl").is_file()
    if is_run:
        base = _configuration_of_run(source, out, config, is_other=preset is not None or model is not None)
    else:
        base = configuration_of(preset or DEFAULT_PRESET, config, model)
    configuration = with_beam(base, policy, lamps)
    headlamps = read_headlamps(configuration.beam.headlamps)
    _check_can(can, headlamps, is_compact=compact)
    pipeline: Stepper
    if is_run:
        pipeline, images, num_frames = _replay(source, configuration)
        limit, on_error = min(num_frames, limit or num_frames), "skip"
    else:
        pipeline, images = Pipeline(configuration), source
    files = (calibration, can_log, dbc, mapping, road_map, poses)
    frames = equipped(opened(images, out, on_error, topic), files, time_offset, pose_error)
    _check_equipment(frames, images, configuration, has_log=can_log is not None)

    def make_sinks(results: OutputFolder) -> list[ResultSink]:
        sinks: list[ResultSink] = [*viewer_sinks(view, save, configuration, lux_as_driven(frames))]
        if video:
            sinks.append(beam_sink(frames, results, headlamps))
        if can is not None:
            sinks.append(_can_sink(results, can, configuration.beam.restore_s, is_compact=compact))
        return sinks

    finish(run_frames(frames, str(images), out, pipeline, make_sinks=make_sinks, limit=limit), out)


def _configuration_of_run(run: Path, out: Path, file: Path | None, *, is_other: bool) -> PipelineConfig:
    """The configuration of an earlier run, overridden by the file's fields."""
    from foreglow.config import read_config

    if is_other:
        raise ValueError(f"{run}: expected neither --preset nor --model with a run: its tracks are taken as they are")
    if run.resolve() == out.resolve():
        raise ValueError(f"{out}: expected another folder for the results than that of the run")
    configuration = read_config(run / "config.toml")
    if configuration.classifier.model is None or configuration.tracker.method == "none":
        raise ValueError(f"{run}: expected the folder of a run with tracks: it had no model or no tracker")
    return configuration if file is None else read_config(file, configuration)


def with_beam(configuration: PipelineConfig, policy: str | None, lamps: Path | None) -> PipelineConfig:
    """`configuration` with the policy and the lamps that were asked for."""
    from foreglow.beam import policy_class

    if policy is not None:
        policy_class(policy, "--policy")
    wanted = {"policy": policy, "headlamps": lamps}
    return configuration.commanding(**{name: value for name, value in wanted.items() if value is not None})


def lamp_bus(channel: str, configuration: PipelineConfig) -> CanBus:
    """The bus to the lamps, which have to have as many LEDs as its messages."""
    from foreglow.beam.messages import NUM_LEDS
    from foreglow.photometry import read_headlamps
    from foreglow.runtime.can_output import CanBus

    headlamps = read_headlamps(configuration.beam.headlamps)
    if headlamps.num_leds != NUM_LEDS:
        raise ValueError(f"--can: expected lamps of {NUM_LEDS} LEDs, {headlamps.name!r} have {headlamps.num_leds} each")
    return CanBus(channel, ramp_s=configuration.beam.restore_s)


def _replay(run: Path, configuration: PipelineConfig) -> tuple[Replay, Path, int]:
    """The results of an earlier run, where its frames are, and how many it had."""
    from foreglow.runs.frames_file import read_results
    from foreglow.runs.recorded_run import source_of_run
    from foreglow.runtime.replay import Replay

    results = read_results(run / "frames.jsonl", configuration.classifier.score_threshold)
    return Replay(configuration, results, str(run)), source_of_run(run), len(results)


def _check_can(kind: str | None, headlamps: Headlamps, *, is_compact: bool) -> None:
    """Sees to it that the log can be written, before any work is done."""
    if kind is None:
        if is_compact:
            raise ValueError("--compact: expected --can beside it: it is about the CAN log")
        return
    from foreglow.beam.messages import NUM_LEDS
    from foreglow.runtime.can_output import LOG_SUFFIXES

    importlib.import_module("can")
    if f".{kind}" not in LOG_SUFFIXES:
        raise ValueError(f"--can: expected one of {', '.join(one[1:] for one in LOG_SUFFIXES)}, got {kind!r}")
    if headlamps.num_leds != NUM_LEDS and not is_compact:
        raise ValueError(
            f"--can: expected lamps of {NUM_LEDS} LEDs, {headlamps.name!r} have {headlamps.num_leds} each; "
            "--compact writes their gaps alone"
        )


def _can_sink(results: OutputFolder, kind: str, restore_s: float, *, is_compact: bool) -> ResultSink:
    """The sink for the CAN log; cars that take gaps alone brighten as slowly as our LEDs, as far as they can."""
    from foreglow.beam.messages import RAMPS_S
    from foreglow.runtime.can_output import CanLogSink

    path, ramp_s = results.partial(f"beam.{kind}"), min(restore_s, RAMPS_S[-1])
    return CanLogSink(path, suffix=f".{kind}", ramp_s=ramp_s, has_levels=not is_compact)


def _check_equipment(frames: FrameSource, source: Path, configuration: PipelineConfig, *, has_log: bool) -> None:
    """Sees to it that the first frame has what no high beam is without; the guard looks at each one."""
    first = next(iter(frames), None)
    if first is None:
        return
    if first.camera is None:
        raise ValueError(f"{source}: the beam needs the camera's calibration: expected --calibration FILE")
    if first.motion is None and not has_log and configuration.guard.needs_speed:
        raise ValueError(
            f"{source}: the beam needs our speed: expected --can-log FILE, or needs_speed = false under [guard] in "
            "--config FILE"
        )
