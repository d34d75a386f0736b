"""`beam`: from frames or tracks to the light of the headlamps."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import (
    beam_sink,
    finish,
    open_frames,
    recorded_lux,
    run_frames,
    say_lack,
    source_notes,
    unused_lines,
    viewer_sinks,
)
from foreglow.command_line import argument, flag, option, with_options
from foreglow.options import BeamOptions, OutOption, PipelineOptions, SourceOptions, VehicleOptions, ViewOptions

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.geometry import Camera
    from foreglow.photometry import Headlamps
    from foreglow.runtime import OutputFolder, ResultSink, RunSummary, Stepper
    from foreglow.runtime.can_output import CanBus, CanLogSink
    from foreglow.runtime.run import Replay


@app.command()
@with_options
def beam(
    source: Annotated[
        Path, argument("RUN|SOURCE", "Folder of a `run`, whose tracks are used, or a source as for `run`.")
    ],
    out: OutOption,
    lamps: BeamOptions,
    pipeline: PipelineOptions,
    reading: SourceOptions,
    vehicle: VehicleOptions,
    viewer: ViewOptions,
    can: Annotated[str | None, option("asc|blf|log", "Also write a CAN log of this format; log is candump's.")] = None,
    compact: Annotated[
        bool, flag("--compact", "Write only the gaps to the CAN log, for cars that accept these.")
    ] = False,
    video: Annotated[bool, flag("--video", "Also write pictures of the beam: MP4, or PNG of a single image.")] = False,
) -> None:
    """Compute the beam for each frame: the level of each LED, dark gaps, and reasons for low beam."""
    from foreglow.photometry import read_headlamps
    from foreglow.pipeline import Pipeline
    from foreglow.runs.summary_file import read_summary

    is_run = (source / "frames.jsonl").is_file()
    if is_run:
        configuration = lamps.commanding(_configuration_of_run(source, pipeline))
        _check_policy(source, configuration.beam.policy, lamps, pipeline)
    else:
        configuration = lamps.commanding(pipeline.configuration())
    headlamps = read_headlamps(configuration.beam.headlamps)
    _check_can(can, configuration, headlamps, is_compact=compact)
    stepper: Stepper
    origin: RunSummary | None = None
    among: Collection[int] | None = None
    if is_run:
        if reading.on_error != "stop":
            raise ValueError(f"--on-error: expected without a run: the frames that {source} has are taken, as they are")
        stepper, images = _replay(source, configuration)
        origin = read_summary(source / "summary.json")
        among = None if origin.is_complete else stepper.known
        limit = min(len(stepper.known), reading.limit or len(stepper.known))
        if None not in (reading.topic, origin.topic) and reading.topic != origin.topic:
            raise ValueError(f"--topic: expected none, or {origin.topic} as in {source}, got {reading.topic}")
        skips = origin.on_error == "skip" or (origin.on_error is None and origin.num_skipped > 0)
        on_error = "skip" if skips else "mark"
        reading = dataclasses.replace(reading, limit=limit, on_error=on_error, topic=origin.topic or reading.topic)
        say_lack(source)
    else:
        stepper, images = Pipeline(configuration), source
    frames = open_frames(images, reading, vehicle)
    camera = _checked_camera(frames, images, configuration, has_log=vehicle.can_log is not None)
    logs: list[CanLogSink] = []
    if origin is not None and camera is not None:
        _say_other_calibration(source, origin, camera)

    def make_sinks(results: OutputFolder) -> list[ResultSink]:
        sinks: list[ResultSink] = [*viewer_sinks(viewer, configuration, recorded_lux(frames))]
        if video:
            sinks.append(beam_sink(frames, results, headlamps))
        if can is not None:
            logs.append(_can_sink(results, can, _ramp_s(configuration), is_compact=compact))
            sinks += logs
        return sinks

    summary = run_frames(
        frames,
        str(images),
        out,
        stepper,
        make_sinks=make_sinks,
        limit=reading.limit,
        origin=origin,
        among=among,
    )
    darker = _darker_lines(logs) if compact else ()
    finish(summary, out, *source_notes(frames), *unused_lines(vehicle, summary), *darker)


def _configuration_of_run(run: Path, options: PipelineOptions) -> PipelineConfig:
    """The configuration of an earlier run, overridden by the fields of the file."""
    from foreglow.config import read_config

    if options.preset is not None or options.model is not None:
        raise ValueError(f"{run}: expected neither --preset nor --model with a run: its tracks are taken as they are")
    configuration = read_config(run / "config.toml")
    if configuration.classifier.model is None or configuration.tracker.method == "none":
        raise ValueError(f"{run}: expected the folder of a run with tracks: it had no model or no tracker")
    if options.config is None:
        return configuration
    changed = read_config(options.config, configuration)
    words = f"expected that of {run}, or none: its tracks are taken as they are"
    for section in ("proposals", "classifier", "distance", "tracker", "standing"):
        if getattr(changed, section) != getattr(configuration, section):
            raise ValueError(f"{options.config}: {section}: {words}")
    if changed.guard.white_level != configuration.guard.white_level:  # all stages see the images by it
        raise ValueError(f"{options.config}: guard.white_level: {words}")
    return changed


def _check_policy(run: Path, policy: str, lamps: BeamOptions, options: PipelineOptions) -> None:
    """ValueError for a policy that only the run names, which may be somebody else's, and whose code would run."""
    from foreglow.config import read_config

    own = {lamps.policy} if options.config is None else {lamps.policy, read_config(options.config).beam.policy}
    if ":" in policy and policy not in own:
        raise ValueError(
            f"{run / 'config.toml'}: beam.policy: expected one of Foreglow's, as results choose no code that runs, "
            f"got {policy!r}; if you trust it: --policy {policy}"
        )


