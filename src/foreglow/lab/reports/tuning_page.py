"""The report on a parameter search: Markdown with its tables and figures, all trials as CSV, the parameters as TOML."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from foreglow.checksums import replace_results
from foreglow.files import json_text
from foreglow.lab.learning.tuning import RESULTS, SPACES, Finalist, Measurement, TrialRecord, Tuning, TuningSettings
from foreglow.lab.reports.figures import AMBER, GREY, INK, png, subplots
from foreglow.lab.reports.page import Figure, Page, Table, number
from foreglow.provenance import provenance

SPLITS = ("train", "val", "test")

OBJECTIVE_WORDS = {
    "q-only": "the same",
    "q": "the same and penalties for lost recall and more false boxes",
    "light": "another one, of recall by kind of light, q and the number of boxes",
}
"""How the loss of each objective stands to the paper's, 1 - q."""

HEADINGS = {
    "q": "q",
    "q_k": "q_K",
    "q_b": "q_B",
    "recall": "R",
    "recall_lamps": "R lamps",
    "recall_strongest": "R strongest 3",
    "recall_hidden": "R hidden",
    "boxes_per_image": "boxes an image",
}


def write_report(tuning: Tuning, folder: Path) -> Path:
    """Writes what came of a search to `folder`, and returns the path of `report.md`.

    `best.toml` for `--config`, `trials.csv`, `summary.json`, `parallel.png`, `importance.png` and `report.md`: all of
    them or none.

    Raises:
        ModuleNotFoundError: If Matplotlib is not installed.
        ValueError: If one is there that was changed since an earlier call, or is of something else.
        OSError: If a file cannot be written.
    """
    page = _page(tuning)
    folder.mkdir(parents=True, exist_ok=True)
    files = {
        "best.toml": _best_toml(tuning).encode(),
        "trials.csv": _trials(tuning).csv().encode(),
        "summary.json": json_text(provenance() | _summary(tuning)).encode(),
        **page.files("report.md"),
    }
    replace_results(folder, files, removed=[name for name in RESULTS if name not in files])
    return folder / "report.md"


def _best_toml(tuning: Tuning) -> str:
    settings = tuning.settings
    fields = tuning.chosen.config.model_dump(exclude_none=True, exclude={"backend", "dispatch"})
    camera = {} if settings.white_level is None else {"guard": {"white_level": settings.white_level}}
    return (
        f"# Found by foreglow tune: objective {settings.objective}, space {settings.space_name}, "
        f"{len(tuning.trials)} trials, seed {settings.seed}.\n" + tomli_w.dumps({"proposals": fields} | camera)
    )


def _trials(tuning: Tuning) -> Table:
    parameters = SPACES[tuning.settings.space_name].ranges
    measured = ["num_images", "num_boxes", *HEADINGS]
    rows = [
        [
            trial.number,
            trial.state,
            trial.loss,
            *(trial.parameters.get(name) for name in parameters),
            *(trial.measurement.get(name) for name in measured),
        ]
        for trial in tuning.trials
    ]
    return Table(["number", "state", "loss", *parameters, *measured], rows)


def _summary(tuning: Tuning) -> dict[str, Any]:
    return {
        "data": str(tuning.data),
        "study": tuning.study_name,
        "settings": {**dataclasses.asdict(tuning.settings), "storage": _without_password(tuning.settings.storage)},
        "beside_paper": _beside_paper(tuning.settings),
        "num_finished": len(tuning.trials),
        "num_pruned": _num_pruned(tuning),
        "seconds": tuning.seconds,
        "importances": tuning.importances,
        "chosen": _summary_of(tuning.chosen, tuning),
        "paper": _summary_of(tuning.paper, tuning),
        "finalists": [_summary_of(finalist, tuning) for finalist in tuning.finalists],
    }


def _beside_paper(settings: TuningSettings) -> dict[str, str]:
    """What is as in the paper's search, in words."""
    is_same = settings.space_name == "paper"
    return {
        "space": "in the same space by the same step" if is_same else f"in another space, `{settings.space_name}`",
        "objective": OBJECTIVE_WORDS[settings.objective],
    }


def _num_pruned(tuning: Tuning) -> int:
    return sum(trial.state == "PRUNED" for trial in tuning.trials)


def _without_password(storage: str | None) -> str | None:
    """A database's URL as it may be shown.

    >>> _without_password("postgresql://ann:secret@host/db")
    'postgresql://ann@host/db'
    """
    return None if storage is None else re.sub(r"(://[^:/@]*):[^@/]*@", r"\1@", storage)


def _summary_of(finalist: Finalist, tuning: Tuning) -> dict[str, Any]:
    """A finalist with the parameters that were searched; infinity, which JSON lacks, as text."""
    parameters = finalist.config.model_dump(include=_searched_fields(tuning))
    return {
        "parameters": {name: "inf" if value == math.inf else value for name, value in parameters.items()},
        "train_loss": finalist.train_loss,
        "val_loss": finalist.val_loss,
        **{split: getattr(finalist, split) for split in SPLITS},
    }


def _searched_fields(tuning: Tuning) -> set[str]:
    """The fields of the configuration that the space varies."""
    searched = SPACES[tuning.settings.space_name]
    flipped = {name: not value for name, value in searched.first.items() if isinstance(value, bool)}
    return set(searched.fields(searched.first)) | set(searched.fields({**searched.first, **flipped}))


