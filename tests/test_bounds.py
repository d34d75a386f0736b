"""Every reader says in one line that a small file would become too much, before it takes memory or time."""

from __future__ import annotations

import importlib
import json
import re
import socket
import subprocess
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
from annotated_types import Ge, Gt, Le, Lt
from pydantic import Field
from pydantic.fields import FieldInfo

from foreglow.calibration.ros import _File as RosCalibration
from foreglow.calibration.values import Intrinsics, Mount
from foreglow.config import FrozenModel, PipelineConfig
from foreglow.datasets.simulated.production import ProductionConfig
from foreglow.datasets.vehicle_logs.mapping import CanMapping
from foreglow.lab.learning.recipes import Recipe
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.writing.lidar import LidarConfig
from foreglow.lab.simulation.writing.street_data import StreetDataError
from tests import bounded_reads
from tests.bombs import BOMBS

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, tuple[Path, str, str]]]:
    """By the name of a bomb: its path, the name of the exception that reading it raised, and the message."""
    folder = tmp_path_factory.mktemp("bombs")
    paths = {}
    for number, (name, (_, file, make, _)) in enumerate(BOMBS.items()):
        paths[name] = folder / str(number) / file
        paths[name].parent.mkdir()
        make(paths[name])
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = folder / "address"
        address.write_text(f"tcp://127.0.0.1:{mute.getsockname()[1]}")
        asked = [(BOMBS[name][0], str(path)) for name, path in paths.items()] + [("cluster", str(address))]
        command = [sys.executable, bounded_reads.__file__]
        done = subprocess.run(command, input=json.dumps(asked), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    named = {name: (paths[name], *found[number]) for number, name in enumerate(BOMBS)}
    yield named | {"a mute listener": (address, *found[-1])}
    for path in paths.values():
        if path.is_file():
            path.unlink()  # some are large


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_one_line(name: str, outcomes: dict[str, tuple[Path, str, str]]) -> None:
    path, error, message = outcomes[name]
    assert error == "ValueError", (error, message[:500])
    assert message.startswith(str(path))
    assert BOMBS[name][3] in message
    assert len(message) < 1000
    assert "\n" not in message


def test_a_scheduler_that_does_not_answer(outcomes: dict[str, tuple[Path, str, str]]) -> None:
    path, error, message = outcomes["a mute listener"]
    assert (error, message) == (
        "ConnectionError", f"--cluster {path.read_text()}: expected a dask scheduler, nothing answers there"
    )  # fmt: skip


def test_the_table_has_the_numbers_of_the_code() -> None:
    page = (Path(__file__).parents[1] / "docs" / "bounds.md").read_text()
    found = [
        (module, name, number)
        for module, constants in re.findall(r"^\|.*\| `([\w.]+)` \| (.*) \|$", page, re.MULTILINE)
        for name, number in re.findall(r"`(\w+)` = ([^,`]*(?:,\d{3})*(?: \w+)?)", constants)
    ]
    assert len(found) > 40
    units = {"GiB": 1 << 30, "MiB": 1 << 20, "KiB": 1 << 10, "": 1}
    for module, name, number in found:
        value, _, unit = number.replace(",", "").partition(" ")
        assert getattr(importlib.import_module(f"foreglow.{module}"), name) == float(value) * units[unit], name


def test_every_reader_has_a_bomb() -> None:
    assert {reader for reader, *_ in BOMBS.values()} | {"cluster"} == set(bounded_reads.READERS)


def unlimited(annotation: Any, limits: tuple[Any, ...], field: str, kinds: dict[type, bool]) -> Iterator[str]:
    """The numbers of `kinds` in a field, and in the models in it, that have no upper limit, or no lower one if True."""
    inner = [part for limit in limits for part in (limit.metadata if isinstance(limit, FieldInfo) else [limit])]
    if annotation in kinds:
        is_limited = any(isinstance(limit, Le | Lt) for limit in inner)
        if not is_limited or (kinds[annotation] and not any(isinstance(limit, Ge | Gt) for limit in inner)):
            yield field
    elif isinstance(annotation, type) and issubclass(annotation, FrozenModel):
        for name, known in annotation.model_fields.items():
            yield from unlimited(known.annotation, tuple(known.metadata), f"{field}.{name}", kinds)
    else:
        parts = typing.get_args(annotation)
        is_annotated = typing.get_origin(annotation) is typing.Annotated
        for part in parts[:1] if is_annotated else parts:
            yield from unlimited(part, limits + parts[1:] if is_annotated else limits, field, kinds)


@pytest.mark.parametrize(
    "model",
    [PipelineConfig, Recipe, Scene, CameraProfile, ProductionConfig, CanMapping, Intrinsics, Mount, RosCalibration],
)
def test_every_whole_number_that_a_user_writes_has_an_upper_limit(model: type[FrozenModel]) -> None:
    assert list(unlimited(model, (), model.__name__, {int: False})) == []


@pytest.mark.parametrize("model", [Scene, CameraProfile, ProductionConfig, StreetDataError, LidarConfig])
def test_every_number_of_a_simulation_has_both_limits(model: type[FrozenModel]) -> None:
    assert list(unlimited(model, (), model.__name__, {int: True, float: True})) == []


def test_a_number_without_a_limit_is_found() -> None:
    class Part(FrozenModel):
        free: tuple[float, Annotated[float, Field(ge=0)]] | None = None

    class Whole(FrozenModel):
        parts: Annotated[tuple[Part, ...], Field(max_length=3)] = ()
        count: Annotated[int, Field(le=3)] = 1
        share: Annotated[float, Field(ge=0, lt=1)] = 0.5

    found = ["w.parts.free", "w.parts.free", "w.count"]
    assert list(unlimited(Whole, (), "w", {int: True, float: True})) == found
    assert list(unlimited(Whole, (), "w", {int: False})) == []
