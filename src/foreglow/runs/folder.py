"""The folder that a run writes to: its results appear together at the end, or not at all."""

from __future__ import annotations

import contextlib
import errno
import shutil
import uuid
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from foreglow.config import PipelineConfig, config_to_toml
from foreglow.files import checked_path, file_digest, json_text
from foreglow.folder_lock import FolderLock
from foreglow.own_folders import RESULT_NAMES, RUN, check_own, clear_left
from foreglow.runs.frames_file import frame_to_line
from foreglow.runs.json_lines import LineSink
from foreglow.runs.summary_file import LiveSummary, RunSummary
from foreglow.runs.times_file import frame_to_times
from foreglow.whole_files import naming, partial_path, undisturbed

LINES = {"frames.jsonl": frame_to_line, "times.jsonl": frame_to_times}
"""The files that get a line for every frame, with the functions that make the line."""

Summary = TypeVar("Summary", RunSummary, LiveSummary)

ROOM_BYTES = 1 << 16
"""Room that `OutputFolder.keep_room` keeps; configuration and summary take less than half of it."""

PARTS = "parts-*.partial"
"""Pattern of the folders that hold pieces of results while a run is under way."""


class OutputFolder:
    """The results of a run while they are written, under temporary names.

    `partial` is the path to write a result to. `publish` gives all that were written their final names and removes the
    results of earlier runs that were not written again. `discard` removes what was written and leaves earlier results
    as they were; it is called when a `with` block of the folder ends with an error.
    """

    def __init__(self, path: Path | str) -> None:
        """Makes the folder `path` with its parents, checks it, and clears what a killed run left there.

        Raises:
            OSError: If it cannot be made or written to; the message names the path.
            ValueError: If something there has the name of a result, also the partial one, and is no file or not of a
                run, or another run is writing into it.
        """
        path = checked_path(path)
        self.path, self._home = path, path.absolute()  # a plug-in may go to another folder meanwhile
        self._partials: dict[str, Path] = {}
        self._parts: Path | None = None
        self._lock = FolderLock(path)
        try:
            check_own(path, RUN)
            clear_left(path)
            self.write_text("frames.jsonl", "")
        except BaseException:
            self.discard()
            raise

    def __enter__(self) -> OutputFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self.discard()

    def partial(self, name: str) -> Path:
        """Path of the result called `name` until it is published; nothing is there the first time.

        Raises:
            OSError: If somebody has written something there meanwhile; the message names the path.
        """
        if name not in RESULT_NAMES:
            raise ValueError(f"name: expected one of {', '.join(RESULT_NAMES)}, got {name!r}")
        if name not in self._partials:
            partial = partial_path(self.path / name)
            if partial.exists() or partial.is_symlink():
                words = f"expected nothing there until the run ends, {partial.name} is of something else"
                raise FileExistsError(errno.EEXIST, words, str(self.path / name))
            self._partials[name] = partial
        return self._partials[name]

    def write_text(self, name: str, text: str) -> None:
        """Writes the whole result called `name`.

        Raises:
            OSError: If that fails; the message names the path.
        """
        with naming(self.path / name):
            self.partial(name).write_text(text, encoding="utf-8")

    def keep_room(self) -> None:
        """Keeps room for configuration and summary, so that `publish` can write them when the lines fill the disk.

        Raises:
            OSError: If there is none; the message names the path.
        """
        self.write_text("summary.json", " " * ROOM_BYTES)

    def line_sinks(self) -> list[LineSink]:
        """New sinks for the results that get a line for every frame.

        Raises:
            OSError: If one cannot be written; the message names the path.
        """
        return [LineSink(self.partial(name), to_line) for name, to_line in LINES.items()]

    def make_parts(self) -> Path:
        """A new folder for the `part_sinks` of sequences that are run apart; `publish` and `discard` remove it."""
        self._parts = self.path / PARTS.replace("*", uuid.uuid4().hex)
        with naming(self._parts):
            self._parts.mkdir()
        return self._parts

    def join_parts(self, parts: Path, names: Sequence[str]) -> None:
        """Joins the files of the parts with these names, in this order, into the results that `line_sinks` would write.

        Raises:
            OSError: If that fails; the message names the path.
        """
        for result in LINES:
            path = self.partial(result)
            with naming(path), path.open("wb") as whole:
                for name in names:
                    with (parts / f"{name}.{result}").open("rb") as file:
                        shutil.copyfileobj(file, whole)

    def publish(self, config: PipelineConfig, summary: Summary) -> Summary:
        """Writes configuration and summary, and gives all results their final names, `summary.json` last.

        Returns:
            The summary that was written, which knows the frames.

        Raises:
            OSError: If that fails, or a result was removed while it was written; the message names the path.
        """
        self._lock.check()
        for name in LINES:
            if name in self._partials and not self._partials[name].exists():
                raise FileNotFoundError(f"{self.path / name}: expected what was written so far, it was removed")
        summary = summary.with_frames(file_digest(self.partial("frames.jsonl")))
        self.write_text("summary.json", json_text(summary, indent=2))  # in the room that may have been kept for both
        self.write_text("config.toml", config_to_toml(config))
        for parts in self.path.glob(PARTS):  # of this run, and of runs that were killed
            shutil.rmtree(parts, ignore_errors=True)
        with undisturbed():
            (self.path / RESULT_NAMES[-1]).unlink(missing_ok=True)
            for name in RESULT_NAMES:
                partial = self._partials.get(name)
                if partial is not None and partial.exists():
                    partial.replace(self.path / name)
                else:
                    (self.path / name).unlink(missing_ok=True)
            self._partials.clear()
        self._lock.release()
        return summary

    def discard(self) -> None:
        """Removes what was written, and the folders made for it if nothing else is in them."""
        for partial in self._partials.values():
            with contextlib.suppress(OSError):
                (self._home / partial.name).unlink(missing_ok=True)
        self._partials.clear()
        if self._parts is not None:
            shutil.rmtree(self._home / self._parts.name, ignore_errors=True)
        self._lock.release()


def part_sinks(parts: Path, name: str) -> list[LineSink]:
    """As `OutputFolder.line_sinks`, but for the part of a run called `name`, into the folder for parts."""
    return [LineSink(parts / f"{name}.{result}", to_line) for result, to_line in LINES.items()]
