"""An off-line run: what it writes, and what it leaves when it fails or is interrupted."""

from __future__ import annotations

import dataclasses
import errno
import json
import re
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from foreglow.config import preset, read_config
from foreglow.files import json_text
from foreglow.models import BUNDLED, SHA256, model_path
from foreglow.parallel import Local
from foreglow.pipeline import Pipeline, Stages
from foreglow.runs.tally import Tally
from foreglow.runtime import Opening, OutputFolder, RunSummary, run, run_apart
from foreglow.types import Frame, FrameResult
from tests.linux import needs_full_disk
from tests.stand_ins import REFERENCE, ListSource, night_frames


class Recorder:
    """A sink that notes what is done to it, and fails where it is told to."""

    def __init__(self, failing: str = "") -> None:
        self.calls: list[str] = []
        self._failing = failing

    def write(self, frame: Frame, result: FrameResult) -> None:
        assert frame.frame == result.frame
        self._note("write")

    def close(self) -> None:
        self._note("close")

    def discard(self) -> None:
        self._note("discard")

    def _note(self, name: str) -> None:
        self.calls.append(name)
        if name == self._failing:
            raise OSError(errno.ENOSPC, "No space left on device", "picture")


def run_into(
    path: Path, source: ListSource, sinks: list[Recorder] | None = None, limit: int | None = None
) -> RunSummary:
    return run(source, Pipeline(REFERENCE), OutputFolder(path), sinks=sinks or [], limit=limit, source_name="here")


def records(path: Path, name: str = "frames.jsonl") -> list[dict[str, Any]]:
    return [json.loads(line) for line in (path / name).read_text().splitlines()]


def names(path: Path) -> set[str]:
    return {entry.name for entry in path.iterdir()}


def a_model(path: Path) -> Path:
    path.write_bytes(model_path(Path(BUNDLED)).read_bytes())
    return path


def test_the_summary_knows_the_model_that_was_opened(tmp_path: Path) -> None:
    """A training may put another one in its place before the run ends."""
    model = a_model(tmp_path / "mine.onnx")

    class Replacing(ListSource):
        def __iter__(self) -> Iterator[Frame]:
            for frame in super().__iter__():
                yield frame
                model.write_bytes(b"another")

    source = Replacing(night_frames(2))
    pipeline = Pipeline(preset("foreglow").changed("classifier", model=model))
    assert run(source, pipeline, OutputFolder(tmp_path / "out"), source_name="here").model_sha256 == SHA256


def test_no_worker_opens_another_model(tmp_path: Path) -> None:
    """Those that begin late would score their sequences by another model than the first ones."""
    model = a_model(tmp_path / "mine.onnx")

    def opened() -> ListSource:
        model.write_bytes(content.replace(b"foreglow", b"foreglov", 1))  # the producer's name: it is still a model
        return ListSource(night_frames(2))

    content = model.read_bytes()
    config = preset("foreglow").changed("classifier", model=model)
    with pytest.raises(ValueError, match=f"^{re.escape(str(model))}: expected the model that the run was begun with"):
        run_apart(Opening(opened, ()), config, OutputFolder(tmp_path / "out"), Local(), source_name="here")
    assert model.read_bytes() != content
    assert not (tmp_path / "out" / "frames.jsonl").exists()


@dataclass(frozen=True)
class _Options:
    calibration: Path
    poses: Path | None = None


@pytest.mark.parametrize("is_gone", [False, True])
def test_no_worker_reads_another_file_beside_the_source(tmp_path: Path, is_gone: bool) -> None:
    """Calibration, logs and maps: sequences of one run would have been seen with different ones."""
    file, num_opened = tmp_path / "camera.toml", count(1)
    file.write_text("one")

    def opened(_: _Options) -> ListSource:
        if next(num_opened) == 2 and is_gone:
            file.unlink()
        elif not is_gone:
            file.write_text("two")
        return ListSource(night_frames(2))

    opening, out = Opening(opened, (_Options(file),)), tmp_path / "out"
    with pytest.raises(ValueError, match=f"^{re.escape(str(file))}: expected the file that the run was begun with"):
        run_apart(opening, preset("paper"), OutputFolder(out), Local(), source_name="here")
    assert not (out / "frames.jsonl").exists()


