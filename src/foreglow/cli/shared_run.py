"""What several commands share: runs over a source, and their progress bar, recording, viewer and pictures."""

from __future__ import annotations

import contextlib
import errno
import itertools
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.display.video import Drawing
    from foreglow.display.viewer import RerunSink
    from foreglow.display.viewer.sink import LuxOf
    from foreglow.lab.simulation.camera.likeness import LookSink
    from foreglow.options import SourceOptions, VehicleOptions, ViewOptions
    from foreglow.parallel import Workers
    from foreglow.photometry import Headlamps
    from foreglow.runtime import Opening, OutputFolder, ResultSink, RunSummary, Stepper
    from foreglow.runtime.health import LiveSink

MOST_FRAMES = 0.9
"""A log or poses that say something of so many frames of a run are as ever: one begins or ends a little before the
other."""

BY_CONFIGURATION = "the configuration says so ([guard] white_level)"
BY_OPTION = "--white-level says so"

WINDOW_S = 20.0
"""How far back the plots of the viewer's window go."""


def open_frames(source: Path, reading: SourceOptions, vehicle: VehicleOptions) -> FrameSource:
    """The frames of `source`; workers call it, too."""
    return vehicle.equip(reading.open(source), reading.limit)


def run_frames(
    frames: FrameSource,
    name: str,
    out: Path,
    pipeline: Stepper,
    *,
    make_sinks: Callable[[OutputFolder], Iterable[ResultSink]] = lambda _: (),
    limit: int | None = None,
    origin: RunSummary | None = None,
    among: Collection[int] | None = None,
) -> RunSummary:
    """Runs the pipeline over `frames`, with a progress bar; `origin` and `among` as in `runtime.run`."""
    from foreglow.runtime import OutputFolder, run
    from foreglow.whole_files import entered

    with entered(lambda: OutputFolder(out)) as folder:
        sinks = itertools.chain([progress_sink(frames, limit)], make_sinks(folder))
        return run(frames, pipeline, folder, sinks=sinks, limit=limit, source_name=name, origin=origin, among=among)


def run_in_parallel(
    opening: Opening,
    name: str,
    out: Path,
    configuration: PipelineConfig,
    workers: Workers,
    looks: LookSink | None = None,
) -> RunSummary:
    """Runs a pipeline over each sequence on its own, with a progress bar; `looks` sees the frames.

    Prints a line to stderr if there are several jobs and only one sequence.
    """
    from foreglow.datasets import part_names
    from foreglow.display.progress import PartsProgress
    from foreglow.parallel.local import Local
    from foreglow.runtime import OutputFolder, run_apart
    from foreglow.whole_files import entered

    source = opening()
    if isinstance(workers, Local) and workers.jobs > 1 and len(part_names(source)) == 1:
        typer.echo(f"foreglow: {name}: a single sequence, so that one job does all of the work", err=True)
    with PartsProgress(source.num_frames) as progress, entered(lambda: OutputFolder(out)) as folder:
        return run_apart(opening, configuration, folder, workers, progress=progress, source_name=name, watcher=looks)


def finish(summary: RunSummary, out: Path, *more: str) -> None:
    """Prints what came of a run, and more lines about it before the last; exits with 130 if it was interrupted."""
    from foreglow.display.summary_lines import run_lines

    *lines, last = run_lines(summary, out)
    typer.echo("\n".join([*lines, *more, last]))
    if summary.is_interrupted:
        raise typer.Exit(130)


def say_lack(run: Path, num_frames: int | None = None) -> bool:
    """Prints a line if the run in the folder `run` is incomplete, as `lack_of_run` has it; returns whether it is."""
    from foreglow.runs.summary_file import lack_of_run

    lack = lack_of_run(run, num_frames)
    if lack is not None:
        typer.echo(lack)
    return lack is not None


def unused_lines(vehicle: VehicleOptions, summary: RunSummary) -> list[str]:
    """A line for each file with data of the car that said nothing of any frame of the run: its clock may be another.

    And one where a log leaves the speed of many frames unknown, or poses leave the road of many, which street messages
    of the log do not tell either: these are not sent everywhere, so that a log without poses may leave it unknown.
    """
    num_moving, num_with_road = summary.num_with_motion or 0, summary.num_with_road or 0
    counts = {vehicle.can_log: num_moving + num_with_road, vehicle.poses: num_with_road}
    lines = [
        f"{path} says nothing of any frame: expected data of their times (--time-offset)"
        for path, count in counts.items()
        if path is not None and not count and summary.num_frames
    ]
    has_said = num_moving > 0 or (vehicle.poses is not None and num_with_road > 0)  # those roads may be the poses' own
    if vehicle.can_log is not None and has_said and num_moving < MOST_FRAMES * summary.num_frames:
        from foreglow.datasets.vehicle_logs.can_log import MOTION_STALE_S

        lines.append(
            f"{vehicle.can_log}: our motion is known in {num_moving} of {summary.num_frames} frames, and at most "
            f"{MOTION_STALE_S:g} s after a message: it begins later, ends earlier (--time-offset), or tells it less "
            "often"
        )
    if vehicle.poses is not None and 0 < num_with_road < MOST_FRAMES * summary.num_frames:
        from foreglow.maps.poses import MAX_GAP_S

        lines.append(
            f"{vehicle.poses}: the road is known in {num_with_road} of {summary.num_frames} frames: the poses begin "
            f"later, end earlier (--time-offset), have gaps of more than {MAX_GAP_S:g} s, or leave the map"
        )
    return lines


