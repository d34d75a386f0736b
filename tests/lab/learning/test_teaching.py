"""Networks that learn what other models say."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from foreglow.classifier import FEATURES, InputSpec  # noqa: E402
from foreglow.lab.learning.batches import kind_targets  # noqa: E402
from foreglow.lab.learning.checkpoints import check_begun  # noqa: E402
from foreglow.lab.learning.model_export import write_model  # noqa: E402
from foreglow.lab.learning.networks import CompactNetwork, RelatedNetwork  # noqa: E402
from foreglow.lab.learning.recipes import changed  # noqa: E402
from foreglow.lab.learning.samples import Samples  # noqa: E402
from foreglow.lab.learning.teaching import read_teachers, taught_kinds  # noqa: E402
from foreglow.lab.learning.training import score_samples, train  # noqa: E402
from foreglow.types import KINDS  # noqa: E402
from tests.lab.learning.test_related import RECIPE as RELATED  # noqa: E402

pytestmark = pytest.mark.torch

ALONE = InputSpec(32, 2, None, 9, None)
SPEC = RELATED.inputs
RECIPE = changed(
    RELATED,
    {
        "epochs": 8,
        "batch_size": 32,
        "learning_rate": 0.003,
        "kinds": True,
        "calibration": "none",
        "augmentation": {"flip": 0.0, "feature_noise": 0.0},
    },
)


def samples_of(num_sets: int, seed: int) -> Samples:
    """Sets of four boxes, whose features are random and whose labels follow from nothing."""
    random, count = np.random.default_rng(seed), 4 * num_sets
    labels = random.integers(0, 2, count).astype(np.int8)
    kinds = np.zeros((count, len(KINDS)), np.float32)
    kinds[np.arange(count), np.where(labels, 0, len(KINDS) - 1)] = 1.0
    return Samples(
        crops=np.full((count, 1, 32, 32), 128, np.uint8),
        features=random.uniform(-1, 1, (count, len(FEATURES))).astype(np.float32),
        labels=labels,
        kinds=kinds,
        groups=np.where(labels, 0, -1).astype(np.int8),
        boxes_xyxy_px=np.tile(np.array([0, 0, 4, 4], np.int32), (count, 1)),
        image_ids=np.repeat(np.arange(num_sets), 4),
        sequence_ids=np.zeros(count, np.int64),
        sets=np.repeat(np.arange(num_sets, dtype=np.int32), 4),
    )


def models(folder: Path) -> list[Path]:
    """One that judges each box alone, by its darkest level, and one that compares boxes."""
    torch.manual_seed(0)
    alone = CompactNetwork(ALONE.num_channels, ALONE.num_features, len(KINDS)).eval()
    with torch.no_grad():
        alone.hidden.weight.zero_()
        alone.hidden.weight[0, -ALONE.num_features] = 4.0
        alone.last.weight.zero_()
        alone.last.weight[0, 0] = 2.0
    related = RelatedNetwork(SPEC.num_channels, SPEC.num_features, len(KINDS)).eval()
    write_model(alone, ALONE, folder / "alone.onnx", {})
    write_model(related, SPEC, folder / "related.onnx", {})
    return [folder / "alone.onnx", folder / "related.onnx"]


def test_teachers_say_the_mean_of_their_logits(tmp_path: Path) -> None:
    samples = samples_of(5, 1)
    first, second = teachers = read_teachers(models(tmp_path), SPEC)
    narrow = dataclasses.replace(samples, features=samples.features[:, :9])
    each = [
        score_samples(teacher.network, read, torch.device("cpu"))
        for teacher, read in ((first, narrow), (second, samples))
    ]
    odds = np.exp((each[0] + each[1]) / 2)
    np.testing.assert_allclose(
        taught_kinds(teachers, samples), odds / odds.sum(axis=1, keepdims=True), rtol=1e-4, atol=1e-6
    )


def test_a_network_learns_what_its_teacher_says_and_not_the_labels(tmp_path: Path) -> None:
    """Labels follow from nothing here; what the teacher says follows from a feature."""
    learnt, unseen = samples_of(150, 1), samples_of(40, 2)
    teachers = read_teachers(models(tmp_path)[:1], SPEC)
    wanted = taught_kinds(teachers, unseen)
    losses = []
    for taught in (taught_kinds(teachers, learnt), None):
        recipe = changed(RECIPE, {"taught": 1.0})
        result = train(recipe, learnt, unseen, tmp_path / str(taught is None), taught=taught, device="cpu")
        logits = score_samples(result.network, unseen, torch.device("cpu")).astype(np.float64)
        logits -= np.log(np.exp(logits).sum(axis=1, keepdims=True))
        losses.append(float(-(wanted * logits).sum(axis=1).mean()))
    entropy = float(-(wanted * np.log(wanted)).sum(axis=1).mean())
    assert losses[0] - entropy < 0.2 * (losses[1] - entropy)


def test_another_teaching_does_not_go_on(tmp_path: Path) -> None:
    learnt, unseen = samples_of(20, 1), samples_of(5, 2)
    recipe = changed(RECIPE, {"epochs": 1})
    said = kind_targets(learnt, 1.0)
    train(recipe, learnt, unseen, tmp_path, taught=said, device="cpu")
    with pytest.raises(ValueError, match=r"checkpoint\.pt: teachers: expected that of the training begun here"):
        train(recipe, learnt, unseen, tmp_path, taught=said[::-1], device="cpu")


def test_a_training_with_teachers_goes_on(tmp_path: Path) -> None:
    """Also by the recipe alone, which is looked at before samples are made."""
    learnt, unseen = samples_of(20, 1), samples_of(5, 2)
    said = kind_targets(learnt, 1.0)
    recipe = changed(RECIPE, {"epochs": 1})
    train(recipe, learnt, unseen, tmp_path, taught=said, device="cpu")
    check_begun(tmp_path, recipe.model_dump(mode="json"))
    assert len(train(recipe, learnt, unseen, tmp_path, taught=said, device="cpu").epochs) == 1
    with pytest.raises(
        ValueError, match=r"checkpoint\.pt: taught: expected that of the training begun here, 0\.8, got"
    ):
        check_begun(tmp_path, changed(recipe, {"taught": 0.5}).model_dump(mode="json"))


def test_teachers_that_read_something_else(tmp_path: Path) -> None:
    alone, related = models(tmp_path)
    words = r"expected a teacher that reads what the recipe's network does, "
    with pytest.raises(ValueError, match=rf"related\.onnx: \w+: {words}at most \w+, got \w+$"):
        read_teachers([alone, related], ALONE)
    with pytest.raises(ValueError, match=rf"alone\.onnx: support: {words}{SPEC.support + 1}, got {SPEC.support}$"):
        read_teachers([alone], dataclasses.replace(SPEC, support=SPEC.support + 1))
    torch.manual_seed(0)
    write_model(CompactNetwork(1, 9, 1).eval(), ALONE, tmp_path / "one.onnx", {})
    with pytest.raises(ValueError, match=r"one\.onnx: .*tells the kinds of light, got one that does not"):
        read_teachers([tmp_path / "one.onnx"], SPEC)
    with pytest.raises(FileNotFoundError, match=r"none\.onnx"):
        read_teachers([tmp_path / "none.onnx"], SPEC)
