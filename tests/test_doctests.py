"""The examples in docstrings come out as they stand there."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

import foreglow

SOURCE = Path(foreglow.__file__).parent
MODULES = sorted(
    ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts).removesuffix(".__init__")
    for path in SOURCE.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)
SLOW = {"foreglow.lab.simulation"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in MODULES]
)
def test_examples(name: str) -> None:
    results = doctest.testmod(pytest.importorskip(name, reason="an extra is not installed"))
    assert results.failed == 0
    assert results.attempted, "an example stands where doctest does not look"
