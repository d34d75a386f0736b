"""A run that is read back from its folder is what was written."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from foreglow.runs.folder import OutputFolder
from foreglow.runs.frame_line import FrameLine
from foreglow.runs.frames_file import frame_to_line, read_gaps, read_results, read_tracks
from foreglow.runs.origin import origin_digest
from foreglow.runs.predictions import read_predictions
from foreglow.runs.recorded_run import doubt_about_source, read_run, source_of_run
from foreglow.runs.summary_file import read_summary
from foreglow.runs.tally import Tally
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, TrackState
from tests.stand_ins import REFERENCE, night_image, result_of, tracks_of

RUN_OF_0_1_0 = Path(__file__).parent / "run_of_0_1_0"


def write_run(path: Path, made: list[tuple[Frame, FrameResult]], **changes: object) -> Path:
    """Writes a folder as a run does, but for changes in its summary."""
    tally = Tally()
    with OutputFolder(path) as folder:
        for sink in folder.line_sinks():
            for frame, result in made:
                sink.write(frame, result)
            sink.close()
        for frame, result in made:
            tally.add(frame, result)
        folder.publish(REFERENCE, tally.summary("images", [], REFERENCE, is_complete=True, dispatch=None))
    summary = path / "summary.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | changes))
    return path


def made_up(number: int, sequence: str = "S00001", faults: tuple[str, ...] = ()) -> tuple[Frame, FrameResult]:
    frame = Frame(night_image(), 50_000_000 * number, number, sequence)
    tracks = tracks_of([(10, 10, 20, 20)], [TrackState.CONFIRMED], ranges_m=[50.0 - number])
    gaps = np.zeros((0, 2)) if faults else np.radians([[-2.0, 3.0]])
    levels = np.full((2, 84), 0.0 if faults else 0.5)
    mode = BeamMode.LOW if faults else BeamMode.GLARE_FREE
    beam = BeamCommand(frame.timestamp_ns, mode, levels, gaps, np.full(len(gaps), 40.0), faults)
    plain = result_of(frame, [(10, 10, 20, 20), (30, 10, 40, 20)], [0.75, 0.25])
    return frame, dataclasses.replace(plain, tracks=tracks, beam=beam)


def test_everything_comes_back(tmp_path: Path) -> None:
    made = [made_up(1, "A"), made_up(2, "A", ("camera_dark",)), made_up(3, "B")]
    run = read_run(write_run(tmp_path / "run", made))
    sequences = {name: [result.frame for result in results] for name, results in run.sequences.items()}
    assert sequences == {"A": [1, 2], "B": [3]}
    found = [result for results in run.sequences.values() for result in results]
    for (frame, written), result in zip(made, found, strict=True):
        assert frame_to_line(frame, result) == frame_to_line(frame, written)
        assert result.stage_ms == written.stage_ms
    assert run.config == REFERENCE
    assert (run.summary.source, run.summary.num_frames, run.summary.live) == ("images", 3, None)


def test_a_table_never_lies_over_the_run(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [made_up(1, "A")])
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    for write in (read_run(folder).write_coco, read_run(folder).write_parquet):
        for name in ("frames.jsonl", "../run/summary.json"):
            with pytest.raises(ValueError, match=r"expected a file that does not overwrite a part of .*run$"):
                write(folder / name)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_run_without_tracks_and_beam(tmp_path: Path) -> None:
    frame = Frame(night_image(), 0, 5)
    run = read_run(write_run(tmp_path, [(frame, result_of(frame, [(1, 2, 3, 4)]))]))
    ((result,),) = run.sequences.values()
    assert (result.detections, result.tracks, result.beam) == (None, None, None)
    assert result.stage_ms == {"proposals": 0.25}


def test_what_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"frames\.jsonl: no such file, expected the folder of a run"):
        read_run(tmp_path)
    write_run(tmp_path, [made_up(1)])
    text = (tmp_path / "frames.jsonl").read_text()
    (tmp_path / "frames.jsonl").write_text(text.replace('"glare_free"', '"bright"'))
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 1: beam\.mode"):
        read_run(tmp_path)
    (tmp_path / "frames.jsonl").write_text(text.replace("[500,", "[", 1))
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 1"):
        read_run(tmp_path)
    (tmp_path / "summary.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"summary\.json"):
        read_run(tmp_path)


def test_where_a_run_had_its_frames(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"summary\.json: no such file"):
        source_of_run(tmp_path)
    assert source_of_run(write_run(tmp_path, [], source=str(tmp_path))) == tmp_path
    with pytest.raises(FileNotFoundError, match=r"source: expected the run's frames, there is nothing at /nowhere"):
        source_of_run(write_run(tmp_path, [], source="/nowhere/at/all"))
    with pytest.raises(ValueError, match=r"summary\.json: source: expected a valid string"):
        source_of_run(write_run(tmp_path, [], source=3))


def test_another_file_where_a_run_had_its_frames(tmp_path: Path) -> None:
    source = tmp_path / "night.raw"
    source.write_bytes(b"first")
    run = write_run(tmp_path / "run", [], source=str(source), source_digest=origin_digest(source))
    assert source_of_run(run) == source
    moved = source.rename(tmp_path / "moved.raw")
    source.write_bytes(b"other")
    with pytest.raises(ValueError, match=r"summary\.json: source: .*night\.raw, what is there is not what the run was"):
        source_of_run(run)
    assert doubt_about_source(run, moved) is None
    with pytest.raises(ValueError, match=r"^.*night\.raw: expected what .*run was made from"):
        doubt_about_source(run, source)


def test_doubt_about_a_source_that_nothing_tells_apart(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", [], source="/elsewhere/night.avi")
    assert doubt_about_source(run, tmp_path / "night.avi") is None
    words = f"{tmp_path / 'day.avi'}: taken for what {run} was made from, which was /elsewhere/night.avi"
    assert doubt_about_source(run, tmp_path / "day.avi") == words
    labels = tmp_path / "labels.xml"
    labels.write_text("<annotations/>")
    assert doubt_about_source(write_run(tmp_path / "own", [], source=str(labels)), labels) is None
    other = write_run(tmp_path / "other", [], source="/elsewhere/labels.xml")
    assert f"{labels}: taken for what {other} was made from" in str(doubt_about_source(other, labels))


def test_a_run_of_version_0_1_0() -> None:
    """Folders of earlier versions stay readable: this one of `foreglow live` was shortened to three frames."""
    run = read_run(RUN_OF_0_1_0)
    assert (run.summary.version, run.summary.dispatch) == ("0.1.0", "avx512")
    assert run.summary.live is not None
    assert run.summary.live.faults[0].fault == "camera_slow"
    (results,) = run.sequences.values()
    lines = (RUN_OF_0_1_0 / "frames.jsonl").read_text().splitlines()
    for result, line in zip(results, lines, strict=True):
        frame = Frame(night_image(), result.timestamp_ns, result.frame, "S00001")
        assert json.dumps(frame_to_line(frame, result), separators=(",", ":")) == line
        assert "capture" in result.stage_ms
    modes = {result.beam.mode for result in results if result.beam is not None}
    assert modes == {BeamMode.FULL, BeamMode.GLARE_FREE}


def test_frames_that_were_not_copied_are_missed(tmp_path: Path) -> None:
    frames = write_run(tmp_path / "run", [made_up(1), made_up(2)], frames_sha256=None) / "frames.jsonl"
    frames.write_text(frames.read_text().partition("\n")[0] + "\n")
    with pytest.raises(ValueError, match=r"frames\.jsonl: expected the 2 frames of summary\.json, got 1"):
        read_run(tmp_path / "run")


def test_frames_of_another_run_are_told(tmp_path: Path) -> None:
    """As long as the run itself, with the summary of the other one, which an earlier version wrote."""
    frame, fewer = made_up(2)
    detections = result_of(frame, [(10, 10, 20, 20), (30, 10, 40, 20)], [0.25, 0.125]).detections
    others = {
        "3 proposals": (frame, dataclasses.replace(result_of(frame, [(1, 2, 3, 4)], [0.75]), beam=fewer.beam)),
        "1 accepted boxes": (frame, dataclasses.replace(fewer, detections=detections)),
        "1 frames with low beam": made_up(2, faults=("camera_dark",)),
    }
    run = write_run(tmp_path / "run", [made_up(1), made_up(2)])
    for name, other in others.items():
        num_accepted = 1 if name == "1 accepted boxes" else 2
        changes = {"num_accepted": num_accepted, "frames_sha256": None}
        shutil.copy(write_run(tmp_path / name, [made_up(1), other], **changes) / "summary.json", run)
        with pytest.raises(ValueError, match=rf"run/frames\.jsonl: expected the {name} of summary\.json, got \d$"):
            read_run(run)


@pytest.mark.parametrize(
    ("field", "value"),
    [("frame", 2**63), ("frame", -(10**30)), ("timestamp_ns", 10**400), ("tracks", 2**70)],
)
def test_numbers_of_more_than_64_bits(field: str, value: int, tmp_path: Path) -> None:
    """Neither arrays nor tables hold them."""
    for path in RUN_OF_0_1_0.iterdir():
        shutil.copy(path, tmp_path)
    lines = [json.loads(line) for line in (tmp_path / "frames.jsonl").read_text().splitlines()]
    if field == "tracks":
        next(line for line in lines if line["tracks"])["tracks"][0]["id"] = value
    else:
        lines[1][field] = value
    (tmp_path / "frames.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    with pytest.raises(ValueError, match=rf"frames\.jsonl: line \d+: .*{'id' if field == 'tracks' else field}"):
        read_run(tmp_path)


@pytest.mark.parametrize("source", ["a\0b", "x" * 5000, "loop"])
def test_a_source_that_is_no_path(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    summary = json.loads((RUN_OF_0_1_0 / "summary.json").read_text())
    Path("summary.json").write_text(json.dumps(summary | {"source": source}))
    with pytest.raises(FileNotFoundError, match=r"^summary\.json: source: expected the run's frames"):
        source_of_run(Path())


def test_a_table_never_lies_over_what_the_run_was_made_from(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    (images / "1.jpg").write_bytes(b"an image")
    (images / "labels.json").write_text("[]")
    (tmp_path / "notes.txt").write_text("notes")
    folder = write_run(tmp_path / "run", [made_up(1, "A")])
    summary = folder / "summary.json"
    summary.write_text(json.dumps(json.loads(summary.read_text()) | {"source": str(images)}))
    run = read_run(folder)
    assert run.summary.source == str(images)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for write in (run.write_coco, run.write_parquet):
        for name in ("1.jpg", "labels.json"):
            with pytest.raises(ValueError, match="does not overwrite a part of the source of the run"):
                write(images / name)
        with pytest.raises(ValueError, match=r"notes\.txt: expected a file whose name ends with"):
            write(tmp_path / "notes.txt")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


READERS: dict[str, Callable[[Path], object]] = {
    "read_run": lambda path: read_run(path.parent),
    "read_results": lambda path: read_results(path, 0.5),
    "read_predictions": read_predictions,
    "read_tracks": read_tracks,
    "read_gaps": read_gaps,
}


@pytest.mark.parametrize("name", READERS)
def test_an_edited_threshold_is_told_whatever_reads_the_run(tmp_path: Path, name: str) -> None:
    folder = write_run(tmp_path / "run", [made_up(1), made_up(2)])
    READERS[name](folder / "frames.jsonl")
    config = folder / "config.toml"
    config.write_text(config.read_text().replace("score_threshold = 0.5", "score_threshold = 0.2"))
    expected = r"frames\.jsonl: line 1: detections_xyxy_px: expected the 2 boxes with scores above 0\.2, .*, got 1"
    with pytest.raises(ValueError, match=expected):
        READERS[name](folder / "frames.jsonl")


def renumbered(lines: list[FrameLine]) -> None:
    for line in lines:
        line["frame"] += 1


def with_exchanged_ids(lines: list[FrameLine]) -> None:
    lines[0]["frame"], lines[1]["frame"] = lines[1]["frame"], lines[0]["frame"]


def with_exchanged_times(lines: list[FrameLine]) -> None:
    lines[0]["timestamp_ns"], lines[1]["timestamp_ns"] = lines[1]["timestamp_ns"], lines[0]["timestamp_ns"]


def of_another_sequence(lines: list[FrameLine]) -> None:
    lines[1]["sequence"] = "S00002"


def without_tracks(lines: list[FrameLine]) -> None:
    lines[1]["tracks"] = []


def swapped(lines: list[FrameLine]) -> None:
    lines.reverse()


def with_another_frame(lines: list[FrameLine]) -> None:
    lines.append(lines[-1].copy())
    lines[-1]["frame"] = 77


def without_the_last(lines: list[FrameLine]) -> None:
    lines.pop()


EDITS: tuple[Callable[[list[FrameLine]], None], ...] = (
    renumbered,
    with_exchanged_ids,
    with_exchanged_times,
    of_another_sequence,
    without_tracks,
    swapped,
    with_another_frame,
    without_the_last,
)


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("name", READERS)
def test_edited_frames_are_told_whatever_reads_the_run(
    tmp_path: Path, name: str, edit: Callable[[list[FrameLine]], None]
) -> None:
    """Each edit leaves lines that are right by themselves: alone, without the summary, the file is taken as it is."""
    path = write_run(tmp_path / "run", [made_up(1), made_up(2)]) / "frames.jsonl"
    READERS[name](path)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    edit(lines)
    path.write_text("".join(f"{json.dumps(line, separators=(',', ':'))}\n" for line in lines))
    with pytest.raises(ValueError, match=r"run/frames\.jsonl: expected the frames that the run wrote, .*changed since"):
        READERS[name](path)
    if name != "read_run":
        (tmp_path / "alone").mkdir()
        READERS[name](Path(shutil.copy(path, tmp_path / "alone")))
        READERS[name](path.rename(path.with_name("copy.jsonl")))


def test_a_killed_run_is_told(tmp_path: Path) -> None:
    (tmp_path / "frames.jsonl.partial").touch()
    words = "expected the folder of a run; frames.jsonl.partial is of a run that was killed: run it again"
    with pytest.raises(FileNotFoundError, match=rf"^{tmp_path}/frames.jsonl: no such file, {words}$"):
        read_run(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"run it again$"):
        read_predictions(tmp_path / "frames.jsonl")
    with pytest.raises(FileNotFoundError, match=r"run it again$"):
        read_summary(tmp_path / "summary.json")
