from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.config import PipelineConfig, preset
from foreglow.distance.hypotheses import parameters_of, read_hypotheses
from foreglow.lab.learning import ranges
from foreglow.lab.learning.ranges import FITTED, PRIOR, fit_ranges, ranged_views, write_hypotheses
from tests.lab.learning.shipped_splits import make_shipped_splits

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_shipped_splits(tmp_path_factory.mktemp("drives"))


CONFIG = preset("foreglow")


def test_views_hold_every_light_with_a_box_and_a_range(data: Path) -> None:
    views = list(ranged_views(data / "val", CONFIG))
    assert views
    for view in views:
        assert len(view.truth_m) == len(view.view.boxes.directions_rad)
        assert (view.truth_m > 0).all()
        assert view.view.road is not None


def test_fitting_moves_what_is_fitted_and_nothing_else(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ranges, "EPOCHS", 2)
    reported: list[str] = []
    start = read_hypotheses(PRIOR)
    model = fit_ranges(
        data, CONFIG, seed=1, progress=lambda step, done, total: reported.append(f"{step} {done}/{total}")
    )
    before, after = parameters_of(start), parameters_of(model)
    for name in before._fields:
        is_same = np.array_equal(getattr(before, name), getattr(after, name))
        assert is_same == (name not in FITTED), name
    assert reported[-1] == "epochs 2/2"
    assert "lights of" in model.origin


@pytest.mark.parametrize("truths_m", [[[50.0]], [[50.0], [50.0, 50.0]], [[50.0] * 400, [90.0, 20.0]]])
def test_lights_at_one_range_count_the_same(truths_m: list[list[float]], data: Path) -> None:
    view = next(ranged_views(data / "val", CONFIG)).view
    balance = ranges._balance([ranges.RangedView(view, np.array(truth_m)) for truth_m in truths_m])
    assert np.concatenate(balance) == pytest.approx(1.0)


def test_a_model_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    model = read_hypotheses()
    write_hypotheses(path, model)
    assert read_hypotheses(path) == model


def test_drives_without_known_ranges_cannot_be_fitted_on(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        fit_ranges(tmp_path, PipelineConfig())
