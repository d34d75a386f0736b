"""The command line's frame: the program, its errors, and what several commands share."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource, OnError
    from foreglow.display.video import Drawing
    from foreglow.parallel import Workers
    from foreglow.photometry import Headlamps
    from foreglow.runtime import Opening, OutputFolder, ResultSink, RunSummary, Stepper
    from foreglow.runtime.health import LiveSink

EXTRAS = {
    **dict.fromkeys(("onnx", "torch", "optuna"), "train"),
    **dict.fromkeys(("mitsuba", "drjit"), "sim"),
    **dict.fromkeys(("libreyolo", "torchvision"), "yolo"),
    **dict.fromkeys(("cantools", "can"), "can"),
    **dict.fromkeys(("foxglove", "lz4", "zstandard"), "recordings"),
    **dict.fromkeys(("rclpy", "rmw_fastrtps_cpp"), "ros2"),
    **dict.fromkeys(("dask", "distributed"), "scale"),
    "rerun": "view",
    "matplotlib": "plots",
    "ultralytics": "ultralytics",
    "trackeval": "mot",
}
"""Optional modules, and the extra that installs each."""


DEFAULT_PRESET = "foreglow"
"""What runs where nothing else is asked for."""


class Commands(TyperGroup):
    """The sub-commands, with their errors turned into one line on stderr."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the sub-command.

        Raises:
            typer.Exit: With code 2 for bad input and 130 for Ctrl-C; with `--debug` the error itself is raised.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            line, code = "interrupted", 130
        except BrokenPipeError:  # whoever reads the output, such as `head`, has seen enough
            raise
        except (ValueError, OSError, ModuleNotFoundError) as error:
            is_ours = not isinstance(error, ModuleNotFoundError) or error.name in EXTRAS
            if ctx.params["debug"] or not is_ours:
                raise
            line, code = _one_line(error), 2
        typer.echo(f"foreglow: {line}", err=True)
        raise typer.Exit(code)


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Foreglow: provident vehicle detection at night.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

experiments = typer.Typer(no_args_is_help=True, help="Experiments: figures, tables and a report in a folder.")
app.add_typer(experiments, name="experiment")

yolo = typer.Typer(no_args_is_help=True, help="A YOLO on the same boxes, to compare with.")
app.add_typer(yolo, name="yolo")

# readable=False leaves unreadable files to the readers, whose errors take one line.
argument = functools.partial(typer.Argument, readable=False)
file = functools.partial(typer.Option, readable=False, metavar="FILE")
folder = functools.partial(typer.Option, readable=False, metavar="DIR")

_SOURCE_HELP = "An image, a folder of images, a video, a recording, a PVDN split (PVDN/day/val) or a PVDN sequence."
Source = Annotated[Path, argument(metavar="SOURCE", help=_SOURCE_HELP)]
PresetOption = Annotated[str, typer.Option(metavar="foreglow|paper|baseline", help="Parameters to start from.")]
ModelOption = Annotated[Path | None, file(help="ONNX model that classifies the proposals; overrides the file's.")]
ConfigOption = Annotated[Path | None, file(help="TOML whose fields override the preset.")]
CalibrationOption = Annotated[Path | None, file(help="The camera's TOML, so that boxes and tracks get ranges.")]
CanLogOption = Annotated[Path | None, file(help="CAN log of the drive: motion and street messages.")]
DbcOption = Annotated[Path | None, file(help="What is in the log's frames (default: our own).")]
MappingOption = Annotated[Path | None, file(help="TOML: what the DBC's signals mean.")]
MapOption = Annotated[Path | None, file("--map", help="GeoJSON, OpenDRIVE or Lanelet2; with --poses.")]
PosesOption = Annotated[Path | None, file(help="Where the car was on the map, over time: CSV or TUM.")]
TimeOffsetOption = Annotated[
    float, typer.Option(metavar="S", help="Added to the times of log and poses to have the frames'.")
]
PoseErrorOption = Annotated[float, typer.Option(metavar="M", help="How far the poses may be off along the road.")]
LimitOption = Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop after N frames.")]
TopicOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Image topic of a recording (default: its first).")
]
RecordOption = Annotated[Path | None, file(help="Also record all as MCAP, to replay and for Foxglove.")]
OnErrorOption = Annotated[str, typer.Option(metavar="stop|skip|mark", help="What an unreadable or damaged frame does.")]
JobsOption = Annotated[int, typer.Option(min=1, metavar="N", help="Processes, a sequence each; 1 stays in this one.")]
ClusterOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="dask scheduler whose workers do it, such as tcp://host:8786.")
]


