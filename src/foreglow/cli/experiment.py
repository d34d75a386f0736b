"""`experiment`: what `lab.studies` registers, each a command."""

from __future__ import annotations

import importlib

import typer

from foreglow.cli.app import app
from foreglow.lab.studies import STUDIES
from foreglow.options import with_options

experiment = typer.Typer(no_args_is_help=True, help="Run an experiment: figures, tables and a report in a folder.")
app.add_typer(experiment, name="experiment")

for _name, _module in STUDIES.items():
    experiment.command(_name)(with_options(importlib.import_module(_module).command))
