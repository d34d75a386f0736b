"""The output folder: all results together, or none."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.runtime import RESULT_NAMES, OutputFolder


def contents(path: Path) -> dict[str, str]:
    return {entry.name: entry.read_text() for entry in path.iterdir()}


def test_nothing_has_its_name_before_it_is_published(tmp_path: Path) -> None:
    folder = OutputFolder(tmp_path)
    folder.write_text("summary.json", "{}")
    assert not (tmp_path / "summary.json").exists()
    folder.partial("frames.jsonl").unlink()
    folder.publish()
    assert contents(tmp_path) == {"summary.json": "{}"}


def test_publishing_removes_results_of_an_earlier_run_and_nothing_else(tmp_path: Path) -> None:
    for name in (*RESULT_NAMES, "notes.txt"):
        (tmp_path / name).write_text("old")
    folder = OutputFolder(tmp_path)
    folder.write_text("config.toml", "new")
    folder.partial("frames.jsonl").write_text("new")
    folder.publish()
    assert contents(tmp_path) == {"config.toml": "new", "frames.jsonl": "new", "notes.txt": "old"}


def test_publishing_removes_what_a_killed_run_left(tmp_path: Path) -> None:
    (tmp_path / "overlay.mp4.partial").write_text("half")
    folder = OutputFolder(tmp_path)
    folder.write_text("frames.jsonl", "new")
    folder.publish()
    assert contents(tmp_path) == {"frames.jsonl": "new"}


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
