"""A run's results as tables with a row a frame, a box or a track: for pandas, Parquet and COCO."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from foreglow.files import atomic_path, write_atomic
from foreglow.types import FrameResult, TrackState

if TYPE_CHECKING:
    import pandas as pd

TableName: TypeAlias = Literal["frames", "boxes", "tracks"]

COCO_LIGHT = 2
"""Id of the category `light` in the files that `foreglow labels export` writes."""

Row: TypeAlias = dict[str, Any]
Results: TypeAlias = Mapping[str, tuple[FrameResult, ...]]
"""As `RecordedRun.sequences`."""


def columns_of(sequences: Results, table: TableName) -> Mapping[str, list[Any]]:
    """The columns of a table by name, all of the same length.

    Raises:
        ValueError: If there is no such table.
    """
    rows_of = {"frames": _frame_rows, "boxes": _box_rows, "tracks": _track_rows}
    if table not in rows_of:
        raise ValueError(f"table: expected one of {', '.join(rows_of)}, got {table!r}")
    rows = [
        {"sequence": sequence, "frame": result.frame, "time_s": result.timestamp_ns / 1e9, **row}
        for sequence, results in sequences.items()
        for result in results
        for row in rows_of[table](result)
    ]
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else ("sequence", "frame", "time_s"))}


def _frame_rows(result: FrameResult) -> Iterator[Row]:
    detections, tracks = result.detections, result.tracks
    yield {
        "num_proposals": len(result.proposals),
        "num_accepted": None if detections is None else int(detections.is_accepted.sum()),
        "num_tracks": None if tracks is None else int(tracks.is_plausible.sum()),
        "mode": None if result.beam is None else result.beam.mode.name.lower(),
        "time_ms": sum(result.stage_ms.values()),
    }


def _box_rows(result: FrameResult) -> Iterator[Row]:
    detections, ranges = result.detections, result.ranges
    kinds = None if detections is None else detections.kind_names
    for index, box in enumerate(result.proposals.boxes_xyxy_px.tolist()):
        yield {
            **_edges(box),
            "score": np.nan if detections is None else float(detections.scores[index]),
            "is_accepted": None if detections is None else bool(detections.is_accepted[index]),
            "kind": None if kinds is None else kinds[index],
            "direct": np.nan if detections is None else float(detections.direct_probabilities[index]),
            "range_m": np.nan if ranges is None else float(ranges.ranges_m[index]),
            "sigma_m": np.inf if ranges is None else float(ranges.sigmas_m[index]),
        }


def _track_rows(result: FrameResult) -> Iterator[Row]:
    tracks = result.tracks
    if tracks is None:
        return
    for index, box in enumerate(tracks.boxes_xyxy_px.tolist()):
        yield {
            "track": int(tracks.ids[index]),
            "state": TrackState(tracks.states[index]).name.lower(),
            **_edges(box),
            "confidence": float(tracks.confidences[index]),
            "direct": float(tracks.direct_probabilities[index]),
            "age_s": float(tracks.ages_s[index]),
            "range_m": float(tracks.ranges_m[index]),
            "sigma_m": float(tracks.sigmas_m[index]),
        }


def _edges(box: list[float]) -> Row:
    return dict(zip(("x1_px", "y1_px", "x2_px", "y2_px"), box, strict=True))


def to_pandas(sequences: Results, table: TableName) -> pd.DataFrame:
    """As `RecordedRun.to_pandas`."""
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("pandas is not installed: pip install 'foreglow[pandas]'", name=error.name) from None
    return pd.DataFrame(columns_of(sequences, table))


def write_parquet(sequences: Results, path: Path, table: TableName) -> None:
    """As `RecordedRun.write_parquet`."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "pyarrow is not installed: pip install 'foreglow[parquet]'", name=error.name
        ) from None
    columns = pa.table(dict(columns_of(sequences, table)))
    with atomic_path(path) as temporary:
        pq.write_table(columns, temporary)


def write_coco(sequences: Results, path: Path) -> None:
    """As `RecordedRun.write_coco`."""
    entries = [
        {
            "image_id": result.frame,
            "category_id": COCO_LIGHT,
            "bbox": [x1, y1, x2 - x1, y2 - y1],
            "score": score,
        }
        for results in sequences.values()
        for result in results
        if result.detections is not None
        for (x1, y1, x2, y2), score in zip(
            result.detections.boxes_xyxy_px.tolist(), result.detections.scores.tolist(), strict=True
        )
    ]
    write_atomic(path, (json.dumps(entries) + "\n").encode())
