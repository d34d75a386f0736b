from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from foreglow.lab.learning.batches import learning_rate, num_plateaus
from foreglow.lab.learning.recipes import RECIPES, Recipe, changed, read_recipe, recipe, recipe_to_toml


@pytest.mark.parametrize("name", RECIPES)
@pytest.mark.parametrize("base", RECIPES)
def test_a_recipe_is_read_back_over_any_base(tmp_path: Path, name: str, base: str) -> None:
    wanted = changed(RECIPES[name], {"patience": 7, "inputs": {"lag_s": 0.25}})
    for chosen in (RECIPES[name], wanted):
        path = tmp_path / "recipe.toml"
        path.write_text(recipe_to_toml(chosen))
        assert read_recipe(path, changed(RECIPES[base], {"max_gradient": 3.0, "inputs": {"lag_s": 0.5}})) == chosen


def test_the_published_recipe() -> None:
    """Paper and published code, number by number."""
    paper = recipe("paper")
    assert (paper.epochs, paper.batch_size, paper.learning_rate, paper.weight_decay) == (300, 64, 1e-3, 0.01)
    assert (paper.optimiser, paper.schedule, paper.plateau_factor, paper.plateau_patience) == (
        "adam",
        "plateau",
        0.9,
        5,
    )
    assert (paper.positive_weight, paper.best_by, paper.calibration) == ("balanced", "loss", "none")
    augmentation = paper.augmentation
    assert (augmentation.flip, augmentation.rotation_deg, augmentation.min_area) == (0.5, 20.0, 0.8)
    assert (augmentation.max_ratio, augmentation.gamma, augmentation.normalise) == (1.5, 0.2, True)
    assert (paper.inputs.size_px, paper.inputs.support, paper.inputs.lag_s, paper.inputs.num_features) == (
        64,
        2,
        None,
        0,
    )
    assert paper.jitter.num_copies == 0


def test_a_table_changes_only_what_it_names(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('max_gradient = "none"\nepochs = 3\n[augmentation]\nnoise = 0.1\n')
    found, base = read_recipe(path, RECIPES["foreglow"]), RECIPES["foreglow"]
    assert (found.epochs, found.max_gradient, found.augmentation.noise) == (3, None, 0.1)
    assert found.augmentation.model_copy(update={"noise": base.augmentation.noise}) == base.augmentation


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("epoch = 3", "epoch: unknown, expected one of network"),
        ("epochs = 0", "epochs: Input should be greater than or equal to 1, got 0"),
        ("[augmentation]\nflips = 0.5", "augmentation.flips: unknown, expected one of flip"),
        ("epochs = 2\nwarmup_epochs = 3.0", "warmup_epochs: expected at most epochs, 2, got 3"),
        ("schedule = 'plateau'", "warmup_epochs: expected 0 with the schedule plateau"),
        ("epochs 3", "expected TOML"),
        ("[inputs]\nsize_px = 1000000", "inputs.*size_px: expected 1 to 1024, got 1000000"),
        ("[inputs]\nsupport = 1000", "inputs.*support: expected 1 to 100, got 1000"),
        ("[inputs]\ncontext = 1000", "inputs.*context: expected 1 to 100, got 1000"),
        ("patience = 3\nbest_by = 'last'", "patience: expected none where best_by is last, as each epoch is, got 3"),
        ("patience = 100001", "patience: Input should be less than or equal to 100000"),
    ],
)
def test_a_bad_recipe_names_file_and_field(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"own.toml: .*{message}"):
        read_recipe(path, RECIPES["foreglow"])


def test_a_check_of_the_whole_recipe_has_no_other_name(tmp_path: Path) -> None:
    path = tmp_path / "rf.toml"
    path.write_text("[inputs]\ntogether = false\n")
    with pytest.raises(ValueError, match=r"rf\.toml: inputs\.together: expected true with the network both"):
        read_recipe(path, RECIPES["foreglow"])


def test_an_unknown_network_is_refused_in_python_too() -> None:
    with pytest.raises(ValueError, match=r"recipe: network: expected one of paper, compact, related, both, got 'x'"):
        changed(recipe("compact"), {"network": "x"})


def test_an_unknown_recipe_lists_the_known() -> None:
    with pytest.raises(ValueError, match="recipe: expected one of paper, compact, related, foreglow, got 'best'"):
        recipe("best")


def rates(fields: dict[str, Any], epochs_done: list[float]) -> list[float]:
    base: dict[str, Any] = {"epochs": 10, "learning_rate": 1.0, "warmup_epochs": 0.0}
    chosen = changed(RECIPES["foreglow"], base | fields)
    return [learning_rate(chosen, done, []) for done in epochs_done]


def test_cosine_with_warm_up() -> None:
    found = rates({"schedule": "cosine", "warmup_epochs": 2.0}, [0.0, 1.0, 2.0, 6.0, 10.0])
    assert found == pytest.approx([0.0, 0.5, 1.0, 0.5, 0.0])
    assert rates({"schedule": "constant", "warmup_epochs": 2.0}, [1.0, 2.0, 10.0]) == pytest.approx([0.5, 1.0, 1.0])
    assert rates({"epochs": 2, "schedule": "cosine", "warmup_epochs": 2.0}, [1.0, 2.0]) == pytest.approx([0.5, 1.0])


@pytest.mark.torch
def test_plateau_is_that_of_torch() -> None:
    torch = pytest.importorskip("torch")
    import numpy as np

    losses = np.abs(np.random.default_rng(0).normal(1, 0.5, 60)).round(2).tolist() + [math.nan] * 8
    for patience in (0, 2, 5):
        chosen = changed(RECIPES["paper"], {"plateau_patience": patience})
        optimiser = torch.optim.SGD([torch.zeros(1, requires_grad=True)], chosen.learning_rate)
        scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(optimiser, "min", factor=0.9, patience=patience)
        for number, loss in enumerate(losses):
            scheduler.step(loss)
            expected = optimiser.param_groups[0]["lr"]
            # torch leaves out reductions below 1e-8, far from here
            assert learning_rate(chosen, number + 1, losses[: number + 1]) == pytest.approx(expected, rel=1e-9)
    assert num_plateaus([], 5) == 0


def test_recipes_are_frozen() -> None:
    with pytest.raises(ValueError, match="frozen"):
        recipe("paper").epochs = 3
    assert isinstance(recipe("paper"), Recipe)
