"""`demo`: the quickest look at what Foreglow does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import beam_sink, finish, open_frames, picture_sink, run_frames, source_notes
from foreglow.command_line import argument, folder, with_options
from foreglow.options import ModelOption, PipelineOptions, SourceOptions, VehicleOptions

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.lab.studies.demo.metrics import Story
    from foreglow.runtime import OutputFolder, ResultSink


@app.command()
@with_options
def demo(
    source: Annotated[Path | None, argument("SOURCE", "What to run on, as for `run`.")] = None,
    out: Annotated[Path, folder("Folder for the results.")] = Path("demo_output"),
    model: ModelOption = None,
) -> None:
    """Run on SOURCE, or on the drive that ships, with annotated pictures; tell what happened if there are labels."""
    from foreglow.datasets import shipped_drive
    from foreglow.photometry import read_headlamps
    from foreglow.pipeline import Pipeline

    source = shipped_drive() if source is None else source
    frames = open_frames(source, SourceOptions(), VehicleOptions())
    configuration = PipelineOptions(model=model).configuration()
    first = next(iter(frames), None)
    has_beam = first is not None and first.camera is not None and first.motion is not None
    if has_beam:
        configuration = configuration.commanding(policy="foreglow")

    def make_sinks(results: OutputFolder) -> list[ResultSink]:
        sinks = [picture_sink(frames, results, "overlay")]
        return [*sinks, beam_sink(frames, results, read_headlamps())] if has_beam else sinks

    summary = run_frames(frames, str(source), out, Pipeline(configuration), make_sinks=make_sinks)
    stories = _stories(frames, out, configuration, has_beam=has_beam) if summary.is_complete else ()
    finish(summary, out, *source_notes(frames))
    _print_stories(stories, is_classified=summary.is_classified)


def _stories(frames: FrameSource, out: Path, configuration: PipelineConfig, *, has_beam: bool) -> tuple[Story, ...]:
    """What happened in a run on frames with labels; its best moments become a picture beside the results."""
    from foreglow.datasets import LabelledSource
    from foreglow.lab.evaluation import read_predictions
    from foreglow.lab.studies.demo.figures import write_moments
    from foreglow.lab.studies.demo.metrics import best_story, has_labels, tell_stories
    from foreglow.runs.frames_file import read_gaps, read_tracks

    if not isinstance(frames, LabelledSource) or not has_labels(frames):
        return ()
    predictions, threshold = read_predictions(out / "frames.jsonl"), configuration.classifier.score_threshold
    tracks = read_tracks(out / "frames.jsonl") if configuration.classifier.model is not None else None
    gaps_rad = read_gaps(out / "frames.jsonl") if has_beam else None
    stories = tell_stories(frames, predictions, threshold, tracks, gaps_rad)
    best = best_story(stories)
    if best is not None:
        images = [frames.read(moment.light.image_id) for moment in best.moments.values()]
        write_moments(out / "moments.png", best, images, predictions, threshold)
    return stories


def _print_stories(stories: tuple[Story, ...], *, is_classified: bool) -> None:
    """Prints what happened: a single story in full, several as a table."""
    import rich

    from foreglow.lab.studies.demo.page import papers_scene, story_lines, story_table

    if len(stories) == 1:
        typer.echo("\n".join(["", *story_lines(stories[0], is_classified=is_classified)]))
    elif stories:
        rich.print(story_table(stories, is_classified=is_classified))
    if stories and is_classified:
        typer.echo(papers_scene())
