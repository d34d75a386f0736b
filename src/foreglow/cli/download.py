"""`download`: data sets from the network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.options import argument, folder, with_options


@app.command()
@with_options
def download(
    dataset: Annotated[str, argument("DATASET", "Name of the data set: pvdn.")],
    out: Annotated[Path, folder("Folder to put it into.")] = Path("PVDN"),
) -> None:
    """Download a data set."""
    if dataset != "pvdn":
        raise ValueError(f"download: expected pvdn, got {dataset!r}")
    from foreglow.datasets import download_pvdn

    typer.echo(f"PVDN is in {download_pvdn(out)}")
