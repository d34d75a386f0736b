"""What the paper says, from `claims.toml`, and what a study's results say to it."""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

from foreglow.display.summary_lines import counted
from foreglow.files import read_plain_json, read_toml
from foreglow.lab.evaluation.ratios import mean
from foreglow.lab.reports.page import percent

Rule: TypeAlias = Literal["", "same", "close", "at least", "at most", "least"]

REPRODUCED, DIFFERS, GIVEN = "reproduced", "differs", "by construction"
NEEDS, TOLD, UNMEASURED = "needs", "beside it", "not measurable"
"""What is said of a claim; `by construction` where ours could hardly do otherwise than agree, and `beside it` where
both values are told and nothing is compared.
"""

AGREEMENTS: Mapping[str, str] = {
    "at least": "no less than the paper's",
    "at most": "no more than the paper's",
    "least": "their order, not the values",
}
"""In what ours agrees with the paper's, by the rule; otherwise in the value."""

MIN_TRIALS = 20
"""Fewer say nothing of a search: it draws the first 10 at random, and then needs some to learn from."""

NO_VALUE = "no value"

LABELLED = ", labelled boxes"
"""What a row of the paper's table in parentheses is called."""

_STEP = re.compile(r"([^.\[\]]+)|\[([^=\]]+)=([^\]]*)\]")
_FIELD = re.compile(r"\{([^{}:]+)(?::([^{}]*))?\}")
_TERM = re.compile(r" ([-+/]) (?![^\[]*\])")
_OPERATORS: Mapping[str, Callable[[float, float], float]] = {
    "-": operator.sub,
    "+": operator.add,
    "/": operator.truediv,
}
_SUMMARIES: Mapping[str, Callable[[Sequence[float]], float]] = {"min": min, "mean": mean}


@dataclass(frozen=True, slots=True)
class Claim:
    """One thing that the paper says; the head of `claims.toml` explains the fields.

    Attributes:
        values: The paper's numbers that are compared, each with its own of every text of `ours`, in their order.
        tolerances: Of each of them, or one for all.
        beside: What is told behind our value, and not compared.
        image: The study's file that is shown instead of a value; empty for none.
        network: The row of the paper's table whose network our value is of; empty for none.
        holds_by: Why our value could hardly do otherwise than agree, on any data; empty where it depends on them.
        is_searched: Whether our value is of the search for parameters, which begins with the paper's.
        row: Of a table of the paper, the row that it is in; empty outside of them.
        column: Of that table.
    """

    id: str
    place: str
    says: str
    paper: str
    values: tuple[float, ...] = ()
    rule: Rule = ""
    tolerances: tuple[float, ...] = (0.0,)
    study: str = ""
    ours: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    image: str = ""
    reason: str = ""
    why: str = ""
    only_pvdn: bool = False
    is_timed: bool = False
    is_figure: bool = False
    network: str = ""
    holds_by: str = ""
    is_searched: bool = False
    row: str = ""
    column: str = ""

    def __post_init__(self) -> None:
        if not (self.id and self.place and self.says and self.paper and self.reason):
            raise ValueError(
                f"claims.toml: {self.id}: expected id, place, says, paper and reason, and none of them empty"
            )
        if bool(self.study) != bool(self.ours or self.image):
            raise ValueError(f"claims.toml: {self.id}: expected a study with ours or image, or none of them")
        if (self.rule in ("", "least")) == bool(self.values):
            raise ValueError(
                f"claims.toml: {self.id}: expected a value with a rule that compares with it, and only then"
            )
        if len(self.tolerances) not in (1, len(self.values)):
            raise ValueError(
                f"claims.toml: {self.id}: expected one tolerance, or {len(self.values)}, got {len(self.tolerances)}"
            )


