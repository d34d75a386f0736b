"""`export-mot`: a run's tracks for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app, argument, folder


@app.command("export-mot")
def export_mot(
    run: Annotated[Path, argument(metavar="RUN", help="The folder of a `foreglow run` on SPLIT.")],
    split: Annotated[Path, argument(metavar="SPLIT", help="The PVDN split that it ran on, such as PVDN/day/val.")],
    out: Annotated[Path, folder(help="Folder for the MOTChallenge files.")],
    name: Annotated[str, typer.Option(metavar="NAME", help="What the tracker is called in them.")] = "foreglow",
    score: Annotated[bool, typer.Option("--score", help="Also print HOTA, IDF1 and CLEAR, by TrackEval.")] = False,
) -> None:
    """Write a run's tracks and the labelled lights as MOTChallenge files."""
    import importlib

    from foreglow.datasets import PVDN
    from foreglow.lab.evaluation import read_predictions
    from foreglow.lab.evaluation.tracks import mot
    from foreglow.runs.frames_file import read_tracks

    if score:
        importlib.import_module("trackeval")  # fails before anything is written
    results = run / "frames.jsonl"
    mot.export_mot(PVDN(split), read_predictions(results), read_tracks(results), out, name)
    if score:
        its = mot.score_mot(out, name)
        typer.echo(f"HOTA {its.hota:.3f} (DetA {its.det_a:.3f}, AssA {its.ass_a:.3f}), IDF1 {its.idf1:.3f}")
        typer.echo(f"MOTA {its.mota:.3f}, {its.num_switches} switches, {its.num_fragments} interruptions")
    typer.echo(f"look in {out}")
