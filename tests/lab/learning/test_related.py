"""Networks that compare the boxes of a frame: as models, in training, and what they learn that others cannot."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from foreglow.classifier import FEATURES, InputSpec, OnnxClassifier  # noqa: E402
from foreglow.classifier.inputs import InputMaker  # noqa: E402
from foreglow.classifier.onnx import MAX_TOGETHER  # noqa: E402
from foreglow.config import ClassifierConfig  # noqa: E402
from foreglow.lab.learning.augmentation import COLUMN, PLACES, SIDE, SIZES, augment  # noqa: E402
from foreglow.lab.learning.batches import set_batches  # noqa: E402
from foreglow.lab.learning.model_export import calibrated, largest_difference, write_model  # noqa: E402
from foreglow.lab.learning.networks import (  # noqa: E402
    BothNetwork,
    Hearing,
    RelatedNetwork,
    learnt_logits,
    light_of,
    logits_of,
)
from foreglow.lab.learning.recipes import RECIPES, Augmentation, Recipe, changed  # noqa: E402
from foreglow.lab.learning.samples import Samples, joined, set_sizes  # noqa: E402
from foreglow.lab.learning.scores import Calibrator  # noqa: E402
from foreglow.lab.learning.training import score_samples, train  # noqa: E402
from foreglow.types import KINDS, Frame, Proposals  # noqa: E402

pytestmark = pytest.mark.torch

SPEC = InputSpec(32, 2, None, len(FEATURES), None, together=True)
CPU = torch.device("cpu")


COMPARING = pytest.mark.parametrize("make", [RelatedNetwork, BothNetwork])


def network(seed: int = 0, make: type[RelatedNetwork | BothNetwork] = RelatedNetwork) -> Any:
    """A network whose batch normalisations have seen something."""
    torch.manual_seed(seed)
    made = make(SPEC.num_channels, SPEC.num_features, 1).train()
    made(torch.rand(64, 1, 32, 32), torch.rand(64, len(FEATURES)), [40, 24])
    return made.eval()


def pairs(num_sets: int, seed: int) -> Samples:
    """Boxes all alike but for their places: in sets with light, each has another at its height on the other side."""
    random = np.random.default_rng(seed)
    features, labels, sets = [], [], []
    for number in range(num_sets):
        is_lit = bool(random.random() < 0.5)
        rows, sides = random.uniform(-0.8, 0.8, 3), random.uniform(0.2, 1.5, 3)
        row = np.concatenate([rows, rows if is_lit else random.uniform(-0.8, 0.8, 3)])
        side = np.concatenate([sides, -sides if is_lit else -random.uniform(0.2, 1.5, 3)])
        each = np.full((6, len(FEATURES)), 0.5, np.float32)
        each[:, FEATURES.index("row")], each[:, FEATURES.index("side")] = row, side
        each[:, FEATURES.index("column")] = np.abs(side)
        features.append(each)
        labels += [is_lit] * 6
        sets += [number] * 6
    count = len(labels)
    return Samples(
        crops=np.full((count, 1, 32, 32), 128, np.uint8),
        features=np.concatenate(features),
        labels=np.array(labels, np.int8),
        kinds=np.zeros((count, 5), np.float32),
        groups=np.where(labels, 0, -1).astype(np.int8),
        boxes_xyxy_px=np.tile(np.array([0, 0, 4, 4], np.int32), (count, 1)),
        image_ids=np.array(sets, np.int64),
        sequence_ids=np.zeros(count, np.int64),
        sets=np.array(sets, np.int32),
    )


RECIPE = Recipe(
    network="related",
    inputs=SPEC,
    epochs=12,
    batch_size=64,
    optimiser="adamw",
    learning_rate=0.005,
    weight_decay=0.0,
    schedule="cosine",
    positive_weight="equal",
    augmentation=Augmentation(flip=0.5, feature_noise=0.2),
)


@pytest.mark.slow
def test_it_learns_what_no_box_shows_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hearing, "LARGEST_SHARE", 0.1)  # few epochs are enough then
    judged = pairs(100, 2)
    num_light = judged.num_labelled(1)
    blind = 2 * num_light / (num_light + len(judged))  # the best F of boxes that are all alike
    assert train(RECIPE, pairs(400, 1), judged, tmp_path).best.f1 > (1 + blind) / 2


@COMPARING
def test_sets_of_a_batch_do_not_know_of_each_other(make: type[RelatedNetwork | BothNetwork]) -> None:
    made, samples = network(make=make), pairs(4, 1)
    crops, features = torch.from_numpy(samples.crops).float() / 255, torch.from_numpy(samples.features)
    with torch.inference_mode():
        together = made(crops, features, set_sizes(samples.sets)).numpy()
        alone = made(crops[6:12], features[6:12]).numpy()
        mixed = made(crops, features).numpy()
    np.testing.assert_allclose(together[6:12], alone, atol=1e-5)
    assert np.abs(mixed[6:12] - alone).max() > 1e-3, "a set is told something by its own boxes only"
    np.testing.assert_allclose(score_samples(made, samples, CPU), together, atol=1e-5)


@COMPARING
def test_frames_without_boxes_change_nothing(make: type[RelatedNetwork | BothNetwork]) -> None:
    made, samples = network(make=make), pairs(2, 1)
    crops, features = torch.from_numpy(samples.crops).float() / 255, torch.from_numpy(samples.features)
    with torch.inference_mode():
        wanted = made(crops, features, [6, 6]).numpy()
        np.testing.assert_array_equal(made(crops, features, [0, 6, 0, 6, 0]).numpy(), wanted)
        for sizes in (None, [], [0, 0]):
            assert made(crops[:0], features[:0], sizes).shape == (0, 1)


def test_a_batch_of_which_no_box_passes_the_first_network() -> None:
    made, samples = network(make=BothNetwork), pairs(2, 1)
    assert isinstance(made, BothNetwork)
    with torch.no_grad():
        made.alone.last.bias.fill_(float("nan"))  # no other number is below the least of all boxes
    assert np.isnan(score_samples(made, samples, CPU)).all()


@COMPARING
def test_the_model_computes_what_the_network_does(make: type[RelatedNetwork | BothNetwork], tmp_path: Path) -> None:
    made = network(make=make)
    samples = joined([pairs(3, 1), pairs(2, 2)[:9]])  # the last set is cut
    write_model(made, SPEC, tmp_path / "model.onnx", {})
    assert largest_difference(tmp_path / "model.onnx", samples, score_samples(made, samples, CPU)) < 1e-4
    with pytest.raises(ValueError, match="expected the logits of torch"):
        largest_difference(tmp_path / "model.onnx", samples, score_samples(network(1, make), samples, CPU))


def test_two_networks_learn_for_themselves_and_are_used_together(tmp_path: Path) -> None:
    recipe = changed(RECIPE, {"network": "both", "epochs": 2, "augmentation": {"flip": 0.0, "feature_noise": 0.0}})
    samples = pairs(40, 1)
    both = train(recipe, samples, pairs(10, 2), tmp_path / "both").network
    assert isinstance(both, BothNetwork)
    crops, features = torch.from_numpy(samples.crops).float() / 255, torch.from_numpy(samples.features)
    sizes = set_sizes(samples.sets)
    members = [logits_of(both.alone, crops, features[:, :9], sizes), logits_of(both.related, crops, features, sizes)]
    assert not torch.allclose(*members)
    torch.testing.assert_close(both(crops, features, sizes), torch.stack(members).mean(0))
    both.train().zero_grad()
    learnt = learnt_logits(both, crops, features, sizes)
    assert len(learnt) == 2
    learnt[0].sum().backward()  # type: ignore[no-untyped-call]
    assert all(parameter.grad is None for parameter in both.related.parameters())
    found = calibrated(both, Calibrator(2.0, 1.0))(crops, features, sizes).detach().numpy()
    wanted = Calibrator(2.0, 1.0).applied(both.eval()(crops, features, sizes).detach().numpy())
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_the_classifier_reads_the_boxes_of_a_frame_together(tmp_path: Path) -> None:
    made = network()
    write_model(made, SPEC, tmp_path / "model.onnx", {})
    classifier = OnnxClassifier(ClassifierConfig(model=tmp_path / "model.onnx"))
    assert classifier.spec == SPEC
    random = np.random.default_rng(0)
    frame = Frame(random.integers(0, 256, (96, 128)).astype(np.uint8), 0)
    corners = random.integers(0, 80, (MAX_TOGETHER + 30, 2))
    boxes = Proposals(np.concatenate([corners, corners + 12], axis=1).astype(np.int32))
    scores = classifier.classify(frame, boxes).scores
    inputs = InputMaker(SPEC).make(frame, boxes)
    parts = []
    for part in (slice(0, MAX_TOGETHER), slice(MAX_TOGETHER, None)):
        with torch.inference_mode():
            parts.append(made(torch.from_numpy(inputs.crops[part]), torch.from_numpy(inputs.features[part])).numpy())
    np.testing.assert_allclose(scores, 1 / (1 + np.exp(-np.concatenate(parts)[:, 0])), atol=1e-5)


@pytest.mark.parametrize("num_outputs", [1, 5])
def test_boxes_that_are_surely_no_light_are_judged_by_the_first_network_alone(
    num_outputs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    both, samples = BothNetwork(1, len(FEATURES), num_outputs).eval(), pairs(20, 1)
    features = torch.from_numpy(samples.features)
    samples = dataclasses.replace(
        samples, crops=np.random.default_rng(1).integers(0, 256, samples.crops.shape, np.uint8)
    )
    crops = torch.from_numpy(samples.crops).float() / 255
    with torch.inference_mode():
        alone = both.alone(crops, features[:, :9])
        light = light_of(alone).numpy().reshape(-1, 6)
        monkeypatch.setattr(BothNetwork, "LEAST_LOGIT", float(np.quantile(light, 0.8)))
        is_shown = light >= np.minimum(light.max(axis=1, keepdims=True), BothNetwork.LEAST_LOGIT)
        assert is_shown.any(axis=1).all()
        assert (is_shown.sum(axis=1) > 1).any()
        wanted = alone.clone()
        for start in range(0, 120, 6):
            rows = start + np.flatnonzero(is_shown[start // 6])
            wanted[rows] = (wanted[rows] + both.related(crops[rows], features[rows])) / 2
    found = score_samples(both, samples, CPU)
    np.testing.assert_allclose(found, wanted.numpy(), atol=1e-5)
    np.testing.assert_allclose(found[~is_shown.ravel()], alone.numpy()[~is_shown.ravel()], atol=1e-5)
    with torch.inference_mode():
        np.testing.assert_allclose(both(crops, features, [6] * 20), wanted.numpy(), atol=1e-5)
    write_model(both, SPEC, tmp_path / "model.onnx", {})
    assert largest_difference(tmp_path / "model.onnx", samples, wanted.numpy()) < 1e-4


def test_batches_are_of_whole_sets_with_labels() -> None:
    samples = pairs(40, 3)
    labels = samples.labels.copy()
    labels[:12] = -1  # all of two sets
    labels[12] = -1  # one box of another: it is seen, but not learnt
    samples = dataclasses.replace(samples, labels=labels)
    batches = list(set_batches(samples, RECIPE, 1))
    assert max(map(len, batches)) <= RECIPE.batch_size
    assert all(set(set_sizes(samples.sets[batch])) == {6} for batch in batches)
    np.testing.assert_array_equal(np.sort(np.concatenate(batches)), np.arange(12, len(samples)))
    assert not np.array_equal(np.concatenate(batches), np.concatenate(list(set_batches(samples, RECIPE, 2))))


def test_lamps_are_left_out_of_a_share_of_the_frames() -> None:
    samples = pairs(40, 3)
    kinds = samples.kinds.copy()
    kinds[:, KINDS.index("none")] = 1.0
    kinds[::6] = [0.6, 0.0, 0.4, 0.0, 0.0]  # the first box of each set
    kinds[1::6] = [0.0, 0.05, 0.0, 0.95, 0.0]
    labels = samples.labels.copy()
    labels[1:6] = -1  # of the first set, nothing but its lamp is labelled
    samples = dataclasses.replace(samples, kinds=kinds, labels=labels)
    batches = list(set_batches(samples, changed(RECIPE, {"without_lamps": 1.0}), 1))
    np.testing.assert_array_equal(np.sort(np.concatenate(batches)), np.flatnonzero(np.arange(240) % 6)[5:])
    assert all(set(set_sizes(samples.sets[batch])) == {5} for batch in batches)
    half = changed(RECIPE, {"without_lamps": 0.5})
    lit = [
        {int(i) // 6 for batch in set_batches(samples, half, epoch) for i in batch if i % 6 == 0} for epoch in (1, 2)
    ]
    assert all(10 <= len(each) <= 30 for each in lit)
    assert lit[0] != lit[1]
    with pytest.raises(ValueError, match=r"without_lamps: expected 0 without inputs.together, got 0.5"):
        changed(RECIPES["compact"], {"without_lamps": 0.5})


def test_boxes_of_a_frame_are_reflected_and_moved_together() -> None:
    samples = pairs(30, 4)
    sizes = set_sizes(samples.sets)
    crops, features = torch.rand(len(samples), 1, 32, 32), torch.from_numpy(samples.features)
    random = torch.Generator().manual_seed(1)
    flipped, changed_features = augment(
        crops, features, Augmentation(flip=0.5), torch.ones(len(FEATURES)), random, sizes=sizes
    )
    is_flipped = torch.isclose(flipped, crops.flip(3)).all(dim=(1, 2, 3)).numpy().reshape(-1, 6)
    assert (is_flipped == is_flipped[:, :1]).all()
    assert 5 < is_flipped[:, 0].sum() < 25
    signs = np.where(is_flipped.ravel(), -1, 1)
    np.testing.assert_allclose(changed_features[:, SIDE], samples.features[:, SIDE] * signs)
    _, moved = augment(crops, features, Augmentation(feature_noise=0.5), torch.ones(len(FEATURES)), random, sizes=sizes)
    shifts = (moved - features).numpy().reshape(-1, 6, len(FEATURES))
    np.testing.assert_allclose(moved[:, COLUMN], moved[:, SIDE].abs())
    shifts = np.delete(shifts, COLUMN, axis=2)
    np.testing.assert_allclose(shifts, np.repeat(shifts[:, :1], 6, axis=1), atol=1e-5)
    assert shifts[:, 0].std(axis=0).min() > 0.2
    _, zoomed = augment(crops, features, Augmentation(zoom=0.5), torch.ones(len(FEATURES)), random, sizes=sizes)
    factors = (zoomed[:, PLACES] / features[:, PLACES]).numpy().reshape(-1, 6 * len(PLACES))
    np.testing.assert_allclose(factors, np.repeat(factors[:, :1], factors.shape[1], axis=1), rtol=1e-4)
    assert factors.min() < 0.8
    assert factors.max() > 1.2
    grown = (zoomed[:, SIZES] - features[:, SIZES]).numpy().reshape(-1, 6 * len(SIZES))
    np.testing.assert_allclose(grown[:, 0], np.log2(factors[:, 0]) / 10, atol=1e-4)


def test_a_recipe_that_tells_a_network_too_little_is_refused() -> None:
    for fields, words in (
        ({"network": "compact"}, "false with the network compact"),
        ({"inputs": {"together": False}}, "true with the network related"),
    ):
        with pytest.raises(ValueError, match=f"inputs.together: expected {words}"):
            changed(RECIPES["related"], fields)
    with pytest.raises(ValueError, match=r"max_negatives_per_positive: expected none where inputs\.together"):
        changed(RECIPES["related"], {"max_negatives_per_positive": 2.0})