@dataclass(frozen=True, slots=True)
class Answer:
    """What our results say to a claim.

    Attributes:
        ours: Our value in words; the reason where there is none.
        verdict: One of the six words above.
        because: Why it differs, or what it needs; may be empty.
    """

    claim: Claim
    ours: str
    verdict: str
    because: str = ""


def answer(
    claim: Claim,
    results: Mapping[str, Any] | None,
    *,
    is_pvdn: bool,
    is_busy: bool = False,
    reason: str = "",
    untrained: Mapping[str, str] = MappingProxyType({}),
) -> Answer:
    """What a study's `results` say to a claim.

    Args:
        claim: The paper's.
        results: Of the claim's study, as its JSON file has them; None if it was not run.
        is_pvdn: Whether they are of PVDN.
        is_busy: Whether other programs kept the machine busy, so that times say little.
        reason: Why the study was not run.
        untrained: What networks lack to be compared with the paper's, by their rows of its table.
    """
    if results is None:
        told = []
    elif claim.image:
        told = ["below"]
    else:
        told = [text for text in claim.ours if filled(text, results)]
    beside = [] if results is None else [text for text in claim.beside if filled(text, results)]
    ours = "; ".join(filled(text, results) for text in told) or NO_VALUE
    if beside:
        ours += "; not compared: " + "; ".join(filled(text, results) for text in beside)
    if not told and results is not None and claim.network in untrained:
        return Answer(claim, ours, NEEDS, untrained[claim.network])
    if not told:
        verdict = NEEDS if claim.reason.startswith(NEEDS) else UNMEASURED
        because = claim.reason.removeprefix(f"{NEEDS} ")
        return Answer(claim, ours, verdict, "; ".join(part for part in (because, reason) if part))
    if claim.only_pvdn and not is_pvdn:
        return Answer(claim, ours, NEEDS, claim.reason.removeprefix(f"{NEEDS} "))
    if claim.is_timed and is_busy:
        return Answer(claim, ours, NEEDS, "an idle machine: this one was busy with other programs")
    if claim.network in untrained:
        return Answer(claim, ours, NEEDS, untrained[claim.network])
    if not claim.rule:
        return Answer(claim, ours, TOLD, claim.why)
    start = beyond_start(results or {}) if claim.is_searched else None
    if start is not None:
        return Answer(claim, ours, *start)
    if holds(claim, [_numbers(text, results) for text in told]):
        if claim.study == "settings":
            return Answer(claim, ours, TOLD, "the same setting")
        if claim.holds_by:
            return Answer(claim, ours, GIVEN, claim.holds_by)
        on_data = "" if is_pvdn else "on simulated drives"
        return Answer(claim, ours, REPRODUCED, "; ".join(filter(None, (AGREEMENTS.get(claim.rule), on_data))))
    because = claim.why or ("" if is_pvdn else "simulated drives, not PVDN")
    return Answer(claim, ours, DIFFERS, f"contradicts the paper; {because}" if claim.rule == "least" else because)


def holds(claim: Claim, numbers: Sequence[Sequence[float]]) -> bool:
    """Whether all our numbers agree with the paper by the claim's rule; of each text of `ours` its numbers.

    Of a text, as many are compared as the claim has values.
    """
    if claim.rule == "least":
        return all(first <= min(others) + _SLACK + claim.tolerances[0] for first, *others in numbers)
    tolerances = claim.tolerances * (len(claim.values) if len(claim.tolerances) == 1 else 1)
    return all(
        _agrees(claim.rule, number, value, tolerance + _SLACK)
        for ours in numbers
        for number, value, tolerance in zip(ours[: len(claim.values)], claim.values, tolerances, strict=True)
    )


_SLACK = 1e-9
"""Of sums and differences of floating-point numbers."""


def _agrees(rule: Rule, number: float, value: float, slack: float) -> bool:
    if rule == "at least":
        return number >= value - slack
    if rule == "at most":
        return number <= value + slack
    return abs(number - value) <= slack


