"""What is written to `frames.jsonl`, and that it is read back as it was."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from foreglow.runs.frame_line import FrameLineModel
from foreglow.runs.frames_file import (
    beam_entry,
    frame_to_line,
    has_tracks,
    line_to_result,
    read_gaps,
    read_results,
    read_tracks,
)
from foreglow.runs.json_lines import LineSink, read_lines
from foreglow.runs.predictions import read_predictions
from foreglow.types import (
    BeamCommand,
    BeamMode,
    Detections,
    Frame,
    FrameResult,
    Proposals,
    Ranges,
    Tracks,
    TrackState,
    Vehicles,
)
from foreglow.types.kinds import kinds_of_direct
from tests.stand_ins import night_frames, night_image, result_of, tracks_of

BOXES = [[3.0, 4.0, 9.5, 8.25], [20.0, 21.0, 40.0, 33.0]]
STATES = [TrackState.TENTATIVE, TrackState.COASTING]


def write_run(path: Path, *followed: Tracks | None) -> Path:
    sink = LineSink(path, frame_to_line)
    for frame, tracks in zip(night_frames(len(followed)), followed, strict=True):
        result: FrameResult = result_of(frame, [[3, 4, 9, 8]], [0.5])
        sink.write(frame, dataclasses.replace(result, tracks=tracks))
    sink.close()
    return path


def test_tracks_come_back_as_they_were(tmp_path: Path) -> None:
    written = tracks_of(BOXES, STATES, ids=[3, 8], ranges_m=[np.nan, 81.5], detections=[0, -1])
    written = dataclasses.replace(written, light_kinds=kinds_of_direct(np.array([0.123456789, np.nan])))
    tracks = read_tracks(write_run(tmp_path / "frames.jsonl", written, tracks_of([])))
    assert list(tracks) == [0, 2]
    assert len(tracks[2]) == 0
    for field in dataclasses.fields(Tracks):
        np.testing.assert_array_equal(getattr(tracks[0], field.name), getattr(written, field.name))


def test_kinds_come_back_and_are_left_out_where_a_model_does_not_tell_them(tmp_path: Path) -> None:
    frame, path = night_frames(1)[0], tmp_path / "frames.jsonl"
    result, tracks = result_of(frame, [[3, 4, 9, 8], [20, 21, 40, 33]], [0.5, 0.1]), tracks_of(BOXES)
    assert result.detections is not None
    told = np.array([[0.1, 0.6, 0.1, 0.2], [math.nan] * 4])
    direct = kinds_of_direct(np.array([0.7, math.nan]))
    for kinds, is_written in ((told, True), (direct, False), (told * math.nan, False)):
        detections = dataclasses.replace(result.detections, light_kinds=kinds.astype(np.float32))
        followed = dataclasses.replace(tracks, light_kinds=kinds)
        written = dataclasses.replace(result, detections=detections, tracks=followed)
        path.write_text(json.dumps(frame_to_line(frame, written)) + "\n")
        assert ("light_kinds" in path.read_text()) == is_written
        found = read_results(path, 0.5)[0]
        assert found.detections is not None
        assert found.tracks is not None
        np.testing.assert_array_equal(found.detections.light_kinds, detections.light_kinds)
        np.testing.assert_array_equal(found.tracks.light_kinds, kinds)
        np.testing.assert_array_equal(read_tracks(path)[0].light_kinds, kinds)
    assert found.tracks is not None
    assert found.tracks.kind_names == (None, None)


def with_vehicles(tracks: Tracks) -> Tracks:
    """The same tracks, all of them of vehicle 5."""
    vehicles = Vehicles(
        ids=np.array([5]),
        states=np.array([int(TrackState.COASTING)]),
        confidences=np.array([0.25]),
        is_in_sight=np.array([True]),
        of_tracks=np.full(len(tracks), 5),
        leading=np.array([1]),
    )
    return dataclasses.replace(tracks, vehicles=vehicles)


def test_vehicles_come_back_and_are_left_out_without_any(tmp_path: Path) -> None:
    written = with_vehicles(tracks_of(BOXES, ids=[3, 8]))
    path = write_run(tmp_path / "frames.jsonl", written, tracks_of(BOXES))
    found = read_tracks(path)
    assert [tracks.vehicles is None for tracks in found.values()] == [False, True]
    for field in dataclasses.fields(Vehicles):
        np.testing.assert_array_equal(getattr(found[0].vehicles, field.name), getattr(written.vehicles, field.name))
    assert [line.count('"vehicles"') for line in path.read_text().splitlines()] == [1, 0]


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("[3,8]", "[3]", "vehicles: expected one that has track 8, found none"),
        ('"leading":8', '"leading":7', r"Vehicles\.leading: expected a track of each vehicle, got \[-1\]"),
    ],
)
def test_vehicles_that_contradict_the_tracks(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = write_run(tmp_path / "frames.jsonl", with_vehicles(tracks_of(BOXES, ids=[3, 8])))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=f"line 1: {complaint}"):
        read_tracks(path)


def test_a_run_without_a_tracker(tmp_path: Path) -> None:
    path = write_run(tmp_path / "frames.jsonl", None)
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 1: tracks: expected a list, got nothing"):
        read_tracks(path)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('"confidence":0.75', '"confidence":1.5', r"line 1: tracks\.0\.confidence"),
        ('"state":"confirmed"', '"state":"lost"', r"line 1: tracks\.0\.state: expected 'tentative'"),
        ("[3.0,4.0,9.5,8.25]", "[3.0,4.0,2.0,8.25]", r"line 1: Tracks\.boxes_xyxy_px: expected finite boxes"),
        ('"id":0', '"was":0', r"line 1: tracks\.0\.id: field is missing"),
    ],
)
def test_a_broken_line_names_itself(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = write_run(tmp_path / "frames.jsonl", tracks_of(BOXES))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=complaint):
        read_tracks(path)


@pytest.mark.parametrize("read", [read_tracks, lambda path: read_results(path, 0.5), read_gaps, read_predictions])
@pytest.mark.parametrize("has_kinds", [False, True])
@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("direct", [0.5, 0.5], "direct: expected 1, one a box, got 2"),
        ("direct", [], "direct: expected 1, one a box, got 0"),
        ("direct", [2.0], "direct.0: expected a number from 0 to 1, got 2.0"),
        ("direct", [-0.5], "direct.0: expected a number from 0 to 1, got -0.5"),
        ("direct", [math.nan], "direct.0: "),
        ("direct", ["x"], "direct.0: "),
        ("scores", [0.5, 0.5], "scores: expected 1, one a box, got 2"),
        ("scores", [1.5], "scores.0: expected a number from 0 to 1, got 1.5"),
        ("light_kinds", [], "light_kinds: expected 1, one a box, got 0"),
        ("ranges_m", [1.0, 2.0], "ranges_m: expected 1, one a box, got 2"),
        ("range_sigmas_m", [], "range_sigmas_m: expected 1, one a box, got 0"),
    ],
)
def test_every_reader_refuses_values_that_fit_no_box(
    tmp_path: Path, read: Any, has_kinds: bool, field: str, value: list[Any], complaint: str
) -> None:
    """`direct` was not looked at beside `light_kinds`."""
    path = write_run(tmp_path / "frames.jsonl", tracks_of(BOXES))
    line = json.loads(path.read_text())
    if has_kinds:
        line["light_kinds"] = [[0.25, 0.25, 0.25, 0.25]]
    path.write_text(json.dumps(line | {field: value}))
    with pytest.raises(ValueError, match=rf"frames\.jsonl: line 1: {complaint}"):
        read(path)


def test_each_frame_once(tmp_path: Path) -> None:
    path = write_run(tmp_path / "frames.jsonl", tracks_of([]))
    path.write_text(path.read_text() * 2)
    with pytest.raises(ValueError, match="line 2: frame: expected each frame once, 0 is there twice"):
        read_tracks(path)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"frames\.jsonl: no such file"):
        read_tracks(tmp_path / "frames.jsonl")


def test_whole_results_come_back(tmp_path: Path) -> None:
    frame = night_frames(1)[0]
    written = result_of(frame, [[3, 4, 9, 8], [20, 21, 40, 33]], [0.5, 0.1], threshold=0.3)
    detections = written.detections
    assert detections is not None
    ranges = Ranges(detections, np.array([33.25, np.nan]), np.array([np.inf, np.inf]))
    written = dataclasses.replace(written, ranges=ranges, tracks=tracks_of(BOXES, STATES))
    sink = LineSink(tmp_path / "frames.jsonl", frame_to_line)
    sink.write(frame, written)
    sink.close()
    found = read_results(tmp_path / "frames.jsonl", 0.3)[0]
    assert (found.frame, found.timestamp_ns) == (0, 0)
    assert found.proposals.boxes_xyxy_px.tolist() == written.proposals.boxes_xyxy_px.tolist()
    assert found.detections is not None
    assert found.detections.scores.tolist() == detections.scores.tolist()
    assert found.detections.is_accepted.tolist() == [True, False]
    assert found.ranges is not None
    np.testing.assert_array_equal(found.ranges.ranges_m, ranges.ranges_m)
    np.testing.assert_array_equal(found.ranges.sigmas_m, ranges.sigmas_m)
    assert found.tracks is not None
    assert found.tracks.states.tolist() == STATES


def test_results_with_a_broken_line(tmp_path: Path) -> None:
    path = write_run(tmp_path / "frames.jsonl", tracks_of([]))
    path.write_text(path.read_text().replace("[[3,4,9,8]]", "[[3,4,9,4]]", 1))
    with pytest.raises(ValueError, match=r"line 1: Proposals\.boxes_xyxy_px: box 0 is \[3, 4, 9, 4\]"):
        read_results(path, 0.5)


def test_gaps_come_back(tmp_path: Path) -> None:
    path, frames = tmp_path / "frames.jsonl", night_frames(3)
    gaps_rad = np.radians([[-3.0, -1.25], [0.5, 2.0]])
    commands = [
        BeamCommand(0, BeamMode.GLARE_FREE, np.ones((2, 3)), gaps_rad, np.array([np.nan, 80.0])),
        BeamCommand(0, BeamMode.FULL, np.ones((2, 3))),
        None,
    ]
    sink = LineSink(path, frame_to_line)
    for frame, command in zip(frames, commands, strict=True):
        sink.write(frame, dataclasses.replace(result_of(frame, []), beam=command))
    sink.close()
    found = read_gaps(path)
    assert list(found) == [0, 2]
    np.testing.assert_allclose(found[0], gaps_rad)
    assert found[2].shape == (0, 2)
    path.write_text(path.read_text().replace('"left_deg":2.0', '"left_deg":"far"', 1))
    with pytest.raises(ValueError, match=r"line 1: beam\.gaps\.1\.left_deg: expected a valid number"):
        read_gaps(path)
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_gaps(tmp_path / "absent.jsonl")


def test_gaps_in_degrees_and_levels_in_thousandths() -> None:
    levels = np.array([[0.0, 0.0004, 0.12345], [0.9996, 1.0, 0.5]])
    gaps_rad = np.radians([[-3.0, -1.25], [0.5, 2.0]])
    command = BeamCommand(5, BeamMode.GLARE_FREE, levels, gaps_rad, np.array([np.nan, 81.23456]))
    assert beam_entry(command) == {
        "mode": "glare_free",
        "gaps": [
            {"right_deg": -3.0, "left_deg": -1.25, "range_m": None},
            {"right_deg": 0.5, "left_deg": 2.0, "range_m": 81.235},
        ],
        "faults": [],
        "levels": [[0, 0, 123], [1000, 1000, 500]],
    }


def test_faults_are_named_and_a_frame_without_a_beam_has_none() -> None:
    frame = night_frames(1)[0]
    result = result_of(frame, [])
    assert frame_to_line(frame, result)["beam"] is None
    low = dataclasses.replace(result, beam=BeamCommand.low(0, 2, "too_slow", "no_camera"))
    entry = frame_to_line(frame, low)["beam"]
    assert entry is not None
    assert (entry["mode"], entry["faults"], entry["levels"]) == ("low", ["too_slow", "no_camera"], [[0, 0], [0, 0]])


def test_scores_are_exact_and_accepted_boxes_are_listed() -> None:
    frame = night_frames(1)[0]
    score = float(np.nextafter(np.float32(0.5), np.float32(1)))
    line = frame_to_line(frame, result_of(frame, [[0, 0, 4, 4], [8, 8, 12, 12]], [score, 0.5]))
    assert line["scores"] == [score, 0.5]
    assert line["detections_xyxy_px"] == [[0, 0, 4, 4]]


unit = st.floats(0, 1, width=32)
metres = st.floats(0.001, 1e6) | st.just(math.nan)


@st.composite
def results(draw: st.DrawFn) -> FrameResult:
    """Results with any of the stages, and the values that are hardest to write."""
    corners = draw(st.lists(st.tuples(*[st.integers(-50, 2000)] * 2), max_size=4))
    boxes = np.array([(x, y, x + draw(st.integers(1, 90)), y + 3) for x, y in corners], np.int32).reshape(-1, 4)
    num = len(boxes)

    def column(values: st.SearchStrategy[Any], dtype: type = np.float64, size: int = num) -> NDArray[Any]:
        return np.array(draw(st.lists(values, min_size=size, max_size=size)), dtype)

    made = FrameResult(draw(st.integers(0, 2**63 - 1)), draw(st.integers(0, 2**62)), Proposals(boxes), None)
    if not draw(st.booleans()):
        return made

    def kinds(dtype: type) -> NDArray[Any]:
        """As of a model with one, two or five outputs."""
        if draw(st.booleans()):
            return kinds_of_direct(column(unit | st.just(math.nan), dtype))
        rows = column(st.sampled_from([math.nan, 0.001, 1.0]), dtype)[:, None] * np.array([3, 0.1, 1, 7], dtype)
        return np.asarray(rows / rows.sum(axis=1, keepdims=True))

    detections = Detections(made.proposals, column(unit, np.float32), 0.5, kinds(np.float32))
    ranges_m = column(metres)
    ranges = Ranges(detections, ranges_m, np.where(np.isnan(ranges_m), np.inf, column(st.floats(0.001, 1e6))))
    track_ranges_m = column(metres)
    tracks = Tracks(
        ids=np.arange(num),
        states=column(st.sampled_from(TrackState), np.int64),
        boxes_xyxy_px=boxes + column(unit).reshape(-1, 1),
        confidences=column(unit),
        num_hits=column(st.integers(1, 9), np.int64),
        num_misses=column(st.integers(0, 9), np.int64),
        ages_s=column(st.floats(0, 1e6)),
        ranges_m=track_ranges_m,
        sigmas_m=np.where(np.isnan(track_ranges_m), np.inf, column(st.floats(0.001, 1e6))),
        detections=np.where(column(st.booleans(), np.bool_), np.arange(num), -1),
        light_kinds=kinds(np.float64),
    )
    gaps_rad = np.radians([[-3.0, -1.25], [0.5, 2.0]])[: draw(st.integers(0, 2))]
    levels = column(unit, size=6).reshape(2, 3)
    mode = BeamMode.GLARE_FREE if len(gaps_rad) else draw(st.sampled_from([BeamMode.GLARE_FREE, BeamMode.FULL]))
    beam = BeamCommand(
        made.timestamp_ns, mode, levels, gaps_rad, column(metres, size=len(gaps_rad)), ("a",) * draw(st.integers(0, 1))
    )
    return dataclasses.replace(
        made,
        detections=detections,
        ranges=draw(st.sampled_from([None, ranges])),
        tracks=draw(st.sampled_from([None, tracks])),
        beam=draw(st.sampled_from([None, beam])),
    )


@pytest.mark.slow
@settings(derandomize=True, max_examples=200)
@given(result=results())
def test_a_line_that_is_read_and_written_again_is_the_same(result: FrameResult) -> None:
    frame = Frame(night_image(), result.timestamp_ns, result.frame, "S00001")
    text = json.dumps(frame_to_line(frame, result), allow_nan=False)
    line = FrameLineModel.model_validate_json(text).root
    assert line == json.loads(text)
    assert json.dumps(frame_to_line(frame, line_to_result(line, 0.5))) == text


def test_lines_of_another_program(tmp_path: Path) -> None:
    path = tmp_path / "frames.jsonl"
    path.write_text('{"frame": 1, "proposals_xyxy_px": [[0.5, 0, 4, 4]], "note": "mine"}\n\n')
    assert read_predictions(path).boxes_xyxy_px[1].tolist() == [[0.5, 0.0, 4.0, 4.0]]
    assert not has_tracks(path)
    with pytest.raises(ValueError, match="line 1: timestamp_ns: field is missing"):
        read_lines(path, FrameLineModel, lambda line: line_to_result(line, 0.5))
    for edge in ("0.5", "1e12"):
        path.write_text(f'{{"frame": 1, "timestamp_ns": 0, "proposals_xyxy_px": [[{edge}, 0, 4, 4]]}}')
        with pytest.raises(ValueError, match="line 1: proposals_xyxy_px: expected whole pixels, got"):
            read_lines(path, FrameLineModel, lambda line: line_to_result(line, 0.5))


def test_results_of_coco(tmp_path: Path) -> None:
    """As YOLOv5 writes them: corner, width and height, in any order; its category and other fields do not matter."""
    path = tmp_path / "results.json"
    first = {"image_id": 7, "category_id": 0, "bbox": [10, 20.5, 4, 6], "score": 0.25}
    path.write_text(json.dumps([first, first | {"image_id": 3}, first | {"bbox": [0, 0, 1, 0], "score": 1}]))
    found = read_predictions(path)
    assert found.is_scored
    assert found.boxes_xyxy_px[7].tolist() == [[10, 20.5, 14, 26.5], [0, 0, 1, 0]]
    assert found.scores[7].tolist() == [0.25, 1.0]
    assert found.boxes_xyxy_px[3].tolist() == [[10, 20.5, 14, 26.5]]
    path.write_text("[]")
    assert not read_predictions(path).boxes_xyxy_px


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"bbox": [0, 0, 4]}, "bbox"),
        ({"bbox": [0, 0, -1, 4]}, "bbox"),
        ({"score": 1.5}, "score"),
        ({"image_id": "a"}, "image_id"),
    ],
)
def test_broken_results_of_coco(fields: dict[str, Any], expected: str, tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps([{"image_id": 7, "bbox": [0, 0, 4, 4], "score": 0.5} | fields]))
    with pytest.raises(ValueError, match=rf"results\.json: 0\.{expected}"):
        read_predictions(path)


@pytest.mark.parametrize("text", ["null", '"x"', "5"])
def test_predictions_that_are_neither_an_object_nor_a_list(text: str, tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"results\.json: (?!dict).*expected an object by image id, or a list, got"):
        read_predictions(path)


def test_results_of_coco_with_several_categories(tmp_path: Path) -> None:
    """Those of cars, say, are no light, and nothing tells which is which."""
    path = tmp_path / "results.json"
    box = {"image_id": 7, "bbox": [10, 20.5, 4, 6], "score": 0.25}
    for first, second in ((1, 2), (None, 1), (1, None)):
        both = [box if number is None else box | {"category_id": number} for number in (first, first, second)]
        path.write_text(json.dumps(both))
        words = rf"results\.json: 2\.category_id: expected boxes of one category, .*, got {second} after {first}"
        with pytest.raises(ValueError, match=words):
            read_predictions(path)


def test_which_files_have_tracks(tmp_path: Path) -> None:
    assert has_tracks(write_run(tmp_path / "frames.jsonl", tracks_of([])))
    assert not has_tracks(write_run(tmp_path / "frames.jsonl", None))
    assert not has_tracks(tmp_path / "absent.jsonl")
    (tmp_path / "empty.jsonl").write_text("")
    assert not has_tracks(tmp_path / "empty.jsonl")


@pytest.mark.parametrize(
    "gaps_rad",
    [[[-0.1, 0.05], [0.05 + 1e-7, 0.2]], [[0.05, 0.05 + 1e-7]], [[-0.2, -0.1], [-0.1 + 1e-12, -0.1 + 1e-9]]],
)
def test_gaps_that_rounding_would_join_can_be_read(gaps_rad: list[list[float]], tmp_path: Path) -> None:
    frame, gaps = night_frames(1)[0], np.array(gaps_rad)
    command = BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, np.ones((2, 4)), gaps, np.full(len(gaps), np.nan))
    sink = LineSink(tmp_path / "frames.jsonl", frame_to_line)
    sink.write(frame, dataclasses.replace(result_of(frame, [[3, 4, 9, 8]], [0.5]), beam=command))
    sink.close()
    np.testing.assert_allclose(read_gaps(tmp_path / "frames.jsonl")[frame.frame], gaps, atol=1e-12)
    line = FrameLineModel.model_validate_json((tmp_path / "frames.jsonl").read_bytes()).root
    assert line_to_result(line, 0.5).beam is not None


def test_what_is_smaller_than_its_rounding_can_be_read(tmp_path: Path) -> None:
    small = tracks_of([[3.0, 4.0, 3.0001, 8.0]], ranges_m=[1e-4])
    small = dataclasses.replace(small, sigmas_m=np.array([0.0]))
    frame = night_frames(1)[0]
    result = dataclasses.replace(result_of(frame, [[3, 4, 9, 8]], [0.5]), tracks=small)
    assert result.detections is not None
    result = dataclasses.replace(result, ranges=Ranges(result.detections, np.array([1e-4]), np.array([1e-5])))
    (tmp_path / "frames.jsonl").write_text(json.dumps(frame_to_line(frame, result)) + "\n")
    found = read_results(tmp_path / "frames.jsonl", 0.5)[frame.frame]
    assert found.tracks is not None
    assert found.ranges is not None
    assert found.tracks.boxes_xyxy_px.tolist() == [[3.0, 4.0, 3.0001, 8.0]]
    assert (found.tracks.ranges_m.item(), found.tracks.sigmas_m.item()) == (1e-4, 0.0)
    assert (found.ranges.ranges_m.item(), found.ranges.sigmas_m.item()) == (1e-4, 1e-5)
