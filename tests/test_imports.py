"""Imports point one way only, as the house style draws it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import foreglow

SOURCE = Path(foreglow.__file__).parent
VALUES = {"types", "geometry", "rays", "photometry", "config", "calibration", "street"}
STAGES = {"proposals", "classifier", "distance", "tracking", "beam"}
BASE = {"files", "provenance", "scale"}
TOOLS = {"evaluation", "learning", "experiments", "runtime"}

ALLOWED: dict[str, set[str]] = {
    "files": set(),
    "models": set(),
    "provenance": set(),
    "scale": set(),
    "geometry": set(),
    "types": {"geometry"},
    "rays": {"types", "geometry"},
    "photometry": {"types", "geometry", "config"},
    "config": {"types", "geometry"},
    "street": {"types", "geometry", "config"},
    "calibration": {"types", "geometry", "config", "files"},
    "maps": {"types", "geometry", "street", "files"},
    **{stage: VALUES | {"_native", "models"} for stage in STAGES},
    "pipeline": VALUES | STAGES,
    "datasets": VALUES | {"files", "maps"},
    "simulation": VALUES | {"files", "scale", "datasets"},
    **{tool: VALUES | STAGES | BASE | {"pipeline", "datasets", "simulation"} for tool in ("evaluation", "runtime")},
    "learning": VALUES | STAGES | BASE | {"_native"} | {"pipeline", "datasets", "simulation", "evaluation"},
    "experiments": VALUES | STAGES | BASE | {"pipeline", "datasets", "simulation", "evaluation", "learning", "runtime"},
    "reports": VALUES | TOOLS | BASE | {"simulation"},
    "cli": VALUES | STAGES | TOOLS | BASE | {"pipeline", "datasets", "simulation", "reports", ""},
    "": VALUES | {"pipeline", "datasets", "evaluation", "proposals"},
}
"""For every part, the other parts that it may import; "" is the package itself."""


def part_of(module: str) -> str:
    """The part of the package that `module` belongs to: `foreglow.runtime.run` is in `runtime`."""
    return module.split(".")[1] if "." in module else ""


def imported_parts(path: Path, package: str) -> set[str]:
    """The parts that the file imports anywhere, also inside functions and for type checking only."""
    parts = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            parts |= {part_of(alias.name) for alias in node.names if alias.name.split(".")[0] == "foreglow"}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                kept = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*kept, base]).rstrip(".")
            if base == "foreglow":
                parts |= {
                    alias.name if alias.name in ALLOWED or alias.name == "_native" else "" for alias in node.names
                }
            elif base.startswith("foreglow."):
                parts.add(part_of(base))
    return parts


FILES = sorted(SOURCE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(SOURCE)) for path in FILES])
def test_imports_point_one_way(path: Path) -> None:
    relative = path.relative_to(SOURCE).with_suffix("")
    part = "" if relative.name == "__init__" and len(relative.parts) == 1 else relative.parts[0]
    package = ".".join(["foreglow", *relative.parts[:-1]])
    forbidden = imported_parts(path, package) - ALLOWED[part] - {part}
    assert not forbidden, f"{part or 'foreglow'} imports {sorted(forbidden)}"


def test_the_walk_sees_every_form(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(
        "import foreglow.runtime.run\nfrom foreglow import _native, config\nfrom . import x\nfrom ..beam import guard\n"
        "def f():\n    from foreglow.tracking.tracker import Tracker\n"
    )
    expected = {"runtime", "_native", "config", "datasets", "beam", "tracking"}
    assert imported_parts(path, "foreglow.datasets") == expected


def modules_after(statement: str) -> set[str]:
    """The modules that are loaded once `statement` has run in a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


HEAVY = {"numpy", "scipy", "onnxruntime", "onnx", "av", "cv2", "torch", "pydantic"}


def test_command_line_starts_without_heavy_modules() -> None:
    assert not HEAVY & modules_after("import foreglow.cli")


def test_package_is_imported_lazily() -> None:
    assert not HEAVY & modules_after("import foreglow\nforeglow.__version__")


def test_inference_needs_nothing_of_training() -> None:
    assert not {"torch", "onnx"} & modules_after("import foreglow.pipeline, foreglow.runtime, foreglow.datasets")


@pytest.mark.parametrize("name", foreglow.__all__)
def test_public_names_exist(name: str) -> None:
    assert getattr(foreglow, name) is not None
    assert name in dir(foreglow)


def test_unknown_public_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = foreglow.nothing
