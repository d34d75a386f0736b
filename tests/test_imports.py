"""Imports point one way only, and never in a circle; the command line and the package start light."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

import foreglow

SOURCE = Path(foreglow.__file__).parent

VALUES = {"types", "geometry", "config", "photometry", "rays", "street", "numbers", "wording"}
STAGES = {"proposals", "classifier", "distance", "tracking", "beam"}
BASES = {"files", "whole_files", "provenance", "parallel", "plugins", "stopwatch", "own_files"}
CAR = VALUES | STAGES | BASES | {"calibration", "maps", "_native", "pipeline", "datasets", "runs", "runtime", "display"}
LAB = {"lab.simulation", "lab.evaluation", "lab.learning", "lab.reports", "lab.studies"}

ALLOWED: dict[str, set[str]] = {
    "whole_files": set(),
    "wording": set(),
    "numbers": {"wording"},
    "files": {"whole_files", "wording"},
    "provenance": set(),
    "plugins": set(),
    "parallel": {"numbers", "plugins"},
    "stopwatch": set(),
    "models": set(),
    "protobuf": set(),
    "_native": set(),
    "geometry": {"numbers", "wording"},
    "types": {"geometry", "numbers", "wording"},
    "config": {"types", "geometry", "files", "numbers", "wording"},
    "photometry": {"types", "geometry", "config", "files", "numbers", "wording"},
    "rays": {"types", "geometry"},
    "street": {"types", "geometry", "config"},
    "calibration": {"types", "geometry", "config", "files", "wording"},
    "maps": {"types", "geometry", "street", "files", "numbers", "wording"},
    **{stage: VALUES | {"models", "_native", "plugins"} for stage in STAGES},
    "classifier": VALUES | {"models", "_native", "files", "own_files", "protobuf"},
    "pipeline": VALUES | STAGES | {"plugins", "stopwatch"},
    "datasets": VALUES | {"calibration", "maps", "files", "whole_files", "folder_lock", "own_files", "protobuf"},
    "runs": VALUES
    | {
        "own_files",
        "calibration",
        "files",
        "whole_files",
        "folder_lock",
        "outputs",
        "own_folders",
        "provenance",
        "models",
        "datasets",
    },
    "runtime": VALUES
    | STAGES
    | BASES
    | {"calibration", "maps", "folder_lock", "outputs", "own_folders", "pipeline", "datasets", "runs"},
    "display": VALUES | {"own_files", "files", "whole_files", "plugins", "datasets", "runs", "runtime"},
    "folder_lock": {"whole_files"},
    "own_files": {"whole_files"},
    "checksums": {"whole_files"},
    "own_folders": {"checksums", "own_files", "whole_files"},
    "outputs": {"own_folders", "files", "whole_files", "own_files", "datasets"},
    "inputs": {"files", "outputs", "own_folders"},
    "command_line": {"files", "inputs", "folder_lock", "outputs", "own_folders", "own_files", "wording"},
    "options": {
        "command_line",
        "config",
        "beam",
        "classifier",
        "datasets",
        "files",
        "outputs",
        "own_folders",
        "own_files",
        "parallel",
        "plugins",
    },
    "lab": set(),
    "lab.simulation": VALUES
    | BASES
    | {
        "folder_lock",
        "outputs",
        "own_folders",
        "calibration",
        "maps",
        "proposals",
        "beam",
        "datasets",
        "runtime",
        "display",
    },
    "lab.evaluation": CAR | {"checksums", "outputs", "own_folders"},
    "lab.learning": CAR
    | {"models", "folder_lock", "checksums", "outputs", "own_folders", "lab.simulation", "lab.evaluation"},
    "lab.reports": CAR | {"checksums", "outputs", "own_folders", "lab.simulation", "lab.evaluation", "lab.learning"},
    "lab.studies": CAR
    | {"models", "command_line", "options", "checksums", "inputs"}
    | {"lab.simulation", "lab.evaluation", "lab.learning", "lab.reports"},
    "foreglow": CAR | LAB,
    "cli": CAR | LAB | {"command_line", "options", "folder_lock", "outputs", "own_folders", "foreglow"},
}
"""For every room, the other rooms that it may import; "foreglow" is the package's own file, with names of all rooms."""


class Import(NamedTuple):
    importer: str
    imported: str
    file: str
    line: int


def room_of(module: str) -> str:
    """The room of a module: `runtime.run` is in `runtime`, `lab.reports.page` in `lab.reports`.

    The package's own file has no name here, and a room called `foreglow`.
    """
    return ".".join(module.split(".")[: 2 if module.startswith("lab.") else 1]) or "foreglow"