def lamp_bus(channel: str, configuration: PipelineConfig) -> CanBus:
    """The bus to the headlamps, which need as many LEDs as its messages have."""
    from foreglow.photometry import NUM_LEDS, read_headlamps
    from foreglow.runtime.can_output import CanBus

    headlamps = read_headlamps(configuration.beam.headlamps)
    if headlamps.num_leds != NUM_LEDS:
        raise ValueError(f"--can: expected lamps of {NUM_LEDS} LEDs, {headlamps.name!r} have {headlamps.num_leds} each")
    try:
        return CanBus(channel, ramp_s=_ramp_s(configuration))
    except (OSError, ValueError) as error:
        raise type(error)(f"--can {error}") from error


def _ramp_s(configuration: PipelineConfig) -> float:
    """In cars that accept gaps alone, light returns as slowly as in our LEDs, if their lamps can."""
    from foreglow.beam.messages import RAMPS_S

    return min(max(configuration.beam.restore_s, configuration.guard.brightening_s), RAMPS_S[-1])


def _replay(run: Path, configuration: PipelineConfig) -> tuple[Replay, Path]:
    """The results of an earlier run, and the path of its frames."""
    from foreglow.runs.frames_file import read_results
    from foreglow.runs.recorded_run import check_frames, source_of_run
    from foreglow.runs.summary_file import read_summary
    from foreglow.runtime.run import Replay

    results = read_results(run / "frames.jsonl", configuration.classifier.score_threshold)
    check_frames(run, read_summary(run / "summary.json"), results.values())
    return Replay(configuration, results, str(run)), source_of_run(run)


def _check_can(kind: str | None, configuration: PipelineConfig, headlamps: Headlamps, *, is_compact: bool) -> None:
    """Checks that the CAN log can be written, before any work is done."""
    if kind is None:
        if is_compact:
            raise ValueError("--compact: expected --can beside it: it is about the CAN log")
        return
    if is_compact and configuration.beam.ask:
        raise ValueError("--compact: expected ask = false under [beam]: gaps alone cannot carry its questions")
    from foreglow.photometry import NUM_LEDS
    from foreglow.runtime.can_output import LOG_SUFFIXES

    importlib.import_module("can")
    if f".{kind}" not in LOG_SUFFIXES:
        raise ValueError(f"--can: expected one of {', '.join(suffix[1:] for suffix in LOG_SUFFIXES)}, got {kind!r}")
    if headlamps.num_leds != NUM_LEDS and not is_compact:
        raise ValueError(
            f"--can: expected lamps of {NUM_LEDS} LEDs, {headlamps.name!r} have {headlamps.num_leds} each; "
            "--compact writes their gaps alone"
        )


def _can_sink(results: OutputFolder, kind: str, ramp_s: float, *, is_compact: bool) -> CanLogSink:
    """The sink for the CAN log."""
    from foreglow.runtime.can_output import CanLogSink

    return CanLogSink(results.partial(f"beam.{kind}"), suffix=f".{kind}", ramp_s=ramp_s, has_levels=not is_compact)


def _darker_lines(logs: Collection[CanLogSink]) -> Iterator[str]:
    """A line for a log of gaps that says low beam where there was light."""
    for log in logs:
        if log.gap_light.num_darker:
            yield (
                f"--compact: low beam in the place of {log.gap_light.num_darker} commands that dim LEDs without a gap, "
                "or let light return more slowly than a ramp says"
            )


def _checked_camera(
    frames: FrameSource, source: Path, configuration: PipelineConfig, *, has_log: bool
) -> Camera | None:
    """The first frame's camera; checks that it has what a high beam needs, which the guard checks of every frame."""
    first = next(iter(frames), None)
    if first is None:
        return None
    if first.camera is None:
        raise ValueError(f"{source}: the beam needs the camera's calibration: expected --calibration FILE")
    if first.motion is None and not has_log and configuration.guard.needs_speed:
        raise ValueError(
            f"{source}: the beam needs our speed: expected --can-log FILE, or needs_speed = false under [guard] in "
            "--config FILE"
        )
    return first.camera


def _say_other_calibration(run: Path, origin: RunSummary, camera: Camera) -> None:
    """Prints a line to stderr if the ranges of the run were not made with the calibration of the beam."""
    from foreglow.calibration import calibration_values

    if origin.calibration is None:
        if origin.num_with_camera == 0:
            typer.echo(f"foreglow: {run}: made without a calibration, so that its tracks have no ranges", err=True)
        return
    changes = []
    for table, values in calibration_values(camera).items():
        before = origin.calibration.get(table, {})
        for name in dict.fromkeys([*values, *before]):  # a sigma of 0 is left out
            was, now = before.get(name, 0.0), values.get(name, 0.0)
            if was != now:
                changes.append(f"{table}.{name} was {was}, is {now} now")
    if changes:
        more = f" (and {len(changes) - 1} more)" if len(changes) > 1 else ""
        words = "its ranges were made with another calibration, and stay as they are"
        typer.echo(f"foreglow: {run}: {words}: {changes[0]}{more}", err=True)
