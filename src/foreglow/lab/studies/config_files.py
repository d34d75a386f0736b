"""What decides a study's results beside its configuration: the files that this names."""

from __future__ import annotations

from pathlib import Path

from foreglow.config import PipelineConfig
from foreglow.inputs import named_by
from foreglow.models import model_path
from foreglow.plugins import source_files

MODULE = "module "
"""What the names of modules begin with."""


def files_of(config: PipelineConfig) -> dict[str, Path]:
    """By name, the models and lamps of a configuration, and the tables that lamps name, as far as they exist.

    So are the modules of what is plugged in, once the stages were made.
    """
    sections = config.model_dump().values()
    given = {str(each): model_path(each) for fields in sections for each in fields.values() if isinstance(each, Path)}
    texts = {name: path for name, path in given.items() if path.suffix.lower() == ".toml"}
    modules = {f"{MODULE}{name}": path for name, path in source_files().items()}
    return {name: path for name, path in (given | named_by(texts) | modules).items() if path.is_file()}