def _show_version(is_wanted: bool) -> None:
    if is_wanted:
        import foreglow

        typer.echo(f"foreglow {foreglow.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None: ...


def _one_line(error: Exception) -> str:
    """What is wrong, in one line."""
    if isinstance(error, ModuleNotFoundError):
        extra = EXTRAS[str(error.name)]
        return f"{error.name} is not installed; this command needs: pip install 'foreglow[{extra}]'"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def configuration_of(preset: str, file: Path | None, model: Path | None) -> PipelineConfig:
    """The preset's configuration, overridden by the file's fields, and by the model given."""
    from foreglow import config

    configuration = config.preset(preset)
    if file is not None:
        configuration = config.read_config(file, configuration)
    if model is not None:
        classifier = configuration.classifier.model_copy(update={"model": model})
        configuration = configuration.model_copy(update={"classifier": classifier})
    return configuration


def size_of(text: str) -> tuple[int, int]:
    """The width and height that `text` such as 1280x960 says."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"size: expected WIDTHxHEIGHT such as 1280x960, got {text!r}")
    return int(width), int(height)


def opened(source: Path, out: Path, on_error: str = "stop", topic: str | None = None) -> FrameSource:
    """The frames of `source`, which must not be what the results in `out` overwrite."""
    from foreglow.datasets import open_source
    from foreglow.runtime import RESULT_NAMES

    if source.resolve() in [(out / name).resolve() for name in RESULT_NAMES]:
        raise ValueError(f"{source}: expected a source that the results in {out} do not overwrite")
    if source.resolve() == out.resolve() and source.is_dir():  # a picture in it would be a source of the next run
        raise ValueError(f"{out}: expected another folder for the results than the source")
    return open_source(source, on_error=cast("OnError", on_error), topic=topic)


def recording_sinks(record: Path | None, source: Path, configuration: PipelineConfig) -> list[LiveSink]:
    """The sink that records what is made of `source`, which must not be what it writes; none without a path."""
    if record is None:
        return []
    from foreglow.runtime.mcap import McapRecorder

    if source.resolve() in (record.resolve(), record.with_name(record.name + ".partial").resolve()):
        raise ValueError(f"{source}: expected a source that the recording {record} does not overwrite")
    return [McapRecorder(record, config=configuration, source_name=str(source))]


def equipped(
    frames: FrameSource, files: Sequence[Path | None], time_offset_s: float, pose_error_m: float
) -> FrameSource:
    """`frames` with what the files of `open_vehicle_data`, in its order, know of them."""
    if all(one is None for one in files):
        return frames
    from foreglow.datasets import Equipped
    from foreglow.datasets.vehicle_logs import open_vehicle_data

    data = open_vehicle_data(*files, time_offset_s=time_offset_s, pose_error_m=pose_error_m)
    return Equipped(frames, data)


def open_equipped(
    source: Path,
    out: Path,
    on_error: str,
    topic: str | None,
    files: tuple[Path | None, ...],
    time_offset_s: float,
    pose_error_m: float,
) -> FrameSource:
    """The frames of `source` as `opened` and `equipped` give them; every worker calls it."""
    return equipped(opened(source, out, on_error, topic), files, time_offset_s, pose_error_m)


def run_by_workers(
    opening: Opening, name: str, out: Path, configuration: PipelineConfig, workers: Workers
) -> RunSummary:
    """Runs a pipeline over each sequence apart, with a progress bar where there is a terminal."""
    from foreglow.display.progress import PartsProgress
    from foreglow.runtime import OutputFolder, run_apart

    with contextlib.closing(PartsProgress(opening().num_frames)) as progress:
        return run_apart(opening, configuration, OutputFolder(out), workers, progress=progress, source_name=name)


def run_frames(
    frames: FrameSource,
    name: str,
    out: Path,
    pipeline: Stepper,
    *,
    make_sinks: Callable[[OutputFolder], Sequence[ResultSink]] = lambda _: (),
    limit: int | None = None,
) -> RunSummary:
    """Runs the pipeline over `frames`, with a progress bar where there is a terminal."""
    from foreglow.runtime import OutputFolder, run

    folder = OutputFolder(out)
    try:
        sinks = [progress_sink(frames, limit), *make_sinks(folder)]
    except BaseException:
        folder.discard()
        raise
    return run(frames, pipeline, folder, sinks=sinks, limit=limit, source_name=name)


def progress_sink(frames: FrameSource, limit: int | None) -> ResultSink:
    """A progress bar where there is a terminal."""
    from foreglow.display.progress import ProgressSink

    return ProgressSink(frames.num_frames if limit is None else min(limit, frames.num_frames or limit))


def picture_sink(frames: FrameSource, folder: OutputFolder, name: str, draw: Drawing | None = None) -> ResultSink:
    """The sink for pictures, annotated frames unless drawn otherwise: a picture of a single image, else a video."""
    from foreglow.display.overlay import annotate
    from foreglow.display.video import PictureSink, VideoSink

    if frames.num_frames == 1:
        return PictureSink(folder.partial(f"{name}.png"), draw or annotate)
    return VideoSink(folder.partial(f"{name}.mp4"), frames.rate_hz, draw or annotate)


def beam_sink(frames: FrameSource, folder: OutputFolder, headlamps: Headlamps) -> ResultSink:
    """The sink for the pictures of the beam, whose light is shown as drivers' eyes get it."""
    from foreglow.display.beam_view import EYE_HEIGHT_M, BeamView

    return picture_sink(frames, folder, "beam", BeamView(headlamps, map_height_m=EYE_HEIGHT_M).draw)


def finish(summary: RunSummary, out: Path) -> None:
    """Says on stdout what came of a run; exits with 130 where it was interrupted."""
    from foreglow.lab.reports.tables import run_lines

    typer.echo("\n".join(run_lines(summary, out)))
    if not summary.is_complete:
        raise typer.Exit(130)
