"""`labels`: to and from annotation tools; `suggest`: which frames are worth labelling."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import say_lack
from foreglow.command_line import argument, file, folder, option, output_file, with_options
from foreglow.own_files import LABELS
from foreglow.plugins import words_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from foreglow.datasets.exchange.marks import ImageLabels

labels = typer.Typer(no_args_is_help=True, help="Labels to and from CVAT, COCO and Label Studio.")
app.add_typer(labels, name="labels")


@labels.command()
@with_options
def export(
    source: Annotated[Path, argument("SOURCE", "Labelled images; with --run, what the run was made from.")],
    out: Annotated[Path, output_file("File to write: .xml for CVAT, else .json.", LABELS)],
    name: Annotated[str, option("cvat|cvat-video|coco|label-studio", "Format of the file.", "--format")] = "cvat",
    run: Annotated[
        Path | None, file("Write what this run found instead of labels, to be corrected.", metavar="RUN")
    ] = None,
    frames: Annotated[Path | None, file("Only frames in this CSV, as `foreglow suggest` writes it.")] = None,
) -> None:
    """Write the labels of SOURCE, or a first guess, for an annotation tool."""
    from foreglow.datasets import exchange, open_labelled
    from foreglow.lab.learning.suggestion import read_suggestions
    from foreglow.runs.first_guess import read_guess
    from foreglow.runs.recorded_run import check_suggestions_of, doubt_about_source, open_run

    exchange.check_target(out, name)
    if name == "cvat-video" and frames is not None:
        raise ValueError("labels export: expected --format cvat for --frames; cvat-video has every frame of a drive")
    if frames is not None:
        read_suggestions(frames)  # what is wrong in it by itself is said before a long run is read
    lines = []
    if run is None:
        dataset = open_labelled(source)
        sequences = {image_id: dataset.sequence(image_id).directory for image_id in dataset.frame_ids}
        found = exchange.labels_of(dataset, None if frames is None else read_suggestions(frames, sequences))
    else:
        frames_of_run = open_run(run, source)
        doubt = doubt_about_source(run, source)
        lines += [] if doubt is None else [doubt]
        if frames is not None:
            check_suggestions_of(run, frames)
        guesses = read_guess(run)
        sequences = {number: guess.sequence for number, guess in guesses.items()}
        chosen = None if frames is None else read_suggestions(frames, sequences)
        found = exchange.guesses_of(frames_of_run, guesses, chosen)
    lost = exchange.write_labels_file(out, found, name, is_guess=run is not None)
    if run is not None:
        say_lack(run)
    typer.echo("\n".join([*lines, _counted(found.images), *exchange.lost_lines(lost), f"look at {out}"]))


@labels.command("import")
@with_options
def import_(
    source: Annotated[Path, argument("FILE", "Labels of CVAT (.xml), COCO or Label Studio (.json).")],
    out: Annotated[Path, folder("Folder for the data set, in PVDN's format.")],
    images: Annotated[
        Path | None, file("Folder of the images, or the video (default: beside FILE).", metavar="DIR|VIDEO")
    ] = None,
) -> None:
    """Make a data set of labels and their images, which every command takes."""
    from foreglow.datasets import exchange
    from foreglow.display.summary_lines import left_out_lines
    from foreglow.runs.labels_of_run import origins_of

    dataset = exchange.LabelFile(source, images)
    origins = origins_of(dataset)
    exchange.write_split(dataset, out, origins, dataset.path if dataset.coco_ids else None)
    found = dataset.images_read
    lines = [_counted(found), *exchange.lost_lines(dataset.lost), *dataset.unknown_vehicles]
    num_lost_parts = sum(isinstance(key, str) for key in dataset.passed_over)
    lines += left_out_lines([*dataset.passed_over.values()], num_lost_parts)
    lights = [mark for image in found for mark in image.marks if mark.kind == exchange.Kind.LIGHT]
    if lights and not any(mark.is_direct for mark in lights):
        lines.append("no light is marked as direct: all of it is learnt as light that lamps throw, and none as a lamp")
    num_empty = sum(not image.marks for image in found)
    if num_empty:
        lines.append(_empty_line(num_empty))
    if any(frame != image_id for origin in origins for frame, image_id in origin.ids or ()):
        lines.append(
            "the images are renumbered, as they have other numbers in a run on their folder; evaluate and export-mot "
            "know which is which"
        )
    if dataset.coco_ids:
        lines.append(
            f"the images have other numbers than in {source}: COCO's results by its ids are compared with {source} "
            "itself"
        )
    typer.echo("\n".join([*lines, f"look in {out}; foreglow run, evaluate and every later command read it as PVDN"]))


def _empty_line(num_empty: int) -> str:
    """What images without points mean.

    >>> _empty_line(1)
    '1 of the images has no point: it teaches that nothing in it is light of a vehicle'
    """
    has, teach, them = ("has", "it teaches", "it") if num_empty == 1 else ("have", "they teach", "them")
    return f"{num_empty} of the images {has} no point: {teach} that nothing in {them} is light of a vehicle"


def _counted(images: Sequence[ImageLabels]) -> str:
    from foreglow.datasets.exchange import Kind
    from foreglow.datasets.exchange.marks import num_outside
    from foreglow.display.summary_lines import counted

    counts = {kind: sum(mark.kind == kind for image in images for mark in image.marks) for kind in Kind}
    lights = counted(counts[Kind.LIGHT], "light")
    outside = sum(map(num_outside, images))
    words = f"{counted(len(images), 'image')}, {counted(counts[Kind.VEHICLE], 'vehicle point')}, {lights}"
    words += f", {counts[Kind.DOUBTFUL]} doubtful" if counts[Kind.DOUBTFUL] else ""
    return f"{words}; {counted(outside, 'point')} outside the image" if outside else words


@app.command()
@with_options
def suggest(
    runs: Annotated[list[Path], argument("RUN...", "Folders of runs; each gets a suggestions.csv.")],
    frames: Annotated[int, option("N", "How many frames, over all runs.", min=1, max=100_000)] = 200,
) -> None:
    """Name the frames that are worth labelling: doubtful, restless over time, or unlike what the model has seen."""
    from foreglow.display.summary_lines import counted
    from foreglow.lab.learning import suggestion
    from foreglow.runs.recorded_run import read_run

    if len({folder_.resolve() for folder_ in runs}) < len(runs):
        raise ValueError(f"{', '.join(map(str, runs))}: expected each run once")
    drives, folders = [], []
    for folder_ in runs:
        run = read_run(folder_)
        say_lack(folder_)
        try:
            unlike = suggestion.unlikeness(run)
        except FileNotFoundError as error:
            typer.echo(f"how the images look does not count: {words_of(error)}")
            unlike = None
        rated = suggestion.rated(run, unlike)
        drives += rated
        folders += [folder_] * len(rated)
    chosen = suggestion.suggested(drives, frames)
    texts, lines = {}, []
    for folder_ in runs:
        found = [each for drive, home in zip(chosen, folders, strict=True) if home == folder_ for each in drive]
        path = folder_ / suggestion.FILE_NAME
        texts[path] = suggestion.suggestions_text(found)
        lines.append(f"{counted(len(found), 'frame')}: look at {path}")
    suggestion.write_suggestions(texts)
    typer.echo("\n".join(lines))
