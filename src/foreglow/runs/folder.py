"""The folder that a run writes into: its results appear together at the end, or not at all."""

from __future__ import annotations

import contextlib
import shutil
import uuid
from pathlib import Path

from foreglow.files import naming

RESULT_NAMES = (
    "frames.jsonl",
    "times.jsonl",
    "overlay.mp4",
    "overlay.png",
    "beam.mp4",
    "beam.png",
    "beam.asc",
    "beam.blf",
    "beam.log",
    "moments.png",
    "config.toml",
    "summary.json",
)
"""Every name that a run may write; `summary.json` is published last, so where it exists the set is whole. Only what is
made of the results themselves, `moments.png` by `foreglow demo`, comes after it."""

PARTS = "parts-*.partial"
"""Pattern of the folders that hold pieces of results while a run is under way."""


class OutputFolder:
    """Makes the folder and checks it before any work is done, then hands out temporary names.

    `partial` gives the path to write a result to; `publish` renames all that were written to their final names and
    removes results of earlier runs that this one did not write again; `discard` removes what was written and
    leaves earlier results as they were.
    """

    def __init__(self, path: Path) -> None:
        """Makes the folder `path`, with its parents.

        Raises:
            OSError: If it cannot be made or written to; the message names the path.
            ValueError: If it holds a folder where a result's file has to go.
        """
        self.path = path
        self._partials: dict[str, Path] = {}
        self._parts: Path | None = None
        self._made = [folder for folder in (path, *path.parents) if not folder.exists()]
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(f"{path}: expected a folder to write into, got a file")
        path.mkdir(parents=True, exist_ok=True)
        for name in RESULT_NAMES:
            if (path / name).is_dir():
                raise ValueError(f"{path / name}: expected a file to write, or nothing, got a folder")
        try:
            self.write_text("frames.jsonl", "")
        except OSError:
            self.discard()
            raise

    def partial(self, name: str) -> Path:
        """Where to write the result called `name` until it is published."""
        if name not in RESULT_NAMES:
            raise ValueError(f"name: expected one of {', '.join(RESULT_NAMES)}, got {name!r}")
        return self._partials.setdefault(name, _partial(self.path, name))

    def write_text(self, name: str, text: str) -> None:
        """Writes the whole result called `name`.

        Raises:
            OSError: If that fails; the message names the path.
        """
        with naming(self.path / name):
            self.partial(name).write_text(text, encoding="utf-8")

    def parts(self) -> Path:
        """A new folder in it for pieces of results; it goes with `publish` and `discard`."""
        self._parts = self.path / PARTS.replace("*", uuid.uuid4().hex)
        with naming(self._parts):
            self._parts.mkdir()
        return self._parts

    def publish(self) -> None:
        """Gives all results their final names, `summary.json` last; a name never written to is skipped."""
        for parts in self.path.glob(PARTS):  # this run's, and those of runs that were killed
            shutil.rmtree(parts, ignore_errors=True)
        (self.path / RESULT_NAMES[-1]).unlink(missing_ok=True)
        for name in RESULT_NAMES:
            partial = self._partials.get(name)
            if partial is not None and partial.exists():
                partial.replace(self.path / name)
            else:
                (self.path / name).unlink(missing_ok=True)
                _partial(self.path, name).unlink(missing_ok=True)  # of a run that was killed
        self._partials.clear()

    def discard(self) -> None:
        """Removes what was written, and the folders that were made for it if nothing else is in them."""
        for partial in self._partials.values():
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
        self._partials.clear()
        if self._parts is not None:
            shutil.rmtree(self._parts, ignore_errors=True)
        for folder in self._made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _partial(folder: Path, name: str) -> Path:
    """Where the result called `name` is written until it is published."""
    return folder / f"{name}.partial"
