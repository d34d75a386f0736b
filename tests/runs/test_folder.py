"""The output folder: all results together, or none."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

import pytest

from foreglow.config import config_to_toml, read_config
from foreglow.own_folders import RESULT_NAMES
from foreglow.runs.folder import OutputFolder, part_sinks
from foreglow.runs.summary_file import LiveSummary, read_summary
from foreglow.runs.tally import Tally
from foreglow.whole_files import open_atomic, together
from tests.stand_ins import REFERENCE, night_frames, result_of

SUMMARY = Tally().summary("here", [], REFERENCE, is_complete=True, dispatch=None)
DESCRIPTION = {"config.toml", "summary.json"}


def contents(path: Path) -> dict[str, str]:
    """The files in `path` but for those that describe the run."""
    return {entry.name: entry.read_text() for entry in path.iterdir() if entry.name not in DESCRIPTION}


OLD = '{"frame":0,"sequence":"","timestamp_ns":0}\n'


def test_nothing_has_its_name_before_it_is_published(tmp_path: Path) -> None:
    folder = OutputFolder(tmp_path)
    folder.write_text("beam.log", "new")
    assert [entry.name for entry in tmp_path.iterdir() if entry.suffix != ".partial"] == []
    folder.publish(REFERENCE, SUMMARY)
    assert contents(tmp_path) == {"beam.log": "new", "frames.jsonl": ""}
    assert read_config(tmp_path / "config.toml") == REFERENCE
    assert read_summary(tmp_path / "summary.json").source == "here"


@pytest.mark.parametrize("is_live", [False, True])
@pytest.mark.parametrize("num_parts", [0, 2])
def test_the_summary_knows_the_frames_as_they_are_on_disk(tmp_path: Path, num_parts: int, is_live: bool) -> None:
    folder = OutputFolder(tmp_path)
    if num_parts:
        parts = folder.make_parts()
        for name in "ab":
            for sink in part_sinks(parts, name):
                sink.write(night_frames(1)[0], result_of(night_frames(1)[0], [[1, 2, 9, 9]]))
                sink.close()
        folder.join_parts(parts, "ab")
    else:
        folder.write_text("frames.jsonl", "whatever there is\n")
    live = LiveSummary(
        run=SUMMARY, num_dropped=0, num_late=0, num_unrecorded=0, sink_errors=(), fault_counts={}, faults=()
    )
    if is_live:
        folder.publish(REFERENCE, live)
    else:
        folder.publish(REFERENCE, SUMMARY)
    written = (tmp_path / "frames.jsonl").read_bytes()
    assert written
    summary = read_summary(tmp_path / "summary.json")
    assert summary.frames_sha256 == hashlib.sha256(written).hexdigest()
    assert (summary.live is not None) == is_live


def test_results_that_somebody_removed_are_not_published(tmp_path: Path) -> None:
    (tmp_path / "frames.jsonl").write_text(OLD)
    (tmp_path / "config.toml").write_text("old")
    folder = OutputFolder(tmp_path)
    folder.partial("frames.jsonl").unlink()
    with pytest.raises(FileNotFoundError, match=r"frames\.jsonl: expected what was written so far, it was removed"):
        folder.publish(REFERENCE, SUMMARY)
    folder.discard()
    assert contents(tmp_path) == {"frames.jsonl": OLD}


def test_publishing_removes_results_of_an_earlier_run_and_nothing_else(tmp_path: Path) -> None:
    for name in (*RESULT_NAMES, "notes.txt"):
        (tmp_path / name).write_text(OLD if name == "frames.jsonl" else "old")
    folder = OutputFolder(tmp_path)
    folder.partial("frames.jsonl").write_text("new")
    folder.publish(REFERENCE, SUMMARY)
    assert contents(tmp_path) == {"frames.jsonl": "new", "notes.txt": "old"}
    assert (tmp_path / "config.toml").read_text() == config_to_toml(REFERENCE)


LEFT = {
    "frames.jsonl": OLD.encode(),
    "times.jsonl": b"",
    "summary.json": b" " * 4096,
    "config.toml": config_to_toml(REFERENCE).encode(),
    "overlay.mp4": b"\0\0\0\x20ftypisom",
    "overlay.png": b"\x89PNG\r\n\x1a\n",
    "beam.mp4": b"",
    "beam.png": b"",
    "beam.asc": b"date Thu",
    "beam.blf": b"LOGG",
    "beam.log": b"(12.0) can0",
}
"""What a run that is killed may leave, without the ending of the names."""


@pytest.mark.parametrize("is_published", [False, True])
def test_what_a_killed_run_left_is_cleared(tmp_path: Path, is_published: bool) -> None:
    for name, data in LEFT.items():
        is_whole = is_published and name == "frames.jsonl"
        (tmp_path / (name if is_whole else f"{name}.partial")).write_bytes(data)
    folder = OutputFolder(tmp_path)
    folder.write_text("frames.jsonl", "new")
    folder.publish(REFERENCE, SUMMARY)
    assert contents(tmp_path) == {"frames.jsonl": "new"}


@pytest.mark.parametrize("has_run", [False, True])
@pytest.mark.parametrize("name", LEFT)
def test_a_file_of_somebody_else_with_a_partial_name_stays(tmp_path: Path, name: str, has_run: bool) -> None:
    if has_run:
        with OutputFolder(tmp_path) as folder:
            folder.publish(REFERENCE, SUMMARY)
    (tmp_path / "frames.jsonl.partial").write_bytes(b"")
    path = tmp_path / f"{name}.partial"
    path.write_text("my notes")
    with pytest.raises(ValueError, match=rf"{name}\.partial: expected nothing there but what an interrupted run left"):
        OutputFolder(tmp_path)
    assert path.read_text() == "my notes"
    assert (tmp_path / "frames.jsonl.partial").exists()


def test_a_video_beside_a_complete_run_is_not_one_that_a_killed_run_left(tmp_path: Path) -> None:
    with OutputFolder(tmp_path) as folder:
        folder.publish(REFERENCE, SUMMARY)
    path = tmp_path / "overlay.mp4.partial"
    path.write_bytes(LEFT["overlay.mp4"])
    with pytest.raises(ValueError, match=r"overlay\.mp4\.partial: expected nothing there"):
        OutputFolder(tmp_path)
    assert path.exists()


def test_a_partial_name_makes_nobody_elses_results_those_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "overlay.mp4.partial").write_text("mine")
    (tmp_path / "config.toml").write_text("mine")
    with pytest.raises(ValueError, match=r"config\.toml: expected nothing there but earlier results"):
        OutputFolder(tmp_path)


def test_a_new_page_under_a_partial_name_stays(tmp_path: Path) -> None:
    """Where somebody wrote the page meanwhile, the user was told that it is there."""
    (tmp_path / "report.html.partial").write_text("page")
    with OutputFolder(tmp_path) as folder:
        folder.publish(REFERENCE, SUMMARY)
    assert (tmp_path / "report.html.partial").read_text() == "page"


def test_a_file_that_somebody_writes_under_a_partial_name_meanwhile_stays(tmp_path: Path) -> None:
    folder = OutputFolder(tmp_path)
    (tmp_path / "config.toml.partial").write_text("mine")
    with pytest.raises(FileExistsError, match="of something else"):
        folder.publish(REFERENCE, SUMMARY)
    folder.discard()
    assert contents(tmp_path) == {"config.toml.partial": "mine"}


def test_an_error_in_its_block_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with OutputFolder(tmp_path / "out") as folder:
            folder.write_text("frames.jsonl", "new")
            folder.make_parts()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_parts_are_joined_in_the_order_of_their_names(tmp_path: Path) -> None:
    frames = night_frames(3)
    whole, joined = OutputFolder(tmp_path / "whole"), OutputFolder(tmp_path / "joined")
    parts = joined.make_parts()
    for name, its in (("b", frames[2:]), ("a", frames[:2])):
        for sink in part_sinks(parts, name):
            for frame in its:
                sink.write(frame, result_of(frame, [[0, 0, 4, 4]]))
            sink.close()
    joined.join_parts(parts, ["a", "b"])
    for sink in whole.line_sinks():
        for frame in frames:
            sink.write(frame, result_of(frame, [[0, 0, 4, 4]]))
        sink.close()
    for folder in (whole, joined):
        folder.publish(REFERENCE, SUMMARY)
    assert contents(joined.path) == contents(whole.path)
    assert set(contents(whole.path)) == {"frames.jsonl", "times.jsonl"}


def test_discarding_removes_only_what_it_made(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    folder = OutputFolder(tmp_path / "kept" / "a" / "b")
    folder.write_text("config.toml", "new")
    folder.discard()
    assert [entry.name for entry in tmp_path.iterdir()] == ["kept"]
    assert list((tmp_path / "kept").iterdir()) == []


def test_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OSError, match="out: expected a folder"):
        OutputFolder(tmp_path / "out")


def test_file_among_the_parents(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(NotADirectoryError, match="out"):
        OutputFolder(tmp_path / "out" / "deep")


def test_folder_where_a_result_goes(tmp_path: Path) -> None:
    (tmp_path / "summary.json").mkdir()
    with pytest.raises(ValueError, match=r"summary\.json: expected a file"):
        OutputFolder(tmp_path)


@pytest.mark.parametrize("name", ["times.jsonl", "times.jsonl.partial"])
def test_pipe_where_a_result_goes(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(ValueError, match=rf"{name}: expected a file to write, or nothing, got a device, a pipe"):
        OutputFolder(tmp_path)
    assert (tmp_path / name).is_fifo()


def test_unwritable_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "write_text", refuse)  # as root, permissions stop nothing
    with pytest.raises(PermissionError, match="Permission denied"):
        OutputFolder(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_unknown_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"frames\.jsonl, .*got 'x'"):
        OutputFolder(tmp_path).partial("x")


def test_discarding_where_a_plug_in_went_to_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It left the files of the run, under their temporary names, in the folder for it."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    folder = OutputFolder(Path("out"))
    os.chdir("elsewhere")
    folder.discard()
    assert [path.name for path in tmp_path.iterdir()] == ["elsewhere"]


def test_an_atomic_file_where_a_plug_in_went_to_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    for block in (contextlib.nullcontext(), together()):
        os.chdir(tmp_path)
        with block, open_atomic(Path("result.txt")) as file:
            os.chdir("elsewhere")
            file.write(b"whole")
        assert sorted(path.name for path in tmp_path.rglob("*")) == ["elsewhere", "result.txt"]
        (tmp_path / "result.txt").unlink()
