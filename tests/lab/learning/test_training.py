from __future__ import annotations

import copy
import csv
import dataclasses
import math
import resource
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import torch

from foreglow.lab.learning import training
from foreglow.lab.learning.batches import epoch_indices, sample_weights
from foreglow.lab.learning.checkpoints import Checkpoint
from foreglow.lab.learning.recipes import Recipe, changed
from foreglow.lab.learning.samples import NO_GROUP, Samples
from foreglow.lab.learning.scores import kind_accuracy, light_logits
from foreglow.lab.learning.training import Teacher, TrainingResult, told_losses, train
from foreglow.lab.learning.training_progress import Epoch
from foreglow.types import KINDS
from tests.lab.learning.tiny_training import RECIPE, TinyNetwork, make_samples, make_tiny
from tests.pipes import ENDLESS, soon

pytestmark = [pytest.mark.torch, pytest.mark.slow]

TRAIN, VAL = make_samples(300, seed=1), make_samples(150, seed=2)


def run(folder: Path, recipe: Recipe = RECIPE, **changes: Any) -> TrainingResult:
    options: dict[str, Any] = {"make_network": make_tiny, "device": "cpu"} | changes
    return train(recipe, options.pop("train", TRAIN), options.pop("val", VAL), folder, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    """A training of `RECIPE`, uninterrupted."""
    return run(tmp_path_factory.mktemp("whole"))


def weights(result: TrainingResult) -> dict[str, bytes]:
    return {name: value.numpy().tobytes() for name, value in result.network.state_dict().items()}


def figures(result: TrainingResult) -> list[str]:
    """All epochs without their duration, NaN equal to itself."""
    return [repr(dataclasses.replace(epoch, seconds=0.0)) for epoch in result.epochs]


class StopAfter:
    """Ctrl-C in the middle of an epoch."""

    def __init__(self, epoch: int, step: int = 2) -> None:
        self.at = (epoch, step)

    def step(self, epoch: int, num_done: int, num_steps: int) -> None:  # noqa: ARG002
        if (epoch, num_done) == self.at:
            raise KeyboardInterrupt

    def epoch(self, epoch: Epoch, num_epochs: int) -> None: ...


def test_learns_a_blob_and_keeps_the_best_epoch(tmp_path: Path) -> None:
    result = run(tmp_path, changed(RECIPE, {"epochs": 12, "best_by": "f1"}))
    assert result.best.f1 > 0.9
    assert result.best.f1 == max(epoch.f1 for epoch in result.epochs)
    used = VAL.labels != -1
    is_right = (result.val_logits[used, 0] > 0) == (VAL.labels[used] == 1)
    assert is_right.mean() > 0.9


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"optimiser": "adam", "schedule": "plateau", "warmup_epochs": 0.0, "plateau_patience": 0, "ema_decay": 0.0},
        {"max_negatives_per_positive": 1.0, "group_balance": 0.5, "label_smoothing": 0.1, "max_gradient": 1.0},
    ],
)
def test_an_interrupted_training_ends_with_the_same_bits(tmp_path: Path, fields: dict[str, Any]) -> None:
    recipe = changed(RECIPE, fields)
    whole = run(tmp_path / "whole", recipe)
    for epoch in (2, 4):
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path / "parts", recipe, progress=StopAfter(epoch))
    resumed = run(tmp_path / "parts", recipe)
    assert weights(resumed) == weights(whole)
    assert figures(resumed) == figures(whole)
    curves = []
    for name in ("whole", "parts"):
        with (tmp_path / name / training.CURVES).open(newline="") as file:
            curves.append([row | {"seconds": ""} for row in csv.DictReader(file)])
    assert curves[0] == curves[1]
    assert len(curves[0]) == RECIPE.epochs


def test_an_interruption_after_the_best_epoch_keeps_its_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "best_number", lambda *_: 1)
    whole = run(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "parts", progress=StopAfter(2, 1))
    assert weights(run(tmp_path / "parts")) == weights(whole)


