"""`report`: a run as a page to read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.cli.shared_run import say_lack
from foreglow.command_line import argument, output_file, with_options
from foreglow.folder_lock import locked
from foreglow.outputs import check_kinds
from foreglow.own_files import RUN_PAGE


@app.command()
@with_options
def report(
    run: Annotated[Path, argument("RUN", "Folder of `run`, `beam` or `live`.")],
    out: Annotated[
        Path | None, output_file("File to write (default: RUN/report.html).", RUN_PAGE, metavar="FILE.html")
    ] = None,
) -> None:
    """Write an HTML page about RUN: tracks, ranges, beam and faults over time, key moments, run-times."""
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.reports.run_page import write_report

    require_matplotlib()
    unnamed = {"RUN": run / "report.html"} if out is None and run.is_dir() else {}
    check_kinds(unnamed, {"RUN": RUN_PAGE})
    with locked({}, unnamed):
        page = write_report(run, out)
    say_lack(run)
    typer.echo(f"look in {page}")
