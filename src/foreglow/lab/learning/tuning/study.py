"""The Optuna side of a search: storage, reproducible sampling, and the loop that one process runs."""

from __future__ import annotations

import contextlib
import datetime
import math
import os
import re
import socket
import sqlite3
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foreglow.lab.learning.tuning.journal import FIRST_BYTES, WAYS_OUT, NoJournalError, check_journal
from foreglow.lab.learning.tuning.measurement import Bench, Material, Measurement
from foreglow.lab.learning.tuning.objectives import OBJECTIVES, PAPER, SPACES, Space
from foreglow.plugins import first_line_of
from foreglow.wording import check_one_of

if TYPE_CHECKING:
    import optuna
    from optuna.storages import BaseStorage
    from optuna.trial import FrozenTrial, Trial

NUM_STARTUP_TRIALS = 10
"""Number of random trials before the sampler and the pruner start to use them; Optuna's default."""

LEFT_LOCK_S = 5
"""A journal whose lock has been held for so long, without a new line, is taken from a killed process: it is held for
milliseconds."""

STALE_S = 600.0
"""A running trial of another machine that began this long ago counts as dead; a trial takes seconds."""

UNNAMED_S = 2.0
"""So does one that began this long ago and says nothing of its process: it was killed between the two."""

IMPORTANCE_TRIALS = 20
"""Smallest number of finished trials for which importances are meaningful."""


_SEED = "seed"
"""Where a study keeps its seed: its first trials do not tell it."""


