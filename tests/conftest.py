"""What the markers mean: what a test is skipped without, what `--quick` leaves out, what stays in one process."""

from __future__ import annotations

import functools
import gc
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.testing
from hypothesis import settings

# Two processes share two cores, and threads that wait for work spin. NumPy and others read this when they are loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Hundreds of tests call a command, and building all of them takes a quarter of a second.
typer.testing._get_command = functools.cache(typer.testing._get_command)  # type: ignore[attr-defined]

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as of a job in the background, whose children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


EXTRAS = {"torch": "torch", "renderer": "mitsuba", "ros": "rclpy"}
"""The markers that say which extra a test needs, and the module that is missing without it."""

NOT_QUICK = {*EXTRAS, "process", "slow"}

NO_TEST_IS_QUICK = re.compile(rf"^pytestmark = \[?\s*pytest\.mark\.({'|'.join(NOT_QUICK)})\b", re.MULTILINE)
"""In the text of a file all of whose tests `--quick` leaves out."""

TOGETHER = {
    "ros": "pytest.mark.ros",
    "dask": "cluster: DaskCluster",
    "torch": "pytest.mark.torch",
    "renderer": "pytest.mark.renderer",
}
"""Files that stay in one process, by words in their text: the process that hands out the tests knows no markers. They
are handed out in this order: while those with ROS 2 wait for one another, others learn and render."""


def pytest_addoption(parser: pytest.Parser) -> None:
    help_text = "leave out all that is slow, starts processes, or needs torch, the renderer or ROS 2"
    parser.addoption("--quick", action="store_true", help=help_text)


def pytest_configure(config: pytest.Config) -> None:
    # No deadline: a busy machine is slow, which is no fault of what is tested.
    settings.register_profile("whole", deadline=None)
    settings.register_profile("quick", deadline=None, max_examples=15)
    settings.load_profile("quick" if config.getoption("--quick") else "whole")


@pytest.fixture(autouse=True, scope="session")
def _images_of_the_shipped_drive_are_decoded_once() -> Iterator[None]:
    """Dozens of tests run over it, and decoding it takes longer than looking for lights in it."""
    from foreglow.datasets import images, shipped_drive

    folder, decode = str(shipped_drive()), images._decoded
    once = functools.cache(decode)

    def decoded(data: bytes, origin: str) -> Any:
        image = (once if origin.startswith(folder) else decode)(data, origin)
        image.flags.writeable = False
        return image

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(images, "_decoded", decoded)
        yield


@pytest.fixture(autouse=True, scope="module")
def _live_loops_thaw_nothing_before_the_last_test_of_a_file() -> Iterator[None]:
    """With what collection loaded thawed, each live loop would first search 800,000 objects, in half a second."""
    thaw, thawed = gc.unfreeze, list[bool]()
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(gc, "unfreeze", lambda: thawed.append(True))
        yield
    if thawed:
        thaw()
        gc.collect()
        gc.freeze()


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """A dark image in a folder of its own."""
    import cv2
    import numpy as np

    path = tmp_path / "image.png"
    cv2.imwrite(str(path), np.zeros((64, 96), np.uint8))
    return path


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of a report's words and tables: its figures are made, but not drawn, which is what takes long."""
    pytest.importorskip("matplotlib")
    import cv2
    import numpy as np

    pixel = cv2.imencode(".png", np.zeros((1, 1), np.uint8))[1].tobytes()
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, file, **__: file.write(pixel))


@pytest.fixture
def few_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of other rows than those of the rules of confirmation: each rule has every fourth of its settings."""
    from foreglow.lab.studies.time_benefit import run

    few = {rule: dict(list(settings.items())[::4]) for rule, settings in run.RULES.items()}
    monkeypatch.setattr(run, "RULES", few)


def pytest_runtest_setup(item: pytest.Item) -> None:
    markers = markers_of(item)
    for marker in EXTRAS.keys() & markers:
        pytest.importorskip(EXTRAS[marker])
    if "renderer" in markers:
        from foreglow.lab.simulation.light.llvm import prepare

        try:
            prepare()
        except OSError as error:  # no LLVM for it
            pytest.skip(f"the renderer has no LLVM that it can use: {error}")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """The quick loop does not even import such a file: it may load torch or ROS 2."""
    is_test = collection_path.name.startswith("test_") and collection_path.is_file() and config.getoption("--quick")
    return True if is_test and NO_TEST_IS_QUICK.search(collection_path.read_text(encoding="utf-8")) else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Nothing that is loaded here is garbage: it is not searched for any, neither now nor during the tests."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.enable()
    return result


def pytest_sessionfinish() -> None:
    gc.unfreeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Gives every process whole files, in the order of the tests, for the sake of what their tests set up."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            return group_of(config.rootpath / nodeid.partition("::")[0])

        def mark_test_complete(self, node: Any, item_index: int, duration: float = 0) -> None:
            """Forgets groups that are done: otherwise all tests that a process was given are counted each time."""
            super().mark_test_complete(node, item_index, duration)
            groups = self.assigned_work[node].items()
            self.assigned_work[node] = {group: tests for group, tests in groups if not all(tests.values())}

    config.option.loadscopereorder = False
    return Scheduling(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--quick"):
        config.hook.pytest_deselected(items=[item for item in items if NOT_QUICK & markers_of(item)])
        items[:] = [item for item in items if not NOT_QUICK & markers_of(item)]
    if hasattr(config, "workerinput"):  # one of several processes of pytest-xdist: what takes long comes first
        groups = {item: group_of(item.path) for item in items}
        long = {group for item, group in groups.items() if NOT_QUICK & markers_of(item)}
        turns = {group: turn for turn, group in enumerate(TOGETHER)}
        items.sort(key=lambda item: (turns.get(groups[item], len(turns)), groups[item] not in long))


@functools.cache
def group_of(file: Path) -> str:
    """What stays in one process: a file; or all with ROS 2, as they meet on one network, or with the same cluster, or
    with torch or the renderer, which take seconds to load."""
    text = file.read_text(encoding="utf-8")
    return next((name for name, words in TOGETHER.items() if words in text), str(file))


def markers_of(item: pytest.Item) -> set[str]:
    return {mark.name for mark in item.iter_markers()}
