"""An imported data set is there whole or not at all, also after its process was killed."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from foreglow.datasets import open_labelled
from foreglow.datasets.exchange import write_split
from foreglow.datasets.pvdn import is_pvdn
from foreglow.folder_lock import FolderLock

KILLED = """
import os, signal, sys
from pathlib import Path
from foreglow.datasets import open_labelled
from foreglow.datasets.exchange import write_split
from foreglow.datasets.pvdn import writer

files = []
write = getattr(writer, sys.argv[3])

def write_until(*arguments):
    files.append(arguments)
    if len(files) == int(sys.argv[4]):
        os.kill(os.getpid(), signal.SIGKILL)
    write(*arguments)

setattr(writer, sys.argv[3], write_until)
write_split(open_labelled(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.mark.parametrize(("write", "number"), [("write_atomic", 2), ("write_label_files", 1), ("write_json", 7)])
def test_what_a_killed_process_left_is_no_data_set_and_goes(
    write: str, number: int, split: Path, tmp_path: Path
) -> None:
    """In the midst of the images, before the files of the whole split, and between the two."""
    out = tmp_path / "out"
    command = [sys.executable, "-c", KILLED, str(split), str(out), write, str(number)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert [path.name for path in out.iterdir()] == [".import.partial"]
    assert not is_pvdn(out)
    assert write_split(open_labelled(split), out) == len(open_labelled(split))
    assert sorted(path.name for path in out.iterdir()) == ["images", "labels"]
    assert is_pvdn(out)


def test_a_hidden_split_is_not_complete(split: Path, tmp_path: Path) -> None:
    shutil.copytree(split, tmp_path / "out/.import.partial")
    assert not is_pvdn(tmp_path / "out")


@pytest.mark.parametrize("inner", ["val", "day/val", "mine"])
def test_no_split_is_written_around_others(inner: str, split: Path, tmp_path: Path) -> None:
    """Commands would take one of them, and say nothing."""
    shutil.copytree(split, tmp_path / "out" / inner)
    with pytest.raises(ValueError, match=f"out: expected a folder without a data set, the split .*out/{inner} is "):
        write_split(open_labelled(split), tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == [Path(inner).parts[0]]
    write_split(open_labelled(split), tmp_path / "out" / "another")


def test_empty_folders_are_no_data_set(split: Path, tmp_path: Path) -> None:
    (tmp_path / "out/images/S00001").mkdir(parents=True)
    (tmp_path / "out/labels").mkdir()
    assert write_split(open_labelled(split), tmp_path / "out") == len(open_labelled(split))


def test_a_second_process_does_not_write_the_same_split(split: Path, tmp_path: Path) -> None:
    with FolderLock(tmp_path / "out"), pytest.raises(ValueError, match="another run is writing into this folder"):
        write_split(open_labelled(split), tmp_path / "out")
