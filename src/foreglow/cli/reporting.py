"""`report`: a run as a page to read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app, argument, file


@app.command()
def report(
    run: Annotated[Path, argument(metavar="RUN", help="Folder of `run`, `beam` or `live`.")],
    out: Annotated[Path | None, file(metavar="FILE.html", help="Where to write it (default: RUN/report.html).")] = None,
) -> None:
    """Write one HTML page on RUN: tracks, ranges, beam and faults over time, key moments, run-times."""
    from foreglow.lab.reports.run_page import write_report

    typer.echo(f"look in {write_report(run, out)}")