def test_seed_decides_everything(tmp_path: Path, whole: TrainingResult) -> None:
    torch.manual_seed(7)
    state = torch.get_rng_state()
    assert weights(run(tmp_path / "b")) == weights(whole)
    assert torch.equal(torch.get_rng_state(), state)  # the caller's own generator is as it was
    assert weights(run(tmp_path / "c", changed(RECIPE, {"seed": 4}))) != weights(whole)


def test_a_finished_training_is_read_not_repeated(tmp_path: Path) -> None:
    first = run(tmp_path)
    again = run(tmp_path, progress=StopAfter(1, 1))
    assert weights(again) == weights(first)
    assert figures(again) == figures(first)


def test_validation_is_clean_whatever_the_augmentation(tmp_path: Path) -> None:
    """Validation sees the samples themselves: a network that cannot learn validates alike under any augmentation."""
    still = {"learning_rate": 1e-12, "epochs": 1, "ema_decay": 0.0, "warmup_epochs": 0.0}
    recipes = [
        changed(RECIPE, still | {"augmentation": {"rotation_deg": angle, "noise": noise}})
        for angle, noise in ((0.0, 0.0), (180.0, 1.0))
    ]
    seen: list[np.ndarray[Any, Any]] = []

    def watched(recipe: Recipe) -> torch.nn.Module:
        network = make_tiny(recipe)
        network.register_forward_pre_hook(
            lambda module, inputs: None if module.training else seen.append(inputs[0].numpy().copy())
        )
        return network

    for number, recipe in enumerate(recipes):
        run(tmp_path / str(number), recipe, make_network=watched)
    crops = np.concatenate(seen).reshape(4, len(VAL), *VAL.crops.shape[1:])  # two trainings: an epoch, then the best
    for passed in crops:
        np.testing.assert_array_equal(passed, VAL.crops.astype(np.float32) / 255)


def with_kinds(samples: Samples) -> Samples:
    """The samples with light of front or rear lamps, where a feature says so."""
    is_rear = samples.image_ids % 2 == 0
    kinds = np.zeros((len(samples), len(KINDS)), np.float32)
    kinds[np.arange(len(samples)), np.where(samples.labels == 1, np.where(is_rear, 3, 2), 4)] = 1.0
    return dataclasses.replace(samples, kinds=kinds, features=is_rear[:, None].astype(np.float32))


def test_kinds_are_learnt(tmp_path: Path) -> None:
    samples = {"train": with_kinds(TRAIN), "val": with_kinds(VAL)}
    recipe = changed(RECIPE, {"epochs": 30, "kinds": True})
    result = run(tmp_path, recipe, make_network=lambda _: TinyNetwork(1, 1, 5), **samples)
    assert result.val_logits.shape == (len(VAL), 5)
    assert result.best.f1 > 0.9
    assert result.best.kind_accuracy > 0.9
    assert kind_accuracy(result.val_logits, samples["val"].kinds) == result.best.kind_accuracy
    assert np.isnan(kind_accuracy(result.val_logits[:, :1], samples["val"].kinds))


def test_shares_are_learnt_as_probabilities(tmp_path: Path) -> None:
    """Where every box of light holds as much of one kind as of another, so says the network."""
    samples = {}
    for name, plain in (("train", TRAIN), ("val", VAL)):
        shares = np.where(plain.labels[:, np.newaxis] == 1, [0.25, 0.0, 0.75, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0])
        samples[name] = dataclasses.replace(plain, kinds=shares.astype(np.float32))
    recipe = changed(RECIPE, {"epochs": 12, "kinds": True})
    result = run(tmp_path, recipe, make_network=lambda _: TinyNetwork(1, 0, 5), **samples)
    logits = result.val_logits[VAL.labels == 1].astype(float)
    probabilities = np.exp(logits) / np.exp(logits).sum(1, keepdims=True)
    assert np.median(probabilities, 0)[:3] == pytest.approx([0.25, 0.0, 0.75], abs=0.1)


