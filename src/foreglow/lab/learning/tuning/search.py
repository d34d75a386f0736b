"""A whole search: trials on train, a comparison of the best few on val, and a rating of the chosen one on test."""

from __future__ import annotations

import dataclasses
import functools
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foreglow.checksums import check_as_written
from foreglow.config import ProposalConfig
from foreglow.datasets import LabelledSource, open_labelled, split_folder
from foreglow.datasets.pvdn.splits import existing_splits
from foreglow.lab.evaluation.boxes.breakdown import check_has_light
from foreglow.lab.learning.annotation import Progress
from foreglow.lab.learning.apart import check_apart
from foreglow.lab.learning.tuning.measurement import Bench, Material, Measurement, measure_split, read_material
from foreglow.lab.learning.tuning.objectives import PAPER, Parameters
from foreglow.lab.learning.tuning.study import (
    StudyPlan,
    TuningSettings,
    check_storage,
    importances,
    num_finished,
    open_study,
    prepare,
    work,
)
from foreglow.parallel import Local, Parent, Workers

if TYPE_CHECKING:
    import optuna

RESULTS = ("best.toml", "trials.csv", "summary.json", "report.md", "parallel.png", "importance.png")
"""What is written of a search, at its end."""


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """One trial.

    Attributes:
        state: COMPLETE, or PRUNED if it was stopped early.
        loss: Loss over the frames that it was measured on.
        parameters: Its parameters by name.
        measurement: Its rating, as `Measurement.to_json`.
    """

    number: int
    state: str
    loss: float
    parameters: Parameters
    measurement: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Finalist:
    """Parameters that were compared on val.

    Attributes:
        config: Configuration of the proposal stage.
        train: Rating on the images of the search.
        train_loss: Loss of that rating.
        val: Rating on all images of val; None without that split.
        val_loss: Loss of that rating.
        test: Rating on all images of test, for the chosen parameters and the paper's only.
    """

    config: ProposalConfig
    train: Measurement
    train_loss: float
    val: Measurement | None = None
    val_loss: float | None = None
    test: Measurement | None = None


@dataclass(frozen=True, slots=True)
class Tuning:
    """The result of a search.

    Attributes:
        settings: What was searched, and how.
        data: The data set.
        study_name: Name of the study in its storage; it identifies the data, the objective and our version.
        paper: The paper's parameters, rated like the finalists.
        finalists: The best on train and the paper's parameters; the best on val is first, and chosen.
        trials: All finished trials, in order.
        importances: Importance of each parameter, adding up to 1; empty with few trials.
        seconds: Duration of the trials of this call, and of the comparison after them.
    """

    settings: TuningSettings
    data: Path
    study_name: str
    paper: Finalist
    finalists: tuple[Finalist, ...]
    trials: tuple[TrialRecord, ...]
    importances: dict[str, float]
    seconds: dict[str, float]

    @property
    def chosen(self) -> Finalist:
        """The chosen parameters."""
        return self.finalists[0]


def tune(
    data: Path | str,
    out: Path | str,
    settings: TuningSettings,
    progress: Progress | None = None,
    *,
    workers: Workers | None = None,
) -> Tuning:
    """Searches parameters of the proposal stage; a call with the same data and storage continues its study.

    Trials are measured on a subset of train. The best few and the paper's parameters are then compared on all of val,
    and the best there is chosen; without a val split, the best on train. If there is a test split, the chosen and the
    paper's parameters are rated on all of it.

    Raises:
        FileNotFoundError: If there is no train split, or a file of the data set is missing.
        ModuleNotFoundError: If Optuna is not installed.
        ValueError: If train is val or test by another name, no light is labelled in val or in the images of train that
            the search goes by, a label or an image is broken, the storage cannot be used,
            the study there has another seed, no trial was finished, or `out` has a result that was changed since it
            was written.
        KeyboardInterrupt: On Ctrl-C; finished trials are kept.
    """
    out = Path(out)
    import optuna  # noqa: F401  before anything is decoded

    check_as_written(out, RESULTS)
    folders = {"train": split_folder(data, "train"), **existing_splits(Path(data), ("val", "test"))}
    check_apart([folders["train"]], [folder for name, folder in folders.items() if name != "train"])
    splits = {name: open_labelled(folder, settings.white_level) for name, folder in folders.items()}
    workers = workers or Local()
    if "val" in splits:
        check_has_light(splits["val"])
    storage = settings.storage or str(out / "study.journal")
    check_storage(storage)
    material = read_material(
        splits["train"], settings.num_images, out / "frames", jobs=workers.num_workers, progress=progress
    )
    of_version = f"{material.digest}-{version('foreglow')}"  # another one may propose other boxes
    name = f"{settings.objective}-{settings.space_name}-{len(material.image_ids)}-{of_version}"
    plan = StudyPlan(storage, name, settings)
    started_s = time.monotonic()
    study = open_study(plan)
    prepare(study, plan)
    _run_trials(study, plan, material, workers, progress)
    searched_s = time.monotonic()
    trials = _records(study)
    if not trials:
        raise ValueError(f"{plan.shown_storage}: expected a finished trial, found none: the same command goes on")
    finalists = _on_train(_best(trials, settings), Bench(material), settings)
    finalists = _on_val(finalists, splits.get("val"), settings, progress)
    finalists = _on_test(finalists, splits.get("test"), progress)
    paper = next(finalist for finalist in finalists if finalist.config == PAPER)
    seconds = {"trials": searched_s - started_s, "comparison": time.monotonic() - searched_s}
    return Tuning(settings, Path(data), plan.name, paper, tuple(finalists), trials, importances(study), seconds)


