"""The values that flow: checked once when made, and never written to afterwards."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.types import (
    BeamCommand,
    BeamMode,
    Detections,
    EgoMotion,
    Frame,
    FrameResult,
    Image,
    Proposals,
    Ranges,
    RoadAhead,
    Tracks,
    TrackState,
    Vehicles,
)
from foreglow.types.beam import MAX_FAULTS

BOXES = np.array([[0, 0, 4, 4], [2, 3, 9, 8]], np.int32)


@pytest.mark.parametrize(
    ("image", "complaint"),
    [
        (np.zeros((4, 4, 3), np.uint8), r"expected a grey array .*\(4, 4, 3\)"),
        (np.zeros((4, 4), np.float32), "expected uint8 or uint16, got float32"),
        (np.zeros((0, 4), np.uint8), r"expected at least one pixel, got shape \(0, 4\)"),
        ([[1, 2]], "expected a grey array .*list"),
    ],
)
def test_frame_refuses_unfit_images(image: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=f"a.png: Frame.image: {complaint}"):
        Frame(image, timestamp_ns=0, path="a.png")


@pytest.mark.parametrize("time", [math.nan, math.inf, 1.5, 2**63, "now", None])
def test_frame_refuses_what_is_no_time(time: Any) -> None:
    with pytest.raises(ValueError, match=r"a\.png: Frame\.timestamp_ns: expected nanoseconds as a whole number"):
        Frame(np.zeros((3, 5), np.uint8), timestamp_ns=time, path="a.png")


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("frame", "7", "a whole number, got str"),
        ("frame", 1.5, "a whole number, got float"),
        ("frame", True, "a whole number, got bool"),
        ("timestamp_ns", True, "nanoseconds as a whole number of 64 bits, got True"),
        ("frame", 2**63, "a whole number of 64 bits, got 9223372036854775808"),
        ("sequence", None, "a name, got NoneType"),
        ("motion", (10.0, 0.0), "an EgoMotion or None, got tuple"),
        ("road", np.zeros((4, 3)), "a RoadAhead or None, got ndarray"),
        ("is_damaged", None, "True or False, got NoneType"),
        ("is_reported", "yes", "True, False or None, got str"),
        ("earlier", np.zeros((3, 5), np.uint8), "a Frame or None, got ndarray"),
        ("red_chroma", "red", "an array or None, got str"),
    ],
)
def test_frame_refuses_values_of_another_type(field: str, value: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=rf"a\.png: Frame\.{field}: expected {complaint}"):
        Frame(**({"image": np.zeros((3, 5), np.uint8), "timestamp_ns": 0, "path": "a.png", field: value}))


@pytest.mark.parametrize(
    ("earlier", "got"),
    [(np.zeros((5, 3), np.uint8), "3x5 px, uint8"), (np.zeros((3, 5), np.uint16), "5x3 px, uint16")],
)
def test_the_earlier_image_of_a_frame_is_like_it(earlier: Any, got: str) -> None:
    with pytest.raises(ValueError, match=rf"a\.png: Frame\.earlier: expected an image of 5x3 px, uint8, got {got}"):
        Frame(np.zeros((3, 5), np.uint8), 1, path="a.png", earlier=Frame(earlier, 0))


@pytest.mark.parametrize("path", [None, 1, b"a.png", Path("a.png"), np.zeros(0), np.zeros((2, 4)), ()])
def test_the_path_of_a_frame_is_a_text(path: Any) -> None:
    with pytest.raises(ValueError, match=r"^Frame\.path: expected a text, got"):
        Frame(np.zeros((3, 5), np.uint8), 0, path=path)


def test_frame_keeps_plain_numbers() -> None:
    assert type(Frame(np.zeros((3, 5), np.uint8), timestamp_ns=np.uint64(7)).timestamp_ns) is int  # type: ignore[arg-type]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_frame_is_read_only_but_its_owner_is_not(dtype: type) -> None:
    image: Image = np.zeros((3, 5), dtype)
    frame = Frame(image, timestamp_ns=0)
    assert (frame.width_px, frame.height_px) == (5, 3)
    with pytest.raises(ValueError, match="read-only"):
        frame.image[0, 0] = 1
    image[0, 0] = 1
    assert frame.image[0, 0] == 1


@pytest.mark.parametrize(
    ("boxes", "complaint"),
    [
        (np.zeros((3,), np.int32), r"expected int32 of shape \(N, 4\), got int32 of shape \(3,\)"),
        (np.zeros((1, 4)), r"expected int32 of shape \(N, 4\), got float64 of shape \(1, 4\)"),
        (np.array([[0, 0, 1, 1], [4, 0, 4, 9]], np.int32), r"box 1 is \[4, 0, 4, 9\], expected x1 < x2"),
    ],
)
def test_proposals_refuse_unfit_boxes(boxes: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Proposals(boxes)


@pytest.mark.parametrize(
    ("scores", "complaint"),
    [
        (np.zeros(1, np.float32), r"scores: expected float32 of shape \(2,\)"),
        (np.zeros(2), "scores: expected float32 .*got float64"),
        (np.array([0.5, np.nan], np.float32), r"expected values in \[0, 1\]"),
        (np.array([0.5, 1.5], np.float32), r"expected values in \[0, 1\]"),
        (np.array([-0.1, 0.5], np.float32), r"expected values in \[0, 1\]"),
    ],
)
def test_detections_refuse_unfit_scores(scores: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Detections(Proposals(BOXES), scores, 0.5)


@pytest.mark.parametrize("threshold", [None, math.nan, math.inf, "x", True, -1, 2, -0.001, 1.001])
def test_detections_refuse_what_is_no_threshold(threshold: Any) -> None:
    with pytest.raises(ValueError, match=r"^Detections\.score_threshold: expected a number from 0 to 1, got"):
        Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), threshold)


@pytest.mark.parametrize("other", [None, (1, 2), BOXES])
def test_boxes_are_of_their_kind(other: Any) -> None:
    name = type(other).__name__
    with pytest.raises(ValueError, match=rf"^Detections\.proposals: expected Proposals, got {name}"):
        Detections(other, np.array([0.5, 0.9], np.float32), 0.5)
    with pytest.raises(ValueError, match=rf"^Ranges\.detections: expected Detections, got {name}"):
        Ranges(other, np.ones(2), np.ones(2))


@pytest.mark.parametrize(
    ("light_kinds", "complaint"),
    [
        (np.zeros((1, 4), np.float32), r"light_kinds: expected float32 of shape \(2, 4\)"),
        (np.full((2, 5), 0.2, np.float32), r"light_kinds: expected float32 of shape \(2, 4\)"),
        (np.full((2, 4), 0.25), "light_kinds: expected float32 .*got float64"),
        (np.array([[1, 0, 0, 0], [0.5, 0, 0, 0]], np.float32), r"sum 1 in each row, got \[0.5, 0.0, 0.0, 0.0\]"),
        (np.array([[1, 0, 0, 0], [1.5, -0.5, 0, 0]], np.float32), r"sum 1 in each row, got \[1.5, -0.5"),
        (np.array([[1, 0, 0, 0], [np.nan, 1, 0, 0]], np.float32), r"sum 1 in each row, got \[nan, 1.0"),
    ],
)
def test_detections_refuse_unfit_kinds(light_kinds: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), 0.5, light_kinds)


def test_kinds_of_boxes() -> None:
    light_kinds = np.array([[0.125, 0.25, 0.5, 0.125], [np.nan] * 4], np.float32)
    detections = Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), 0.6, light_kinds)
    np.testing.assert_array_equal(detections.kinds, [[0.0625, 0.125, 0.25, 0.0625, 0.5], [np.nan] * 5])
    assert detections.kinds.dtype == np.float32
    assert detections.kind_names == ("front_light", None)
    np.testing.assert_array_equal(detections.direct_probabilities, np.array([0.375, np.nan], np.float32))
    silent = Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), 0.6)
    assert np.isnan(silent.kinds).all()
    assert silent.kind_names == (None, None)


def test_accepted_boxes() -> None:
    detections = Detections(Proposals(BOXES), np.array([0.2, 0.9], np.float32), 0.2)
    assert detections.is_accepted.tolist() == [True, True]  # the float32 nearest to 0.2 is above 0.2
    detections = Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), 0.5)  # not above 0.5
    assert detections.accepted_boxes_xyxy_px.tolist() == [[2, 3, 9, 8]]
    assert len(detections) == 2


def test_result_cannot_be_changed() -> None:
    stage_ms = {"proposals": 1.0}
    result = FrameResult(0, 0, Proposals(BOXES), None, stage_ms)
    stage_ms["proposals"] = 2.0
    assert result.stage_ms == {"proposals": 1.0}
    with pytest.raises(TypeError):
        result.stage_ms["proposals"] = 3.0  # type: ignore[index]
    with pytest.raises(ValueError, match="read-only"):
        result.proposals.boxes_xyxy_px[0, 0] = 1


ROAD = np.array([[0.0, 1.6, 0.0], [1.0, 1.6, 0.0], [2.0, 1.6, 0.1]])
GIVEN: dict[str, Any] = {"points_m": ROAD, "half_width_m": 3.2}


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"points_m": ROAD[:1]}, r"points_m: expected shape \(N, 3\) with N >= 2, got \(1, 3\)"),
        ({"points_m": np.full((2, 3), np.nan)}, "points_m: expected finite numbers"),
        ({"points_m": ROAD[[0, 1, 1]]}, "points 1 and the next are the same"),
        ({"half_width_m": 0.0}, "half_width_m: expected a positive number, got 0"),
        ({"half_width_m": 200.1}, "half_width_m: expected at most 200, got 200.1"),
        ({"half_width_m": np.inf}, "half_width_m: expected a positive number, got inf"),
        ({"points_m": 1e10 * ROAD}, r"points_m: expected at most 1e\+09 m, got 2e\+10"),
        ({"cross_slopes": np.full(3, 2.5)}, r"cross_slopes: expected .* of at most 1.6, not percent, got 2.5"),
        ({"cross_slopes": np.zeros(2)}, r"cross_slopes: expected 3 finite numbers"),
        ({"error_bound_m": np.nan}, "error_bound_m: expected a number of at least 0, got nan"),
        ({"error_bound_m": None}, "error_bound_m: expected a number, got None"),
        ({"half_width_m": "wide"}, "half_width_m: expected a number, got 'wide'"),
        ({"points_m": {}}, r"^RoadAhead\.points_m: expected numbers, got \{\}"),
        ({"points_m": [[1.0, 2.0, 3.0], [1.0]]}, r"^RoadAhead\.points_m: expected numbers, got \[\["),
        ({"cross_slopes": None}, "cross_slopes: expected numbers, got None"),
    ],
)
def test_a_road_refuses_unfit_fields(fields: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        RoadAhead(**{**GIVEN, **fields})


def test_a_road_without_cross_slopes_is_level() -> None:
    assert RoadAhead(ROAD, 3.2).cross_slopes.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("fields", [{"speed_mps": np.nan}, {"yaw_rate_radps": np.inf}, {"pitch_rad": -np.inf}])
def test_motion_refuses_numbers_that_are_none(fields: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"EgoMotion.{next(iter(fields))}: expected a finite number"):
        EgoMotion(**({"speed_mps": 20.0, "yaw_rate_radps": 0.0} | fields))


@pytest.mark.parametrize("value", ["x", None, [1.0], 10**400])
@pytest.mark.parametrize("name", ["speed_mps", "yaw_rate_radps", "pitch_rad"])
def test_motion_refuses_what_is_no_number(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=rf"^EgoMotion\.{name}: expected a number, got "):
        EgoMotion(**({"speed_mps": 20.0, "yaw_rate_radps": 0.0} | {name: value}))


def command(**changed: Any) -> BeamCommand:
    fields: dict[str, Any] = {
        "timestamp_ns": 7,
        "mode": BeamMode.GLARE_FREE,
        "levels": np.full((2, 3), 0.5),
        "gaps_rad": np.array([[-0.1, 0.1], [0.2, 0.3]]),
        "gap_ranges_m": np.array([20.0, np.nan]),
    }
    return BeamCommand(**(fields | changed))


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        *(("mode", value, "expected a BeamMode, got") for value in ("x", 77, None)),
        *(("timestamp_ns", value, "expected nanoseconds as a whole number") for value in (None, math.nan, 2**80)),
        *(("faults", value, "expected a tuple of names, got") for value in (3, "dark", (object(),), ["dark"])),
        ("faults", ("dark",) * 101, "expected at most 100 names, got 101"),
        *(("faults", (value,), "expected names of 1 to 100 characters") for value in ("", "a\nb", "x" * 101)),
        *(
            ("gap_ranges_m", np.array([value, 9.0]), "expected numbers of at least 0, or NaN, got")
            for value in (-5.0, -math.inf, math.inf)
        ),
        ("gaps_rad", np.array([[-1e308, 0.1], [0.2, 0.3]]), "expected borders in order and apart, at most a full turn"),
        ("gaps_rad", np.array([[-0.1, 0.1], [0.2, 1e308]]), "expected borders in order and apart, at most a full turn"),
        ("gaps_rad", np.array([[-0.1, 0.1], [0.05, 0.3]]), "expected borders in order and apart"),
        ("gaps_rad", np.array([[-0.1, 0.1], [0.2, np.nan]]), "expected borders in order and apart"),
    ],
)
def test_a_command_refuses_unfit_fields(field: str, value: Any, complaint: str) -> None:
    assert type(command(timestamp_ns=np.int64(7)).timestamp_ns) is int
    with pytest.raises(ValueError, match=rf"^BeamCommand\.{field}: {complaint}"):
        command(**{field: value})


def test_only_a_glare_free_beam_has_gaps() -> None:
    with pytest.raises(ValueError, match=r"^BeamCommand\.gaps_rad: expected none with full beam, got 2$"):
        command(mode=BeamMode.FULL, levels=np.ones((2, 3)))


DETECTED = Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), 0.34)


@pytest.mark.parametrize(
    ("ranges_m", "sigmas_m", "complaint"),
    [
        ([1.0], [1.0, 1.0], r"ranges_m: expected float64 of shape \(2,\)"),
        ([1.0, 0.0], [1.0, 1.0], "ranges_m: expected positive numbers or NaN"),
        ([1.0, np.inf], [1.0, 1.0], "ranges_m: expected positive numbers or NaN"),
        ([1.0, np.nan], [1.0, 1.0], "sigmas_m: expected positive numbers, and infinity beside"),
        ([1.0, 2.0], [1.0, 0.0], "sigmas_m: expected positive numbers"),
        ([1.0, 2.0], [1.0, np.nan], "sigmas_m: expected positive numbers"),
    ],
)
def test_ranges_refuse_what_is_no_estimate(ranges_m: list[float], sigmas_m: list[float], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Ranges(DETECTED, np.array(ranges_m), np.array(sigmas_m))


def test_a_range_may_be_unknown() -> None:
    ranges = Ranges(DETECTED, np.array([np.nan, 30.0]), np.array([np.inf, np.inf]))
    assert len(ranges) == 2
    with pytest.raises(ValueError, match="read-only"):
        ranges.ranges_m[0] = 1.0


def tracks(**changed: Any) -> Tracks:
    fields: dict[str, NDArray[Any]] = {
        "ids": np.array([3, 7]),
        "states": np.array([TrackState.TENTATIVE, TrackState.COASTING], np.int64),
        "boxes_xyxy_px": BOXES.astype(np.float64),
        "confidences": np.array([0.2, 0.8]),
        "num_hits": np.array([1, 9]),
        "num_misses": np.array([0, 2]),
        "ages_s": np.array([0.0, 1.5]),
        "ranges_m": np.array([np.nan, 60.0]),
        "sigmas_m": np.array([np.inf, 9.0]),
        "detections": np.array([0, -1]),
    }
    return Tracks(**(fields | changed))


def test_tracks_say_which_are_plausible() -> None:
    assert tracks().is_plausible.tolist() == [False, True]


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"ids": np.array([7, 3])}, r"Tracks.ids: expected ascending numbers, got \[7, 3\]"),
        ({"ages_s": np.zeros(3)}, r"Tracks.ages_s: expected float64 of shape \(2,\)"),
        ({"light_kinds": np.zeros((2, 4))}, "Tracks.light_kinds: expected NaN or probabilities with the sum 1"),
        ({"num_hits": np.ones(2)}, "Tracks.num_hits: expected int64"),
        ({"boxes_xyxy_px": np.zeros((2, 4))}, "Tracks.boxes_xyxy_px: expected finite boxes with x1 < x2"),
        ({"boxes_xyxy_px": np.full((2, 4), np.nan)}, "Tracks.boxes_xyxy_px: expected finite boxes"),
        (
            {"boxes_xyxy_px": np.array([[1e300, -1e300, 1e308, 1e308], [0.0, 0.0, 1.0, 1.0]])},
            r"Tracks.boxes_xyxy_px: expected numbers from -1e\+06 to 1e\+06",
        ),
        ({"ranges_m": np.array([60.0, np.inf])}, "Tracks.ranges_m: expected positive numbers or NaN"),
        ({"ranges_m": np.array([60.0, 0.0])}, "Tracks.ranges_m: expected positive numbers or NaN"),
        ({"sigmas_m": np.array([1.0, -1.0])}, "Tracks.sigmas_m: expected numbers of at least 0"),
        ({"sigmas_m": np.array([1.0, np.nan])}, "Tracks.sigmas_m: expected numbers of at least 0"),
        ({"states": np.array([1, 99])}, "Tracks.states: expected numbers from 0 to 2"),
        ({"confidences": np.array([0.5, np.nan])}, "Tracks.confidences: expected numbers from 0 to 1"),
        ({"ages_s": np.array([np.inf, 1.0])}, "Tracks.ages_s: expected numbers from 0 to 1e"),
        ({"ages_s": np.array([0.0, -1.0])}, "Tracks.ages_s: expected numbers from 0 to 1e"),
        ({"num_hits": np.array([0, 1])}, "Tracks.num_hits: expected numbers from 1 to inf"),
        ({"num_misses": np.array([0, -1])}, "Tracks.num_misses: expected numbers from 0 to inf"),
        ({"detections": np.array([0, -2])}, "Tracks.detections: expected numbers from -1 to inf"),
        ({"ids": [3, 7]}, r"Tracks.ids: expected int64 of shape \(N,\), got list"),
        ({"ids": np.array(3)}, r"Tracks.ids: expected int64 of shape \(N,\), got int64 of shape \(\)"),
        ({"confidences": None}, r"Tracks.confidences: expected float64 of shape \(2,\), got NoneType"),
        ({"vehicles": "two"}, "Tracks.vehicles: expected Vehicles or None, got str"),
    ],
)
def test_tracks_refuse_unfit_fields(changed: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        tracks(**changed)


def vehicles(**changed: NDArray[Any]) -> Vehicles:
    fields: dict[str, NDArray[Any]] = {
        "ids": np.array([2, 5]),
        "states": np.array([int(TrackState.CONFIRMED), int(TrackState.TENTATIVE)]),
        "confidences": np.array([0.5, 0.25]),
        "is_in_sight": np.array([True, False]),
        "of_tracks": np.array([5, 2]),
        "leading": np.array([1, 0]),
    }
    return Vehicles(**(fields | changed))


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"ids": np.array([5, 2])}, r"Vehicles.ids: expected ascending numbers, got \[5, 2\]"),
        ({"states": np.zeros(2)}, "Vehicles.states: expected int64"),
        ({"states": np.array([1, 99])}, r"Vehicles.states: expected numbers from 0 to 2, got \[1, 99\]"),
        ({"states": np.array([-1, 1])}, r"Vehicles.states: expected numbers from 0 to 2, got \[-1, 1\]"),
        ({"is_in_sight": np.zeros(3, np.bool_)}, r"Vehicles.is_in_sight: .* got bool of shape \(3,\)"),
        ({"confidences": np.array([0.5, 1.5])}, "Vehicles.confidences: expected numbers from 0 to 1"),
        ({"of_tracks": [5, 2]}, r"Vehicles.of_tracks: expected int64 of shape \(N,\), got list"),
        ({"of_tracks": np.array([5, 3])}, r"Vehicles.of_tracks: expected ids of vehicles, got \[5, 3\]"),
        ({"leading": np.array([0, 1])}, r"Vehicles.leading: expected a track of each vehicle, got \[0, 1\]"),
        ({"leading": np.array([1, 2])}, r"Vehicles.leading: expected a track of each vehicle, got \[1, 2\]"),
    ],
)
def test_vehicles_refuse_unfit_fields(changed: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        vehicles(**changed)


def test_vehicles_are_those_of_as_many_tracks() -> None:
    assert tracks(vehicles=vehicles()).vehicles is not None
    with pytest.raises(ValueError, match=r"Tracks.vehicles: expected those of 2 tracks, got 3"):
        tracks(vehicles=vehicles(of_tracks=np.array([2, 5, 5]), leading=np.array([0, 1])))


def test_a_frame_refuses_seconds() -> None:
    with pytest.raises(
        ValueError, match=r"Frame\.timestamp_ns: expected nanoseconds as a whole number of 64 bits, got 0\.5"
    ):
        Frame(np.zeros((2, 2), np.uint8), 0.5)  # type: ignore[arg-type]
    assert Frame(np.zeros((2, 2), np.uint8), np.int64(5)).timestamp_ns == 5  # type: ignore[arg-type]


def is_same(one: Any, other: Any) -> bool:
    """Whether two values hold the same, and each array of the second is read-only."""
    if dataclasses.is_dataclass(one) and not isinstance(one, type):
        pairs = [(getattr(one, each.name), getattr(other, each.name)) for each in dataclasses.fields(one)]
        return type(one) is type(other) and all(is_same(*pair) for pair in pairs)
    if isinstance(one, np.ndarray):
        return (
            bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))
            and one.dtype == other.dtype
            and not other.flags.writeable
        )
    return bool(one == other) or (one != one and other != other)  # NaN


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_values_can_be_copied(copied: Callable[[Any], Any]) -> None:
    image = np.zeros((12, 16), np.uint8)
    frame = Frame(image, 7, motion=EgoMotion(10.0, 0.1))
    detections = Detections(Proposals(BOXES), np.array([0.25, 0.75], np.float32), 0.5)
    ranges = Ranges(detections, np.array([10.0, 20.0]), np.array([1.0, 2.0]))
    beam = BeamCommand(7, BeamMode.GLARE_FREE, np.full((2, 3), 0.5), np.array([[-0.1, 0.1]]), np.array([20.0]), ("a",))
    of_tracks = tracks(vehicles=vehicles())
    result = FrameResult(3, 7, detections.proposals, detections, {"beam": 0.5}, ranges, of_tracks, beam)
    for value in (frame, result):
        assert is_same(value, copied(value))
    again = copied(result)
    assert again.ranges.detections is again.detections
    with pytest.raises(TypeError):
        again.stage_ms["beam"] = 1.0


def test_a_frame_refuses_the_path_of_a_calibration() -> None:
    with pytest.raises(ValueError, match=r"Frame\.camera: expected a Camera, such as of .*, got str"):
        Frame(np.zeros((4, 4), np.uint8), 0, camera="camera.toml")  # type: ignore[arg-type]


def test_low_beam_may_have_any_number_of_faults() -> None:
    """Those of a policy and those of the loop may be too many for a command together."""
    assert len(BeamCommand.low(0, 2, *(f"fault {number}" for number in range(150))).faults) == MAX_FAULTS
