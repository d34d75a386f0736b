"""Commands in processes that are forked from one that has loaded the program, which takes longer than they run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

LOADED = (
    "foreglow.cli.live, foreglow.cli.run, foreglow.distance, foreglow.proposals, foreglow.runtime.live, "
    "foreglow.tracking, rich.progress, scipy.interpolate"
)

PROGRAM = f"""
import gc, json, os, sys, time
from foreglow.cli import main
from foreglow.beam import BeamStage
from foreglow.config import preset
import {LOADED}

config = preset("foreglow").commanding()
BeamStage(config.beam, config.guard, None, config.lit_street)  # what it computes of the headlamps is kept
gc.freeze()  # what is loaded here would be searched for garbage when each fork ends


def waited(pid):
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)


for line in sys.stdin:
    asked = json.loads(line)
    if "wait" in asked:
        print(json.dumps(waited(asked["wait"])), flush=True)
        continue
    child = os.fork()
    if not child:
        for number, path in enumerate((os.devnull, *asked["outputs"])):
            os.dup2(os.open(path, os.O_RDWR | os.O_CREAT), number)
        sys.argv[1:] = asked["arguments"]
        main()
        break
    print(child, flush=True)
"""


@dataclass(frozen=True)
class Forked:
    """A command that runs.

    Attributes:
        pid: Number of its process.
        outputs: The files that take what it writes to standard output and standard error.
        loaded: The process that it was forked from.
    """

    pid: int
    outputs: tuple[Path, Path]
    loaded: Loaded

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)

    def ended(self) -> tuple[int, str, str]:
        """When it has ended, within a minute: its exit code, as of `subprocess`, and what it wrote."""
        code = self.loaded.ask({"wait": self.pid})
        assert isinstance(code, int), "it goes on and on"
        stdout, stderr = (path.read_text() for path in self.outputs)
        return code, stdout, stderr


@dataclass(frozen=True)
class Loaded:
    """A process that has loaded the program."""

    process: subprocess.Popen[str]
    folder: Path

    def start(self, *arguments: object) -> Forked:
        """A `foreglow` command, in a process of its own."""
        number = len(list(self.folder.iterdir()))
        outputs = (self.folder / f"{number}.out", self.folder / f"{number}.err")
        asked = {"arguments": [str(argument) for argument in arguments], "outputs": [str(path) for path in outputs]}
        return Forked(self.ask(asked), outputs, self)

    def ask(self, line: Mapping[str, object]) -> int:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(line) + "\n")
        self.process.stdin.flush()
        answer: int = json.loads(self.process.stdout.readline())
        return answer


@contextlib.contextmanager
def loaded(folder: Path) -> Iterator[Loaded]:
    """A process that has loaded the program; what its commands write goes into `folder`."""
    command = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Loaded(process, folder)
