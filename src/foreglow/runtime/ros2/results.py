"""The stages' results as tables and back: a row for each box or track; one row for the beam and for timing."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from foreglow.pipeline import MAX_TRACKS
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.table import Columns, Field, read_table, table_message
from foreglow.types import BeamCommand, BeamMode, Detections, Proposals, Ranges, Tracks, TrackState, Vehicles
from foreglow.types.kinds import LIGHT_KINDS, kinds_of_direct

PROPOSALS = {"box_xyxy_px": Field("i4", 4)}
DETECTIONS = PROPOSALS | {
    "score": Field("f4"),
    "direct_probability": Field("f4"),
    "light_kinds": Field("f4", len(LIGHT_KINDS), is_optional=True),
}
RANGES = DETECTIONS | {
    "range_m": Field("f8", is_optional=True),
    "sigma_m": Field("f8", is_optional=True),
}
TRACKS = {
    "id": Field("i4"),
    "state": Field("u1"),
    "box_xyxy_px": Field("f8", 4, is_finite=True),
    "confidence": Field("f8", is_finite=True),
    "num_hits": Field("i4"),
    "num_misses": Field("i4"),
    "age_s": Field("f8", is_finite=True),
    "range_m": Field("f8"),
    "sigma_m": Field("f8"),
    "detection": Field("i4"),
    "light_kinds": Field("f8", len(LIGHT_KINDS), is_optional=True),
    "direct_probability": Field("f8"),
}
"""The fields of `Tracks` but `vehicles`, in their order, in the singular, and a property; older versions sent no
`light_kinds`."""

VEHICLES = {
    "vehicle": Field("i4", is_optional=True),
    "vehicle_state": Field("u1", is_optional=True),
    "vehicle_confidence": Field("f8", is_optional=True, is_finite=True),
    "vehicle_in_sight": Field("u1", is_optional=True),
    "is_leading": Field("u1", is_optional=True),
}
"""Of the vehicle that a track belongs to, and whether the track leads it; none of them where vehicles are unknown."""

BEAM = {
    "mode": Field("u1"),
    "levels_left": Field("f8", None),
    "levels_right": Field("f8", None),
    "gaps_rad": Field("f8", None, is_optional=True),
    "gap_ranges_m": Field("f8", None, is_optional=True),
    "faults": Field("u1", None, is_optional=True),
}
"""`gaps_rad` has the right and left border of each gap in turn; `faults` is UTF-8 text, one fault a line."""

_STAGES = ("proposals", "standing", "classifier", "distance", "tracking", "beam")

TIMING = {name: Field("f8", is_optional=True) for name in ("received", "wait", "decode", *_STAGES, "send", "done")}
"""Milliseconds. `received` and `done` are from exposure until the frame's last message was received, and until all
results were sent; the others are how long each part took, the first being the `wait` until the node began.
"""

_INT_32 = np.iinfo(np.int32)


def proposals_message(header: Header, proposals: Proposals) -> PointCloud2:
    """The boxes that may hold light."""
    return table_message(header, {"box_xyxy_px": proposals.boxes_xyxy_px})


def read_proposals(message: PointCloud2, topic: str) -> tuple[Header, Proposals]:
    """The boxes that may hold light.

    Raises:
        ValueError: If it is no such table, or a value is not valid in `Proposals`.
    """
    header, columns = read_table(message, topic, PROPOSALS)
    with _naming(topic):
        return header, Proposals(columns["box_xyxy_px"])


def detections_message(header: Header, detections: Detections, ranges: Ranges | None = None) -> PointCloud2:
    """The scored boxes, with their ranges if there are any."""
    columns: dict[str, NDArray[Any]] = {
        "box_xyxy_px": detections.boxes_xyxy_px,
        "score": detections.scores,
        "direct_probability": detections.direct_probabilities,
        "light_kinds": detections.light_kinds,
    }
    if ranges is not None:
        columns |= {"range_m": ranges.ranges_m, "sigma_m": ranges.sigmas_m}
    return table_message(header, columns)


def read_detections(message: PointCloud2, topic: str, score_threshold: float) -> tuple[Header, Detections]:
    """The scored boxes; the threshold is not in the message, since all nodes have the same configuration.

    Raises:
        ValueError: If it is no such table, or a value is not valid in `Detections`.
    """
    header, columns = read_table(message, topic, DETECTIONS)
    return header, _detections(columns, topic, score_threshold)


def read_ranges(message: PointCloud2, topic: str, score_threshold: float) -> tuple[Header, Detections, Ranges | None]:
    """The scored boxes and their ranges; None if no ranges were estimated.

    Raises:
        ValueError: If it is no such table, or a value is not valid in `Ranges`.
    """
    header, columns = read_table(message, topic, RANGES)
    detections = _detections(columns, topic, score_threshold)
    if "range_m" not in columns and "sigma_m" not in columns:
        return header, detections, None
    for name in ("range_m", "sigma_m"):
        if name not in columns:
            raise ValueError(f"{topic}: {name}: missing, expected range_m and sigma_m, or neither")
    with _naming(topic):
        return header, detections, Ranges(detections, columns["range_m"], columns["sigma_m"])


def tracks_message(header: Header, tracks: Tracks) -> PointCloud2:
    """The tracks, each with the vehicle that it belongs to.

    Raises:
        ValueError: If a number does not fit 32 bits.
    """
    columns = {}
    attributes = [field.name for field in dataclasses.fields(tracks) if field.name != "vehicles"]
    for (name, column), attribute in zip(TRACKS.items(), [*attributes, "direct_probabilities"], strict=True):
        columns[name] = _narrowed(name, getattr(tracks, attribute), column.dtype)
    vehicles = tracks.vehicles
    if vehicles is not None:
        rows, is_leading = vehicles.ids.searchsorted(vehicles.of_tracks), np.zeros(len(tracks), np.uint8)
        is_leading[vehicles.leading] = 1
        columns |= {
            "vehicle": _narrowed("vehicle", vehicles.of_tracks, "i4"),
            "vehicle_state": vehicles.states[rows].astype(np.uint8),
            "vehicle_confidence": vehicles.confidences[rows],
            "vehicle_in_sight": vehicles.is_in_sight[rows].astype(np.uint8),
            "is_leading": is_leading,
        }
    return table_message(header, columns)


def _narrowed(name: str, array: NDArray[Any], dtype: str) -> NDArray[Any]:
    if dtype == "i4" and len(array) and not _INT_32.min <= array.min() <= array.max() <= _INT_32.max:
        raise ValueError(f"{name}: expected numbers of 32 bits, got {array.max()}")
    return array.astype(dtype, copy=False)


def read_tracks(message: PointCloud2, topic: str) -> tuple[Header, Tracks]:
    """The tracks.

    Raises:
        ValueError: If it is no such table, has more rows than a frame may have tracks, or a value is not valid in
            `Tracks`.
    """
    if message.width > MAX_TRACKS:
        raise ValueError(f"{topic}: width: expected at most {MAX_TRACKS} tracks, got {message.width}")
    header, columns = read_table(message, topic, TRACKS | VEHICLES)
    vehicles = _vehicles({name: columns.pop(name) for name in VEHICLES if name in columns}, topic)
    _check_states(columns["state"], f"{topic}: state")
    columns.setdefault("light_kinds", kinds_of_direct(columns.pop("direct_probability")))
    wide: list[Any] = [column.astype(np.int64) if column.dtype.kind in "iu" else column for column in columns.values()]
    with _naming(topic):
        return header, dataclasses.replace(Tracks(*wide), vehicles=vehicles)


def _vehicles(columns: Columns, topic: str) -> Vehicles | None:
    if not columns:
        return None
    missing = VEHICLES.keys() - columns.keys()
    if missing:
        raise ValueError(f"{topic}: {min(missing)}: missing, expected with {min(columns)}")
    _check_states(columns["vehicle_state"], f"{topic}: vehicle_state")
    of_tracks = columns["vehicle"].astype(np.int64)
    leading = np.flatnonzero(columns["is_leading"])
    leading = leading[of_tracks[leading].argsort()]
    ids = np.unique(of_tracks)
    if not np.array_equal(of_tracks[leading], ids):
        raise ValueError(f"{topic}: is_leading: expected one track of each vehicle, got those of {of_tracks[leading]}")
    with _naming(topic):
        return Vehicles(
            ids=ids,
            states=columns["vehicle_state"][leading].astype(np.int64),
            confidences=columns["vehicle_confidence"][leading],
            is_in_sight=columns["vehicle_in_sight"][leading].astype(np.bool_),
            of_tracks=of_tracks,
            leading=leading,
        )


def _check_states(states: NDArray[np.uint8], name: str) -> None:
    if (states > max(TrackState)).any():
        raise ValueError(f"{name}: expected 0 to {max(TrackState)}, got {states.max()}")


def beam_message(header: Header, beam: BeamCommand) -> PointCloud2:
    """The command, in one row."""
    return table_message(
        header,
        {
            "mode": np.array([int(beam.mode)], np.uint8),
            "levels_left": beam.levels[:1],
            "levels_right": beam.levels[1:],
            "gaps_rad": beam.gaps_rad.reshape(1, -1),
            "gap_ranges_m": beam.gap_ranges_m.reshape(1, -1),
            "faults": np.frombuffer("\n".join(beam.faults).encode(), np.uint8).reshape(1, -1),
        },
    )


def read_beam(message: PointCloud2, topic: str) -> tuple[Header, BeamCommand]:
    """The command.

    Raises:
        ValueError: If it is no such table, or a value is not valid in `BeamCommand`.
    """
    header, columns = read_table(message, topic, BEAM, num_rows=1)
    left, right = columns["levels_left"], columns["levels_right"]
    if left.shape != right.shape:
        raise ValueError(f"{topic}: levels_right: expected as many LEDs as left, {left.size}, got {right.size}")
    gaps, ranges_m = columns.get("gaps_rad", np.zeros((1, 0))), columns.get("gap_ranges_m", np.zeros((1, 0)))
    if gaps.size != 2 * ranges_m.size:
        raise ValueError(f"{topic}: gaps_rad: expected two borders for each of {ranges_m.size} ranges, got {gaps.size}")
    if columns["mode"][0] > max(BeamMode):
        raise ValueError(f"{topic}: mode: expected 0 to {max(BeamMode)}, got {columns['mode'][0]}")
    with _naming(topic):  # also of text that is not UTF-8
        faults = columns.get("faults", np.zeros(0, np.uint8)).tobytes().decode()
        return header, BeamCommand(
            header.timestamp_ns,
            BeamMode(int(columns["mode"][0])),
            np.concatenate([left, right]),
            gaps.reshape(-1, 2),
            ranges_m[0],
            tuple(faults.split("\n")) if faults else (),
        )


def timing_message(header: Header, times_ms: Mapping[str, float]) -> PointCloud2:
    """A node's times for a frame, in one row."""
    return table_message(header, {name: np.array([value]) for name, value in times_ms.items()})


def read_timing(message: PointCloud2, topic: str) -> tuple[Header, dict[str, float]]:
    """A node's times for a frame, milliseconds; the header's `sequence` is the node's name.

    Raises:
        ValueError: If it is no such table.
    """
    header, columns = read_table(message, topic, TIMING, num_rows=1)
    return header, {name: float(column[0]) for name, column in columns.items()}


def _detections(columns: Mapping[str, NDArray[Any]], topic: str, score_threshold: float) -> Detections:
    with _naming(topic):
        proposals = Proposals(columns["box_xyxy_px"])
        light_kinds = columns.get("light_kinds", kinds_of_direct(columns["direct_probability"]))
        return Detections(proposals, columns["score"], score_threshold, light_kinds)


@contextlib.contextmanager
def _naming(topic: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{topic}: {error}") from None