@pytest.mark.parametrize(("group", "expected"), [(0, 0.8), (NO_GROUP, 0.4)])
def test_light_in_a_box_without_a_key_point_may_count_half(group: int, expected: float, tmp_path: Path) -> None:
    samples = {}
    for name, plain in (("train", TRAIN), ("val", VAL)):
        shares = np.where(plain.labels[:, np.newaxis] == 1, [0.8, 0.0, 0.0, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0, 1.0])
        groups = np.full_like(plain.groups, group)
        samples[name] = dataclasses.replace(plain, kinds=shares.astype(np.float32), groups=groups)
    recipe = changed(RECIPE, {"epochs": 12, "kinds": True, "unmarked_light": 0.5})
    result = run(tmp_path, recipe, make_network=lambda _: TinyNetwork(1, 0, 5), **samples)
    logits = result.val_logits[VAL.labels == 1].astype(float)
    is_none = np.exp(logits[:, -1]) / np.exp(logits).sum(1)
    assert 1.0 - np.median(is_none) == pytest.approx(expected, abs=0.1)


def test_the_kind_of_every_box_is_needed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="train samples: expected the kind of light of every labelled box, found NaN"):
        run(
            tmp_path,
            changed(RECIPE, {"kinds": True}),
            train=dataclasses.replace(TRAIN, kinds=np.full_like(TRAIN.kinds, np.nan)),
        )


def test_a_network_that_does_not_tell_kinds(tmp_path: Path) -> None:
    fields = {"network": "paper", "inputs": {"size_px": 64, "lag_s": None, "num_features": 0}, "kinds": True}
    with pytest.raises(ValueError, match="kinds: expected false, the network paper does not tell kinds, got true"):
        run(tmp_path, changed(RECIPE, fields), make_network=None)


@pytest.mark.parametrize("kinds", [False, True])
def test_what_a_teacher_says_is_kept(tmp_path: Path, kinds: bool) -> None:
    """Half of the samples have the wrong label; where a teacher is asked instead, they teach what it says."""
    recipe = changed(RECIPE, {"kinds": kinds, "ema_decay": 0.0, "epochs": 12, "best_by": "last"})
    samples, val = (dataclasses.replace(each, kinds=with_kinds(each).kinds) for each in (TRAIN, VAL))
    start = run(tmp_path / "start", recipe, train=samples, val=val)
    is_turned = np.arange(len(samples)) % 2 == 0
    turned = dataclasses.replace(
        samples,
        labels=np.where(is_turned & (samples.labels != -1), 1 - samples.labels, samples.labels).astype(np.int8),
        kinds=np.where(is_turned[:, None], np.roll(samples.kinds, 1, axis=1), samples.kinds),
    )
    teacher = Teacher(copy.deepcopy(start.network), is_turned, 10.0)
    options = {"train": turned, "val": val, "make_network": lambda _: copy.deepcopy(start.network)}

    def separation(result: TrainingResult) -> float:
        light = light_logits(result.val_logits)
        return float(light[val.labels == 1].mean() - light[val.labels == 0].mean())

    taught = run(tmp_path / "taught", recipe, teacher=teacher, **options)
    untaught = run(tmp_path / "untaught", recipe, **options)
    assert separation(taught) > 0.7 * separation(start) > 2 * separation(untaught)
    with pytest.raises(ValueError, match="teacher: expected that of the training begun here"):
        run(tmp_path / "taught", recipe, teacher=dataclasses.replace(teacher, weight=1.0), **options)


@pytest.mark.parametrize("num_outputs", [1, 5])
def test_a_teacher_is_best_imitated_by_itself(num_outputs: int) -> None:
    told = torch.randn(20, num_outputs, generator=torch.Generator().manual_seed(1))
    logits = told.clone().requires_grad_()
    losses = told_losses(logits, told)
    losses.sum().backward()  # type: ignore[no-untyped-call]
    assert losses.shape == (20,)
    assert logits.grad is not None
    torch.testing.assert_close(logits.grad, torch.zeros_like(told), atol=1e-6, rtol=0)


