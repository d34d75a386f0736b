"""Frames worth labelling: doubtful, restless, unlike; spread over drives and over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.lab.learning import suggestion
from foreglow.lab.learning.suggestion import (
    Suggestion,
    rated,
    read_suggestions,
    suggested,
    suggestions_text,
    unlikeness,
    write_suggestions,
)
from foreglow.runs.recorded_run import read_run
from foreglow.types import Frame
from tests.runs.test_recorded_run import write_run
from tests.stand_ins import night_image, result_of

BOX = [10, 10, 20, 20]


def run_of(folder: Path, scores: dict[str, list[list[float]]]) -> Path:
    """A run whose frames have boxes, far from each other, with these scores."""
    made, number = [], 0
    for sequence, drive in scores.items():
        for of_frame in drive:
            frame = Frame(night_image(), 50_000_000 * number, number, sequence)
            boxes = [[x + 60 * k for x in BOX] for k in range(len(of_frame))]
            made.append((frame, result_of(frame, boxes, of_frame)))
            number += 1
    return write_run(folder, made)


def test_doubt_and_restlessness_are_rated(tmp_path: Path) -> None:
    run = read_run(run_of(tmp_path, {"S1": [[0.99], [0.5], [0.99], [0.99], [0.01], [0.99], [0.99, 0.9], [0.99]]}))
    (drive,) = rated(run)
    assert np.argmax([each.uncertain for each in drive]) == 1
    assert drive[1].uncertain == 0.5, "one box of which nothing is known"
    assert [each.restless for each in drive] == [0, 0.5, 0, 0, 0.5, 0, 0.5, 0], "gone, gone, there alone"
    assert max(drive, key=lambda each: each.value) == drive[1]


def test_a_run_without_a_model_rates_nothing(tmp_path: Path) -> None:
    frame = Frame(night_image(), 0, 0, "S1")
    run = read_run(write_run(tmp_path, [(frame, result_of(frame, [BOX]))]))
    with pytest.raises(ValueError, match="scores: expected those of a model, the run had none"):
        rated(run)


def drive_of(name: str, values: list[float]) -> list[Suggestion]:
    return [Suggestion(name, index, value, 0.0, 0.0) for index, value in enumerate(values)]


def test_drives_take_turns_and_moments_keep_apart() -> None:
    restless = drive_of("a", [0.9] * 100)
    quiet = drive_of("b", [0.1] * 50 + [0.2] * 50)
    chosen = suggested([restless, quiet], 10)
    assert [len(drive) for drive in chosen] == [5, 5]
    for drive in chosen:
        frames = [each.frame for each in drive]
        assert frames == sorted(frames)
        assert np.diff(frames).min() >= 5
    assert sum(each.frame >= 50 for each in chosen[1]) >= 4, "its better half"


@pytest.mark.parametrize(("num_frames", "gap"), [(60, 1), (40, 2), (20, 3), (119, 1)])
def test_frames_of_one_moment_are_not_all_named(num_frames: int, gap: int) -> None:
    """Of 60 frames that are as good, the first 20 were named: they show the same."""
    values = [0.9] * 60 + [0.5] * 60
    (chosen,) = suggested([drive_of("a", values)], num_frames)
    frames = [each.frame for each in chosen]
    assert len(frames) == num_frames, "no fewer than are wanted"
    assert np.diff(frames).min() >= gap


def test_no_more_are_named_than_there_are() -> None:
    assert suggested([drive_of("a", [0.1, 0.2]), drive_of("b", [0.3])], 9) == [
        drive_of("a", [0.1, 0.2]), drive_of("b", [0.3]),
    ]  # fmt: skip
    assert suggested([], 9) == []


def test_strange_images_are_unlike(tmp_path: Path) -> None:
    import cv2

    folder = tmp_path / "images"
    folder.mkdir()
    strange = np.random.default_rng(0).integers(0, 256, (96, 128)).astype(np.uint8)
    for number in range(3):
        assert cv2.imwrite(str(folder / f"{number}.png"), strange)
    run = read_run(run_of(tmp_path / "run", {"": [[0.9]] * 3}))
    with pytest.raises(FileNotFoundError):
        unlikeness(run)
    summary = tmp_path / "run/summary.json"
    summary.write_text(summary.read_text().replace('"images"', f'"{folder}"'))
    unlike = unlikeness(read_run(tmp_path / "run"))
    assert unlike.keys() == {0, 1, 2}
    assert min(unlike.values()) > 0.5
    (drive,), (before,) = rated(run, unlike), rated(run)
    assert drive[0].value > before[0].value


def test_a_drive_is_not_taken_for_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its first frames had what the last look at the drive before had found."""
    strange = np.random.default_rng(0).integers(0, 256, (96, 128)).astype(np.uint8)
    images = {"S1": strange, "S2": np.zeros((96, 128), np.uint8)}
    frames = [Frame(images[f"S{1 + number // 3}"], number, number, f"S{1 + number // 3}") for number in range(6)]
    monkeypatch.setattr(suggestion, "open_run", lambda _: frames)
    monkeypatch.setattr(suggestion, "nearest_profile", lambda look: ("", 9.0 * (look[4] > -10)))  # some is bright
    unlike = unlikeness(read_run(run_of(tmp_path, {"S1": [[0.9]] * 3, "S2": [[0.9]] * 3})))
    assert [unlike[number] for number in range(6)] == [1, 1, 1, 0, 0, 0]


