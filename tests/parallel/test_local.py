"""Work in processes of this machine: lost ones, errors, Ctrl-C, and a parent that is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from foreglow.parallel import MAX_DEATHS, Cluster, Local, workers_at
from tests.linux import needs_processes
from tests.parallel import tasks

pytestmark = pytest.mark.process


def nobody(*_: object) -> None:
    pass


def folders(root: Path, *names: str) -> dict[str, Path]:
    for name in names:
        (root / name).mkdir()
    return {name: root / name for name in names}


def wait_for(*paths: Path) -> None:
    tasks.wait_until(lambda: all(path.exists() and path.stat().st_size for path in paths))


def is_running(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


def wait_until_gone(*pids: int) -> None:
    tasks.wait_until(lambda: not any(is_running(pid) for pid in pids))
    assert not [pid for pid in pids if is_running(pid)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_all_items_are_worked_on_and_tell(jobs: int) -> None:
    told: list[tuple[str, int]] = []
    items = {str(number): number for number in range(9)}
    found = dict(Local(jobs).each(tasks.square, items, lambda *news: told.append(news)))
    assert found == {str(number): number * number for number in range(9)}
    assert sorted(told) == [("squared", number) for number in range(9)]


def test_one_job_or_one_item_stays_in_this_process() -> None:
    assert dict(Local(1).each(tasks.process_of, {"a": 0.0, "b": 0.0}, nobody)) == {"a": os.getpid(), "b": os.getpid()}
    assert dict(Local(2).each(tasks.process_of, {"a": 0.0}, nobody)) == {"a": os.getpid()}
    assert dict(Local(2).each(tasks.process_of, {}, nobody)) == {}


def test_a_process_has_one_thread_of_opencv() -> None:
    """With one for each core in as many processes, cores would only change between them."""
    assert dict(Local(2).each(tasks.threads_of_opencv, {"a": 0, "b": 0}, nobody)) == {"a": 1, "b": 1}


def test_processes_are_used_again() -> None:
    items = {str(number): 0.1 for number in range(6)}
    pids = set(dict(Local(2).each(tasks.process_of, items, nobody)).values())
    assert len(pids) == 2
    assert os.getpid() not in pids
    wait_until_gone(*pids)


def test_a_lost_process_costs_its_own_item_only(tmp_path: Path) -> None:
    items = folders(tmp_path, "before", "fatal", "beside", "after")
    assert dict(Local(2).each(tasks.die_once, items, nobody)) == {"before": 1, "fatal": 2, "beside": 1, "after": 1}


def test_an_item_that_costs_too_many_processes_is_named() -> None:
    found: list[str] = []
    with pytest.raises(ChildProcessError, match=f"^fatal: {MAX_DEATHS} processes that worked on it ended unexpectedly"):
        found.extend(name for name, _ in Local(2).each(tasks.die, {"fine": "fine", "fatal": "fatal"}, nobody))
    assert found == ["fine"]


def test_after_an_error_those_under_way_are_finished_and_no_more_begun(tmp_path: Path) -> None:
    items = {name: (name == "bad", path) for name, path in folders(tmp_path, "good", "bad", "never").items()}
    found: list[str] = []
    with pytest.raises(ValueError, match="bad item"):
        found.extend(name for name, _ in Local(2).each(tasks.fail_at, items, nobody))
    assert found == ["good"]
    assert (tmp_path / "good" / "finished").exists()
    assert not (tmp_path / "never" / "finished").exists()


def test_asked_to_stop_work_returns_what_it_has(tmp_path: Path) -> None:
    started: list[str] = []
    items = {name: tmp_path / f"{name}.x" for name in ("a", "b", "c")}
    found = dict(
        Local(2).each(
            tasks.wait_for_stop, items, lambda _, name: started.append(name), is_stopped=lambda: len(started) == 2
        )
    )
    assert found == {"a": "stopped", "b": "stopped"}


def test_who_leaves_early_leaves_no_process_behind(tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    items = {name: tmp_path / f"{name}.x" for name in ("a", "b", "c")}
    with pytest.raises(KeyboardInterrupt):
        list(Local(2).each(tasks.wait_for_stop, items, interrupt))
    pids = [int(path.read_text()) for path in tmp_path.glob("*.started")]
    assert pids
    wait_until_gone(*pids)
    assert len(list(tmp_path.glob("*.stopped"))) == len(pids)  # they were asked first


SCRIPT = """
import signal
import sys
from pathlib import Path
from foreglow.parallel import Local
from tests.parallel import tasks

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts what runs in the background without

items = {name: Path(sys.argv[1]) / f"{name}.x" for name in ("a", "b")}
list(Local(2).each(tasks.wait_for_stop, items, lambda *_: None))
"""


@needs_processes
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_parent_that_is_gone_takes_its_processes_with_it(tmp_path: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]  # a script needs no `if __name__ == "__main__":`
    parent = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=Path(__file__).parents[2])
    marks = [tmp_path / f"{name}.started" for name in ("a", "b")]
    wait_for(*marks)
    pids = [int(mark.read_text()) for mark in marks]
    assert all(is_running(pid) for pid in pids)
    parent.send_signal(number)
    parent.wait(tasks.PATIENCE_S)
    wait_until_gone(*pids)


SQUARES = """
import os
import sys

sys.path.append(sys.argv[1])
from foreglow.parallel import Local
from tests.parallel import tasks

print(sorted(dict(Local(2).each(tasks.square, {"a": 2, "b": 3}, lambda *_: None)).items()))
assert "PYTHONSAFEPATH" not in os.environ
"""


@needs_processes
@pytest.mark.parametrize("name", ["argparse", "inspect", "threading"])
def test_a_file_named_as_a_standard_module_in_the_working_folder_is_not_imported(tmp_path: Path, name: str) -> None:
    (tmp_path / "scripts").mkdir()
    script = tmp_path / "scripts" / "squares.py"
    script.write_text(SQUARES)
    (tmp_path / f"{name}.py").write_text("class Plugin: pass\n")
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONSAFEPATH")}
    done = subprocess.run(
        [sys.executable, script, Path(__file__).parents[2]],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "[('a', 4), ('b', 9)]\n", "")


def test_workers_by_the_options() -> None:
    assert workers_at(3, None) == Local(3)
    assert workers_at(1, "tcp://127.0.0.1:8786") == Cluster("tcp://127.0.0.1:8786")
    with pytest.raises(ValueError, match="expected --jobs or --cluster, got both"):
        workers_at(2, "tcp://127.0.0.1:8786")
    with pytest.raises(ValueError, match="jobs: expected a whole number of at least 1, got 0"):
        workers_at(0, None)


@needs_processes
def test_the_process_that_watches_what_is_left_behind_outlives_a_closed_terminal() -> None:
    """Where SIGHUP came to all processes, a second one printed a traceback for each thing that the first had known."""
    from joblib.externals.loky.backend.resource_tracker import _resource_tracker

    assert dict(Local(2).each(tasks.square, {"a": 1, "b": 2}, nobody)) == {"a": 1, "b": 4}
    status = Path(f"/proc/{_resource_tracker._pid}/status").read_text()
    blocked = int(next(line.split()[1] for line in status.splitlines() if line.startswith("SigBlk")), 16)
    assert blocked & 1 << (signal.SIGHUP - 1)
