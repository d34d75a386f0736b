"""Files that are whole or not there, and windows that never stop a run."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun")

import rerun as rr

from foreglow.display.viewer import RerunSink, RrdFile, ViewerWindow, outputs
from foreglow.display.viewer.blueprint import blueprint
from foreglow.display.viewer.outputs import LOCAL, OFFLINE, check_display, viewer_command
from tests.display.viewer.recordings import frame_at, full_result

ARRANGED = blueprint(has_lux=False)
COPY = "import sys, os; open(sys.argv[1], 'wb').write(sys.stdin.buffer.read())"


def noise(number: int) -> list[tuple[str, object]]:
    """An image of a megabyte that cannot be compressed."""
    return [("image", rr.Image(np.random.default_rng(number).integers(0, 256, (1000, 1000), np.uint8)))]


def test_a_discarded_file_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "run.rrd").write_bytes(b"older")
    file = RrdFile(tmp_path / "run.rrd", ARRANGED)
    file.log(0, 0, noise(0))
    file.discard()
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]
    assert (tmp_path / "run.rrd").read_bytes() == b"older"


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"nowhere/run\.rrd"):
        RrdFile(tmp_path / "nowhere" / "run.rrd", ARRANGED)


def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder.rrd").mkdir()
    os.mkfifo(tmp_path / "pipe.rrd")
    for path in (tmp_path / "folder.rrd", tmp_path / "pipe.rrd"):
        with pytest.raises(OSError, match=r"expected a regular file to overwrite|Is a directory"):
            RrdFile(path, ARRANGED)


def log_for_a_while(file: RrdFile) -> None:
    """Rerun hands over what it has every 0.2 s."""
    for number in range(100):
        file.log(number, number, noise(number))
        time.sleep(0.02)


def test_a_full_disk_at_the_end_is_one_error(tmp_path: Path) -> None:
    file = RrdFile(tmp_path / "run.rrd", ARRANGED)
    limits, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        file.log(0, 0, noise(0))
        with pytest.raises(OSError, match=r"File too large: .*run\.rrd"):
            file.close()
        file.discard()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    file = RrdFile(path, ARRANGED)
    limits, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"File too large: .*run\.rrd"):
            log_for_a_while(file)
        file.log_static(noise(0))  # and whatever follows returns
        file.discard()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_a_window_gets_what_is_logged(tmp_path: Path) -> None:
    path = tmp_path / "received"
    notes: list[str] = []
    sink = RerunSink([ViewerWindow(ARRANGED, notes.append, command=[sys.executable, "-c", COPY, str(path)])])
    for number in range(3):
        frame = frame_at(50_000_000 * number, number)
        sink.write(frame, full_result(frame))
    sink.close()
    received = b""
    for _ in range(200):  # the window's process writes it in pieces
        received = path.read_bytes() if path.exists() else b""
        if b"/camera/image" in received and b"/viewport" in received:
            break
        time.sleep(0.05)
    assert b"/camera/image" in received
    assert b"/viewport" in received
    assert notes == []


@pytest.mark.slow
def test_a_closed_window_is_noted_once_and_the_run_goes_on() -> None:
    notes: list[str] = []
    window = ViewerWindow(ARRANGED, notes.append, command=["true"])
    sink = RerunSink([window])
    for number in range(40):
        frame = frame_at(50_000_000 * number, number)
        sink.write(frame, full_result(frame))
        time.sleep(0.02)
    sink.close()
    assert notes == ["the viewer is closed: the run goes on without it"]


@pytest.mark.slow
def test_a_window_that_takes_nothing_is_noted_once_and_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outputs, "NUM_WAITING", 2)
    notes: list[str] = []
    window = ViewerWindow(ARRANGED, notes.append, command=["sleep", "20"], patience_s=0.05)
    began_s = time.monotonic()
    while not window._is_behind and time.monotonic() < began_s + 15.0:
        window.log(0, 0, noise(0))
        time.sleep(0.05)
    for number in range(10):
        window.log(number, number, noise(number))
        time.sleep(0.05)
    window.close()
    assert notes == ["the viewer does not keep up: what it cannot take is not shown"]
    assert time.monotonic() < began_s + 19.0


def test_no_display_is_said_before_anything_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ValueError, match=r"--view: expected a display.*--save FILE\.rrd"):
        ViewerWindow(ARRANGED, print)
    monkeypatch.setenv("DISPLAY", ":0")
    check_display()


def test_the_viewer_listens_here_alone_and_asks_nobody() -> None:
    command = viewer_command()
    assert command[command.index("--bind") + 1] == LOCAL == "127.0.0.1"
    assert command[command.index("--memory-limit") + 1] == "25%"
    assert OFFLINE["CI"]
    assert OFFLINE["HTTPS_PROXY"] == OFFLINE["https_proxy"] == "http://127.0.0.1:9"