def beyond_start(results: Mapping[str, Any]) -> tuple[str, str] | None:
    """Why what the search chose says nothing of the paper's parameters: verdict and reason; None if it does.

    Its first trial has the paper's parameters: where these stay the best, they agree with themselves.
    """
    num_trials = value_at(results, "num_finished") or 0
    if num_trials < MIN_TRIALS:
        return NEEDS, f"a search of at least {MIN_TRIALS} trials; this one had {num_trials}"
    if value_at(results, "chosen.parameters") == value_at(results, "paper.parameters"):
        return TOLD, f"the search begins with the paper's parameters, and found none better in {num_trials} trials"
    return None


def value_at(results: Any, path: str) -> Any:
    """The value at a path such as `rows[name=paper].quality.f1`; None where there is none.

    `[key=value]` leaves those items of a list whose key is so, and a name behind a list is that of its first item;
    behind a list of numbers, `min` and `mean` are theirs.

    >>> value_at({"rows": [{"name": "a", "f": 1}, {"name": "b", "f": [2, 4]}]}, "rows[name=b].f.mean")
    3.0
    """
    found = results
    for name, key, value in _STEP.findall(path):
        if key:
            found = [row for row in found or () if str(row.get(key)) == value]
        elif isinstance(found, list) and name in _SUMMARIES:
            found = _SUMMARIES[name](found) if found else None
        else:
            holder = next(iter(found), None) if isinstance(found, list) else found
            found = holder.get(name) if isinstance(holder, Mapping) else None
    return found


def _numbers(text: str, results: Any) -> list[float]:
    """The fields in `text` that are numbers."""
    values = (_computed(expression, results) for expression, _ in _FIELD.findall(text))
    return [float(value) for value in values if isinstance(value, int | float)]


def filled(text: str, results: Any) -> str:
    """`text` with its fields filled in; empty if one has no value.

    Formats are Python's, `p` for percentage points, `m` for milliseconds of seconds, and `#` with what is counted.

    >>> filled("{num} of {of.num:.1f}", {"num": 1, "of": {"num": 2}}), filled("{num}", {})
    ('1 of 2.0', '')
    >>> filled("{f - paper.f:+.1p}", {"f": 0.9, "paper": {"f": 0.82}})
    '+8.0 points'
    >>> filled("{share:.0%} of {num:#driver}", {"share": 0.998, "num": 1})
    '>99% of 1 driver'
    """
    if any(_computed(expression, results) is None for expression, _ in _FIELD.findall(text)):
        return ""
    return _FIELD.sub(lambda match: _shown(_computed(match[1], results), match[2] or ""), text)


def _shown(value: Any, form: str) -> str:
    if isinstance(value, Mapping):
        return "; ".join(value)
    if isinstance(value, list):
        return " x ".join(map(str, value))
    if form.startswith("#"):
        return counted(value, form[1:])
    if form == ".0%":
        return percent(value)
    if form.endswith("p"):
        return f"{format(100 * value, form[:-1] + 'f')} points"
    if form.endswith("m"):
        return f"{format(1000 * value, form[:-1] + 'f')} ms"
    return format(value, form)


def _computed(expression: str, results: Any) -> Any:
    """The value of a path, or of several with ` - `, ` + ` and ` / ` between them; None if one has none."""
    first, *others = _TERM.split(expression)
    value = value_at(results, first)
    for sign, term in zip(others[::2], others[1::2], strict=True):
        other = float(term) if term.isdigit() else value_at(results, term)
        if value is None or other is None:
            return None
        value = _OPERATORS[sign](value, other)
    return value


@dataclass(frozen=True, slots=True)
class Comparison:
    """A row of our own: our pipeline beside the paper's whole chain, both measured here.

    Attributes:
        says: What is compared.
        study: The experiment whose results hold both.
        ours: Our value, as `Claim.ours` has it.
        chain: That of the paper's chain.
        on: What they are measured on.
    """

    says: str
    study: str
    ours: str
    chain: str
    on: str