def test_writes_one_line_a_frame(tmp_path: Path) -> None:
    frames = night_frames(4)
    run_into(tmp_path, ListSource(frames))
    lines = records(tmp_path)
    assert [line["frame"] for line in lines] == [0, 2, 4, 6]
    assert [line["timestamp_ns"] for line in lines] == [0, 50_000_000, 100_000_000, 150_000_000]
    assert {line["sequence"] for line in lines} == {"S00001"}
    for line, frame in zip(lines, frames, strict=True):
        assert list(line) == [
            "frame", "sequence", "timestamp_ns", "proposals_xyxy_px", "scores", "direct", "detections_xyxy_px",
            "ranges_m", "range_sigmas_m", "tracks", "beam",
        ]  # fmt: skip
        assert line["proposals_xyxy_px"] == Pipeline(REFERENCE).step(frame).proposals.boxes_xyxy_px.tolist()
        assert line["scores"] is None
        assert line["detections_xyxy_px"] is None
    times = records(tmp_path, "times.jsonl")
    assert [list(line) for line in times] == [["frame", "sequence", "timestamp_ns", "stage_ms"]] * 4
    for line, time in zip(lines, times, strict=True):
        assert all(line[name] == time[name] for name in ("frame", "sequence", "timestamp_ns"))
        assert set(time["stage_ms"]) == {"proposals"}


def test_summary_counts_and_says_on_what(tmp_path: Path) -> None:
    returned = run_into(tmp_path, ListSource(night_frames(3), ["a.png: expected an image"]))
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary == json.loads(json_text(returned))
    lines = records(tmp_path)
    assert summary["source"] == "here"
    assert summary["num_frames"] == 3
    assert summary["num_proposals"] == sum(len(line["proposals_xyxy_px"]) for line in lines)
    assert (summary["num_scored"], summary["num_accepted"]) == (None, None)
    assert (summary["is_complete"], summary["is_classified"]) == (True, False)
    assert (summary["num_skipped"], summary["skipped"]) == (1, ["a.png: expected an image"])
    assert summary["frame_sizes_px"] == [[128, 96]]
    assert set(summary["run_time_ms"]) == {"proposals", "total"}
    assert all(0 < time["median"] <= time["p95"] <= time["p99"] for time in summary["run_time_ms"].values())
    assert summary["dispatch"] is None
    assert summary["processor"]
    assert summary["version"]


def test_configuration_is_written_and_reads_back_equal(tmp_path: Path) -> None:
    run_into(tmp_path, ListSource(night_frames(1)))
    assert read_config(tmp_path / "config.toml") == REFERENCE


