"""Run-times of several calls compared in one run, and what every benchmark writes about itself."""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from foreglow import _native
from foreglow.provenance import checkout_state, processor_name

Row = dict[str, Any]
"""One line of a table, with all its figures, as it goes into the JSON."""

RESULTS = Path("bench_output")
CONSOLE = Console(width=110)


@dataclass(frozen=True, slots=True, eq=False)
class Contender:
    """A call to be timed, `calls` times in each round: more for quick ones, so that the caches are its own."""

    call: Callable[[], Any]
    calls: int = 10


@dataclass(frozen=True, slots=True, eq=False)
class RunTimes:
    """All run-times of one call.

    Attributes:
        samples_ms: Shape (rounds, calls a round), milliseconds.
    """

    samples_ms: NDArray[np.float64]

    @property
    def median_ms(self) -> float:
        return float(np.median(self.samples_ms))

    @property
    def p99_ms(self) -> float:
        """99th percentile (linear between ranks)."""
        return float(np.percentile(self.samples_ms, 99))

    def speed_up_over(self, other: RunTimes) -> float:
        """How many times quicker than `other`: the median of the rounds' ratios of medians, so that drift cancels.

        >>> slow, fast = RunTimes(np.array([[3.0], [6.0], [9.0]])), RunTimes(np.array([[1.0], [2.0], [2.0]]))
        >>> fast.speed_up_over(slow)
        3.0
        """
        return float(np.median(np.median(other.samples_ms, axis=1) / np.median(self.samples_ms, axis=1)))

    def figures(self) -> dict[str, float]:
        return {"median_ms": self.median_ms, "p99_ms": self.p99_ms}


def interleaved(contenders: Mapping[str, Contender], rounds: int, warm_up: int = 2) -> dict[str, RunTimes]:
    """The run-times of `contenders`, each called in each round: A B C A B C ...

    Args:
        contenders: What to time, by name.
        rounds: How often everyone has his turn; a single round shows that all run, and nothing is warmed up for it.
        warm_up: Further rounds before them that do not count.
    """
    is_trial = rounds == 1
    samples_ms = {name: np.empty((rounds, contender.calls)) for name, contender in contenders.items()}
    for number in range(0 if is_trial else -warm_up, rounds):
        for name, contender in contenders.items():
            if not is_trial:
                contender.call()  # brings code and buffers back into the caches; never counts
            for index in range(contender.calls):
                started = time.perf_counter_ns()
                contender.call()
                taken_ns = time.perf_counter_ns() - started
                if number >= 0:
                    samples_ms[name][number, index] = taken_ns / 1e6
    return {name: RunTimes(samples) for name, samples in samples_ms.items()}


def options(description: str | None, name: str, arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options of a benchmark's command: `out`, a path, by default `RESULTS`/`name`.json, and `quick`."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, default=RESULTS / f"{name}.json", help="the figures as JSON")
    parser.add_argument("--quick", action="store_true", help="few repetitions: shows that it runs, not how quickly")
    return parser.parse_args(arguments)


def table(title: str, texts: Sequence[str], figures: Sequence[str]) -> Table:
    """An empty table with columns of text at the left and of figures at the right."""
    empty = Table(title=title, title_justify="left")
    for header in texts:
        empty.add_column(header)
    for header in figures:
        empty.add_column(header, justify="right")
    return empty


def in_ms(row: Row, *keys: str) -> list[str]:
    """The figures `keys` of `row`, to the microsecond."""
    return [f"{row[key]:.3f}" for key in keys]


def machine() -> dict[str, Any]:
    """The processor, the versions and the commit that figures belong to."""
    commit, has_local_changes = checkout_state()
    packages = ("foreglow", "numpy", "scipy", "onnxruntime", "opencv-python-headless")
    return {
        "processor": processor_name(),
        "dispatch": _native.available_dispatch(),
        "python": platform.python_version(),
        "versions": {name: metadata.version(name) for name in packages},
        "commit": commit,
        "has_local_changes": has_local_changes,
    }


def write_results(path: Path, results: Mapping[str, Any]) -> None:
    """Writes `results` and the machine they were measured on as JSON; makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": machine(), **results}, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")