def test_frames_of_another_sequence_are_others(tmp_path: Path) -> None:
    path = tmp_path / "suggestions.csv"
    path.write_text(suggestions_text(drive_of("a, b", [0.25, 0.5])))
    assert read_suggestions(path, {0: "a, b", 1: "a, b", 2: "c"}) == {0, 1}
    for sequences, said in (
        ({0: "a, b", 1: "c"}, "expected 'c' as of frame 1"),
        ({0: ""}, "expected none as of frame 0"),
    ):
        with pytest.raises(ValueError, match=rf"line {2 + max(sequences)}: sequence: {said}, got 'a, b'"):
            read_suggestions(path, sequences)
    path.write_text(suggestions_text(drive_of("", [0.25, 0.5])))
    assert read_suggestions(path, {0: "S1", 1: "S1"}) == {0, 1}, "of a video whose frames are a set by now"
    path.write_text("frame,sequence\n1,\n")
    assert read_suggestions(path, {1: "S1"}) == {1}, "as a person may write it"


def test_the_file_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "suggestions.csv"
    write_suggestions({path: suggestions_text(drive_of("a, b", [0.25, 0.5]))})
    assert read_suggestions(path) == {0, 1}
    for content, said in (
        ("", "line 1: expected a column called frame"),
        ("name\n3\n", "line 1: expected a column called frame"),
        ("frame,sequence\n", "line 2: expected at least one frame, got none"),
        ("frame\nseven\n", "line 2: frame: expected a number, got 'seven'"),
        ("x,frame\n1\n", "line 2: frame: expected a number"),
        ("frame\n1,S1\n", "line 2: expected 1 cells, as in line 1, got 2"),
        ("frame,sequence\n1,S1\n2\n", "line 3: expected 2 cells, as in line 1, got 1"),
        ("frame\n-1\n", "line 2: frame: expected a number"),
        ("frame,frame\n1,2\n", "line 1: expected one column called frame, got 2"),
        ("sequence,frame,sequence\n1,2,3\n", "line 1: expected one column called sequence, got 2"),
        ("frame\r1\r", "expected a CSV file, got a carriage return within a line$"),
    ):
        path.write_bytes(content.encode())
        with pytest.raises(ValueError, match=said) as caught:
            read_suggestions(path)
        assert str(caught.value).startswith(str(path))