def source_notes(frames: FrameSource) -> list[str]:
    """What is assumed of the frames, such as the rate of a video that does not say it, and what is not read."""
    from foreglow.datasets import Equipped, ImageFolder, Video

    source = frames.source if isinstance(frames, Equipped) else frames
    return list(source.notes) if isinstance(source, ImageFolder | Video) else []


def folder_beside(source: Path) -> Path:
    """Where the results for `source` go if nobody says: beside it, in a folder that is named after it.

    Raises:
        ValueError: If there is a folder of this name already, and it is not an earlier run on the same source, or the
            name is too long, or there is nothing beside it.
    """
    from foreglow.runs.summary_file import read_summary

    path = source.resolve() if source.name in ("", "..") else source.absolute()  # a link stays one
    if not path.name:
        raise ValueError(f"{source}: nothing lies beside it; name the folder for the results with --out")
    out = path.with_name(f"{path.stem if path.is_file() else path.name}_foreglow")
    try:
        out.lstat()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise ValueError(
                f"{source}: its name is too long for that of a folder beside it, {out.name[-9:]} at the end; name the "
                "folder for the results with --out"
            ) from None
    is_taken = out.is_file() or (out.is_dir() and any(out.iterdir()))
    summary = out / "summary.json"
    if is_taken and not (summary.is_file() and Path(read_summary(summary).source).resolve() == path.resolve()):
        raise ValueError(f"{out}: expected no folder there, or an earlier run on {source}; name another with --out")
    return out


def look_sink(frames: FrameSource, limit: int | None, configuration: PipelineConfig) -> LookSink:
    """The sink that looks at a few frames, to tell what camera they resemble."""
    from foreglow.lab.simulation.camera.likeness import LookSink

    nums = [num for num in (frames.num_frames, limit) if num is not None]
    return LookSink(min(nums) if nums else None, configuration.guard.white_level)


def expectation(profile: str | None, configuration: PipelineConfig) -> str:
    """What to expect of a run whose camera resembles this profile of the simulator, and of its model."""
    from foreglow.config import PRESETS

    like = "unknown, like no profile of the simulator" if profile is None else f"like {profile} of the simulator"
    model = configuration.classifier.model
    is_ours = model is not None and any(each.classifier.model == model for each in PRESETS.values())
    seen = [
        *(["simulated drives only"] if is_ours else []),
        *(["other boxes"] if sees_other_boxes(configuration) else []),
    ]
    if not seen:
        return f"camera: {like}"
    return f"camera: {like}; the model has seen {', and '.join(seen)}, so look at the result before you trust it"


def boxes_notes(configuration: PipelineConfig) -> list[str]:
    """A line if the model has seen other boxes than those of the configuration."""
    line = "the model has seen other boxes than those of this configuration, so look at the result before you trust it"
    return [line] if sees_other_boxes(configuration) else []


def sees_other_boxes(configuration: PipelineConfig) -> bool:
    """Whether the model gets other boxes than it has learnt from, as far as that is known."""
    from foreglow.classifier.learnt import have_same_boxes
    from foreglow.options import known_proposals

    model, known = configuration.classifier.model, None
    with contextlib.suppress(ValueError, OSError):  # what is broken says nothing: the run is done
        known = None if model is None else known_proposals(model)
    return known is not None and not have_same_boxes(known[0], configuration.proposals)


def bits_notes(brightest: int | None, white_level: int | None, means: str = BY_CONFIGURATION) -> list[str]:
    """What to say of images of 16 bits that seem to be a camera's of fewer bits, or of more than is said.

    Args:
        brightest: The greatest value of some images of 16 bits; None without any.
        white_level: That of the camera, as far as it is given.
        means: How it can be given.
    """
    from foreglow.beam.camera_watch import MOST_OF_FEW_BITS

    if brightest is not None and white_level is not None and brightest > 2 * white_level:
        words = (
            "what is brighter counts as white; videos, PGM and PPM files say theirs themselves and need no white_level"
        )
        return [f"images of 16 bits, as bright as {brightest}, far beyond the white level of {white_level}: {words}"]
    if brightest is None or brightest > MOST_OF_FEW_BITS or white_level is not None:
        return []
    words = f"where white is 1023, 4095 or 16383, light is missed unless {means}"
    return [f"images of 16 bits, none brighter than {brightest}: {words}"]


