"""`run`, `demo`, `download`: frames in, results out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import (
    DEFAULT_PRESET,
    CalibrationOption,
    CanLogOption,
    ClusterOption,
    ConfigOption,
    DbcOption,
    JobsOption,
    LimitOption,
    MapOption,
    MappingOption,
    ModelOption,
    OnErrorOption,
    PoseErrorOption,
    PosesOption,
    PresetOption,
    RecordOption,
    Source,
    TimeOffsetOption,
    TopicOption,
    app,
    argument,
    beam_sink,
    configuration_of,
    finish,
    folder,
    open_equipped,
    opened,
    picture_sink,
    recording_sinks,
    run_by_workers,
    run_frames,
)
from foreglow.cli.viewing import SaveOption, ViewOption, lux_as_driven, viewer_sinks

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.lab.studies.demo.story import Story
    from foreglow.runtime import OutputFolder, ResultSink


@app.command()
def run(
    source: Source,
    out: Annotated[Path, folder(help="Folder for the results; made if need be.")],
    preset: PresetOption = DEFAULT_PRESET,
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
    video: Annotated[
        bool, typer.Option("--video", help="Also write annotated pictures: MP4, or PNG of one image.")
    ] = False,
    record: RecordOption = None,
    topic: TopicOption = None,
    view: ViewOption = False,
    save: SaveOption = None,
    limit: LimitOption = None,
    on_error: OnErrorOption = "stop",
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
) -> None:
    """Find the light artifacts in SOURCE, follow them, and write them to a folder."""
    from foreglow.parallel import workers_at
    from foreglow.pipeline import Pipeline
    from foreglow.runtime import Opening

    workers = workers_at(jobs, cluster)
    configuration = configuration_of(preset, config, model)
    files = (calibration, can_log, dbc, mapping, road_map, poses)
    opening = Opening(open_equipped, (source, out, on_error, topic, files, time_offset, pose_error))
    if jobs > 1 or cluster is not None:
        if video or view or limit is not None or any(one is not None for one in (record, save)):
            raise ValueError(
                "run: expected --video, --record, --view, --save and --limit without --jobs and --cluster: they go "
                "frame by frame"
            )
        finish(run_by_workers(opening, str(source), out, configuration, workers), out)
        return
    frames = opening()

    def make_sinks(results: OutputFolder) -> list[ResultSink]:
        sinks: list[ResultSink] = [*recording_sinks(record, source, configuration)]
        sinks += viewer_sinks(view, save, configuration, lux_as_driven(frames))
        return [*sinks, picture_sink(frames, results, "overlay")] if video else sinks

    finish(run_frames(frames, str(source), out, Pipeline(configuration), make_sinks=make_sinks, limit=limit), out)


@app.command()
def demo(
    source: Annotated[Path | None, argument(metavar="SOURCE", help="What to run on, as in `run`.")] = None,
    out: Annotated[Path, folder(help="Folder for the results.")] = Path("demo_output"),
    model: ModelOption = None,
) -> None:
    """Run on SOURCE, or on the drive that ships, with annotated pictures; tell what happened where there are labels."""
    from foreglow.datasets import shipped_drive
    from foreglow.photometry import read_headlamps
    from foreglow.pipeline import Pipeline

    frames = opened(shipped_drive() if source is None else source, out)
    configuration = configuration_of(DEFAULT_PRESET, None, model)
    first = next(iter(frames), None)
    has_beam = first is not None and first.camera is not None and first.motion is not None
    if has_beam:
        configuration = configuration.commanding(policy="foreglow")

    def make_sinks(results: OutputFolder) -> list[ResultSink]:
        sinks = [picture_sink(frames, results, "overlay")]
        return [*sinks, beam_sink(frames, results, read_headlamps())] if has_beam else sinks

    name = frames.name if source is None else str(source)
    summary = run_frames(frames, name, out, Pipeline(configuration), make_sinks=make_sinks)
    stories = _stories(frames, out, configuration) if summary.is_complete else ()
    finish(summary, out)
    _tell(stories, is_classified=summary.is_classified)
    if has_beam and len(stories) == 1:
        _tell_gap(frames, stories[0], out)


@app.command()
def download(
    dataset: Annotated[str, typer.Argument(metavar="DATASET", help="The data set: pvdn.")],
    out: Annotated[Path, folder(help="Where to put it.")] = Path("PVDN"),
) -> None:
    """Fetch a data set."""
    if dataset != "pvdn":
        raise ValueError(f"download: expected pvdn, got {dataset!r}")
    from foreglow.datasets import download_pvdn

    typer.echo(f"PVDN is in {download_pvdn(out)}")


def _stories(frames: FrameSource, out: Path, configuration: PipelineConfig) -> tuple[Story, ...]:
    """What happened in a run of frames with labels; the best of it becomes a picture beside the results."""
    from foreglow.datasets import PVDN
    from foreglow.lab.evaluation import read_predictions
    from foreglow.lab.studies.demo.moments import write_moments
    from foreglow.lab.studies.demo.story import best_story, has_labels, tell_stories
    from foreglow.runs.frames_file import read_tracks

    if not isinstance(frames, PVDN) or not has_labels(frames):
        return ()
    predictions, threshold = read_predictions(out / "frames.jsonl"), configuration.classifier.score_threshold
    tracks = read_tracks(out / "frames.jsonl") if configuration.classifier.model is not None else None
    stories = tell_stories(frames, predictions, threshold, tracks)
    best = best_story(stories)
    if best is not None:
        images = [frames.read(moment.light.image_id) for moment in best.moments]
        write_moments(out / "moments.png", best, images, predictions, threshold)
    return stories


def _tell(stories: tuple[Story, ...], *, is_classified: bool) -> None:
    """Says what happened: one story in full, several as a table."""
    import rich

    from foreglow.lab.studies.demo.narration import story_lines, story_table

    if len(stories) == 1:
        typer.echo("\n".join(["", *story_lines(stories[0], is_classified=is_classified)]))
    elif stories:
        rich.print(story_table(stories, is_classified=is_classified))


def _tell_gap(frames: FrameSource, story: Story, out: Path) -> None:
    """Says since when the beam was dark where the story's vehicle came into sight."""
    from foreglow.datasets import PVDN
    from foreglow.lab.studies.demo.gap_opening import gap_opened_s
    from foreglow.lab.studies.demo.narration import gap_line
    from foreglow.runs.frames_file import read_gaps

    if isinstance(frames, PVDN) and story.sight is not None:
        typer.echo(gap_line(story, gap_opened_s(frames, story, read_gaps(out / "frames.jsonl"))))
