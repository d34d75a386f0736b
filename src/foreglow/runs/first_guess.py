"""What a run found, as points that a person corrects in an annotation tool."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from pathlib import Path

import numpy as np

from foreglow.datasets.exchange import Guess, Kind, Mark
from foreglow.runs.recorded_run import read_run
from foreglow.types import FrameResult


def read_guess(folder: Path) -> Mapping[int, Guess]:
    """By frame of the run in `folder`, a vehicle with one light for every accepted box, at its middle.

    Vehicle and light have the number of the track that follows the box. Each sequence counts its tracks anew, and parts
    of a video may become one drive, so that a later one's count on from the greatest number before. A box without a
    track has a negative number that no other has.

    Raises:
        FileNotFoundError: If a file of the run is missing.
        ValueError: If one is broken, or the run had no model.
    """
    alone = count(-1, -1)
    first_free = 0
    guesses: dict[int, Guess] = {}
    for sequence, results in read_run(folder).sequences.items():
        offset = first_free
        for result in results:
            if result.detections is None:
                raise ValueError(f"{folder / 'frames.jsonl'}: scores: expected those of a model, the run had none")
            tracks = {box: track + offset for box, track in _tracks_of_boxes(result).items()}
            first_free = max([first_free, *(track + 1 for track in tracks.values())])
            kinds = result.detections.kind_names
            found = []
            for index in np.flatnonzero(result.detections.is_accepted).tolist():
                x1, y1, x2, y2 = result.detections.boxes_xyxy_px[index].tolist()
                middle_px = (x1 + x2) // 2, (y1 + y2) // 2
                kind = kinds[index] or ""  # unknown is neither direct nor rear
                is_direct, is_rear = kind.endswith("_lamp"), kind.startswith("rear_")
                number = tracks[index] if index in tracks else next(alone)
                found.append(Mark(Kind.VEHICLE, middle_px, number, None, is_direct))
                found.append(Mark(Kind.LIGHT, middle_px, number, number, is_direct, is_rear))
            guesses[result.frame] = Guess(result.timestamp_ns, tuple(found), sequence)
    return guesses


def _tracks_of_boxes(result: FrameResult) -> dict[int, int]:
    """The id of the track that follows a box, by the box's index."""
    if result.tracks is None:
        return {}
    pairs = zip(result.tracks.detections.tolist(), result.tracks.ids.tolist(), strict=True)
    return {detection: track for detection, track in pairs if detection >= 0}
