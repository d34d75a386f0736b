"""`experiment simulator`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.command_line import argument, file
from foreglow.options import ReportOption


def command(
    data: Annotated[Path, argument("DATA", "A simulated split, such as DATA/day/test.")],
    out: ReportOption,
    real_labels: Annotated[
        Path | None, file("Real labels to compare with: PVDN/night/val, or a JSON digest of its labels.")
    ] = None,
    real_image: Annotated[Path | None, file("Real image to compare with, of the same exposure.")] = None,
) -> None:
    """Compare simulated drives with real ones: labels, pixels, and the lead time of indirect light."""
    from foreglow.lab.studies.simulator.page import summary_lines, write_report
    from foreglow.lab.studies.simulator.run import examine

    results = examine(data, real_labels, real_image)
    report = write_report(results, out)
    typer.echo("\n".join([f"measured on {results.name}", *summary_lines(results), f"look in {report}"]))