def _run_trials(
    study: optuna.Study, plan: StudyPlan, material: Material, workers: Workers, progress: Progress | None
) -> None:
    """Runs the missing trials; every worker works on the study until it is finished."""

    def tell() -> None:
        if progress is not None:
            progress("trials", num_finished(study), plan.settings.num_trials)

    tell()
    num_workers = min(workers.num_workers, plan.settings.num_trials - num_finished(study))
    items = {f"worker {number}": number for number in range(1, num_workers + 1)}
    paths = (material.frames.path, *([] if "://" in plan.storage else [Path(plan.storage)]))
    for _ in workers.each(functools.partial(_work, plan, material), items, tell, paths=paths):
        pass


def _work(plan: StudyPlan, material: Material, number: int, parent: Parent) -> None:  # noqa: ARG001
    prepare(open_study(plan), plan)  # a process that died may have left a trial behind
    work(plan, material, lambda: parent.is_stopped, parent.report_progress)


def _records(study: optuna.Study) -> tuple[TrialRecord, ...]:
    from optuna.trial import TrialState

    return tuple(
        TrialRecord(
            trial.number, trial.state.name, float(trial.value), trial.params, trial.user_attrs.get("measurement", {})
        )
        for trial in study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED))
        if trial.value is not None
    )


def _best(trials: tuple[TrialRecord, ...], settings: TuningSettings) -> list[ProposalConfig]:
    complete = sorted(
        (trial for trial in trials if trial.state == "COMPLETE"), key=lambda trial: (trial.loss, trial.number)
    )
    rounded = [  # as in `Range.suggest`
        {name: round(value, 9) if isinstance(value, float) else value for name, value in trial.parameters.items()}
        for trial in complete
    ]
    configs = list(dict.fromkeys(map(settings.searched.config, rounded)))
    best = configs[: settings.num_finalists]
    return best if PAPER in best else [*best, PAPER]


def _on_train(configs: list[ProposalConfig], bench: Bench, settings: TuningSettings) -> list[Finalist]:
    measured = {config: list(bench.measure(config))[-1] for config in dict.fromkeys([*configs, PAPER])}
    return [Finalist(config, measured[config], settings.loss(measured[config], measured[PAPER])) for config in configs]


def _on_val(
    finalists: list[Finalist], val: LabelledSource | None, settings: TuningSettings, progress: Progress | None
) -> list[Finalist]:
    """The finalists with their losses on val, the best first; of equals the better one on train."""
    if val is None:
        return sorted(finalists, key=lambda finalist: finalist.train_loss)
    measured = measure_split(val, [finalist.config for finalist in finalists], progress)
    paper = next(found for finalist, found in zip(finalists, measured, strict=True) if finalist.config == PAPER)
    rated = [
        dataclasses.replace(finalist, val=found, val_loss=settings.loss(found, paper))
        for finalist, found in zip(finalists, measured, strict=True)
    ]
    return sorted(rated, key=lambda finalist: (finalist.val_loss, finalist.train_loss))


def _on_test(finalists: list[Finalist], test: LabelledSource | None, progress: Progress | None) -> list[Finalist]:
    """The finalists with ratings on test of the chosen one and the paper's; these do not influence the choice."""
    if test is None:
        return finalists
    rated = list(dict.fromkeys([finalists[0].config, PAPER]))
    found = dict(zip(rated, measure_split(test, rated, progress), strict=True))
    return [dataclasses.replace(finalist, test=found.get(finalist.config)) for finalist in finalists]