def imports_in(source: Path) -> list[Import]:
    """What the files in the package `source` import of it anywhere, also inside functions and for types only.

    Modules are named without the package; the C++ core is one by its stub.
    """
    files = {}
    for path in sorted(source.rglob("*.py*")):
        if path.suffix in {".py", ".pyi"}:
            parts = path.relative_to(source.parent).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    found = []
    for importer, path in files.items():
        package = importer if path.stem == "__init__" else importer.rpartition(".")[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
                names = [f"{base}.{alias.name}" for alias in node.names]
                names = [name if name in files else base for name in names]
            else:
                continue
            for name in dict.fromkeys(names):
                if name.split(".")[0] == source.name:
                    own, other = (module[len(source.name) + 1 :] for module in (importer, name))
                    found.append(Import(own, other, str(path.relative_to(source)), node.lineno))
    return found


def reachable_from(module: str, arrows: dict[str, set[str]]) -> set[str]:
    """The modules that `module` imports, and those that these import, and so on."""
    reached: set[str] = set()
    waiting = [module]
    while waiting:
        new = arrows.get(waiting.pop(), set()) - reached
        reached |= new
        waiting += new
    return reached


def breaches_of(imports: list[Import]) -> dict[tuple[str, str], str]:
    """Imports that the table does not allow, or that are part of a circle of files, with what to say of each."""
    arrows: dict[str, set[str]] = {}
    for found in imports:
        arrows.setdefault(found.importer, set()).add(found.imported)
    reached = {module: reachable_from(module, arrows) for module in arrows}
    breaches = {}
    for importer, imported, file, line in imports:
        room, other = room_of(importer), room_of(imported)
        where = f"{file}:{line}: imports {imported}"
        if room not in ALLOWED:
            breaches[importer, imported] = f"{where}, but the room {room} is not in the table"
        elif other not in ALLOWED[room] | {room}:
            breaches[importer, imported] = f"{where}, which {room} may not"
        elif importer in reached.get(imported, set()):
            breaches[importer, imported] = f"{where}, which leads back to it"
    return breaches


def test_imports_point_one_way() -> None:
    breaches = breaches_of(imports_in(SOURCE)).values()
    assert not breaches, "\n".join(["imports against the plan", *breaches])


def test_the_table_has_no_circle_and_only_rooms_that_there_are() -> None:
    assert set(TopologicalSorter(ALLOWED).static_order()) == ALLOWED.keys()
    there = {path.stem for path in SOURCE.iterdir()} | {f"lab.{path.stem}" for path in (SOURCE / "lab").iterdir()}
    assert ALLOWED.keys() - {"foreglow", "_native"} <= there


def write_package(folder: Path, files: dict[str, str]) -> Path:
    source = folder / "foreglow"
    for name, text in {"__init__.py": "", **files}.items():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(text)
    return source


def test_every_form_of_import_is_seen(tmp_path: Path) -> None:
    text = (
        "import foreglow.runtime.run\nfrom foreglow import config, preset\nfrom . import pvdn, made\n"
        "from ..beam import guard\ndef f():\n    from foreglow.tracking.tracker import Tracker\nimport numpy\n"
    )
    files = {
        "datasets/images.py": text,
        "datasets/pvdn.py": "",
        "config.py": "",
        "beam/__init__.py": "",
        "beam/guard.py": "",
    }
    imported = [(found.imported, found.line) for found in imports_in(write_package(tmp_path, files))]
    expected = [("runtime.run", 1), ("config", 2), ("", 2), ("datasets.pvdn", 3), ("datasets", 3), ("beam.guard", 4)]
    assert sorted(imported) == sorted([*expected, ("tracking.tracker", 6)])


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"files.py": "\nimport foreglow.runs"}, ["files.py:2: imports runs, which files may not"]),
        ({"lab/evaluation/a.py": "import foreglow.lab.simulation"}, ["which lab.evaluation may not"]),
        ({"runtime/a.py": "import foreglow.lab"}, ["which runtime may not"]),
        ({"attic/a.py": "import foreglow.files"}, ["the room attic is not in the table"]),
        ({"runs/a.py": "import foreglow.runs.a"}, ["which leads back"]),
        (
            {
                "runs/a.py": "import foreglow.runs.b",
                "runs/b.py": "import foreglow.runs.c",
                "runs/c.py": "from foreglow.runs import a, b",
            },
            [
                "runs/a.py:1: imports runs.b, which leads back",
                "runs/b.py:1: ",
                "runs/c.py:1: imports runs.a",
                "runs/c.py:1: ",
            ],
        ),
        (
            {
                "lab/studies/a.py": "import foreglow.lab.studies.b, foreglow.display",
                "lab/studies/b.py": "import foreglow.files",
            },
            [],
        ),
    ],
)
def test_breaches_are_told(tmp_path: Path, files: dict[str, str], said: list[str]) -> None:
    breaches = list(breaches_of(imports_in(write_package(tmp_path, files))).values())
    assert len(breaches) == len(said)
    assert all(part in text for part, text in zip(said, breaches, strict=True))


def modules_after(statement: str) -> set[str]:
    """The modules that are loaded once `statement` has run in a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


HEAVY = {"numpy", "scipy", "onnxruntime", "onnx", "av", "cv2", "torch", "pydantic"}


def test_command_line_starts_without_heavy_modules() -> None:
    assert not HEAVY & modules_after("import foreglow.cli")


def test_package_is_imported_lazily() -> None:
    assert not HEAVY & modules_after("import foreglow\nforeglow.__version__")


@pytest.mark.slow
def test_readers_and_runners_need_no_stage_until_there_is_a_pipeline() -> None:
    loaded = modules_after("import foreglow.pipeline, foreglow.runtime, foreglow.datasets, foreglow.lab.evaluation")
    assert not {"asyncio", "av", "torch", "onnx", "onnxruntime", "scipy", "foreglow.tracking"} & loaded


@pytest.mark.slow
def test_a_run_does_not_load_the_simulator_to_tell_what_its_camera_resembles() -> None:
    assert not {"scipy", "foreglow.lab.simulation.drive"} & modules_after(
        "import foreglow.lab.simulation.camera.likeness"
    )


@pytest.mark.parametrize("name", foreglow.__all__)
def test_public_names_exist(name: str) -> None:
    assert getattr(foreglow, name) is not None
    assert name in dir(foreglow)


def test_unknown_public_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = foreglow.nothing
