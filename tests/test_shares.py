"""Several processes of pytest share the tests by whole files, and those with ROS 2 are all in one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.conftest import pytest_xdist_make_scheduler

pytest.importorskip("xdist")

FILES = {
    "test_network.py": "@pytest.mark.ros\n",
    "test_node.py": "pytestmark = pytest.mark.ros\n",
    "test_a.py": "",
    "test_b.py": "",
}


class Worker:
    """A process that notes which tests it is given."""

    def __init__(self, ids: list[str]) -> None:
        self.ids, self.given = ids, list[str]()
        self.shutting_down = False
        self.gateway = SimpleNamespace(id="gw")

    def send_runtest_some(self, indices: list[int]) -> None:
        self.given += [self.ids[index] for index in indices]

    def shutdown(self) -> None:
        self.shutting_down = True


def test_files_stay_whole(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    ids = [f"{name}::test_{number}" for name in FILES for number in range(4)]
    option = SimpleNamespace(loadscopereorder=True)
    config = SimpleNamespace(option=option, rootpath=tmp_path, getvalue=lambda _: ["popen", "popen"])
    log = SimpleNamespace(loadscopesched=lambda *_: None)
    scheduler = pytest_xdist_make_scheduler(config, log)  # type: ignore[arg-type]
    workers = [Worker(ids), Worker(ids)]
    for worker in workers:
        scheduler.add_node(worker)
        scheduler.add_node_collection(worker, ids)
    scheduler.schedule()
    for number in range(8):
        assert scheduler.has_pending
        for worker in workers:
            scheduler.mark_test_complete(worker, ids.index(worker.given[number]))
    assert not scheduler.has_pending
    first, second = ([test.partition("::")[0] for test in worker.given] for worker in workers)
    assert first == ["test_network.py"] * 4 + ["test_node.py"] * 4
    assert second == ["test_a.py"] * 4 + ["test_b.py"] * 4
