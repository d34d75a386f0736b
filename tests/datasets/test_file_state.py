"""A file that changes while it is read: its frames may be anything, and that is told."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from foreglow.datasets import Recording, Video
from foreglow.datasets.file_state import FileStates
from tests.datasets.bags.bags import images, make_bag, make_mcap, raw
from tests.datasets.video.test_video_file import make_video

CONTAINERS = {
    "clip.y4m": "rawvideo",
    "clip.avi": "rawvideo",
    "clip.mxf": "mpeg2video",
    "clip.nut": "rawvideo",
    "clip.mkv": "mpeg4",
    "clip.mp4": "mpeg4",
    "clip.ts": "mpeg2video",
}


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def append(path: Path) -> None:
    with path.open("ab") as file:
        file.write(path.read_bytes())


def overwrite(path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        file.write(bytes(200))
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 1))  # the clock of some file systems has coarse steps


def replace(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    state = path.stat()
    os.utime(other, ns=(state.st_atime_ns, state.st_mtime_ns))
    other.replace(path)


CHANGES = [cut, append, overwrite, replace]


def read(source: Video | Recording, path: Path, change: Callable[[Path], None]) -> None:
    """Reads all frames; the file changes after the second."""
    for index, _ in enumerate(source):
        if index == 1:
            change(path)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", CONTAINERS)
def test_a_video_that_changes_is_told(tmp_path: Path, name: str, change: Callable[[Path], None]) -> None:
    path = make_video(tmp_path / name, codec=CONTAINERS[name])
    video = Video(path, on_error="skip")
    assert list(video)
    assert video.lost_parts == []
    read(video, path, change)
    (line,) = video.lost_parts
    assert line.startswith(f"{path}: changed while it was read, ")
    assert line in video.skipped


def test_with_stop_it_is_an_error(tmp_path: Path) -> None:
    path = make_video(tmp_path / "clip.y4m", codec="rawvideo")
    with pytest.raises(ValueError, match=r"clip\.y4m: changed while it was read, from \d+ to \d+ bytes; frames may be"):
        read(Video(path), path, cut)


@pytest.mark.parametrize("change", [append, overwrite])
@pytest.mark.parametrize("kind", ["mcap", "bag", "sqlite3"])
def test_a_recording_that_changes_is_told(tmp_path: Path, kind: str, change: Callable[[Path], None]) -> None:
    pictures = [raw(image) for image in images(8)]
    path = make_bag(tmp_path, kind, pictures)
    file = path if path.is_file() else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    recording = Recording(path, on_error="skip")
    read(recording, file, change)
    assert any(line.startswith(f"{file}: changed while it was read, ") for line in recording.lost_parts)


def test_a_recording_that_is_still_written_may_grow(tmp_path: Path) -> None:
    whole = make_mcap(tmp_path / "drive.mcap", images(8))
    path = whole.rename(tmp_path / "drive.mcap.partial")
    recording = Recording(path)
    read(recording, path, append)
    assert recording.lost_parts == []


def test_a_deleted_file_is_read_to_its_end(tmp_path: Path) -> None:
    path = make_video(tmp_path / "clip.mkv")
    video = Video(path)
    read(video, path, Path.unlink)
    assert video.lost_parts == []


def test_a_file_that_stays_has_not_changed(tmp_path: Path) -> None:
    path = tmp_path / "some"
    path.write_bytes(b"some")
    states = FileStates([path])
    assert states.change() == ""
    overwrite(path)
    assert "of 200 bytes" not in states.change()
    assert "from 4 to 202 bytes" in states.change()
