"""A probe: a command on hostile input, and what must hold after it, whatever the input."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import multiprocessing
import os
import re
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

MAX_ADDRESSES = 8 << 30
"""Bytes of addresses that a probe's process may take; its threads and libraries alone reserve 2 to 3 GiB."""

MAX_RESIDENT_MIB = 1400
"""Memory that a probe may really use, beyond that of the process that it is a copy of."""

MAX_S, MAX_WAIT_S = 60, 300.0
"""Seconds of the processor for a probe, of which a run of a few frames takes one or two; and seconds until it hangs."""

MAX_LINE_CHARS = 2000
"""A message that is longer helps nobody."""

STATUS = re.compile(r"\s+\d+\.\d+ s  ")
"""A line of `live` about a fault, with its time."""

DONE, REFUSED, INTERRUPTED = 0, 2, 130


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        code: Its exit code; minus the signal's number if a signal ended it; None if it was ended for its time.
        stdout: What it printed.
        stderr: What it complained of.
        seconds: Wall-clock time.
        resident_mib: The most memory that it used, beyond that of the process that it is a copy of.
        is_input_changed: Whether a file that was there before is another one now, or gone.
        left: Files that should not have stayed: partial and hidden ones.
        written: What is there besides the inputs.
    """

    code: int | None
    stdout: str
    stderr: str
    seconds: float
    resident_mib: float
    is_input_changed: bool
    left: tuple[str, ...]
    written: tuple[str, ...]


Check = Callable[[Path, Outcome], list[str]]


def orderly(folder: Path, outcome: Outcome) -> list[str]:
    """What is wrong with how a command ended: it has to be done, or refuse with one line, and leave no mess."""
    wrong = []
    if outcome.code is None:
        wrong.append(f"hangs: not done after {MAX_WAIT_S:.0f} s")
    elif outcome.code == -signal.SIGXCPU:
        wrong.append(f"still busy after {MAX_S} s of the processor")
    elif outcome.code not in (DONE, REFUSED, INTERRUPTED):
        wrong.append(f"exit code {outcome.code}")
    if "Traceback" in outcome.stdout + outcome.stderr:
        wrong.append("a traceback")
    if outcome.code == REFUSED:
        lines = outcome.stderr.splitlines()
        told = [line for line in lines if not STATUS.match(line)]
        if lines and not told:  # `live` has told on the way what is not whole
            told = lines[-1:]
        elif len(told) != 1 or not told[0].startswith("foreglow: "):
            wrong.append(f"{len(told)} lines where one is expected")
        if len(outcome.stderr) > MAX_LINE_CHARS:
            wrong.append(f"a message of {len(outcome.stderr)} characters")
    if outcome.resident_mib > MAX_RESIDENT_MIB:
        wrong.append(f"{outcome.resident_mib:.0f} MiB of memory")
    if outcome.is_input_changed:
        wrong.append("an input was changed")
    if outcome.left:
        wrong.append(f"left behind: {', '.join(outcome.left[:3])}")
    return wrong + incomplete(folder)


def refused(folder: Path, outcome: Outcome) -> list[str]:
    """As `orderly`, and it must not have been done."""
    wrong = orderly(folder, outcome)
    return wrong if outcome.code == REFUSED else [*wrong, f"exit code {outcome.code} where a refusal is expected"]


def incomplete(folder: Path) -> list[str]:
    """Results that say to be complete, and are none."""
    wrong = []
    for path in sorted(folder.rglob("summary.json")):
        if path.is_file() and "inputs" not in path.parts:
            try:
                summary = json.loads(path.read_text())
                num_lines = len((path.parent / "frames.jsonl").read_text().splitlines())
            except (OSError, ValueError) as error:
                wrong.append(f"{path.relative_to(folder)}: {error}")
                continue
            is_whole = summary.get("is_complete") and not summary.get("live", {}).get("num_unrecorded")
            if is_whole and summary.get("num_frames") not in (None, num_lines):
                wrong.append(f"{path.relative_to(folder)}: {summary['num_frames']} frames, {num_lines} lines")
    return wrong


@dataclasses.dataclass(frozen=True)
class Probe:
    """A command line on files that `prepare` makes.

    Attributes:
        kind: The class of knocks that it belongs to.
        name: What is done to what; the same in every campaign with the same seed.
        prepare: Fills the empty folder `inputs` below the given folder, in which the command then runs, and returns the
            command line, or a function to be called in place of a command.
        check: What is wrong with how it ended.
        interrupt: A signal and the seconds after which it comes.
        limits: Further limits of the process: the `resource`'s number and the limit.
    """

    kind: str
    name: str
    prepare: Callable[[Path], Sequence[str] | Callable[[], int]]
    check: Check = orderly
    interrupt: tuple[signal.Signals, float] | None = None
    limits: tuple[tuple[int, int], ...] = ()


@dataclasses.dataclass(frozen=True)
class Verdict:
    """A probe's result: what was wrong, nothing if all held, and how to see it again."""

    kind: str
    name: str
    command: str
    wrong: tuple[str, ...]
    code: int | None
    seconds: float
    resident_mib: float
    stderr: str


