"""Files: whole or not at all, and errors that name the file that the user knows."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import fcntl
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from enum import IntEnum, StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from foreglow.datasets.json_files import parse_json, read_json, read_json_lines
from foreglow.files import (
    fields_to_json,
    file_digest,
    json_text,
    number_in,
    read_plain_json,
    read_text,
    read_toml,
    read_yaml,
    to_json,
    write_json_results,
)
from foreglow.lab.learning.kept_files import check_torch_file, file_checksum, image_state
from foreglow.whole_files import (
    MAX_LOCKS,
    atomic_path,
    make_folder,
    naming,
    open_atomic,
    put,
    remove_file,
    together,
    undisturbed,
    write_atomic,
)
from tests.pipes import ENDLESS, soon


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_atomic(path, b"old")
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.json'"):
        _fail_inside(path)
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.json"]


def _fail_inside(path: Path) -> None:
    with open_atomic(path) as file:
        file.write(b"half of the ne")
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_file_goes_when_the_others_appear(tmp_path: Path) -> None:
    new, old, folder = tmp_path / "new.txt", tmp_path / "old.txt", tmp_path / "folder"
    old.touch()
    folder.mkdir()

    @together()
    def write(*, fails: bool) -> None:
        remove_file(old)
        remove_file(folder)  # not a file
        write_atomic(new, b"new")
        assert old.exists()
        if fails:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write(fails=True)
    assert old.exists()
    write(fails=False)
    assert {path.name for path in tmp_path.iterdir()} == {"new.txt", "folder"}
    remove_file(new)
    remove_file(new)
    assert not new.exists()


def test_several_files_appear_together_or_none_of_them(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "new" / "deep" / "second"
    first.write_bytes(b"old")

    @together()
    def fail_at_the_third() -> None:
        write_atomic(first, b"new")
        with together():  # a part of the whole
            make_folder(second.parent)
            write_atomic(second, b"new")
        assert first.read_bytes() == b"old"
        _fail_inside(tmp_path / "third")

    with pytest.raises(OSError, match="No space left"):
        fail_at_the_third()
    assert first.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["first"]
    with together():
        write_atomic(first, b"earlier")
        write_atomic(first, b"new")
        make_folder(second.parent)
        write_atomic(second, b"new")
    assert {path.name: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == {
        "first": b"new",
        "second": b"new",
    }
    write_atomic(first, b"alone again")
    assert first.read_bytes() == b"alone again"


def test_files_of_which_one_cannot_be_put_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()

    @together()
    def write_all() -> None:
        for name in "abc":
            write_atomic(tmp_path / name, b"new")

    with pytest.raises(IsADirectoryError) as caught:
        write_all()
    assert caught.value.filename == str(tmp_path / "b")
    assert [each.name for each in tmp_path.iterdir()] == ["b"]


def test_files_that_wait_for_others_are_locked(tmp_path: Path) -> None:
    """Else a process on another machine, to which ours is none that lives, would take them for left over."""
    with together():
        write_atomic(tmp_path / "a", b"new")
        (waiting,) = tmp_path.iterdir()
        with waiting.open("rb") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_more_files_than_may_be_locked_at_a_time(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (MAX_LOCKS + 200, limits[1]))
    try:
        with together():
            for number in range(MAX_LOCKS + 300):
                write_atomic(tmp_path / str(number), b"new")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert len(list(tmp_path.iterdir())) == MAX_LOCKS + 300


def test_an_error_names_the_file_and_not_the_temporary_one(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "a.json"
    with pytest.raises(FileNotFoundError) as caught:
        write_atomic(path, b"new")
    assert caught.value.filename == str(path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder") as error:
        write_atomic(tmp_path / "folder", b"new")
    assert error.value.filename == str(tmp_path / "folder")
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


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


class Colour(StrEnum):
    RED = "red"


class Level(IntEnum):
    HIGH = 2


@dataclasses.dataclass(frozen=True, slots=True)
class Share:
    num: int
    total: int

    @property
    def share(self) -> float:
        return self.num / self.total if self.total else float("nan")

    def to_json(self) -> dict[str, Any]:
        return fields_to_json(self, "share")


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Results:
    values: Any
    share: Share | None = None


class Model(BaseModel):
    rate_hz: float
    path: Path


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float("nan"), None),
        (float("-inf"), None),
        (np.float64("nan"), None),
        (np.float32(0.5), 0.5),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.array([[1.0, np.nan], [np.inf, 2.0]]), [[1.0, None], [None, 2.0]]),
        (np.array([], np.int32), []),
        ((1, (2.0, "a")), [1, [2.0, "a"]]),
        (Colour.RED, "red"),
        (Level.HIGH, 2),
        ({Colour.RED: Level.HIGH, 7: None}, {"red": 2, "7": None}),
        (MappingProxyType({"a": np.float64(1.5)}), {"a": 1.5}),
        (Path("a") / "b", "a/b"),
        (Model(rate_hz=float("nan"), path=Path("x")), {"rate_hz": None, "path": "x"}),
        (Results({"x": (float("nan"),)}), {"values": {"x": [None]}, "share": None}),
        (Results(1, Share(1, 2)), {"values": 1, "share": {"num": 1, "total": 2, "share": 0.5}}),
        ([Share(0, 0)], [{"num": 0, "total": 0, "share": None}]),
    ],
)
def test_values_as_json(value: Any, expected: Any) -> None:
    found = to_json(value)
    assert found == expected
    assert json.loads(json.dumps(found, allow_nan=False)) == expected  # nothing of numpy is left
    assert json.loads(json_text(value)) == expected


@pytest.mark.parametrize("text", ["1_000", "1_0.5", "", "one", "1,5", "\u0661"])
def test_what_is_no_number(text: str) -> None:
    assert number_in(" -1.5e3\n") == -1500
    with pytest.raises(ValueError, match="could not convert"):
        number_in(text)


def test_a_value_that_json_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Unable to serialize unknown type: <class 'object'>"):
        to_json({"a": [object()]})
    with pytest.raises(ValueError, match="Unable to serialize"):
        write_json_results(tmp_path / "results.json", object())
    assert not list(tmp_path.iterdir())


class Labels(BaseModel):
    labels: dict[str, int]


@pytest.mark.parametrize("text", ['{"labels": {"a": 1, "b": 2, "a": 1}}', '\ufeff{"labels": {"b": 2}, "a": 1, "a": 1}'])
def test_a_key_that_comes_twice_in_json_is_refused(tmp_path: Path, text: str) -> None:
    """The last one counted, silently."""
    path = tmp_path / "labels.json"
    path.write_text(text)
    words = r"labels\.json: (line 1: )?keys: expected each once, a comes twice"
    reads: tuple[Callable[[], Any], ...] = (
        lambda: read_plain_json(path),
        lambda: read_json(path, Labels),
        lambda: parse_json(text.removeprefix("\ufeff"), Labels, str(path)),
    )
    for read in reads:
        with pytest.raises(ValueError, match=words):
            read()
    path.write_text(f'[{{"a": 1}}, {{"a": {"9" * 4000}}}]')
    assert len(read_plain_json(path)) == 2


def test_what_is_wrong_in_yaml_is_told_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: [1\nb: {\n")
    with pytest.raises(ValueError, match=r"a\.yaml: expected YAML: .*line 2, column 2") as refused:
        read_yaml(path)
    assert "\n" not in str(refused.value)


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = [tmp_path / f".a.json.{gone.pid}-{number}.tmp" for number in (1, 140_737)] + [
        tmp_path / f".b.rrd.{gone.pid}.tmp"
    ]
    kept = [tmp_path / f".a.json.{os.getpid()}-1.tmp", tmp_path / ".1.tmp", tmp_path / f"a.{gone.pid}-1.tmp"]
    for path in (*left, *kept):
        path.write_bytes(b"half")
    write_atomic(tmp_path / "c.json", b"whole")
    assert set(tmp_path.iterdir()) == {*kept, tmp_path / "c.json"}


@pytest.mark.parametrize("kind", ENDLESS)
def test_a_pipe_is_not_waited_for(tmp_path: Path, kind: str) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    pipe = tmp_path / f".a.json.{gone.pid}-1.tmp"
    ENDLESS[kind](pipe)
    with soon():
        write_atomic(tmp_path / "c.json", b"whole")
        for read in (file_digest, file_checksum, image_state, check_torch_file):
            with pytest.raises(ValueError, match=f"tmp: expected a file, is {kind}$"):
                read(pipe)


def test_what_another_machine_writes_stays(tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    foreign = tmp_path / f".a.json.{gone.pid}-1.tmp"
    with foreign.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        write_atomic(tmp_path / "c.json", b"whole")
    assert foreign.exists()


def test_a_library_that_opens_its_file_itself(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    with contextlib.suppress(KeyboardInterrupt), atomic_path(path) as temporary:
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"whole")
    assert path.read_bytes() == b"whole"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupt_waits_until_files_are_there_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*given: Path) -> None:
        signal.raise_signal(signal.SIGINT)
        put(*given)

    monkeypatch.setattr("foreglow.whole_files.put", interrupted)
    with contextlib.suppress(KeyboardInterrupt), together():
        for name in ("report", "figures"):
            write_atomic(tmp_path / name, b"new")
        assert not list(tmp_path.glob("[!.]*"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figures", "report"]


def test_a_signal_that_is_ignored_stays_so_in_a_block_that_is_undisturbed() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with undisturbed():
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("read", [read_text, read_plain_json, read_toml, lambda path: read_json(path, dict)])
def test_utf_16_is_told(tmp_path: Path, read: Any) -> None:
    path = tmp_path / "a.json"
    path.write_text("{}", "utf-16")
    with pytest.raises(ValueError, match=r"a\.json: expected UTF-8 text, is UTF-16: save it as UTF-8$"):
        read(path)


def test_a_mark_of_utf_8_may_begin_lines_of_json(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text("{}\n{}\n", "utf-8-sig")
    assert [value for _, value in read_json_lines(path, dict)] == [{}, {}]