def _page(tuning: Tuning) -> Page:
    settings, chosen, paper = tuning.settings, tuning.chosen, tuning.paper
    searched = sorted(_searched_fields(tuning))
    page = Page(f"Parameters of the proposal stage, tuned on {tuning.data.name}")
    page.text(
        f"Objective `{settings.objective}`, space `{settings.space_name}`, {len(tuning.trials)} trials on "
        f"{paper.train.num_images} images of train, {_num_pruned(tuning)} of them ended early; seed {settings.seed}. "
        f"The trials of the last call took {tuning.seconds['trials']:.0f} s, the comparison on other splits "
        f"{tuning.seconds['comparison']:.0f} s."
    )
    split = "val" if chosen.val is not None else "train (there is no val)"
    page.section("Chosen", f"The best of the finalists on {split}.")
    rows = [[name, f"{getattr(chosen.config, name):g}", f"{getattr(paper.config, name):g}"] for name in searched]
    page.table(Table(["parameter", "chosen", "paper"], rows))
    rows = [
        [f"{split}, {name}", number(getattr(finalist, f"{split}_loss", None), 4), *_figures(getattr(finalist, split))]
        for split in SPLITS
        for name, finalist in (("chosen", chosen), ("paper", paper))
        if getattr(finalist, split) is not None
    ]
    page.table(Table(["", "loss", *HEADINGS.values()], rows))
    page.section("Finalists", f"The best on train and the paper's, in the order of their loss on {split}.")
    rows = [
        [
            *(f"{getattr(finalist.config, name):g}" for name in searched),
            number(finalist.train_loss, 4),
            number(finalist.val_loss, 4),
        ]
        for finalist in tuning.finalists
    ]
    page.table(Table([*searched, "loss on train", "loss on val"], rows))
    page.section("Trials")
    page.figure(Figure(png(_parallel_figure(tuning)), "The trials' parameters and losses", "parallel.png"))
    if tuning.importances:
        page.text("How much each parameter matters to being among the best (PED-ANOVA):")
        page.figure(Figure(png(_importance_figure(tuning.importances)), "Importance", "importance.png"))
    else:
        page.text("Too few finished trials to tell which parameter matters.")
    return page


def _figures(measured: Measurement) -> list[str]:
    return [number(measured.figures[name], 2 if name == "boxes_per_image" else 3) for name in HEADINGS]


def _parallel_figure(tuning: Tuning) -> Any:
    """A line a trial through its parameters to its loss; the darker the better, the best on train in colour."""
    from matplotlib import colormaps

    complete = [trial for trial in tuning.trials if trial.state == "COMPLETE"]
    complete.sort(key=lambda trial: -trial.loss)
    ranges = SPACES[tuning.settings.space_name].ranges
    names = [*ranges, "loss"]
    figure, (axes,) = subplots(1, 1.5 * len(names) + 1.0, 3.8)
    # One column for each axis, from its lowest to its highest value; switches and the loss's rank go from 0 to 1.
    table = np.array(
        [[*(trial.parameters[name] for name in ranges), _rank(trial.loss, complete)] for trial in complete], np.float64
    ).reshape(len(complete), len(names))
    limits = [(getattr(ranges.get(name), "low", 0.0), getattr(ranges.get(name), "high", 1.0)) for name in names]
    low, high = np.array(limits, np.float64).T
    heights = (table - low) / np.where(high > low, high - low, 1.0)
    greys = colormaps["Greys"]
    for order, line in enumerate(heights):
        is_best = order == len(heights) - 1
        shade = 0.15 + 0.6 * order / max(len(heights) - 1, 1)
        axes.plot(line, color=AMBER if is_best else greys(shade), linewidth=2.2 if is_best else 0.8)
    ends = [(f"{least:g}", f"{most:g}") for least, most in limits[:-1]]
    if complete:
        ends.append((f"{complete[-1].loss:.3g}", f"{complete[0].loss:.3g}"))
    for x, (below, above) in enumerate(ends):
        axes.text(x, -0.04, below, ha="center", va="top", color=INK, fontsize=8)
        axes.text(x, 1.04, above, ha="center", va="bottom", color=INK, fontsize=8)
    axes.set_xticks(range(len(names)), [*names[:-1], "loss, by rank"], fontsize=8)
    axes.tick_params(length=0, pad=12)
    axes.set(yticks=[], ylim=(-0.03, 1.03))
    axes.grid(visible=True, axis="x", color=INK, linewidth=0.6)
    axes.spines[:].set_visible(False)
    return figure


def _rank(loss: float, trials: Sequence[TrialRecord]) -> float:
    """0 for the lowest loss of `trials`, 1 for the highest."""
    return sum(trial.loss < loss for trial in trials) / max(len(trials) - 1, 1)


def _importance_figure(importances: dict[str, float]) -> Any:
    figure, (axes,) = subplots(1, 5.0, 0.4 * len(importances) + 0.9)
    names = sorted(importances, key=lambda name: importances[name])
    axes.barh(names, [importances[name] for name in names], color=GREY)
    axes.set(xlabel="importance")
    return figure
