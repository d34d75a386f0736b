"""Runs the experiments that answer the paper's claims, each into its own folder; what is there is not run again."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import shlex
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import RootModel

from foreglow.datasets import SPLIT_NAMES, split_in
from foreglow.datasets.json_files import Record, read_json
from foreglow.files import file_digest, read_plain_json, write_json_results
from foreglow.lab.studies.config_files import files_of
from foreglow.lab.studies.detector.rows import check_given, given_digest, split_digest
from foreglow.lab.studies.progress import Progress
from foreglow.lab.studies.reproduction.experiments import EXPERIMENTS, counted_splits
from foreglow.lab.studies.reproduction.plan import ReproductionPlan
from foreglow.models import model_path
from foreglow.parallel import Local, Parent, Workers
from foreglow.pipeline import Pipeline
from foreglow.plugins import first_line_of

STATE = "experiments.json"
"""What has been run, and why others could not be."""

WAVES = (
    ("settings", "data", "detector", "distance", "drive", "detection-range"),
    ("tune",),
    ("time-benefit",),
    ("glare",),
    ("runtime",),
)
"""What may run at once; a single experiment spreads its own work. The table of detectors may train the paper's network,
which later ones use, and nothing disturbs the run-times."""


class Known(Record):
    """What `STATE` keeps of an experiment: what it was run with (`key`), and what came of it, as in `Outcome`.

    Attributes:
        epochs: What was asked for where networks are trained.
        results: Digest of the file with its results.
    """

    key: str = ""
    results: str = ""
    seconds: float = 0.0
    load: float = 0.0
    reason: str = ""
    has_failed: bool = False
    epochs: int | None = None


class State(RootModel[dict[str, Known]]):
    """The file `STATE`, by experiment."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of an experiment.

    Attributes:
        seconds: How long it took.
        load: Programs that wanted a core at its end, over the cores; or when a part of it was measured, if more did.
        reason: Why there are no results; empty if there are.
        has_failed: Whether it was begun, and ended with that reason.
        results: As its file has them.
    """

    command: str
    seconds: float
    load: float = 0.0
    reason: str = ""
    has_failed: bool = False
    results: Mapping[str, Any] | None = None


def run_experiments(
    plan: ReproductionPlan, out: Path, *, workers: Workers | None = None, progress: Progress
) -> dict[str, Outcome]:
    """Runs what `out` does not have yet, and returns what came of each experiment, by its name.

    Independent experiments run at once on the workers; those that spread their own work have them all.

    Raises:
        FileNotFoundError: If there is no split `test`, or a given model is missing.
        ValueError: If a model or the configuration cannot be used, networks were trained for other epochs in `out`, or
            folders there are of something else.
        OSError: If something cannot be written.
    """
    plan.split("test")
    check_given(plan.models, plan.config.guard.white_level)
    Pipeline(plan.config.commanding())  # opens our model; an experiment that cannot would only have a reason
    _claim(out)
    state = read_json(out / STATE, State).root
    known: dict[str, dict[str, Any]] = {name: each.model_dump(exclude_unset=True) for name, each in state.items()}
    begun = known.get("detector", {}).get("epochs", plan.epochs)
    if begun != plan.epochs:
        raise ValueError(
            f"{out}: --epochs: expected that of the networks trained here, {begun or 'the default'}, got "
            f"{plan.epochs or 'the default'}; name another folder"
        )
    digest, files = _data_digest(plan), tuple(files_of(plan.config).values())
    for wave in WAVES:
        outer, inner = (workers or Local(), Local()) if len(wave) > 1 else (Local(), workers or Local())
        todo: dict[str, str] = {}
        for name in wave:
            key = _key(name, plan, out, digest, files)
            before, found = known.get(name, {}), _results_digest(name, out)
            if before.get("key") != key or not found or before.get("results") != found:
                todo[name] = name
                known[name] = {"key": key} | ({"epochs": plan.epochs} if name == "detector" else {})
        work = functools.partial(_run, plan, out, inner)
        for name, told in outer.each(work, todo, progress, paths=(out, plan.data)):
            known[name] |= told | {"results": _results_digest(name, out)} | ({"key": ""} if told["reason"] else {})
            write_json_results(out / STATE, known)
    return {name: _outcome(name, plan, out, known[name]) for name in EXPERIMENTS}


def _claim(out: Path) -> None:
    """Makes the folder with its `STATE`, or checks that it has one, if it has folders with the experiments' names.

    Raises:
        ValueError: If such a folder is of something else.
    """
    out.mkdir(parents=True, exist_ok=True)
    if (out / STATE).exists():
        return
    for name in (*EXPERIMENTS, "images"):
        if (out / name).exists():
            raise ValueError(
                f"{out / name}: expected nothing there but what `reproduce` has begun; name another folder"
            )
    write_json_results(out / STATE, {})


def _run(plan: ReproductionPlan, out: Path, workers: Workers, name: str, parent: Parent) -> dict[str, Any]:
    """What is kept of an outcome; a reason that the data give ends this experiment alone."""
    experiment, started_s = EXPERIMENTS[name], time.monotonic()
    reason, has_failed = experiment.reason(plan), False
    if not reason:

        def progress(step: str, num_done: int, num_all: int) -> None:
            parent.report_progress(f"{name}: {step}", num_done, num_all)

        (out / name).mkdir(exist_ok=True)
        try:
            experiment.run(plan, out / name, workers, progress)
        except (FileNotFoundError, ImportError, ValueError) as error:
            reason, has_failed = first_line_of(error), True
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    return {"seconds": time.monotonic() - started_s, "load": load, "reason": reason, "has_failed": has_failed}


def _outcome(name: str, plan: ReproductionPlan, out: Path, kept: Mapping[str, Any]) -> Outcome:
    known = Known.model_validate(kept)  # a part of it may be lost
    file = out / name / EXPERIMENTS[name].results
    results = read_plain_json(file) if file.is_file() and not known.reason else None
    # Rows of the table of detectors that an interrupted call measured are not measured again.
    rows = (row for row in (results or {}).get("rows", []) if isinstance(row, dict))
    load = max([known.load, *(row.get("load", 0.0) for row in rows)])
    return Outcome(_words(name, plan, out), known.seconds, load, known.reason, known.has_failed, results)


def _results_digest(name: str, out: Path) -> str:
    """Digest of an experiment's results; empty without any. Damaged or changed ones are made again."""
    file = out / name / EXPERIMENTS[name].results
    return file_digest(file) if file.is_file() else ""


