"""The report on a parameter search: Markdown with its tables and figures, all trials as CSV, the parameters as TOML."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from foreglow.files import write_atomic, write_json_results
from foreglow.lab.learning.tuning import SPACES, Finalist, Measurement, TrialRecord, Tuning
from foreglow.lab.reports.figures import AMBER, GREY, INK, png, subplots
from foreglow.lab.reports.numbers import number
from foreglow.provenance import checkout_state

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

    `best.toml` for `--config`, `trials.csv`, `summary.json`; then `parallel.png`, `importance.png` and `report.md`.

    Raises:
        ModuleNotFoundError: If Matplotlib is not installed; the first three files are there then.
        OSError: If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(folder / "best.toml", _best_toml(tuning).encode())
    write_atomic(folder / "trials.csv", _trials_csv(tuning).encode())
    write_json_results(folder / "summary.json", _summary(tuning))
    write_atomic(folder / "parallel.png", png(_parallel_figure(tuning)))
    importance = folder / "importance.png"
    if tuning.importances:
        write_atomic(importance, png(_importance_figure(tuning.importances)))
    else:
        importance.unlink(missing_ok=True)
    report = folder / "report.md"
    write_atomic(report, "\n".join(_lines(tuning)).encode())
    return report


def _best_toml(tuning: Tuning) -> str:
    settings = tuning.settings
    fields = tuning.chosen.config.model_dump(exclude_none=True, exclude={"backend", "dispatch"})
    return (
        f"# Found by foreglow tune: objective {settings.objective}, space {settings.space_name}, "
        f"{len(tuning.trials)} trials, seed {settings.seed}.\n" + tomli_w.dumps({"proposals": fields})
    )


def _trials_csv(tuning: Tuning) -> str:
    ranges = SPACES[tuning.settings.space_name].ranges
    names = ["number", "state", "loss", *ranges, "num_images", "num_boxes", *HEADINGS]
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    for one in tuning.trials:
        writer.writerow(
            {"number": one.number, "state": one.state, "loss": one.loss, **one.parameters, **one.measurement}
        )
    return text.getvalue()


def _summary(tuning: Tuning) -> dict[str, Any]:
    commit, has_local_changes = checkout_state()
    return {
        "version": version("foreglow"),
        "commit": commit,
        "has_local_changes": has_local_changes,
        "data": str(tuning.data),
        "study": tuning.study_name,
        "settings": {**dataclasses.asdict(tuning.settings), "storage": _without_password(tuning.settings.storage)},
        "num_finished": len(tuning.trials),
        "num_pruned": sum(one.state == "PRUNED" for one in tuning.trials),
        "seconds": tuning.seconds,
        "importances": tuning.importances,
        "chosen": _as_json(tuning.chosen, tuning),
        "paper": _as_json(tuning.paper, tuning),
        "finalists": [_as_json(one, tuning) for one in tuning.finalists],
    }


def _without_password(storage: str | None) -> str | None:
    """A database's URL as it may be shown.

    >>> _without_password("postgresql://ann:secret@host/db")
    'postgresql://ann@host/db'
    """
    return None if storage is None else re.sub(r"(://[^:/@]*):[^@/]*@", r"\1@", storage)


def _as_json(one: Finalist, tuning: Tuning) -> dict[str, Any]:
    """A finalist with the parameters that were searched; infinity, which JSON lacks, as text."""
    parameters = one.config.model_dump(include=_searched_fields(tuning))
    return {
        "parameters": {name: "inf" if value == math.inf else value for name, value in parameters.items()},
        "train_loss": one.train_loss,
        "val_loss": one.val_loss,
        **{
            split: None if found is None else found.to_json()
            for split, found in (("train", one.train), ("val", one.val), ("test", one.test))
        },
    }


def _searched_fields(tuning: Tuning) -> set[str]:
    """The fields of the configuration that the space varies."""
    searched = SPACES[tuning.settings.space_name]
    flipped = {name: not value for name, value in searched.first.items() if isinstance(value, bool)}
    return set(searched.fields(searched.first)) | set(searched.fields({**searched.first, **flipped}))


def _lines(tuning: Tuning) -> list[str]:
    settings = tuning.settings
    num_pruned = sum(one.state == "PRUNED" for one in tuning.trials)
    lines = [
        f"# Parameters of the proposal stage, tuned on {tuning.data.name}",
        "",
        f"Objective `{settings.objective}`, space `{settings.space_name}`, {len(tuning.trials)} trials on "
        f"{tuning.paper.train.num_images} images of train, {num_pruned} of them ended early; seed {settings.seed}. "
        f"The trials of the last call took {tuning.seconds['trials']:.0f} s, the comparison on other splits "
        f"{tuning.seconds['comparison']:.0f} s.",
        "",
        "## Chosen",
        "",
        "The best of the finalists on " + ("val" if tuning.chosen.val is not None else "train (there is no val)") + ".",
        "",
        "| parameter | chosen | paper |",
        "|---|---|---|",
    ]
    chosen, paper = tuning.chosen.config, tuning.paper.config
    searched = sorted(_searched_fields(tuning))
    lines += [f"| {name} | {getattr(chosen, name):g} | {getattr(paper, name):g} |" for name in searched]
    lines += ["", f"| | loss | {' | '.join(HEADINGS.values())} |", f"|{'---|' * (len(HEADINGS) + 2)}"]
    for split in ("train", "val", "test"):
        for name, one in (("chosen", tuning.chosen), ("paper", tuning.paper)):
            found: Measurement | None = getattr(one, split)
            if found is not None:
                lines.append(_row(f"{split}, {name}", getattr(one, f"{split}_loss", None), found))
    lines += ["", "## Finalists", "", "The best on train and the paper's, in the order of their loss on val.", ""]
    lines += [f"| {' | '.join(searched)} | loss on train | loss on val |", "|" + "---|" * (len(searched) + 2)]
    for one in tuning.finalists:
        values = " | ".join(f"{getattr(one.config, name):g}" for name in searched)
        lines.append(f"| {values} | {one.train_loss:.4f} | {number(one.val_loss, 4)} |")
    lines += ["", "## Trials", "", "![trials](parallel.png)", ""]
    if tuning.importances:
        lines += ["How much each parameter matters to being among the best (PED-ANOVA):", ""]
        lines += ["![importance](importance.png)", ""]
    else:
        lines += ["Too few finished trials to tell which parameter matters.", ""]
    return lines


def _row(name: str, loss: float | None, found: Measurement) -> str:
    figures = " | ".join(number(found.figures[key], 2 if key == "boxes_per_image" else 3) for key in HEADINGS)
    return f"| {name} | {number(loss, 4)} | {figures} |"


def _parallel_figure(tuning: Tuning) -> Any:
    """A line a trial through its parameters to its loss; the darker the better, the best on train in colour."""
    from matplotlib import colormaps

    complete = [one for one in tuning.trials if one.state == "COMPLETE"]
    complete.sort(key=lambda one: -one.loss)
    names = [*SPACES[tuning.settings.space_name].ranges, "loss"]
    figure, (axes,) = subplots(1, 1.5 * len(names) + 1.0, 3.8)
    table = np.array([[_coordinate(one, name) for name in names] for one in complete], np.float64)
    table = table.reshape(len(complete), len(names))
    table[:, -1] = [_rank(one.loss, complete) for one in complete]
    low, high = _limits(tuning, names)
    heights = (table - low) / np.where(high > low, high - low, 1.0)
    greys = colormaps["Greys"]
    for place, line in enumerate(heights):
        is_best = place == len(heights) - 1
        shade = 0.15 + 0.6 * place / max(len(heights) - 1, 1)
        axes.plot(line, color=AMBER if is_best else greys(shade), linewidth=2.2 if is_best else 0.8)
    for place in range(len(names) - 1):
        for text, height in ((f"{low[place]:g}", -0.04), (f"{high[place]:g}", 1.04)):
            axes.text(place, height, text, ha="center", va="top" if height < 0 else "bottom", color=INK, fontsize=8)
    if complete:
        for text, height in ((f"{complete[-1].loss:.3g}", -0.04), (f"{complete[0].loss:.3g}", 1.04)):
            place = len(names) - 1
            axes.text(place, height, text, ha="center", va="top" if height < 0 else "bottom", color=INK, fontsize=8)
    axes.set_xticks(range(len(names)), [*names[:-1], "loss, by rank"], fontsize=8)
    axes.tick_params(length=0, pad=12)
    axes.set(yticks=[], ylim=(-0.03, 1.03))
    axes.grid(visible=True, axis="x", color=INK, linewidth=0.6)
    axes.spines[:].set_visible(False)
    return figure


def _limits(tuning: Tuning, names: list[str]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Lowest and highest value of each axis; 0 and 1 for switches and for the loss's rank."""
    ranges = SPACES[tuning.settings.space_name].ranges
    limits = [(getattr(ranges.get(name), "low", 0.0), getattr(ranges.get(name), "high", 1.0)) for name in names]
    low, high = np.array(limits, np.float64).T
    return low, high


def _coordinate(one: TrialRecord, name: str) -> float:
    return float(one.loss if name == "loss" else one.parameters[name])


def _rank(loss: float, trials: list[TrialRecord]) -> float:
    """0 for the lowest loss of `trials`, 1 for the highest."""
    return sum(one.loss < loss for one in trials) / max(len(trials) - 1, 1)


def _importance_figure(importances: dict[str, float]) -> Any:
    """A bar a parameter."""
    figure, (axes,) = subplots(1, 5.0, 0.4 * len(importances) + 0.9)
    names = sorted(importances, key=lambda name: importances[name])
    axes.barh(names, [importances[name] for name in names], color=GREY)
    axes.set(xlabel="importance")
    return figure