def test_results_are_the_same_twice_but_for_run_times(tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        run_into(tmp_path / name, ListSource(night_frames(3)))
        contents.append((tmp_path / name / "frames.jsonl").read_bytes())
    assert contents[0] == contents[1]


@pytest.mark.parametrize(("limit", "expected"), [(None, 5), (2, 2), (9, 5)])
def test_limit(tmp_path: Path, limit: int | None, expected: int) -> None:
    summary = run_into(tmp_path, ListSource(night_frames(5)), limit=limit)
    assert (summary.num_frames, summary.is_complete) == (expected, True)


def test_pipeline_is_reset_at_the_start_of_each_sequence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resets: list[Stages] = []
    monkeypatch.setattr(Stages, "reset", lambda stages: resets.append(stages))
    frames = night_frames(2, "S00001") + night_frames(3, "S00002")
    run_into(tmp_path, ListSource(frames))
    assert len(resets) == 2


def test_no_frames_give_a_valid_empty_result(tmp_path: Path) -> None:
    run_into(tmp_path, ListSource([]))
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["num_frames"] == 0
    assert summary["run_time_ms"] == {"total": {"median": None, "p95": None, "p99": None}}
    assert records(tmp_path) == []


def test_sinks_get_every_frame_and_are_closed_once(tmp_path: Path) -> None:
    sink = Recorder()
    run_into(tmp_path, ListSource(night_frames(2)), [sink])
    assert sink.calls == ["write", "write", "close"]


@pytest.mark.parametrize("failing", ["write", "close"])
def test_failing_sink_leaves_nothing_of_a_new_folder(tmp_path: Path, failing: str) -> None:
    sink = Recorder(failing)
    with pytest.raises(OSError, match="No space left"):
        run_into(tmp_path / "new" / "deep", ListSource(night_frames(2)), [sink])
    assert sink.calls[-1] == "discard"
    assert names(tmp_path) == set()


def test_failure_leaves_an_older_result_untouched(tmp_path: Path) -> None:
    run_into(tmp_path, ListSource(night_frames(2)))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(OSError, match="No space left"):
        run_into(tmp_path, ListSource(night_frames(3)), [Recorder("write")])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_unreadable_frame_leaves_nothing(tmp_path: Path) -> None:
    class Broken(ListSource):
        def __iter__(self) -> Iterator[Frame]:
            yield from night_frames(2)
            raise ValueError("c.png: expected an image")

    with pytest.raises(ValueError, match=r"c\.png"):
        run_into(tmp_path / "out", Broken([]))
    assert names(tmp_path) == set()


@needs_full_disk
def test_full_disk_names_the_file(tmp_path: Path) -> None:
    folder = OutputFolder(tmp_path / "out")
    folder.partial("frames.jsonl").unlink()
    folder.partial("frames.jsonl").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        run(ListSource(night_frames(2)), Pipeline(REFERENCE), folder)
    assert str(caught.value.filename).endswith("frames.jsonl.partial")
    assert names(tmp_path) == set()


class Interrupting(ListSource):
    """Presses Ctrl-C `presses` times before the third frame."""

    presses = 1

    def __iter__(self) -> Iterator[Frame]:
        for index, frame in enumerate(night_frames(6)):
            if index == 2:
                for _ in range(self.presses):
                    signal.raise_signal(signal.SIGINT)
            yield frame


def test_interrupt_keeps_what_was_done(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    sink = Recorder()
    summary = run_into(tmp_path, Interrupting([]), [sink])
    assert not summary.is_complete
    assert json.loads((tmp_path / "summary.json").read_text())["is_complete"] is False
    assert [line["frame"] for line in records(tmp_path)] == [0, 2, 4]
    assert sink.calls == ["write"] * 3 + ["close"]
    assert names(tmp_path) == {"frames.jsonl", "times.jsonl", "summary.json", "config.toml"}
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("moment", ["the summary is made", "results are replaced"])
def test_an_interrupt_after_the_last_frame_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """A run that had all its frames was discarded, or its results were left without a summary."""
    run_into(tmp_path, ListSource(night_frames(2)))
    with monkeypatch.context() as patch:
        place: Any = Tally if moment == "the summary is made" else Path
        name = "summary" if moment == "the summary is made" else "replace"
        really = getattr(place, name)

        def interrupted(*given: Any, **named: Any) -> Any:
            done = really(*given, **named)
            patch.setattr(place, name, really)
            signal.raise_signal(signal.SIGINT)
            return done

        patch.setattr(place, name, interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_into(tmp_path, ListSource(night_frames(3)))
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["num_frames"], summary["is_complete"]) == (3, True)
    assert names(tmp_path) == {"frames.jsonl", "times.jsonl", "summary.json", "config.toml"}
    assert len(records(tmp_path)) == 3


def test_second_interrupt_stops_at_once_and_leaves_nothing(tmp_path: Path) -> None:
    source = Interrupting([])
    source.presses = 2
    with pytest.raises(KeyboardInterrupt):
        run_into(tmp_path / "out", source)
    assert names(tmp_path) == set()


def test_a_number_that_comes_twice_ends_a_run(tmp_path: Path) -> None:
    """As of frames without numbers, whose results no command could read."""
    frames = [dataclasses.replace(frame, frame=0) for frame in night_frames(3)]
    with pytest.raises(ValueError, match="frame: expected another number than that of the frame before, got 0 again"):
        run(ListSource(frames), Pipeline(REFERENCE), OutputFolder(tmp_path / "out"))
    assert not list((tmp_path / "out").glob("*"))