def _words(name: str, plan: ReproductionPlan, out: Path) -> str:
    return shlex.join(map(str, ("foreglow", *EXPERIMENTS[name].command(plan, out / name))))


def _key(name: str, plan: ReproductionPlan, out: Path, data_digest: str, of_config: Sequence[Path]) -> str:
    """Digest of what decides an experiment's results: data, options, models, our version; not where files and folders
    are, which may be moved.
    """
    words = EXPERIMENTS[name].command(plan, out / name)
    parts: list[Any] = [metadata.version("foreglow"), data_digest]
    parts += ["" if isinstance(word, Path) else str(word) for word in words]
    parts += [counted_splits(plan)] if name == "data" else []  # of the other cycle as well
    parts += [split_digest(split_in(word, "test")) for word in words if word in plan.straight]
    given = [word for word in words if isinstance(word, Path) and not word.is_relative_to(out / name)]
    parts += [given_digest(row, path) for row, path in plan.models.items() if path in given]
    files = [model_path(path) for path in given if path not in plan.models.values()]
    if EXPERIMENTS[name].runs_pipeline:
        parts.append(plan.config.model_dump_json())
        files += of_config
    parts += [file_digest(file) for file in files if file.is_file()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _data_digest(plan: ReproductionPlan) -> str:
    digests = (split_digest(plan.split(name)) for name in SPLIT_NAMES if plan.has(name))
    return hashlib.sha256("".join(digests).encode()).hexdigest()