@dataclass(frozen=True, slots=True)
class TuningSettings:
    """What is searched, and how.

    Attributes:
        num_trials: Total number of trials, of all processes and earlier calls.
        num_images: Number of images of train, evenly spread over its sequences.
        space: Name of the space; None for the objective's default.
        num_finalists: Number of the best on train that are compared on val.
        storage: URL of a database, or a journal file, which several machines may share; None for a journal in the
            output folder.
        white_level: That of the camera, as of a pipeline's guard; None for images that fill their type.
    """

    num_trials: int = 200
    num_images: int = 600
    objective: str = "q"
    space: str | None = None
    seed: int = 0
    num_finalists: int = 10
    storage: str | None = None
    white_level: int | None = None

    def __post_init__(self) -> None:
        for name in ("num_trials", "num_images", "num_finalists"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        check_one_of(self.objective, OBJECTIVES, "objective")
        check_one_of(self.space_name, SPACES, "space")

    @property
    def space_name(self) -> str:
        """The name of the space that is searched."""
        return self.space or OBJECTIVES[self.objective][1]

    @property
    def searched(self) -> Space:
        """The space that is searched."""
        return SPACES[self.space_name]

    def loss(self, found: Measurement, paper: Measurement) -> float:
        """The loss of a measurement; the second is that of the paper's parameters on the same frames."""
        return OBJECTIVES[self.objective][0](found, paper)


@dataclass(frozen=True, slots=True)
class StudyPlan:
    """What a process needs to know to work on a study.

    Attributes:
        storage: URL of a database, or path of a journal file.
        name: Name of the study in the storage.
        settings: Its trials are those of all processes together; with one process, the same seed gives the same ones.
    """

    storage: str
    name: str
    settings: TuningSettings

    @property
    def shown_storage(self) -> str:
        """The storage, for messages."""
        return _without_password(self.storage, self.storage)


def open_study(plan: StudyPlan) -> optuna.Study:
    """The study of `plan`, created if it does not exist.

    Raises:
        ModuleNotFoundError: If Optuna, or a package for the database, is not installed.
        ValueError: If the storage cannot be used, or its study of that name has other directions.
    """
    import optuna
    from optuna.pruners import MedianPruner
    from optuna.study import StudyDirection

    optuna.logging.set_verbosity(optuna.logging.ERROR)  # it warns of the lock that a killed process has left
    try:
        study = optuna.create_study(
            storage=_storage(plan.storage),
            study_name=plan.name,
            sampler=_sampler(plan.settings.seed),
            pruner=MedianPruner(n_startup_trials=NUM_STARTUP_TRIALS),
            direction="minimize",
            load_if_exists=True,
        )
    except (ModuleNotFoundError, OSError, NoJournalError):
        raise
    except Exception as error:  # errors of SQLAlchemy, which need not be installed
        if "://" not in plan.storage:  # a record with another field or number
            reason = first_line_of(error) or type(error).__name__
            raise ValueError(f"{plan.storage}: expected whole records of a search: {reason}; {WAYS_OUT}") from error
        raise _unusable(plan.storage, error) from None
    if study.directions != [StudyDirection.MINIMIZE]:  # in a database; a journal was looked at
        found = ", ".join(direction.name.lower() for direction in study.directions)
        raise ValueError(
            f"{plan.shown_storage}: study {plan.name}: expected one that minimises one loss, got directions {found}; "
            "choose another storage"
        )
    return study


def check_storage(storage: str) -> None:
    """Checks that a storage can be used, before work is done for it; a database is made ready for studies.

    Raises:
        ModuleNotFoundError: If a package for the database is not installed.
        ValueError: If it cannot, such as a database that is gone with its connection.
    """
    from optuna.storages import RDBStorage

    if "://" not in storage:
        check_journal(Path(storage))
        return
    try:
        _check_file(storage)
        RDBStorage(storage).engine.dispose()
        if not _has_studies(storage):  # such as one in memory; others would not see the trials of this process
            raise NoJournalError(
                _without_password(f"storage: {storage}: expected a database that keeps what is written", storage)
                + ", such as sqlite:///FILE"
            )
    except (ModuleNotFoundError, OSError, NoJournalError):
        raise
    except Exception as error:  # as in `open_study`
        raise _unusable(storage, error) from None


def _check_file(url: str) -> None:
    """As `check_database`, for the file of a URL if it has one."""
    import sqlalchemy

    parts = sqlalchemy.make_url(url)
    if parts.get_backend_name() == "sqlite" and parts.database not in (None, "", ":memory:"):
        if parts.database.startswith("file:"):
            raise NoJournalError(f"storage: {url}: expected sqlite:///FILE, with the path of the file alone")
        check_database(Path(parts.database))


def _has_studies(url: str) -> bool:
    """Whether a new connection to a database finds the table of studies that an earlier one has made."""
    import sqlalchemy

    engine = sqlalchemy.create_engine(url)
    try:
        return "studies" in sqlalchemy.inspect(engine).get_table_names()
    finally:
        engine.dispose()


def _unusable(url: str, error: Exception) -> ValueError:
    """The error on the URL of a database that cannot be opened."""
    reason = first_line_of(error) or type(error).__name__
    expected = "expected the URL of a database that can be opened, such as sqlite:///FILE, or a file"
    return ValueError(_without_password(f"storage: {url}: {expected}: {reason}", url))


def _without_password(message: str, url: str) -> str:
    """A message of one line about a storage, with `***` for the password in its URL.

    >>> _without_password("sql://me:se@cret@host/x: no such host", "sql://me:se@cret@host/x")
    'sql://me:***@host/x: no such host'
    """
    found = re.match(r"[^/]*://[^:/@]*:(.*)@", url)
    hidden = message.replace(f":{found[1]}@", ":***@") if found and found[1] else message
    return " ".join(hidden.split())


def check_database(path: Path) -> None:
    """Checks that there is no other database than one of searches in the file of an SQLite URL.

    Raises:
        NoJournalError: If there is something else.
    """
    if not path.exists() or (path.is_file() and path.stat().st_size == 0):
        return
    if not path.is_file():
        raise NoJournalError(f"{path}: expected a file for a database of searches, got something else")
    try:
        with contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            names = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except sqlite3.Error as error:
        raise NoJournalError(f"{path}: expected a new file, or a database of searches: {error}") from None
    if "studies" not in names:
        raise NoJournalError(f"{path}: expected a new file, or a database of searches, got one without their table")


def _storage(storage: str) -> BaseStorage | str:
    if "://" in storage:
        _check_file(storage)
        return storage
    check_journal(Path(storage))
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock

    path = Path(storage).absolute()  # the lock is a link to it: a relative one would point nowhere, and never be let go
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = JournalFileSymlinkLock(str(path), grace_period=LEFT_LOCK_S)
    left = path.with_name(f"{path.name}.lock")
    if left.is_symlink() and not left.readlink().is_absolute():  # of an earlier version, whose process was killed
        left.unlink(missing_ok=True)
    backend = JournalFileBackend(str(path), lock)
    lock.acquire()
    try:  # a line that a killed process left unfinished: what follows would become part of it
        data = path.read_bytes()
        if data.startswith(FIRST_BYTES):
            os.truncate(path, data.rfind(b"\n") + 1)
    finally:
        lock.release()
    return JournalStorage(backend)


def _sampler(seed: int) -> Any:
    """A TPE sampler whose draws depend on the seed and the trials so far, but not on earlier draws of the same object.

    So an interrupted search continues as if it had not been, and processes with the same seed draw different trials.
    """
    from optuna.samplers import TPESampler
    from optuna.trial import TrialState

    class Resumable(TPESampler):
        def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
            earlier = [other for other in study.get_trials(deepcopy=False) if other.number < trial.number]
            num_earlier = sum(other.state not in (TrialState.FAIL, TrialState.WAITING) for other in earlier)
            own_seed = int(np.random.SeedSequence((seed, num_earlier)).generate_state(1)[0])
            # A running trial of another process counts as a bad one, so that not all search in the same region.
            TPESampler.__init__(self, seed=own_seed, n_startup_trials=NUM_STARTUP_TRIALS, constant_liar=True)
            super().before_trial(study, trial)

    return Resumable(seed=seed)


def prepare(study: optuna.Study, plan: StudyPlan) -> None:
    """Marks trials whose process is gone as failed, and lets a new study begin with the paper's parameters.

    Raises:
        ValueError: If the study was begun with another seed, or a finished trial lacks a part.
    """
    from optuna.trial import TrialState

    begun, seed = study.user_attrs.get(_SEED), plan.settings.seed
    if begun not in (None, seed):
        raise ValueError(
            f"{plan.shown_storage}: seed: expected that of the search begun here, {begun}, got {seed}; choose "
            "another folder or storage"
        )
    for trial in study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
        if not _is_measured(trial, plan.settings.searched):
            raise ValueError(
                f"{plan.shown_storage}: trial {trial.number}: expected all its parameters and its measurement, a "
                f"record is missing, wrong or in another place; {WAYS_OUT}"
            )
    for trial in study.get_trials(deepcopy=False, states=(TrialState.PRUNED,)):
        if len(trial.values or ()) > 1:
            raise ValueError(
                f"{plan.shown_storage}: trial {trial.number}: expected at most one loss, got {len(trial.values)}; "
                f"{WAYS_OUT}"
            )
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        if not _is_alive(trial):
            study.tell(trial.number, state=TrialState.FAIL)
    trials = study.get_trials(deepcopy=False)
    if not trials:
        study.set_user_attr(_SEED, seed)
    if not any("fixed_params" in trial.system_attrs for trial in trials if trial.state != TrialState.FAIL):
        study.enqueue_trial(dict(plan.settings.searched.first))  # also if its process was killed


def _is_measured(trial: FrozenTrial, searched: Space) -> bool:
    """Whether a finished trial has what is read of it later: parameters that can be, a loss, and its measurement."""
    values: Sequence[float] = trial.values or []
    if "measurement" not in trial.user_attrs or len(values) != 1 or not math.isfinite(values[0]):
        return False
    try:
        searched.config(trial.params)
    except (KeyError, TypeError, ValueError):
        return False
    return searched.first.keys() <= trial.params.keys()


def work(plan: StudyPlan, material: Material, is_stopped: Callable[[], bool], report: Callable[[], None]) -> None:
    """Runs trials until the study has `plan.settings.num_trials`, of this process and others, or until `is_stopped`."""
    study = open_study(plan)
    bench = Bench(material)
    paper = tuple(bench.measure(PAPER))
    while not is_stopped() and num_taken(study) < plan.settings.num_trials:
        trial = study.ask()
        _run(study, trial, plan, bench, paper)
        report()


def num_taken(study: optuna.Study, before: int | None = None) -> int:
    """Number of trials that are finished or running, counting only numbers below `before`."""
    from optuna.trial import TrialState

    states = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.RUNNING)
    trials = study.get_trials(deepcopy=False, states=states)
    return sum(1 for trial in trials if before is None or trial.number < before)


