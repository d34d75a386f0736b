"""The journal of a search, a file to which Optuna appends a record a line: whether one can be begun or continued."""

from __future__ import annotations

import datetime
import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from foreglow.wording import shortened

FIRST_BYTES = b'{"op_code":'
"""With this each line of a journal begins."""

WAYS_OUT = "choose another folder or storage, or remove this file"

_BEGINS_STUDY, _BEGINS_TRIAL, _ENDS_TRIAL = 0, 4, 6
"""What Optuna calls these records (`op_code`); studies and trials have the numbers in which they began."""

_RUNNING, _NUM_STATES = 0, 5
"""Of Optuna's states of a trial: the first, and how many there are; 1 to 3 are those of a trial that has ended."""

_ENDED = range(1, 4)

Kind = tuple[str, Callable[[Any], bool]]
"""What is expected of a value, and whether one is that."""


class NoJournalError(ValueError):
    """A file that is to be continued as a journal is something else."""


def _is_count(value: Any) -> bool:
    return type(value) is int and value >= 0


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _is_time(value: Any) -> bool:
    try:
        datetime.datetime.fromisoformat(value).astimezone()  # as Optuna reads it
    except (TypeError, ValueError, OverflowError, OSError):
        return False
    return True


def _is_state(value: Any) -> bool:
    return _is_count(value) and value < _NUM_STATES


def _is_distribution(value: Any) -> bool:
    from optuna.distributions import json_to_distribution

    try:
        json_to_distribution(value)
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError):
        return False
    return True


def _is_list(value: Any, of: Callable[[Any], bool]) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(map(of, value))


def _is_table(value: Any, of: Callable[[Any], bool]) -> bool:
    return isinstance(value, dict) and all(map(of, value.values()))


def _is_attributes(value: Any) -> bool:
    """Whether those that are read of a trial are what was written; others may be anything."""
    if not isinstance(value, dict):
        return False
    process, measured = value.get("process", ["", 1]), value.get("measurement", {})
    is_process = isinstance(process, list) and [type(part) for part in process[:2]] == [str, int] and process[1] > 0
    return (
        (is_process and len(process) <= 3 and all(map(_is_number, process[2:])))  # an early version wrote two
        and _is_table(measured, lambda figure: figure is None or type(figure) in (int, float))
        and _is_table(value.get("fixed_params", {}), lambda chosen: isinstance(chosen, bool) or _is_number(chosen))
        and all(isinstance(drawn, str) for name, drawn in value.items() if name.startswith("tpe:"))
    )


_COUNT: Kind = ("a whole number of at least 0", _is_count)
_TEXT: Kind = ("text", lambda value: isinstance(value, str))
_NUMBER: Kind = ("a finite number", _is_number)
_NUMBERS: Kind = ("finite numbers or null", lambda value: value is None or _is_list(value, _is_number))
_STATE: Kind = ("the number of a state, from 0 to 4", _is_state)
_TIME: Kind = ("a time", _is_time)
_ATTRIBUTES: Kind = ("attributes as a search writes them", _is_attributes)
_ATTRIBUTE: Kind = ("one attribute as a search writes it", lambda value: _is_attributes(value) and len(value) == 1)

_FIELDS: Mapping[int, Mapping[str, Kind]] = {
    _BEGINS_STUDY: {
        "study_name": _TEXT,
        "directions": (
            "[1], the one direction of a search, which minimises",
            lambda value: _is_list(value, lambda each: type(each) is int) and value == [1],
        ),
    },
    1: {"study_id": _COUNT},
    2: {"study_id": _COUNT, "user_attr": _ATTRIBUTE},
    3: {"study_id": _COUNT, "system_attr": _ATTRIBUTE},
    _BEGINS_TRIAL: {
        "study_id": _COUNT,
        "datetime_start": ("a time or null", lambda value: value is None or _is_time(value)),
    },
    5: {
        "trial_id": _COUNT,
        "param_name": _TEXT,
        "param_value_internal": _NUMBER,
        "distribution": ("a distribution as text", _is_distribution),
    },
    _ENDS_TRIAL: {"trial_id": _COUNT, "state": _STATE, "values": _NUMBERS},
    7: {"trial_id": _COUNT, "step": _COUNT, "intermediate_value": _NUMBER},
    8: {"trial_id": _COUNT, "user_attr": _ATTRIBUTE},
    9: {"trial_id": _COUNT, "system_attr": _ATTRIBUTE},
}
"""What each kind of record has, by `op_code`, as Optuna's `JournalStorage` reads it."""

