"""`export-mot`: the tracks of a run, for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.command_line import argument, flag, folder, option, with_options


@app.command("export-mot")
@with_options
def export_mot(
    run: Annotated[Path, argument("RUN", "Folder of a `foreglow run` on SPLIT.")],
    split: Annotated[Path, argument("SPLIT", "The PVDN split that it ran on, such as PVDN/day/val.")],
    out: Annotated[Path, folder("Folder for the MOTChallenge files.")],
    name: Annotated[str, option("NAME", "Name of the tracker in the files.")] = "foreglow",
    score: Annotated[bool, flag("--score", "Also print HOTA, IDF1 and CLEAR, computed by TrackEval.")] = False,
) -> None:
    """Write the tracks of a run and the labelled lights as MOTChallenge files, without tracks of doubtful light."""
    import importlib

    from foreglow.datasets import open_labelled
    from foreglow.lab.evaluation import mot, read_predictions
    from foreglow.runs.frames_file import read_tracks
    from foreglow.runs.labels_of_run import check_times, labels_of_run

    if score:
        importlib.import_module("trackeval")  # fails before anything is written
    results = run / "frames.jsonl"
    labels = labels_of_run(run, split, open_labelled(split))
    if labels.doubt is not None:
        raise ValueError(f"{labels.doubt}; expected a run on {split}")
    proposals, tracks = labels.of_images(read_predictions(results)), labels.by_image(read_tracks(results))
    check_times(run, split, labels.dataset, proposals.times_ns)
    mot.export_mot(labels.dataset, proposals, tracks, out, name, origin=str(results))
    if score:
        scores = mot.score_mot(out, name)
        typer.echo(f"HOTA {scores.hota:.3f} (DetA {scores.det_a:.3f}, AssA {scores.ass_a:.3f}), IDF1 {scores.idf1:.3f}")
        typer.echo(f"MOTA {scores.mota:.3f}, {scores.num_switches} switches, {scores.num_fragments} interruptions")
    typer.echo("\n".join([*labels.lines, f"look in {out}"]))