@functools.cache
def read_comparisons() -> tuple[Comparison, ...]:
    """All rows of our own, in the order of `claims.toml`."""
    return tuple(Comparison(**fields) for fields in _read()["comparison"])


@functools.cache
def read_claims() -> tuple[Claim, ...]:
    """All claims, in the order of `claims.toml`.

    Raises:
        ValueError: If one lacks something, or two have the same id.
    """
    told = _read()
    claims = [_claim(fields) for fields in told["claim"]]
    first_after = next(index for index, claim in enumerate(claims) if claim.place.startswith("6.2"))
    claims[first_after:first_after] = [claim for table in told["table"] for claim in _columns(table, told["columns"])]
    claims += [_claim(fields | {"is_figure": True}) for fields in told["figure"]]
    ids = [claim.id for claim in claims]
    twice = {name for name in ids if ids.count(name) > 1}
    if twice:
        raise ValueError(f"claims.toml: expected each id once, got {', '.join(sorted(twice))} again")
    return tuple(claims)


def _read() -> dict[str, Any]:
    return read_toml(Path(__file__).with_name("claims.toml"))


def _claim(fields: Mapping[str, Any]) -> Claim:
    lists = {name: tuple(fields.get(name, ())) for name in ("ours", "beside")}
    numbers = {f"{name}s": _tuple(fields[name]) for name in ("value", "tolerance") if name in fields}
    return Claim(**{name: field for name, field in fields.items() if f"{name}s" not in numbers} | lists | numbers)


def _tuple(numbers: float | list[float]) -> tuple[float, ...]:
    return tuple(numbers) if isinstance(numbers, list) else (numbers,)


def _columns(table: Mapping[str, Any], columns: Mapping[str, Any]) -> Iterator[Claim]:
    """A claim for each of the paper's values in a row of its table."""
    for name, paper in table["paper"].items():
        column = columns[name]
        numbers = [float(number) for number in re.findall(r"[\d.]+", paper)]
        if column.get("rule") == "at most":
            del numbers[1:]  # the spread, which is neither better nor worse
        is_compared = "rule" in column or "tolerance" in column
        compared = {"value": numbers, "rule": "close"} if is_compared else {}
        is_label = name.startswith("most_")
        row = table["says"] + (table.get("labelled", LABELLED) if is_label else "")
        why = {"why": table["why"]} if "why" in table and name.endswith("size") else {}
        found = table.get("labels", table["row"]) if is_label else table["row"]
        yield _claim(
            {
                **{key: table[key] for key in ("place", "study", "reason") if key in table},
                **compared,
                **why,
                **{key: value for key, value in column.items() if key not in ("says", "is_scored")},
                "network": table.get("network", "") if column.get("is_scored") else "",
                "row": row,
                "column": column["says"],
                "id": f"{table['id']}-{name.replace('_', '-')}",
                "says": f"{row}: {column['says']}",
                "paper": paper,
                "ours": [text.replace("{row}", found) for text in column["ours"]],
            }
        )


def paper_words(claim_id: str) -> str:
    """The paper's value of a claim, as printed."""
    return _named(claim_id).paper


def paper_value(claim_id: str) -> float:
    """The paper's number of a claim, the first of several."""
    return _named(claim_id).values[0]


def _named(claim_id: str) -> Claim:
    return next(claim for claim in read_claims() if claim.id == claim_id)


def beside_paper(study: str, results_file: Path) -> list[str]:
    """What a study's command says last: the paper's values, and those of its results, a line each."""
    results = read_plain_json(results_file)
    answers = [
        answer(claim, results, is_pvdn=True) for claim in read_claims() if claim.study == study and not claim.image
    ]
    lines = [
        f"{found.claim.says}: {found.claim.paper}; here {found.ours}" for found in answers if found.ours != NO_VALUE
    ]
    return ["the paper's values, and those here:", *lines] if lines else []
