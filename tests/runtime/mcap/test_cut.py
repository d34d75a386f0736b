"""A recording of a run that was interrupted, or that was never finished, says so, and so does what is made from it."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import resource
import signal
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import preset
from foreglow.datasets import open_source
from foreglow.runs.recorded_run import read_run
from foreglow.runs.summary_file import lack_of_run, read_summary
from foreglow.runtime import OutputFolder
from foreglow.runtime.live import LiveLoop, Paced
from foreglow.runtime.live.background import Background
from foreglow.runtime.live.kept_results import KeptResults
from foreglow.runtime.run import run
from foreglow.types import Frame
from tests.cli.commands import foreglow_command
from tests.datasets.bags.bags import images, make_mcap
from tests.runtime.mcap.drives import full_frame, full_result
from tests.stand_ins import REFERENCE, ListSource, night_frames

pytest.importorskip("foxglove")

from foreglow.pipeline import Pipeline
from foreglow.runtime.mcap import McapRecorder

WORDS = "frames are missing from the recording, what is made from it is incomplete"


class Interrupted(ListSource):
    """A source in whose third frame Ctrl-C comes, which waits until the run has begun."""

    has_begun: threading.Event | None = None

    def __iter__(self) -> Iterator[Frame]:
        if self.has_begun is not None:
            assert self.has_begun.wait(60)
        for number, frame in enumerate(super().__iter__()):
            if number == 2:
                signal.raise_signal(signal.SIGINT)
            yield frame


class Broken(ListSource):
    """A source that cannot be read from its third frame on."""

    def __iter__(self) -> Iterator[Frame]:
        yield from list(super().__iter__())[:2]
        raise ValueError("drive.avi: frame 2: damaged")


def recorded(path: Path, source: ListSource) -> Path:
    run(source, Pipeline(REFERENCE), None, sinks=[McapRecorder(path)])
    return path


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    return recorded(tmp_path / "drive.mcap", Interrupted(night_frames(5)))


def test_a_run_on_it_says_so(cut: Path, tmp_path: Path) -> None:
    out, again = tmp_path / "out", tmp_path / "again.mcap"
    result = foreglow_command("run", cut, "--preset", "paper", "--out", out, "--record", again)
    assert result.exit_code == 0, result.output
    assert f"{cut}: {WORDS}\n" in result.stdout
    summary = read_summary(out / "summary.json")
    assert (summary.num_frames, summary.is_complete, summary.is_interrupted) == (3, False, False)
    assert summary.source_lack == f"{cut}: {WORDS}"
    assert lack_of_run(out) == f"{out}: made from {cut}: {WORDS}"
    with pytest.warns(UserWarning, match=f"made from .*{WORDS}"):
        read_run(out)
    said = foreglow_command("report", out, "--out", tmp_path / "page.html")
    assert f"{out}: made from {cut}: {WORDS}\n" in said.stdout
    with pytest.warns(UserWarning, match=WORDS):  # what was recorded of it lacks the same
        open_source(again)


def test_one_of_a_damaged_recording_says_so(tmp_path: Path) -> None:
    """Of a cut one it said so, of one with a hole not."""
    damaged, again = recorded(tmp_path / "drive.mcap", ListSource(night_frames(40))), tmp_path / "again.mcap"
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    result = foreglow_command("record", damaged, "--on-error", "skip", "--preset", "paper", "--out", again)
    assert result.exit_code == 0, result.output
    with pytest.warns(UserWarning, match=WORDS):
        assert 0 < len(list(open_source(again))) < 40


def test_bytes_that_are_missing_in_the_first_chunk_cost_no_other(tmp_path: Path) -> None:
    """Topics were defined there, and the end of the file is elsewhere than it says: the whole file was refused."""
    noise = np.random.default_rng(5).integers(0, 256, (40, 96, 128), np.uint8)
    frames = [dataclasses.replace(frame, image=image) for frame, image in zip(night_frames(40), noise, strict=True)]
    damaged = recorded(tmp_path / "drive.mcap", ListSource(frames))
    content = damaged.read_bytes()
    damaged.write_bytes(content[:20_000] + content[20_100:])
    with pytest.raises(ValueError, match=r"drive\.mcap: byte \d+: .*damaged"):
        list(open_source(damaged))
    assert 20 <= len(list(open_source(damaged, on_error="skip"))) < 40


def test_of_a_damaged_end_what_is_before_the_damage_is_known(tmp_path: Path) -> None:
    damaged = recorded(tmp_path / "drive.mcap", ListSource(night_frames(40)))
    content = bytearray(damaged.read_bytes())
    content[-(8 + 20 + 9) - 18] = 0xFF  # the length of the last record before the footer
    content[2_700] ^= 1  # the first chunk, which defines the topics
    damaged.write_bytes(content)
    assert 20 <= len(list(open_source(damaged, on_error="skip"))) < 40


@pytest.mark.slow
def test_so_do_workers_and_a_replay(cut: Path, tmp_path: Path) -> None:
    for number, command in enumerate([("run", cut, "--jobs", 2), ("live", cut, "--speed", 0)]):
        out = tmp_path / str(number)
        result = foreglow_command(*command, "--out", out)
        assert result.exit_code == 0, result.output
        assert f"{cut}: {WORDS}\n" in result.stdout
        assert "interrupted\n" not in result.output
        summary = read_summary(out / "summary.json")
        assert (summary.is_complete, summary.is_interrupted) == (False, False)


def test_in_python_a_warning_says_so(cut: Path) -> None:
    with pytest.warns(UserWarning, match=WORDS):
        frames = open_source(cut)
    assert len(list(frames)) == 3
    with pytest.warns(UserWarning, match=WORDS):
        assert not run(open_source(cut), Pipeline(REFERENCE), None).is_complete


def test_one_of_a_source_that_broke_in_a_live_run_says_so(tmp_path: Path) -> None:
    path, config = tmp_path / "drive.mcap", preset("foreglow").commanding()
    source = Paced(Broken(night_frames(5)), float("inf"))
    loop = LiveLoop(source, lambda: Pipeline(config), config, sinks=[McapRecorder(path)])
    with pytest.raises(TimeoutError, match="damaged"):
        loop.run()
    with pytest.warns(UserWarning, match=WORDS):
        assert len(list(open_source(path))) == 2


@pytest.mark.parametrize("is_endless", [False, True])
def test_ctrl_c_cuts_a_replay_and_ends_a_camera(is_endless: bool, tmp_path: Path) -> None:
    path, config = tmp_path / "drive.mcap", preset("foreglow").commanding()
    frames, begun = Interrupted(night_frames(5)), threading.Event()
    frames.has_begun = begun
    source = Paced(frames, float("inf"))
    source.is_endless = is_endless
    recorder = McapRecorder(path)
    summary = LiveLoop(source, lambda: Pipeline(config), config, sinks=[recorder], at_begin=begun.set).run()
    assert summary.run.is_interrupted
    with contextlib.nullcontext() if is_endless else pytest.warns(UserWarning, match=WORDS):
        open_source(path)


def test_one_that_was_not_finished_says_so(tmp_path: Path) -> None:
    whole = recorded(tmp_path / "drive.mcap", ListSource(night_frames(3)))
    left = tmp_path / "left.mcap.partial"
    left.write_bytes(whole.read_bytes()[:-100])
    result = foreglow_command("run", left, "--preset", "paper", "--out", tmp_path / "out")
    assert f"{left}: the recording was not finished, what is made from it is incomplete\n" in result.stdout
    assert read_summary(tmp_path / "out" / "summary.json").is_complete is False


@pytest.mark.parametrize("on_error", ["skip", "mark"])
def test_one_whose_end_is_missing_says_so(on_error: str, tmp_path: Path) -> None:
    """The same bytes under a name of unfinished ones said so."""
    whole = make_mcap(tmp_path / "drive.mcap", images(6))
    whole.write_bytes(whole.read_bytes()[:-3000])
    out = tmp_path / "out"
    result = foreglow_command("run", whole, "--on-error", on_error, "--preset", "paper", "--out", out)
    words = f"{whole}: truncated recording, its end is missing"
    assert f"{words}\n" in result.stdout
    summary = read_summary(out / "summary.json")
    assert (summary.is_complete, summary.source_lack) == (False, words)
    with pytest.warns(UserWarning, match=words):
        open_source(whole, on_error="skip")


def test_whole_and_foreign_ones_say_nothing(tmp_path: Path) -> None:
    whole = recorded(tmp_path / "drive.mcap", ListSource(night_frames(3)))
    foreign = make_mcap(tmp_path / "foreign.mcap", images(3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in (whole, foreign):
            summary = run(open_source(path), Pipeline(REFERENCE), None)
            assert (summary.is_complete, summary.source_lack) == (True, None)


@pytest.mark.parametrize("limit", [100_000, 150_000, 200_000])
def test_what_a_full_disk_did_not_take_is_counted(limit: int, tmp_path: Path) -> None:
    """Also what was waiting in the queue, and the rest of the chunk that did not fit."""
    path, folder, num_frames = tmp_path / "drive.mcap", OutputFolder(tmp_path / "out"), 60
    recording, kept = Background(McapRecorder(path), is_lossless=True), KeptResults(folder)
    lines = Background(kept, is_lossless=True)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
    try:
        for index in range(num_frames):
            for background in (recording, lines):
                background.write(full_frame(index), full_result(full_frame(index)))
        for background in (recording, lines):
            background.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert recording.error is not None
    with pytest.warns(UserWarning, match="not finished"):
        num_recorded = len(list(open_source(tmp_path / "drive.mcap.partial")))
    assert recording.num_lost == num_frames - num_recorded
    text = (tmp_path / "out" / "frames.jsonl.partial").read_text()
    assert lines.num_lost == num_frames - len([json.loads(line) for line in text.splitlines()])
    folder.discard()
