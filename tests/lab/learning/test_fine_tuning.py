"""A model goes on learning: from its file, with old samples mixed in."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

import torch

from foreglow.classifier import OnnxClassifier
from foreglow.classifier.inputs import InputSpec
from foreglow.config import ClassifierConfig, config_to_toml, preset
from foreglow.lab.learning import fine_tuning
from foreglow.lab.learning.checkpoints import Checkpoint, write_checkpoint
from foreglow.lab.learning.model_import import read_model
from foreglow.lab.learning.old_samples import (
    WIDEST,
    HeldOut,
    OldSamples,
    chosen,
    held_out,
    main,
    read_old_samples,
    write_old_samples,
)
from foreglow.lab.learning.samples import NUM_KINDS, Samples, set_bounds, set_sizes
from foreglow.lab.reports import training_pictures
from foreglow.models import OLD_SAMPLES
from tests.cli.commands import complaint, foreglow_command
from tests.lab.learning.test_model_import import ALONE, NARROW, model_at
from tests.lab.learning.tiny_drives import CONFIG_TOML, doubt, make_drives

pytestmark = [pytest.mark.torch, pytest.mark.slow]


def made_up(num_samples: int, seed: int = 0, set_size: int = 5) -> Samples:
    random = np.random.default_rng(seed)
    labels = random.choice(np.array([1, 0, 0, 0, -1], np.int8), num_samples)
    smooth = cv2.GaussianBlur(random.normal(0, 1, (num_samples * 3 * 32, 32)), (0, 0), 4)
    kinds = np.eye(NUM_KINDS, dtype=np.float32)[np.where(labels == 1, random.integers(0, 4, num_samples), 4)]
    return Samples(
        crops=np.clip(128 + 400 * smooth, 0, 255).astype(np.uint8).reshape(num_samples, 3, 32, 32),
        features=random.random((num_samples, WIDEST.num_features)).astype(np.float32),
        labels=labels,
        kinds=kinds,
        groups=np.where(labels == 1, 0, -1).astype(np.int8),
        boxes_xyxy_px=np.zeros((num_samples, 4), np.int32),
        image_ids=np.arange(num_samples, dtype=np.int64),
        sequence_ids=np.zeros(num_samples, np.int64),
        sets=np.arange(num_samples, dtype=np.int32) // set_size,
    )


def old_samples(num_samples: int) -> OldSamples:
    judge = [made_up(num, seed) for num, seed in ((20, 5), (30, 6))]
    weights = [np.linspace(1, 9, len(part), dtype=np.float32) for part in judge]
    return OldSamples(made_up(num_samples), tuple(map(HeldOut, ("a/day", "b/night"), judge, weights)))


def test_the_samples_that_ship_are_for_the_model_that_ships() -> None:
    start = read_model(Path("foreglow"))
    old = read_old_samples(OLD_SAMPLES, start.inputs)
    assert old.learn.crops.shape[1:] == (start.inputs.num_channels, 32, 32)
    for part in (old.learn, *(each.samples for each in old.judge)):
        assert min(part.num_labelled(0), part.num_labelled(1)) > 50
        assert (part.features[:, 6] > 0).any()  # boxes with a moment of the past
        assert not np.isnan(part.kinds).any()
        is_lit = [(part.labels[start:end] == 1).any() for start, end in set_bounds(part.sets)]
        assert min(is_lit.count(True), is_lit.count(False)) > 2  # images with light of a vehicle, and without
    assert len({each.camera for each in old.judge}) == len(old.judge) > 1
    assert OLD_SAMPLES.stat().st_size <= 4_000_000


@pytest.mark.parametrize("spec", [WIDEST, ALONE, NARROW, InputSpec(size_px=32, context=6)])
def test_samples_survive_their_file(tmp_path: Path, spec: InputSpec) -> None:
    old = old_samples(150)
    write_old_samples(tmp_path / "some.npz", old)
    again = read_old_samples(tmp_path / "some.npz", spec)
    channels = [0, *([1] if spec.lag_s else []), *([2] if spec.context else [])]
    pairs = [(again.learn, old.learn)]
    for found_part, part in zip(again.judge, old.judge, strict=True):
        assert found_part.camera == part.camera
        np.testing.assert_array_equal(found_part.weights, part.weights)
        pairs.append((found_part.samples, part.samples))
    for found, samples in pairs:
        assert np.abs(found.crops.astype(int) - samples.crops[:, channels]).mean() < 2
        np.testing.assert_allclose(found.features, samples.features[:, : spec.num_features], atol=1e-3)
        for name in ("labels", "kinds", "image_ids"):
            np.testing.assert_array_equal(getattr(found, name), getattr(samples, name))
        assert set_sizes(found.sets) == set_sizes(samples.sets)
    write_old_samples(tmp_path / "again.npz", old)
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "some.npz").read_bytes()


def test_samples_of_other_inputs_or_of_nothing_say_so(tmp_path: Path) -> None:
    write_old_samples(tmp_path / "some.npz", old_samples(20))
    with pytest.raises(ValueError, match=r"some\.npz: expected a model that reads no more than"):
        read_old_samples(tmp_path / "some.npz", dataclasses.replace(WIDEST, size_px=64))
    with pytest.raises(ValueError, match=r"some\.npz: .*; mix in drives instead"):
        read_old_samples(tmp_path / "some.npz", dataclasses.replace(WIDEST, lag_s=0.5))
    for content in (b"", b"PK\x05\x06", (tmp_path / "some.npz").read_bytes()[:900]):
        (tmp_path / "some.npz").write_bytes(content)
        with pytest.raises(ValueError, match=r"some\.npz: expected samples as"):
            read_old_samples(tmp_path / "some.npz", WIDEST)


def test_chosen_samples_are_whole_sets_of_every_part() -> None:
    parts = [made_up(400, seed) for seed in (1, 2)]
    for part in parts:
        part.labels[:200] = np.where(part.labels[:200] == 1, 0, part.labels[:200])  # the first half has no light
        part.labels[200:205] = -1  # one set is wholly doubtful
    found = chosen(parts, 200)
    sizes = set_sizes(found.sets)
    assert set(sizes) == {5}
    assert len(found) == 200
    is_lit = np.array([(found.labels[start:end] == 1).any() for start, end in set_bounds(found.sets)])
    assert is_lit.sum() == 2 * 14
    assert (found.labels == -1).any()
    assert not any((found.labels[start:end] == -1).all() for start, end in set_bounds(found.sets))
    for part, rows in zip(parts, ([*range(70), *range(140, 170)], [*range(70, 140), *range(170, 200)]), strict=True):
        ids = found.image_ids[rows]
        assert len(np.unique(ids)) == 100
        np.testing.assert_array_equal(found.crops[rows], part.crops[ids])
    np.testing.assert_array_equal(found.crops, chosen(parts, 200).crops)
    with_empty = chosen([parts[0], parts[1][:200]], 160)  # one without any light: as many with light, of the other
    assert len(with_empty) == 160


def test_the_samples_are_made_by_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = make_drives(tmp_path / "data", num_images=3)
    doubt(data / "day/val", 1101)
    arguments = [str(data), "--judge", str(data), "--samples", "10"]
    main([*arguments, "--out", str(tmp_path / "some.npz"), "--cache", str(tmp_path / "cache")])
    found = read_old_samples(tmp_path / "some.npz", WIDEST)
    said = capsys.readouterr().out
    assert f"{found.learn.num_labelled(1)} boxes with light, {found.learn.num_labelled(0)} without" in said
    (judge,) = found.judge
    assert judge.camera == f"{tmp_path.name}/data"
    assert f"; {len(judge.samples)} of {len(set_sizes(judge.samples.sets))} to judge by" in said
    assert min(judge.samples.num_labelled(label) for label in (0, 1, -1)) > 0
    assert (judge.samples.labels[judge.samples.image_ids != 1101] >= 0).all()


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    (folder / "config.toml").write_text(CONFIG_TOML + "[classifier]\nscore_threshold = 0.45\n")
    return make_drives(folder / "data", num_images=6)


@pytest.mark.parametrize(("spec", "num_outputs"), [(NARROW, 1), (ALONE, 5)])
def test_a_model_learns_own_drives(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spec: InputSpec, num_outputs: int
) -> None:
    monkeypatch.setattr(fine_tuning, "MAX_LOSS", 1.0)  # the start knows nothing that is worth keeping
    monkeypatch.setattr(fine_tuning, "OLD_WEIGHT", 1.0)
    model_at(tmp_path / "start.onnx", spec, num_outputs)
    more = make_drives(tmp_path / "more", num_images=2)
    options = ["--config", drives.parent / "config.toml", "--device", "cpu", "--seed", 2, "--mix", more]
    out = tmp_path / "mine"
    command = ["train", drives, "--from", tmp_path / "start.onnx", "--out", out, *options]
    (tmp_path / "fast.toml").write_text("learning_rate = 0.002\nbatch_size = 8\n")
    done = foreglow_command(*command, "--epochs", 15, "--recipe-file", tmp_path / "fast.toml")
    assert done.exit_code == 0, done.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["num_epochs"] == summary["best_epoch"]["number"] == 15
    own, old = summary["before_and_after"].values()
    assert own[1]["average_precision"] > own[0]["average_precision"]
    assert len(old) == 2
    assert summary["way"] == 1
    assert "what it knew before" in done.stdout
    picture = cv2.imread(str(out / "changes.jpg"))
    assert picture is not None
    assert picture.shape[1] == 2 * 720
    legend = picture[: training_pictures.LEGEND_HEIGHT_PX].astype(int)
    for colour in training_pictures.LEGEND.values():
        assert (np.abs(legend - colour).max(axis=-1) < 60).any()
    assert OnnxClassifier(ClassifierConfig(model=out / "model.onnx")).spec == spec
    again = foreglow_command(*command, "--epochs", 15, "--recipe-file", tmp_path / "fast.toml")
    assert again.exit_code == 0, again.output
    assert json.loads((out / "summary.json").read_text())["model_sha256"] == summary["model_sha256"]
    model_at(tmp_path / "start.onnx", spec, num_outputs, seed=4)
    assert "checkpoint.pt: start: expected that of the training begun here" in complaint(
        *command, "--epochs", 15, "--recipe-file", tmp_path / "fast.toml"
    )


def test_what_is_drawn_to_judge_stands_for_all() -> None:
    samples = made_up(4000, set_size=4)
    found = held_out("a", samples, {True: 400, False: 200})
    again = held_out("a", samples, {True: 400, False: 200})
    np.testing.assert_array_equal(found.samples.image_ids, again.samples.image_ids)
    assert set(set_sizes(found.samples.sets)) == {4}
    is_lit = np.array([(each == 1).any() for each in found.samples.labels.reshape(-1, 4)])
    is_known = np.array([(each >= 0).any() for each in samples.labels.reshape(-1, 4)])
    assert (abs(4 * is_lit.sum() - 400), abs(4 * (~is_lit).sum() - 200)) <= (4, 4)
    weights = found.weights.reshape(-1, 4)
    assert (weights == weights[:, :1]).all()
    assert found.weights.sum() == pytest.approx(4 * is_known.sum(), rel=0.02)
    for label in (1, 0, -1):
        stood_for = found.weights[found.samples.labels == label].sum()
        assert stood_for == pytest.approx(samples.num_labelled(label), rel=0.15)
    sums = [held_out("a", samples, {True: 400, False: 200}, seed).weights.sum() for seed in range(9)]
    assert np.mean(sums) == pytest.approx(4 * is_known.sum(), rel=0.005)
    few = held_out("a", samples[:48], {True: 400, False: 200})
    assert (few.weights == 1).all()
    assert len(few.samples) == 4 * is_known[:12].sum()


def test_doubtful_boxes_do_not_count(tmp_path: Path) -> None:
    network = model_at(tmp_path / "model.onnx", WIDEST, 5)
    samples, weights = made_up(60), np.linspace(1, 5, 60, dtype=np.float32)
    found = fine_tuning._average_precisions(network, HeldOut("a", samples, weights), torch.device("cpu"))
    other = dataclasses.replace(
        samples, groups=np.where(samples.labels == -1, 0, samples.groups).astype(np.int8)
    )  # what they hold is not looked at
    assert found == fine_tuning._average_precisions(network, HeldOut("a", other, weights), torch.device("cpu"))
    alone = model_at(tmp_path / "alone.onnx", dataclasses.replace(WIDEST, together=False), 5)
    is_known = samples.labels != -1
    with_all, known = (
        fine_tuning._average_precisions(alone, HeldOut("a", each, counts), torch.device("cpu"))
        for each, counts in ((samples, weights), (samples[is_known], weights[is_known]))
    )
    assert with_all == pytest.approx(known)


def test_boxes_count_as_often_as_they_stand_for() -> None:
    random = np.random.default_rng(1)
    scores, is_light, counts = random.random(40), random.random(40) < 0.4, random.integers(1, 5, 40)
    repeated = fine_tuning.box_figures(np.repeat(scores, counts), np.repeat(is_light, counts), 0.5)
    weighed = fine_tuning.box_figures(scores, is_light, 0.5, counts.astype(np.float32))
    assert weighed.precision == pytest.approx(repeated.precision)
    assert weighed.recall == pytest.approx(repeated.recall)
    assert weighed.average_precision == pytest.approx(repeated.average_precision)


@pytest.mark.parametrize("labels", [[1, 1, 0, 0, 0], [0, 0, 0, 1, 1], [0, 1, 0, 1, 0]])
def test_the_order_of_boxes_with_equal_scores_counts_for_nothing(labels: list[int]) -> None:
    is_light = np.array(labels, np.bool_)
    assert fine_tuning.box_figures(np.full(5, 0.7), is_light, 0.5).average_precision == pytest.approx(0.4)
    found = fine_tuning.box_figures(np.append(np.full(5, 0.7), 0.9), np.append(is_light, True), 0.5)
    assert found.average_precision == pytest.approx((1.0 + 2 * 3 / 6) / 3)  # one alone, and then all of them at once


def test_weights_move_only_as_far_as_old_samples_allow(tmp_path: Path) -> None:
    spec = dataclasses.replace(WIDEST, together=False)
    network = model_at(tmp_path / "model.onnx", spec, 5)
    start = read_model(tmp_path / "model.onnx").network
    samples = made_up(60)
    with torch.inference_mode():
        logits = network(torch.from_numpy(samples.crops).float() / 255, torch.from_numpy(samples.features)).numpy()
    order = np.argsort(np.logaddexp.reduce(logits[:, :-1], axis=1) - logits[:, -1])
    labels = np.zeros(60, np.int8)
    labels[order[30:]] = 1  # what the start says is right
    groups = np.where(labels == 1, 0, -1).astype(np.int8)
    known = dataclasses.replace(samples, labels=labels, groups=groups)
    old = [HeldOut("known", known, np.ones(60, np.float32))]
    device = torch.device("cpu")
    other: Any = read_model(tmp_path / "model.onnx").network
    with torch.no_grad():
        other.last.bias.add_(1.0)
        other.last.weight.mul_(2.0)  # the order stays
    assert fine_tuning._move(other, start, old, device)[0] == 1
    with torch.no_grad():
        other.last.weight.mul_(-5.0)  # the order is turned around
    before = {name: value.clone() for name, value in start.state_dict().items()}
    worse = {name: value.clone() for name, value in other.state_dict().items()}
    way, kept = fine_tuning._move(other, start, old, device)
    assert way < 0.5
    assert kept["known"]["light"][0] - kept["known"]["light"][1] <= fine_tuning.MAX_LOSS
    # One camera that loses is enough, however many gain: by labels that are wrong, all others do.
    gaining = dataclasses.replace(known, labels=1 - labels, groups=np.where(labels == 1, -1, 0).astype(np.int8))
    others = [HeldOut(f"gains {k}", gaining, np.ones(60, np.float32)) for k in range(9)]
    other.load_state_dict(worse)
    assert fine_tuning._move(other, start, others, device)[0] == 1
    other.load_state_dict(worse)
    assert fine_tuning._move(other, start, [*others, *old], device)[0] == way
    # So is one by what a person would mark, where the labels by light lose nothing.
    other.load_state_dict(worse)
    marked = dataclasses.replace(gaining, groups=known.groups)
    assert fine_tuning._move(other, start, [HeldOut("marks", marked, np.ones(60, np.float32))], device)[0] == way
    assert all(torch.equal(value, before[name]) for name, value in start.state_dict().items())


def test_without_held_out_drives_and_with_the_samples_that_ship(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fine_tuning, "MAX_LOSS", 1.0)
    monkeypatch.setattr(fine_tuning, "MAX_SEEN", 1)
    model_at(tmp_path / "start.onnx", NARROW, 1)
    options = ["--config", drives.parent / "config.toml", "--device", "cpu", "--epochs", 3]
    out = tmp_path / "mine"
    done = foreglow_command("train", drives / "day/train", "--from", tmp_path / "start.onnx", "--out", out, *options)
    assert done.exit_code == 0, done.output
    assert "no drives of yours are held out" in done.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert summary["mixed_in"] == OLD_SAMPLES.name
    assert summary["num_epochs"] == summary["recipe"]["epochs"] == 1  # as few as there may be
    assert summary["kept"].keys() == {each.camera for each in read_old_samples(OLD_SAMPLES, NARROW).judge}
    camera, (before, now) = max(
        ((name, pair) for name, kept in summary["kept"].items() for pair in kept.values()),
        key=lambda found: found[1][0] - found[1][1],
    )
    said = f"of what it knew, it kept least on {camera}: average precision {before:.3f} before, {now:.3f} after"
    assert said in " ".join(done.stdout.split())
    (_, after), *_ = summary["before_and_after"].values()
    figures = "P {precision:.3f} R {recall:.3f} F {f1:.3f}".format(**after)
    assert f"{figures} at a score > 0.45" in done.output  # in the log as in the table
    for name in ("precision", "recall", "f1"):
        assert summary["validation"][name] == pytest.approx(after[name]), "and in the summary"
    assert not (out / "changes.jpg").exists()


def test_a_model_of_other_boxes(drives: Path, tmp_path: Path) -> None:
    """Those that it was trained on are in its folder."""
    model_at(tmp_path / "start.onnx", NARROW, 1)
    (tmp_path / "config.toml").write_text(config_to_toml(preset("paper")))
    told = complaint("train", drives, "--out", tmp_path / "mine", "--from", tmp_path / "start.onnx")
    assert f"expected --config {tmp_path / 'config.toml'} with --from" in told


def test_another_recipe_is_refused_before_samples_are_made(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model_at(tmp_path / "start.onnx", WIDEST, 5)
    start = read_model(tmp_path / "start.onnx")
    begun = fine_tuning.fine_tuning_recipe(start).model_dump(mode="json") | {"start": start.digest, "seed": 9}
    (tmp_path / "mine").mkdir()
    write_checkpoint(tmp_path / "mine", Checkpoint(begun, {}, {}, {}))
    monkeypatch.setattr(fine_tuning, "labelled_samples", pytest.fail)
    command = ["train", drives, "--from", tmp_path / "start.onnx", "--out", tmp_path / "mine", "--device", "cpu"]
    told = complaint(*command, "--config", drives.parent / "config.toml")
    assert "checkpoint.pt: seed: expected that of the training begun here, 9, got 1" in told


def test_the_recipe_is_that_of_the_model(drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fine_tuning, "MAX_SEEN", 1)
    out = tmp_path / "mine"
    model_at(tmp_path / "start.onnx", WIDEST, 5)
    command = ["train", drives, "--from", tmp_path / "start.onnx", "--device", "cpu"]
    command += ["--config", drives.parent / "config.toml", "--out"]
    for name in ("foreglow", "paper"):
        message = f"expected the recipe related with --from, got {name!r}"
        assert message in complaint(*command, out, "--recipe", name)
    done = foreglow_command(*command, out, "--recipe", "related")
    assert done.exit_code == 0, done.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["recipe"]["network"] == "related"
    assert summary["mixed_in"] == OLD_SAMPLES.name
    assert OnnxClassifier(ClassifierConfig(model=out / "model.onnx")).spec == WIDEST
    more = make_drives(tmp_path / "more", num_images=2)
    done = foreglow_command(*command, tmp_path / "mixed", "--mix", more)
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--mix", "."], "expected --from with --mix"),
        (["--from", "foreglow", "--recipe", "paper"], "expected the recipe foreglow with --from, got 'paper'"),
        (["--from", "nothing.onnx"], "nothing.onnx: no such model file"),
        (["--from", "foreglow", "--preset", "paper"], "expected --preset foreglow with --from foreglow"),
        (["--from", "foreglow", "--patience", "3"], "patience: expected none where best_by is last"),
    ],
)
def test_what_does_not_go_together_is_said(drives: Path, tmp_path: Path, options: list[str], message: str) -> None:
    assert message in complaint("train", drives, "--out", tmp_path / "mine", *options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('network = "related"', "recipe: network: expected 'both', that of foreglow, which goes on, got 'related'"),
        ("kinds = false", "recipe: kinds: expected True, that of foreglow, which goes on, got False"),
    ],
)
def test_the_network_that_goes_on_is_that_of_the_model(drives: Path, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "own.toml").write_text(text)
    arguments = ("--from", "foreglow", "--recipe-file", tmp_path / "own.toml")
    assert message in complaint("train", drives, "--out", tmp_path / "mine", *arguments)
    (tmp_path / "own.toml").write_text("[classifier]\nsupport = 4\n")
    for start in (("--from", "foreglow"), ()):
        line = complaint("train", drives, "--out", tmp_path / "mine", *start, "--config", tmp_path / "own.toml")
        assert "classifier.support: expected none, or 2 as inputs.support of the recipe, got 4" in line
    assert not (tmp_path / "mine").exists()


def test_drives_that_nobody_has_labelled_teach_nothing(
    tmp_path: Path, drives: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All light in them would be learnt as light of no vehicle."""
    model_at(tmp_path / "start.onnx", NARROW, 1)
    data = make_drives(tmp_path / "data", num_images=2)
    for path in data.glob("day/*/labels/keypoints/*.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"annotations": []}))
    options = ["--from", tmp_path / "start.onnx", "--config", drives.parent / "config.toml", "--device", "cpu"]
    options += ["--epochs", 1, "--out"]
    mine = tmp_path / "mine"
    assert f"{data}/day/train: expected light artifacts among" in complaint("train", data, *options, mine)
    monkeypatch.setattr(fine_tuning, "MAX_LOSS", 1.0)
    monkeypatch.setattr(fine_tuning, "MAX_SEEN", 1)
    done = foreglow_command("train", drives / "day/train", data, *options, mine)
    assert done.exit_code == 0, done.output
    mixed = foreglow_command("train", drives, "--mix", data, *options, tmp_path / "mixed")
    assert mixed.exit_code == 0, mixed.output
    for split in ("train", "val"):
        for told in (done.stdout, mixed.stdout):
            assert f"{data}/day/{split}: no box with light: it says that nothing in it is light of a vehicle" in told


def test_nothing_is_learnt_and_kept_as_it_was(tmp_path: Path, drives: Path) -> None:
    """What is mixed in has the old model's word for targets, against the labels."""
    model_at(tmp_path / "start.onnx", NARROW, 1)
    options = ["--from", tmp_path / "start.onnx", "--config", drives.parent / "config.toml", "--device", "cpu"]
    for data in (drives, drives / "day/train"):
        line = complaint("train", data, *options, "--mix", drives, "--out", tmp_path / "mine")
        assert "DATA and --mix: expected each once" in line
