"""A dask cluster of real processes on this machine, started as a user would."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.parallel.tasks import PATIENCE_S

ROOT = Path(__file__).parents[2]

SETTINGS = {
    "admin.system-monitor.interval": "10s",
    "admin.tick.interval": "1s",
    "worker.memory.monitor-interval": "1s",
    "worker.multiprocessing-method": "forkserver",
    "worker.profile.enabled": False,
}
"""Of dask's `distributed`: idle processes hardly wake, and a worker is forked from a process that has loaded dask."""


def as_variables(settings: Mapping[str, object]) -> dict[str, str]:
    """Settings as environment variables, which is how processes are given them."""
    return {
        f"DASK_DISTRIBUTED__{name.upper().replace('.', '__').replace('-', '_')}": str(value)
        for name, value in settings.items()
    }


@dataclass
class DaskCluster:
    """A scheduler and its workers, with nannies that start them again should they die."""

    folder: Path
    address: str = ""
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start_workers(self, number: int) -> None:
        """Workers of one thread each; their nannies share a process."""
        options = (
            "--nworkers",
            str(number),
            "--nthreads",
            "1",
            "--no-dashboard",
            "--local-directory",
            str(self.folder),
        )
        self.start("worker", self.address, *options)

    def wait_for_workers(self, number: int) -> None:
        """Until that many are there."""
        from distributed import Client

        with Client(self.address, timeout=PATIENCE_S, set_as_default=False) as client:
            client.wait_for_workers(number, timeout=PATIENCE_S)

    def start(self, *arguments: str) -> None:
        """A `dask` command in a folder of its own, so that no path is right by chance."""
        with (self.folder / "log.txt").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                cwd=self.folder,
                env=os.environ | as_variables(SETTINGS) | {"PYTHONPATH": str(ROOT)},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self.processes.append(process)

    def stop(self) -> None:
        """Kills all that was started, with their children: to say goodbye they would take as long as to start."""
        for process in self.processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextlib.contextmanager
def dask_cluster(folder: Path, num_workers: int = 2) -> Iterator[DaskCluster]:
    """A scheduler on a free port of the local host, and workers of one thread each."""
    cluster, file = DaskCluster(folder), folder / "scheduler.json"
    try:
        cluster.start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)
        )
        cluster.address = _address(file)
        cluster.start_workers(num_workers)
        cluster.wait_for_workers(num_workers)
        yield cluster
    finally:
        cluster.stop()


def _address(file: Path) -> str:
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        with contextlib.suppress(FileNotFoundError, json.JSONDecodeError):
            return str(json.loads(file.read_text())["address"])
        time.sleep(0.05)
    raise TimeoutError(f"{file}: expected a scheduler to write it")
