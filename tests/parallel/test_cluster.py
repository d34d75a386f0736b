"""Work on a dask cluster of real processes: lost workers, Ctrl-C, and what a cluster must have."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from foreglow.parallel import MAX_DEATHS, Cluster
from foreglow.parallel import cluster as cluster_module
from foreglow.parallel import pool as pool_module
from tests.parallel import tasks
from tests.parallel.dask_cluster import DaskCluster
from tests.parallel.test_local import folders, nobody, wait_for

pytestmark = pytest.mark.process

pytest.importorskip("distributed")


def test_all_items_are_worked_on_and_tell(cluster: DaskCluster) -> None:
    told: list[tuple[str, int]] = []
    items = {str(number): number for number in range(9)}
    found = dict(Cluster(cluster.address).each(tasks.square, items, lambda *news: told.append(news)))
    assert found == {str(number): number * number for number in range(9)}
    assert sorted(told) == [("squared", number) for number in range(9)]
    assert dict(Cluster(cluster.address).each(tasks.square, {}, nobody)) == {}


def test_workers_are_counted(cluster: DaskCluster) -> None:
    items = {str(number): 0.3 for number in range(4)}
    assert len(set(dict(Cluster(cluster.address).each(tasks.process_of, items, nobody)).values())) == 2
    assert Cluster(cluster.address).num_workers == 2


def test_paths_mean_the_same_as_here(cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("data.txt").write_text("the same")
    workers = Cluster(cluster.address)
    assert dict(workers.each(tasks.read_here, {"a": "data.txt"}, nobody, paths=[Path("data.txt")])) == {"a": "the same"}
    missing = r"^elsewhere/data: no such file or folder at worker tcp://127\.0\.0\.1.* same paths on every machine"
    with pytest.raises(FileNotFoundError, match=missing):
        list(workers.each(tasks.read_here, {"a": "data.txt"}, nobody, paths=[Path("elsewhere/data")]))


def test_a_lost_worker_costs_its_own_item_only(cluster: DaskCluster, tmp_path: Path) -> None:
    items = folders(tmp_path, "before", "fatal", "beside", "after")
    found = dict(Cluster(cluster.address).each(tasks.die_once, items, nobody))
    assert found == {"before": 1, "fatal": 2, "beside": 1, "after": 1}


def test_an_item_that_costs_too_many_workers_is_named(cluster: DaskCluster) -> None:
    with pytest.raises(ChildProcessError, match=f"^fatal: {MAX_DEATHS} processes that worked on it ended unexpectedly"):
        list(Cluster(cluster.address).each(tasks.die, {"fine": "fine", "fatal": "fatal"}, nobody))


def test_an_error_is_that_of_the_work(cluster: DaskCluster, tmp_path: Path) -> None:
    items = {name: (name == "bad", path) for name, path in folders(tmp_path, "good", "bad", "never").items()}
    with pytest.raises(ValueError, match="bad item"):
        list(Cluster(cluster.address).each(tasks.fail_at, items, nobody))
    assert (tmp_path / "good" / "finished").exists()
    assert not (tmp_path / "never" / "finished").exists()


def test_a_frozen_worker_does_not_hold_up_the_end(
    cluster: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It never answered the request to stop, and Ctrl-C ended nothing."""
    for module in (cluster_module, pool_module):
        monkeypatch.setattr(module, "GRACE_S", 0.5)
    number = tmp_path / "process"

    def interrupted(*_: object) -> None:
        tasks.wait_until(lambda: tasks.is_frozen(number.read_text()))
        raise KeyboardInterrupt

    try:
        with pytest.raises(KeyboardInterrupt):
            list(Cluster(cluster.address).each(tasks.freeze, {"a": number}, interrupted))
    finally:
        os.kill(int(number.read_text()), signal.SIGCONT)


def test_asked_to_stop_work_returns_what_it_has(cluster: DaskCluster, tmp_path: Path) -> None:
    started: list[str] = []
    items = {name: tmp_path / f"{name}.x" for name in ("a", "b", "c")}
    found = Cluster(cluster.address).each(
        tasks.wait_for_stop, items, lambda _, name: started.append(name), is_stopped=lambda: len(started) == 2
    )
    assert dict(found) == {"a": "stopped", "b": "stopped"}


SCRIPT = """
import signal
import sys
from pathlib import Path
from foreglow.parallel import Cluster
from tests.parallel import tasks

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts what runs in the background without

items = {name: Path(sys.argv[1]) / f"{name}.x" for name in ("a", "b")}
list(Cluster(sys.argv[2]).each(tasks.wait_for_stop, items, lambda *_: None))
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_work_ends_when_who_wanted_it_is_gone(cluster: DaskCluster, tmp_path: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path), cluster.address]
    parent = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=Path(__file__).parents[2])
    wait_for(tmp_path / "a.started", tmp_path / "b.started")
    parent.send_signal(number)
    parent.wait(tasks.PATIENCE_S)
    tasks.wait_until(lambda: len(list(tmp_path.glob("*.stopped"))) == 2)
    assert len(list(tmp_path.glob("*.stopped"))) == 2


def test_nothing_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 0.5)
    with pytest.raises(ConnectionError, match=r"^--cluster tcp://127\.0\.0\.1:9: expected a dask scheduler, nothing"):
        list(Cluster("tcp://127.0.0.1:9").each(tasks.square, {"a": 1}, nobody))


def test_workers_must_be_there_and_have_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    here = {"processes": False, "protocol": "tcp://", "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=0, threads_per_worker=2, **here) as empty:
        with monkeypatch.context() as patch:
            patch.setattr(cluster_module, "CONNECT_S", 1.0)
            with pytest.raises(ConnectionError, match="expected workers at this scheduler, found none; start some"):
                list(Cluster(empty.scheduler_address).each(tasks.square, {"a": 1}, nobody))
        empty.scale(1)
        with pytest.raises(ValueError, match=r"expected one thread \(dask worker --nthreads 1\), it has 2"):
            list(Cluster(empty.scheduler_address).each(tasks.square, {"a": 1}, nobody))


def test_another_version_is_refused(cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "version", lambda _: "0.0.1")
    with pytest.raises(ValueError, match=r"expected foreglow 0\.0\.1, it has "):
        list(Cluster(cluster.address).each(tasks.square, {"a": 1}, nobody))