def num_finished(study: optuna.Study) -> int:
    """Number of trials that are complete or pruned."""
    from optuna.trial import TrialState

    return len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED)))


def _run(study: optuna.Study, trial: Trial, plan: StudyPlan, bench: Bench, paper: tuple[Measurement, ...]) -> None:
    """Measures one trial part by part; stops early if the parts so far are worse than those of other trials."""
    from optuna.exceptions import UpdateFinishedTrialError
    from optuna.trial import TrialState

    try:
        trial.set_user_attr("process", [socket.gethostname(), os.getpid(), time.time()])
        if num_taken(study, before=trial.number) >= plan.settings.num_trials:  # another process has taken the last one
            study.tell(trial, state=TrialState.FAIL)
            return
        searched = plan.settings.searched
        config = searched.config(searched.suggest(trial))
        loss = 0.0
        for step, found in enumerate(bench.measure(config)):
            loss = plan.settings.loss(found, paper[step])
            trial.report(loss, step)
            is_last = step == bench.num_chunks - 1
            if is_last or trial.should_prune():
                trial.set_user_attr("measurement", found.to_json())
            if not is_last and trial.should_prune():
                study.tell(trial, state=TrialState.PRUNED, skip_if_finished=True)
                return
        study.tell(trial, loss, skip_if_finished=True)
    except UpdateFinishedTrialError:  # another machine took this process for dead, as it stood still for long
        return
    except BaseException:
        study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
        raise


def _is_alive(trial: FrozenTrial) -> bool:
    """Whether the process of a running trial may still exist."""
    host, pid, *began = trial.user_attrs.get("process", (None, 0))
    if host == socket.gethostname():
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return True
        return bool(pid != os.getpid())
    if began:  # Optuna's own time is that of the other machine's zone
        return bool(time.time() - began[0] < STALE_S)
    started = trial.datetime_start  # a process says who it is right after it began
    return started is not None and 0 <= (datetime.datetime.now() - started).total_seconds() < UNNAMED_S


def importances(study: optuna.Study) -> dict[str, float]:
    """Importance of each parameter for being among the best trials, adding up to 1; empty with few trials.

    Source: Watanabe, Bansal and Hutter, PED-ANOVA, IJCAI 2023, as implemented in Optuna.
    """
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
    from optuna.trial import TrialState

    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if len(complete) < IMPORTANCE_TRIALS or len({trial.value for trial in complete}) < 2:
        return {}
    return dict(get_param_importances(study, evaluator=PedAnovaImportanceEvaluator()))