def test_ignored_samples_are_never_seen(tmp_path: Path, whole: TrainingResult) -> None:
    """Their content changes nothing: not the weights, not the figures."""
    for name, samples in (("train", TRAIN), ("val", VAL)):
        crops = samples.crops.copy()
        crops[samples.labels == -1] = 255 - crops[samples.labels == -1]
        other = dataclasses.replace(samples, crops=crops)
        result = run(tmp_path / name, RECIPE, **{name: other})
        assert weights(result) == weights(whole)
        assert figures(result) == figures(whole)


def test_epochs_hold_all_positives_and_other_negatives_each_time() -> None:
    recipe = changed(RECIPE, {"max_negatives_per_positive": 0.5})
    epochs = [epoch_indices(TRAIN.labels, recipe, number) for number in (1, 2)]
    num_positive = TRAIN.num_labelled(1)
    for indices in epochs:
        assert len(set(indices.tolist())) == len(indices) == num_positive + -(-num_positive // 2)
        assert (TRAIN.labels[indices] == 1).sum() == num_positive
        assert (TRAIN.labels[indices] != -1).all()
    assert set(epochs[0].tolist()) != set(epochs[1].tolist())
    assert len(epoch_indices(TRAIN.labels, RECIPE, 1)) == (TRAIN.labels != -1).sum()


def test_groups_can_count_alike() -> None:
    positive = TRAIN.labels == 1
    for balance in (0.0, 0.5, 1.0):
        found = sample_weights(TRAIN, balance)
        assert found[~positive].tolist() == [1.0] * int((~positive).sum())
        assert found[positive].mean() == pytest.approx(1.0)
    sums = [found[positive & (TRAIN.groups == group)].sum() for group in range(3)]
    assert sums == pytest.approx([sums[0]] * 3)


def test_patience_ends_it(tmp_path: Path) -> None:
    still = changed(
        RECIPE, {"schedule": "constant", "learning_rate": 1e-12, "warmup_epochs": 0.0, "ema_decay": 0.0, "patience": 2}
    )
    result = run(tmp_path, changed(still, {"epochs": 50, "best_by": "f1"}))
    assert [epoch.number for epoch in result.epochs][-1] == result.best.number + 2


def test_another_training_in_the_folder_is_an_error(tmp_path: Path) -> None:
    one = changed(RECIPE, {"epochs": 1, "warmup_epochs": 0.0})
    run(tmp_path, one)
    with pytest.raises(ValueError, match=r"checkpoint\.pt: learning_rate: expected .* 0\.01, got 0\.02"):
        run(tmp_path, changed(one, {"learning_rate": 0.02}))
    augmentation = one.augmentation.model_copy(update={"gamma": 0.25})
    with pytest.raises(
        ValueError, match=r"checkpoint\.pt: augmentation\.gamma: expected .* here, 0\.2, got 0\.25; choose"
    ):
        run(tmp_path, one.model_copy(update={"augmentation": augmentation}))
    with pytest.raises(ValueError, match=r"checkpoint\.pt: train data: expected that of the training begun here"):
        run(tmp_path, one, train=make_samples(300, seed=5))


@pytest.mark.parametrize("keep", [0, 100, -1])
def test_damaged_checkpoint(tmp_path: Path, keep: int) -> None:
    one = changed(RECIPE, {"epochs": 1, "warmup_epochs": 0.0})
    run(tmp_path, one)
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"checkpoint\.pt: expected a whole checkpoint, found it damaged; remove it"):
        run(tmp_path, one)


@pytest.mark.parametrize("kind", ENDLESS)
def test_a_pipe_is_no_checkpoint(tmp_path: Path, kind: str) -> None:
    ENDLESS[kind](tmp_path / "checkpoint.pt")
    with (
        soon(),
        pytest.raises(ValueError, match=r"checkpoint\.pt: expected a whole checkpoint, found it damaged; remove it"),
    ):
        run(tmp_path, changed(RECIPE, {"epochs": 1, "warmup_epochs": 0.0}))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, None) for name in Checkpoint.__slots__),
        *((name, math.nan) for name in ("identity", "num_steps", "best_epoch")),
        *((name, -1) for name in ("identity", "num_steps", "best_epoch", "epochs")),
        *((name, {}) for name in ("network", "averaged", "optimiser", "best")),
        ("best_epoch", 2),
        ("epochs", [{}]),
    ],
)
def test_checkpoint_of_other_kinds(tmp_path: Path, name: str, value: Any) -> None:
    _expect_damaged(tmp_path, lambda content: content | {name: value})


