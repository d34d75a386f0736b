"""`download`: data sets from the network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foreglow.cli.app import app
from foreglow.command_line import argument, file, folder, with_options


@app.command()
@with_options
def download(
    dataset: Annotated[str, argument("DATASET", "Name of the data set: pvdn.")],
    out: Annotated[Path | None, folder("Folder to put it into (default: PVDN).")] = None,
    check: Annotated[
        Path | None, file("Download nothing: count the copy in this folder, and name what is missing.", metavar="DIR")
    ] = None,
) -> None:
    """Download a data set, or check a download; exit code 2 means that something is missing."""
    if dataset != "pvdn":
        raise ValueError(f"download: expected pvdn, got {dataset!r}")
    if check is not None:
        if out is not None:
            raise ValueError("download: expected --out or --check, got both")
        _check(check)
        return
    from foreglow.datasets import download_pvdn

    typer.echo(f"PVDN is in {download_pvdn(out or Path('PVDN'))}")


def _check(copy: Path) -> None:
    """Prints what is there of each split; exits with 2 if that is not all."""
    import rich
    from rich.table import Table

    from foreglow.datasets.pvdn.download import count_pvdn

    counts = count_pvdn(copy)
    table = Table("", "scenes", "of", "images", "of", title=str(copy), title_justify="left")
    rows = [(row.num_scenes, row.num_stated_scenes, row.num_images, row.num_stated_images) for row in counts]
    names = [*(row.name for row in counts), "all"]
    for name, row in zip(names, [*rows, map(sum, zip(*rows, strict=True))], strict=True):
        table.add_row(name, *map(str, row))
    rich.print(table)
    missing = [line for row in counts for line in row.missing]
    typer.echo("\n".join(missing) if missing else "nothing is missing")
    if missing:
        raise typer.Exit(2)