def try_out(probe: Probe, folder: Path) -> Verdict:
    """Runs a probe in the empty `folder`, in a process that is a copy of this one."""
    (folder / "inputs").mkdir(parents=True)
    command = probe.prepare(folder)
    before = digests(folder / "inputs")
    for name in (".stdout", ".stderr"):
        (folder / name).touch()
    code, seconds, resident_mib = _run(probe, folder, command)
    stdout, stderr = ((folder / name).read_text(errors="replace") for name in (".stdout", ".stderr"))
    after = digests(folder / "inputs")
    entries = [path for path in sorted(folder.rglob("*")) if is_written(path, folder)]
    outcome = Outcome(
        code,
        stdout,
        stderr,
        seconds,
        resident_mib,
        any(after.get(name) != digest for name, digest in before.items()),
        tuple(str(path.relative_to(folder)) for path in entries if is_left(path)),
        tuple(str(path.relative_to(folder)) for path in entries),
    )
    words = "function" if callable(command) else " ".join(command)
    wrong = tuple(probe.check(folder, outcome))
    said = stderr or stdout[-400:]
    return Verdict(probe.kind, probe.name, words[:400], wrong, code, seconds, resident_mib, said[-400:])


def is_written(path: Path, folder: Path) -> bool:
    """Whether a command has made a file or folder."""
    inputs = folder / "inputs"
    return path != inputs and inputs not in path.parents and path.name not in (".stdout", ".stderr")


def is_left(path: Path) -> bool:
    """Whether a file is one that only an unfinished command has; a recording is kept as far as it came.

    Pipes and links are the probe's own.
    """
    return not (path.is_fifo() or path.is_symlink()) and (
        path.suffix == ".tmp"
        or path.name.startswith(".")
        or (".mcap" not in path.suffixes and path.suffix == ".partial")
    )


def digests(folder: Path) -> dict[str, str]:
    """By path, what is in each regular file of a folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder)).encode(errors="surrogateescape").hex()
        if path.is_symlink():
            found[name] = f"link to {str(path.readlink())!r}"
        elif path.is_file() and path.stat().st_size < 64 << 20:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = "" if path.is_dir() else f"{path.stat().st_size} bytes"
    return found


def _run(probe: Probe, folder: Path, command: Any) -> tuple[int | None, float, float]:
    context = multiprocessing.get_context("fork")
    is_ready = context.Event()
    process = context.Process(target=_child, args=(probe, folder, command, is_ready))
    began_s = time.monotonic()
    process.start()
    pid: int = process.pid  # type: ignore[assignment]
    if probe.interrupt is not None:
        kind, after_s = probe.interrupt
        is_ready.wait(MAX_WAIT_S)  # on a busy machine, the signal would come before the command
        process.join(after_s)
        if process.is_alive():
            os.kill(pid, kind)
    process.join(MAX_WAIT_S)
    is_late = process.is_alive()
    if is_late:
        process.kill()
        process.join()
    usage = folder / ".usage"
    resident_mib = float(usage.read_text()) if usage.exists() else 0.0
    usage.unlink(missing_ok=True)
    return None if is_late else process.exitcode, time.monotonic() - began_s, resident_mib


def _child(probe: Probe, folder: Path, command: Any, is_ready: Event) -> None:
    """What the copied process does: limits, own streams, the command; what its memory grew by goes to `.usage`."""
    os.setsid()
    copied_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # of the process that this one is a copy of
    for number, name in ((1, ".stdout"), (2, ".stderr")):
        os.dup2(os.open(folder / name, os.O_WRONLY), number)
    sys.stdin = open(os.devnull)  # noqa: PTH123, SIM115
    sys.stdout, sys.stderr = (os.fdopen(number, "w", buffering=1) for number in (1, 2))
    os.chdir(folder)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESSES, MAX_ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_S, MAX_S + 10))
    for kind, limit in probe.limits:
        resource.setrlimit(kind, (limit, resource.getrlimit(kind)[1]))
    code = 1
    is_ready.set()
    try:
        if callable(command):
            code = command()
        else:
            from foreglow.cli import main

            sys.argv = ["foreglow", *command]
            main()
            code = DONE
    except SystemExit as ending:
        code = ending.code if isinstance(ending.code, int) else 0 if ending.code is None else 1
    except BaseException:  # the command's own edge should have turned it into a line
        traceback.print_exc()
    finally:
        for kind, _ in probe.limits:
            resource.setrlimit(kind, 2 * (resource.getrlimit(kind)[1],))
        peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        (folder / ".usage").write_text(str((peak_kib - copied_kib) / 1024))
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
