"""`run`, `demo`, `download`: frames in, results out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import (
    DEFAULT_PRESET,
    ModelOption,
    PresetOption,
    Source,
    app,
    argument,
    configuration_of,
    file,
    finish,
    folder,
    opened,
    run_frames,
)

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource
    from foreglow.evaluation.story import Story


@app.command()
def run(
    source: Source,
    out: Annotated[Path, folder(help="Folder for the results; made if need be.")],
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: Annotated[Path | None, file(help="TOML whose fields override the preset.")] = None,
    calibration: Annotated[Path | None, file(help="The camera's TOML, so that boxes and tracks get ranges.")] = None,
    can_log: Annotated[Path | None, file(help="CAN log of the drive: motion and street messages.")] = None,
    dbc: Annotated[Path | None, file(help="What is in the log's frames (default: our own).")] = None,
    mapping: Annotated[Path | None, file(help="TOML: what the DBC's signals mean.")] = None,
    road_map: Annotated[Path | None, file("--map", help="GeoJSON, OpenDRIVE or Lanelet2; with --poses.")] = None,
    poses: Annotated[Path | None, file(help="Where the car was on the map, over time: CSV or TUM.")] = None,
    time_offset: Annotated[
        float, typer.Option(metavar="S", help="Added to the times of log and poses to have the frames'.")
    ] = 0.0,
    pose_error: Annotated[float, typer.Option(metavar="M", help="How far the poses may be off along the road.")] = 5.0,
    video: Annotated[
        bool, typer.Option("--video", help="Also write annotated pictures: MP4, or PNG of one image.")
    ] = False,
    limit: Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop after N frames.")] = None,
    on_error: Annotated[str, typer.Option(metavar="stop|skip", help="What an unreadable file does.")] = "stop",
) -> None:
    """Find the light artifacts in SOURCE, follow them, and write them to a folder."""
    configuration = configuration_of(preset, config, model)
    frames = opened(source, out, on_error)
    files = (calibration, can_log, dbc, mapping, road_map, poses)
    if any(one is not None for one in files):
        from foreglow.datasets import Equipped
        from foreglow.datasets.vehicle_logs import open_vehicle_data

        data = open_vehicle_data(*files, time_offset_s=time_offset, pose_error_m=pose_error)
        frames = Equipped(frames, data)
    finish(run_frames(frames, str(source), out, configuration, has_video=video, limit=limit), out)


@app.command()
def demo(
    source: Annotated[Path | None, argument(metavar="SOURCE", help="What to run on, as in `run`.")] = None,
    out: Annotated[Path, folder(help="Folder for the results.")] = Path("demo_output"),
    model: ModelOption = None,
) -> None:
    """Run on SOURCE, or on the drive that ships, with annotated pictures; tell what happened where there are labels."""
    from foreglow.datasets import shipped_drive

    frames = opened(shipped_drive() if source is None else source, out)
    configuration = configuration_of(DEFAULT_PRESET, None, model)
    summary = run_frames(frames, frames.name if source is None else str(source), out, configuration, has_video=True)
    stories = _stories(frames, out, configuration) if summary.is_complete else ()
    finish(summary, out)
    _tell(stories, is_classified=summary.is_classified)


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
    from foreglow.evaluation import read_predictions
    from foreglow.evaluation.story import best_story, has_labels, tell_stories
    from foreglow.evaluation.track_file import read_tracks
    from foreglow.reports.moments import write_moments

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

    from foreglow.reports.story import story_lines, story_table

    if len(stories) == 1:
        typer.echo("\n".join(["", *story_lines(stories[0], is_classified=is_classified)]))
    elif stories:
        rich.print(story_table(stories, is_classified=is_classified))
