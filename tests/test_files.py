"""Files: whole or not at all, and errors that name the file that the user knows."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from foreglow.files import naming, open_atomic, read_text, write_atomic


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_atomic(path, b"old")
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.json'"):
        _fail_inside(path)
    assert path.read_bytes() == b"old"
    assert [one.name for one in tmp_path.iterdir()] == ["a.json"]


def _fail_inside(path: Path) -> None:
    with open_atomic(path) as file:
        file.write(b"half of the ne")
        raise OSError(errno.ENOSPC, "No space left on device")


def test_an_error_names_the_file_and_not_the_temporary_one(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "a.json"
    with pytest.raises(FileNotFoundError) as caught:
        write_atomic(path, b"new")
    assert caught.value.filename == str(path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder") as error:
        write_atomic(tmp_path / "folder", b"new")
    assert error.value.filename == str(tmp_path / "folder")
    assert [one.name for one in tmp_path.iterdir()] == ["folder"]


def test_an_error_about_another_file_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught, naming(tmp_path / "a"):
        (tmp_path / "b").read_bytes()
    assert caught.value.filename == str(tmp_path / "b")


def test_text_without_its_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfK\xc3\xb6ln\n")
    assert read_text(path) == "Köln\n"


def test_what_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"a\.txt: expected UTF-8 text"):
        read_text(path)
    with pytest.raises(FileNotFoundError, match="absent"):
        read_text(tmp_path / "absent")
