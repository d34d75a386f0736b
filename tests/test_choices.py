"""Every text of which a public function takes only some is checked: a wrong one would otherwise mean any of them."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import pytest
from pydantic import BaseModel

import foreglow
from foreglow.datasets import ImageFolder, Recording, Video, split_folder, split_in
from foreglow.datasets.exchange import LabelFile
from foreglow.datasets.pvdn import PVDN
from foreglow.datasets.source import FileSource
from foreglow.lab.learning.yolo import export_yolo
from foreglow.lab.simulation import Scene, draw_scenes, long_drives, with_beam
from foreglow.photometry import matrix_beam
from foreglow.runs.recorded_run import RecordedRun

COLOUR = np.zeros((64, 64, 3), np.uint8)

HERE = Path(__file__).parent

CASES: dict[str, tuple[str, Callable[[Any], object]]] = {
    "to_grey": ("order", lambda value: foreglow.to_grey(COLOUR, order=value)),
    "red_chroma": ("order", lambda value: foreglow.red_chroma(COLOUR, order=value)),
    "open_source": ("on_error", lambda value: foreglow.open_source(HERE, on_error=value)),
    "PVDN.__init__": ("on_error", lambda value: PVDN(HERE, on_error=value)),
    "ImageFolder.__init__": ("on_error", lambda value: ImageFolder(HERE, on_error=value)),
    "FileSource.__init__": ("on_error", lambda value: FileSource(HERE, on_error=value)),
    "Recording.__init__": ("on_error", lambda value: Recording(HERE / "a.mcap", on_error=value)),
    "Video.__init__": ("on_error", lambda value: Video(HERE / "a.mp4", on_error=value)),
    "LabelFile.__init__": ("on_error", lambda value: LabelFile(HERE / "a.json", on_error=value)),
    "split_folder": ("split", lambda value: split_folder(HERE, value)),
    "split_in": ("split", lambda value: split_in(HERE, value)),
    "export_yolo": ("splits", lambda value: export_yolo(HERE, HERE / "export", splits=("val", value))),
    "draw_scenes": ("split", lambda value: draw_scenes(1, 0, value)),
    "long_drives": ("split", lambda value: long_drives(1, 0, value)),
    "with_beam": ("beam", lambda value: with_beam(Scene(), value)),
    "matrix_beam": ("side", lambda value: matrix_beam(value)),
    "RecordedRun.to_pandas": ("table", lambda value: run().to_pandas(value)),
    "RecordedRun.write_parquet": ("table", lambda value: run().write_parquet(HERE / "a.parquet", value)),
}
"""By function, the argument as it is told, and how it is called."""

READ_ONLY = {"Artifact.__init__"}
"""Values that are only read from files, whose readers check them."""


def run() -> RecordedRun:
    return RecordedRun(HERE / "run", summary=typing.cast("Any", None), config=foreglow.preset("paper"), sequences={})


@pytest.mark.parametrize("value", ["RGB", "Val", "", None, 1, [], np.zeros(2)], ids=repr)
@pytest.mark.parametrize("name", CASES)
def test_another_text_is_refused(name: str, value: Any) -> None:
    argument, call = CASES[name]
    with pytest.raises(ValueError, match=rf"^(.*\.)?{argument}: expected ") as refused:
        call(value)
    assert len(str(refused.value)) < 400


def has_choices(hint: Any) -> bool:
    if typing.get_origin(hint) is Literal:
        return True
    return any(has_choices(part) for part in typing.get_args(hint) if not isinstance(part, str | int))


def packages() -> Iterator[ModuleType]:
    yield foreglow
    for found in pkgutil.walk_packages(foreglow.__path__, "foreglow."):
        if found.ispkg and not found.name.startswith(("foreglow.cli", "foreglow.runtime.ros2")):
            yield importlib.import_module(found.name)


def functions_of(entry: Any) -> list[Any]:
    """A function itself, or the methods of a class but those of pydantic's models, which check their own fields."""
    if inspect.isfunction(entry):
        return [entry]
    if not inspect.isclass(entry) or issubclass(entry, BaseModel):
        return []
    methods = inspect.getmembers(entry, inspect.isfunction)
    return [method for name, method in methods if name == "__init__" or not name.startswith("_")]


def test_none_is_forgotten() -> None:
    public = {
        function.__qualname__
        for package in packages()
        for name in getattr(package, "__all__", ())
        for function in functions_of(getattr(package, name))
        if any(has_choices(hint) for hint in hints_of(function))
    }
    assert public == CASES.keys() | READ_ONLY


def hints_of(function: Any) -> list[Any]:
    """The types of the arguments; one that is only imported for type checkers has none of these texts."""
    names = vars(inspect.getmodule(function)) | {"__builtins__": {}}
    found = []
    for name, text in inspect.get_annotations(function).items():
        if name != "return":
            try:
                found.append(typing.get_type_hints(type("_", (), {"__annotations__": {name: text}}), names)[name])
            except NameError:
                continue
    return found