def say_bits_of(data: Iterable[Path], white_level: int | None, means: str = BY_CONFIGURATION) -> None:
    """Prints `bits_notes` of a few images of the first split of each; what is wrong with them is said later."""
    import numpy as np

    from foreglow.datasets import open_labelled
    from foreglow.lab.learning.annotation import splits_to_annotate
    from foreglow.lab.simulation.camera.likeness import NUM_IMAGES

    greatest: list[int] = []
    for path in data:
        with contextlib.suppress(ValueError, OSError):
            split = open_labelled(splits_to_annotate(path)[0])
            ids = split.frame_ids[:: max(1, len(split) // NUM_IMAGES)]
            images = (split.read(image_id).image for image_id in ids)
            greatest += [int(image.max()) for image in images if image.dtype == np.uint16]
    for line in bits_notes(max(greatest, default=None), white_level, means):
        typer.echo(line)


def progress_sink(frames: FrameSource, limit: int | None) -> ResultSink:
    """A progress bar; it is shown on a terminal only."""
    from foreglow.display.progress import ProgressSink

    return ProgressSink(frames.num_frames if limit is None else min(limit, frames.num_frames or limit))


def recording_sinks(record: Path | None, source: Path | str, configuration: PipelineConfig) -> list[LiveSink]:
    """The sink that records a run on `source` to the file `record`; none without a file."""
    if record is None:
        return []
    from foreglow.runtime.mcap import McapRecorder

    return [McapRecorder(record, config=configuration, source_name=str(source))]


def viewer_sinks(options: ViewOptions, configuration: PipelineConfig, lux_of: LuxOf | None = None) -> list[RerunSink]:
    """The sink for the Rerun viewer; none if neither a window nor a file was asked for.

    Args:
        options: What was asked for.
        configuration: Of the run; its headlamps decide the layout.
        lux_of: The light at other drivers' eyes, if it is known.

    Raises:
        ModuleNotFoundError: If Rerun is not installed (extra `view`).
        ValueError: If there is no display for a window, or the file's name does not end in `.rrd`.
        OSError: If the file cannot be written.
    """
    if not options.view and options.save is None:
        return []
    from foreglow.display.viewer import RerunSink, RrdFile, ViewerWindow
    from foreglow.display.viewer.blueprint import blueprint
    from foreglow.photometry import read_headlamps

    has_lux = lux_of is not None
    num_columns = read_headlamps(configuration.beam.headlamps).num_columns
    with contextlib.ExitStack() as discarding:
        outputs: list[RrdFile | ViewerWindow] = []
        if options.save is not None:
            outputs.append(RrdFile(options.save, blueprint(has_lux=has_lux)))
            discarding.callback(outputs[-1].discard)
        if options.view:
            outputs.append(ViewerWindow(blueprint(has_lux=has_lux, window_s=WINDOW_S), _note))
            discarding.callback(outputs[-1].discard)
        sink = RerunSink(outputs, num_columns=num_columns, lux_of=lux_of)
        discarding.pop_all()
    return [sink]


def _note(line: str) -> None:
    typer.echo(f"foreglow: {line}", err=True)


def recorded_lux(frames: FrameSource) -> LuxOf | None:
    """The light at other drivers' eyes, as a simulated drive has it on file; None for other sources."""
    from foreglow.datasets import Equipped, LabelledSource
    from foreglow.datasets.simulated import has_truth
    from foreglow.datasets.simulated.vehicle import RecordedLux

    if isinstance(frames, Equipped):
        frames = frames.source
    if not isinstance(frames, LabelledSource) or not has_truth(frames.root):
        return None
    return RecordedLux(frames.root)


def picture_sink(frames: FrameSource, folder: OutputFolder, name: str, draw: Drawing | None = None) -> ResultSink:
    """The sink for pictures of a run, by default annotated frames: a PNG of a single image, else a video."""
    from foreglow.display.overlay import annotate
    from foreglow.display.video import PictureSink, VideoSink

    if frames.num_frames == 1:
        return PictureSink(folder.partial(f"{name}.png"), draw or annotate)
    return VideoSink(folder.partial(f"{name}.mp4"), frames.rate_hz, draw or annotate)


def beam_sink(frames: FrameSource, folder: OutputFolder, headlamps: Headlamps) -> ResultSink:
    """The sink for pictures of the beam, which show the light at the height of drivers' eyes."""
    from foreglow.display.beam_view import EYE_HEIGHT_M, BeamView

    return picture_sink(frames, folder, "beam", BeamView(headlamps, map_height_m=EYE_HEIGHT_M).draw)
