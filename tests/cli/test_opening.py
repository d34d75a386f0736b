"""A signal that comes while outputs are being opened, at any line of the program: nothing is left of them."""

from __future__ import annotations

import contextlib
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from foreglow.cli.shared_run import recording_sinks, run_frames, viewer_sinks
from foreglow.folder_lock import locked
from foreglow.options import ViewOptions
from foreglow.pipeline import Pipeline
from foreglow.runtime.run import ResultSink, run
from foreglow.types import Frame
from foreglow.whole_files import open_atomic, together
from tests.stand_ins import REFERENCE, ListSource, night_frames

pytestmark = pytest.mark.process

WATCHED = ("/foreglow/", "/contextlib.py")
"""Parts of the names of files whose lines count."""

STEP = 7
"""Every so many lines one is tried; all of them were, once."""


class Interrupting:
    """Raises SIGINT when so many lines were executed in a `with` block, until it is told that everything is open.

    Attributes:
        has_come: Whether it was raised.
    """

    def __init__(self, num_lines: int) -> None:
        self._num_left = num_lines
        self.has_come = False

    def __enter__(self) -> Interrupting:
        sys.settrace(self._trace)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def opened(self) -> None:
        sys.settrace(None)

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        if not any(part in frame.f_code.co_filename for part in WATCHED):
            return None
        if event == "line":
            self._num_left -= 1
            if self._num_left < 0:
                sys.settrace(None)
                self.has_come = True
                signal.raise_signal(signal.SIGINT)
                return None
        return self._trace


class Opened(ListSource):
    """A source that tells when the outputs are open, as its first frame is asked for."""

    def __init__(self, interrupting: Interrupting) -> None:
        super().__init__(night_frames(2))
        self._interrupting = interrupting

    def __iter__(self) -> Iterator[Frame]:
        self._interrupting.opened()
        return super().__iter__()


def make_sinks(out: Path) -> Iterator[ResultSink]:
    yield from recording_sinks(out / "drive.mcap", "here", REFERENCE)
    yield from viewer_sinks(ViewOptions(save=out / "drive.rrd"), REFERENCE)


def run_into_folder(out: Path, interrupting: Interrupting) -> None:
    source = Opened(interrupting)
    run_frames(source, "here", out / "run", Pipeline(REFERENCE), make_sinks=lambda _: make_sinks(out))


def record(out: Path, interrupting: Interrupting) -> None:
    run(Opened(interrupting), Pipeline(REFERENCE), None, sinks=make_sinks(out), source_name="here")


def write_files(out: Path, interrupting: Interrupting) -> None:
    with locked({"--out": out / "new" / "folder"}), together():
        for name in ("one", "two"):
            with open_atomic(out / name) as file:
                file.write(b"whole")
        interrupting.opened()
        raise KeyboardInterrupt


@pytest.mark.parametrize("command", [run_into_folder, record, write_files])
def test_nothing_half_written_is_left_wherever_it_comes(
    command: Callable[[Path, Interrupting], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("foxglove")
    pytest.importorskip("rerun")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    unraised: list[type[BaseException]] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda told: unraised.append(told.exc_type))
    with contextlib.suppress(KeyboardInterrupt):
        (tmp_path / "whole").mkdir()
        command(tmp_path / "whole", Interrupting(1 << 30))  # imports what it needs
    num_threads = threading.active_count()
    has_come, num_lines = True, 0
    while has_come:
        out = tmp_path / str(num_lines)
        out.mkdir()
        with contextlib.suppress(KeyboardInterrupt), Interrupting(num_lines) as interrupting:
            command(out, interrupting)
        found = {path.relative_to(out) for path in out.rglob("*") if path.is_file()}
        half = {path for path in found if path.name.startswith(".") or path.suffix == ".partial"}
        assert not half, f"line {num_lines}"
        assert not found or command is not write_files
        assert not list((tmp_path / "temporary").iterdir()), f"line {num_lines}"
        has_come, num_lines = interrupting.has_come, num_lines + STEP
    assert num_lines > 20 * STEP
    assert set(unraised) <= {ResourceWarning}  # a file that is closed only now, and is gone
    assert threading.active_count() <= num_threads
