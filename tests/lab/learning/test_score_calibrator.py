from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import expit

from foreglow.lab.evaluation.boxes.score_calibration import expected_calibration_error, log_loss
from foreglow.lab.learning.scores import (
    EACH_AS_ONE,
    BoxScores,
    Calibration,
    Calibrator,
    doubts_of,
    fit_calibrator,
    light_logits,
)


def drawn(num_samples: int = 20_000) -> tuple[Any, Any]:
    """Logits that say the truth, and labels drawn by them."""
    random = np.random.default_rng(0)
    logits = random.normal(-1.0, 2.0, num_samples)
    return logits, (random.random(num_samples) < expit(logits)).astype(np.int8)


@pytest.mark.parametrize("factor", [0.25, 1.0, 4.0])
def test_temperature_undoes_what_was_multiplied(factor: float) -> None:
    logits, labels = drawn(80_000)
    found = fit_calibrator(factor * logits[:, np.newaxis], labels)
    assert found.temperature == pytest.approx(factor, rel=0.05)
    assert found.shift == 0.0
    after = found.applied(factor * logits[:, np.newaxis])[:, 0]
    assert expected_calibration_error(expit(after), labels) < 0.01
    assert log_loss(after, labels) <= log_loss(factor * logits, labels)
    assert ((after > 0) == (logits > 0)).all()


def test_platt_also_undoes_a_shift() -> None:
    logits, labels = drawn()
    found = fit_calibrator(3.0 * (logits[:, np.newaxis] + 1.5), labels, "platt")
    assert found.temperature == pytest.approx(3.0, rel=0.05)
    assert found.shift == pytest.approx(-1.5, abs=0.1)


def test_kinds_are_calibrated_as_light_and_none() -> None:
    """Dividing and shifting the logits of all kinds is undone; which kind is the greatest stays."""
    logits, labels = drawn()
    random = np.random.default_rng(1)
    kinds = np.column_stack([random.normal(0.0, 1.0, (len(logits), 4)), np.zeros(len(logits))])
    kinds[:, :4] += (logits - light_logits(kinds))[:, np.newaxis]
    np.testing.assert_allclose(light_logits(kinds), logits, atol=1e-9)
    given = 2.0 * kinds
    given[:, :4] += 1.5
    found = fit_calibrator(given, labels, "platt")
    assert found.temperature == pytest.approx(2.0, rel=0.05)
    assert found.shift == pytest.approx(-0.75, abs=0.05)
    np.testing.assert_array_equal(found.applied(given)[:, :4].argmax(1), kinds[:, :4].argmax(1))


def test_no_calibration_and_no_samples() -> None:
    logits, labels = drawn(100)
    logits = logits[:, np.newaxis]
    assert fit_calibrator(logits, labels, "none") == Calibrator(1.0, 0.0)
    assert fit_calibrator(logits[:0], labels[:0]) == Calibrator(1.0, 0.0)


@pytest.mark.parametrize("num_outputs", [1, 5])
@pytest.mark.parametrize("method", ["temperature", "platt"])
@pytest.mark.parametrize("label", [0, 1])
def test_labels_of_one_kind_calibrate_nothing(num_outputs: int, method: Calibration, label: int) -> None:
    """The fit ended at its limits: every score was 0, or every one 1."""
    logits = np.random.default_rng(2).normal(0.0, 3.0, (50, num_outputs))
    with pytest.raises(ValueError, match="labels: expected boxes with and without an artifact, got "):
        fit_calibrator(logits, np.full(50, label, np.int8), method)


def test_a_perfect_network_gets_a_finite_temperature() -> None:
    found = fit_calibrator(np.array([[-3.0], [3.0]]), np.array([0, 1], np.int8))
    assert 0.0099 < found.temperature < 0.5


@pytest.mark.parametrize("method", ["temperature", "platt"])
def test_few_boxes_leave_doubts(method: Calibration) -> None:
    """The calibration error was told as 0.000, or F as 0.000, and no word why."""

    def doubts(logits: Any, labels: Any) -> list[str]:
        found = fit_calibrator(logits[:, np.newaxis], labels, method)
        return doubts_of(found, light_logits(found.applied(logits[:, np.newaxis])), labels)

    logits, labels = drawn(500)
    assert doubts(logits, labels) == []
    assert doubts_of(Calibrator(), logits, labels) == []
    told_apart, backwards = doubts(np.array([-0.5, -0.3, 0.4]), labels[:3] * 0 + [0, 0, 1]), doubts(-logits, labels)
    assert [line.split(",")[0] for line in told_apart] == ["the validation boxes are told apart without an error"]
    assert [line.split(":")[0] for line in backwards] == ["the temperature is at its limit"]


def test_scores_by_hand() -> None:
    logits, labels = np.array([3.0, 1.0, -1.0, 0.0, -2.0]), np.array([1, 0, 1, 1, 0], np.int8)
    assert EACH_AS_ONE.scores(logits, labels) == BoxScores(1 / 2, 1 / 3, 2 / 5)
    nothing = EACH_AS_ONE.scores(np.array([-1.0]), np.array([0], np.int8))
    assert np.isnan([nothing.precision, nothing.recall, nothing.f1]).all()


@pytest.mark.torch
def test_log_loss_by_hand_and_by_torch() -> None:
    assert log_loss(np.zeros(4), np.array([1, 1, 0, 0], np.int8)) == pytest.approx(np.log(2))
    assert log_loss(np.array([1000.0, -1000.0]), np.array([0, 0], np.int8)) == pytest.approx(500.0)
    torch = pytest.importorskip("torch")
    logits, labels = drawn(50)
    expected = torch.nn.functional.binary_cross_entropy_with_logits(
        torch.from_numpy(logits), torch.from_numpy(labels.astype(float)), pos_weight=torch.tensor(3.0)
    )
    assert log_loss(logits, labels, positive_weight=3.0) == pytest.approx(float(expected))


def test_calibration_error_by_hand() -> None:
    # Scores of 0.9 that are right half of the time, and of 0.1 that always are.
    logits = np.log(9) * np.array([1, 1, -1, -1])
    assert expected_calibration_error(expit(logits), np.array([1, 0, 0, 0], np.int8)) == pytest.approx((0.4 + 0.1) / 2)
