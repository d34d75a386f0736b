"""What `experiment occurrence` prints."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from foreglow.config import preset
from foreglow.lab.evaluation.occurrence import Sighting
from foreglow.lab.studies.occurrence.run import report_lines, run_experiment


def test_a_row_for_each_lead() -> None:
    expected = Sighting(0, 1.0, 1.0, 0.25, 3.0, is_covered=True)
    unexpected = Sighting(1, 0.5, math.nan, math.nan, math.nan, is_covered=False)
    remark, table, papers = report_lines([expected, unexpected])
    assert remark.startswith("Where a vehicle comes into sight")
    assert table.splitlines()[2:] == [
        "| 1 s | 1 | 1 | 1.00 deg | 100% | 100% | 3.0 deg | 0.25 s |",
        "| 0.5 s | 1 | 0 | – deg | – | – | – deg | – s |",
    ]
    assert papers.startswith("The paper has no value")
    assert report_lines([]) == ["No vehicle comes into sight after it was hidden."]


def test_without_a_model_nothing_is_expected() -> None:
    with pytest.raises(ValueError, match="beam: expected a model"):
        run_experiment(Path("a split"), preset("paper"))
