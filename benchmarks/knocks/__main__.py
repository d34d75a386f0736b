"""Runs the campaign: every probe in a process of its own, a table of what held, and all that did not."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from rich.progress import Progress

from benchmarks.knocks.campaign import Campaign
from benchmarks.knocks.materials import make_materials
from benchmarks.knocks.probe import Verdict, try_out
from benchmarks.timing import CONSOLE, RESULTS, table, write_results


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS / "knocks.json", help="the verdicts as JSON")
    parser.add_argument("--seed", type=int, default=1, help="of all damage")
    parser.add_argument("--only", default="", help="classes or probes with this text in their names")
    parser.add_argument("--every", type=int, default=1, help="only each so many-th probe")
    parser.add_argument("--jobs", type=int, default=2, help="probes at a time")
    given = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="knocks_"))
    try:
        verdicts = campaign(folder, given.seed, given.only, given.every, given.jobs)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    report(verdicts)
    write_results(given.out, {"knocks": [dataclasses.asdict(verdict) for verdict in verdicts]})
    CONSOLE.print(f"look in {given.out}")
    return 1 if any(verdict.wrong for verdict in verdicts) else 0


def campaign(folder: Path, seed: int, only: str, every: int, jobs: int) -> list[Verdict]:
    """The verdicts of all probes whose class or name holds `only`, in their order."""
    materials = folder / "materials"
    materials.mkdir()
    with ProcessPoolExecutor(1) as pool:  # what it loads and starts does not stay in what the probes are copies of
        pool.submit(make_materials, materials).result()
    numbers = [k for k, probe in enumerate(Campaign(materials, seed).probes()) if only in f"{probe.kind}: {probe.name}"]
    with Progress(console=CONSOLE) as progress, ProcessPoolExecutor(jobs) as pool:
        task = progress.add_task("knocks", total=len(numbers[::every]))
        futures = [pool.submit(verdict_of, folder, seed, number) for number in numbers[::every]]
        verdicts = []
        for future in futures:
            verdicts.append(future.result())
            progress.advance(task)
            show(verdicts[-1])
        return verdicts


def verdict_of(folder: Path, seed: int, number: int) -> Verdict:
    """The verdict of the how many-th probe, in an empty folder that is removed afterwards."""
    probe = next(itertools.islice(Campaign(folder / "materials", seed).probes(), number, None))
    work = folder / f"{number:05d}"
    work.mkdir()
    try:
        return try_out(probe, work)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def show(verdict: Verdict) -> None:
    """Prints what is wrong, and how to see it again."""
    if verdict.wrong:
        complaint = json.dumps(verdict.stderr[-200:])
        CONSOLE.print(f"{verdict.kind}: {verdict.name}: {'; '.join(verdict.wrong)}", markup=False, highlight=False)
        CONSOLE.print(f"    {json.dumps(verdict.command)}  {complaint}", markup=False, highlight=False)


def report(verdicts: Sequence[Verdict]) -> None:
    shown = table("Hard knocks", ("class",), ("probes", "done", "refused", "other ends", "not as it should"))
    for kind in dict.fromkeys(verdict.kind for verdict in verdicts):
        of_kind = [verdict for verdict in verdicts if verdict.kind == kind]
        ends = Counter({0: "done", 2: "refused"}.get(verdict.code, "other") for verdict in of_kind)  # type: ignore[arg-type]
        figures = [len(of_kind), ends["done"], ends["refused"], ends["other"], sum(bool(v.wrong) for v in of_kind)]
        shown.add_row(kind, *map(str, figures))
    CONSOLE.print(shown)
    worst = max(verdicts, key=lambda verdict: verdict.resident_mib, default=None)
    if worst is not None:
        CONSOLE.print(f"{len(verdicts)} probes; at most {worst.resident_mib:.0f} MiB ({worst.kind}: {worst.name})")


if __name__ == "__main__":
    raise SystemExit(main())