@pytest.mark.parametrize("name", ["network", "best"])
def test_checkpoint_that_is_not_finite(tmp_path: Path, name: str) -> None:
    def spoilt(content: dict[str, Any]) -> dict[str, Any]:
        next(iter(content[name].values()))[0] = math.nan
        return content

    _expect_damaged(tmp_path, spoilt)


def _expect_damaged(folder: Path, damage: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    one = changed(RECIPE, {"epochs": 1, "warmup_epochs": 0.0})
    train(one, TRAIN, VAL, str(folder), make_network=make_tiny, device="cpu")
    path = folder / "checkpoint.pt"
    torch.save(damage(torch.load(path, weights_only=True)), path)
    with pytest.raises(ValueError, match=r"checkpoint\.pt: expected a whole checkpoint, found it damaged; remove it"):
        run(folder, one)


@pytest.mark.parametrize("number", range(0, 40, 3))
def test_one_wrong_bit_in_a_checkpoint_is_noticed(tmp_path: Path, number: int) -> None:
    """In any of its parts: torch itself does not look at their checksums."""
    one = changed(RECIPE, {"epochs": 1, "warmup_epochs": 0.0})
    run(tmp_path, one)
    path = tmp_path / "checkpoint.pt"
    with zipfile.ZipFile(path) as archive:
        parts = [part for part in archive.infolist() if part.file_size]
    part = parts[number % len(parts)]
    content = bytearray(path.read_bytes())
    names = int.from_bytes(content[part.header_offset + 26 :][:2], "little")
    extras = int.from_bytes(content[part.header_offset + 28 :][:2], "little")
    content[part.header_offset + 30 + names + extras + part.file_size // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"checkpoint\.pt: expected a whole checkpoint, found it damaged; remove it"):
        run(tmp_path, one)


def test_a_checkpoint_on_a_full_disk_is_named(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    one = changed(RECIPE, {"epochs": 1, "warmup_epochs": 0.0})
    run(tmp_path, one)
    size = path.stat().st_size
    path.unlink()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - 100, before[1]))
    try:
        with pytest.raises(OSError, match="File too large") as caught:
            run(tmp_path, one)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.filename == str(path)
    assert not path.exists()


def without(label: int) -> Samples:
    return TRAIN[TRAIN.labels != label]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"train": without(1)}, "train samples: expected light artifacts among"),
        ({"val": without(0)}, "val samples: expected boxes without one among"),
        ({"device": "tpu"}, "device: expected one of auto, cpu, cuda, got 'tpu'"),
    ],
)
def test_what_cannot_be_trained(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run(tmp_path, **changes)


def test_a_loss_that_explodes_is_said(tmp_path: Path) -> None:
    recipe = changed(RECIPE, {"learning_rate": 10.0, "optimiser": "adam", "weight_decay": 10.0, "epochs": 3})

    def huge(_: Recipe) -> torch.nn.Module:
        network = TinyNetwork()
        torch.nn.init.constant_(network.out.weight, 3e38)
        return network

    with pytest.raises(ValueError, match=r"epoch 1: expected a finite training loss, got .*; try a lower"):
        run(tmp_path, recipe, make_network=huge)


def test_bfloat16_learns_too(tmp_path: Path) -> None:
    result = run(tmp_path, changed(RECIPE, {"epochs": 12, "precision": "bf16"}))
    assert result.best.f1 > 0.9
    assert result.val_logits.dtype == np.float32


def test_unknown_network(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"recipe: network: expected one of paper.*, got 'tiny'"):
        run(tmp_path, make_network=None)