_MAY_HAVE: Mapping[str, Kind] = {
    "state": _STATE,
    "value": ("a finite number or null", lambda value: value is None or _is_number(value)),
    "values": _NUMBERS,
    "datetime_complete": _TIME,
    "distributions": ("distributions as texts", lambda value: _is_table(value, _is_distribution)),
    "params": ("a table of finite numbers", lambda value: _is_table(value, _is_number)),
    "user_attrs": _ATTRIBUTES,
    "system_attrs": _ATTRIBUTES,
    "intermediate_values": (
        "a table of finite numbers by step",
        lambda value: _is_table(value, _is_number) and all(name.isascii() and name.isdecimal() for name in value),
    ),
}
"""What a record that begins a trial may have, too."""


def check_journal(path: Path) -> None:
    """Checks that a journal can be begun or continued at `path`: Optuna appends to whatever is there.

    Raises:
        NoJournalError: If there is something else, or a line of it is damaged.
    """
    if not path.exists():
        return
    if not path.is_file():
        raise NoJournalError(f"{path}: expected a file for a search's journal, got something else")
    with path.open("rb") as file:
        if file.read(len(FIRST_BYTES)) not in (b"", FIRST_BYTES):
            raise NoJournalError(f"{path}: expected a new file, or the journal of a search, which begins with its line")
        file.seek(0)
        names, num_trials, lines = set[str](), 0, dict[bytes, int]()
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):  # it is being written, or never was
                break
            record = _record(line)
            if record is None:
                raise NoJournalError(f"{path}: line {number}: expected a whole record of a search; {WAYS_OUT}")
            first = lines.setdefault(hashlib.sha256(line).digest(), number)
            if first != number and record["op_code"] != _BEGINS_STUDY:  # all else happens once, at its time
                raise NoJournalError(f"{path}: line {number}: expected another line than line {first}; {WAYS_OUT}")
            wrong = _wrong_field(record)
            if wrong is not None:
                raise NoJournalError(f"{path}: line {number}: {wrong}; {WAYS_OUT}")
            study, trial = record.get("study_id", -1), record.get("trial_id", -1)
            if not (study < len(names) and trial < num_trials):
                what = f"study {study}" if study >= len(names) else f"trial {trial}"
                raise NoJournalError(f"{path}: line {number}: expected a line before that begins {what}; {WAYS_OUT}")
            if record["op_code"] == _BEGINS_STUDY:
                names.add(record["study_name"])
            num_trials += record["op_code"] == _BEGINS_TRIAL


def _record(line: bytes) -> dict[str, Any] | None:
    """A line of a journal as Optuna writes it; None for another one. A wrong digit in it is not noticed."""
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    is_one = isinstance(record, dict) and type(record.get("op_code")) is int and record["op_code"] in _FIELDS
    return record if is_one and isinstance(record.get("worker_id"), str) else None


def _wrong_field(record: Mapping[str, Any]) -> str | None:
    """The first field that is missing, or of another kind, and what was expected; None if there is none."""
    wanted, code = dict(_FIELDS[record["op_code"]]), record["op_code"]
    if code == _BEGINS_TRIAL:
        wanted |= {name: kind for name, kind in _MAY_HAVE.items() if name in record}
    if code == _ENDS_TRIAL and record.get("state") == _RUNNING:
        wanted["datetime_start"] = _TIME
    if code == _ENDS_TRIAL and record.get("state") in _ENDED:
        wanted["datetime_complete"] = _TIME
    for name, (words, is_kind) in wanted.items():
        if name not in record or not is_kind(record[name]):
            found = shortened(record[name]) if name in record else "nothing"
            return f"{name}: expected {words}, got {found}"
    return None
