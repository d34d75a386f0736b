"""Which frames of a run are worth labelling: those that the model doubts, that blink, or that look unlike its world."""

from __future__ import annotations

import csv
import io
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from foreglow.datasets.json_files import read_lines
from foreglow.files import MAX_TEXT_BYTES, read_bytes
from foreglow.lab.simulation.camera.likeness import MAX_DISTANCE, look_of, nearest_profile
from foreglow.runs.recorded_run import RecordedRun, open_run
from foreglow.types import FrameResult
from foreglow.types.arrays import Boxes
from foreglow.types.white import full_scale
from foreglow.whole_files import together, write_atomic
from foreglow.wording import csv_words, shortened

FILE_NAME = "suggestions.csv"
LOOK_STEP = 10
"""Every so manieth frame of a drive is looked at: a drive's look changes slowly."""


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A frame, and why it is worth labelling; each reason in [0, 1].

    Attributes:
        sequence: Its sequence.
        frame: Its number.
        uncertain: n / (1 + n) for n boxes of which the model is unsure: the sum of 4 p (1 - p) over the scores p.
        restless: n / (1 + n) for n boxes that are there in this frame alone, or missing in it alone.
        unlike: How far the image is from every camera profile of the simulator; 0 where it is near, or unknown.
    """

    sequence: str
    frame: int
    uncertain: float
    restless: float
    unlike: float

    @property
    def value(self) -> float:
        """All reasons together, as if each were a probability of its own."""
        return 1.0 - (1.0 - self.uncertain) * (1.0 - self.restless) * (1.0 - self.unlike)


def rated(run: RecordedRun, unlike: Mapping[int, float] | None = None) -> list[list[Suggestion]]:
    """Every frame of a run, by sequence.

    Args:
        run: The run.
        unlike: As `Suggestion.unlike`, by the frame's number; None where the images are not there.

    Raises:
        ValueError: If the run had no model.
    """
    drives = []
    for sequence, results in run.sequences.items():
        accepted = [_accepted(result, run.folder) for result in results]
        empty = np.zeros((0, 4), np.int32)
        drive = []
        for index, result in enumerate(results):
            before = accepted[index - 1] if index > 0 else None
            after = accepted[index + 1] if index + 1 < len(results) else None
            num_blinks = 0
            if before is not None and after is not None:
                here = accepted[index]
                num_blinks = int((~_is_met(here, np.concatenate([before, after, empty]))).sum())
                num_blinks += int((_is_met(before, after) & ~_is_met(before, here)).sum())
            drive.append(
                Suggestion(
                    sequence,
                    result.frame,
                    round(_uncertainty(result), 4),
                    round(num_blinks / (1.0 + num_blinks), 4),
                    round((unlike or {}).get(result.frame, 0.0), 4),
                )
            )
        drives.append(drive)
    return drives


def _accepted(result: FrameResult, folder: Path) -> Boxes:
    if result.detections is None:
        raise ValueError(f"{folder / 'frames.jsonl'}: scores: expected those of a model, the run had none")
    return result.detections.accepted_boxes_xyxy_px


def _uncertainty(result: FrameResult) -> float:
    assert result.detections is not None
    scores = result.detections.scores.astype(np.float64)
    num_unsure = float(np.sum(4.0 * scores * (1.0 - scores)))
    return num_unsure / (1.0 + num_unsure)


def _is_met(boxes: Boxes, others: Boxes) -> np.ndarray:
    """Shape (N,): which boxes meet one of the others, each enlarged by its size: light moves from frame to frame."""
    sizes = np.maximum(boxes[:, 2:] - boxes[:, :2], 1)
    low, high = boxes[:, None, :2] - sizes[:, None], boxes[:, None, 2:] + sizes[:, None]
    meets = (low < others[None, :, 2:]) & (high > others[None, :, :2])
    return np.asarray(meets.all(axis=2).any(axis=1))


def unlikeness(run: RecordedRun) -> Mapping[int, float]:
    """As `Suggestion.unlike`, for every frame of the run.

    Raises:
        FileNotFoundError: If the images are no longer where they were.
        ValueError: If they cannot be read.
    """
    found: dict[int, float] = {}
    latest, num_since, sequence = 0.0, 0, None
    for index, frame in enumerate(open_run(run.folder)):
        if index >= run.summary.num_frames:
            break
        num_since = num_since + 1 if frame.sequence == sequence else 0  # drives may look unlike one another
        sequence = frame.sequence
        if num_since % LOOK_STEP == 0:
            seen = full_scale(frame, run.config.guard.white_level)
            distance = nearest_profile(look_of(seen.image))[1]
            latest = float(np.clip((distance - 0.5 * MAX_DISTANCE) / (1.5 * MAX_DISTANCE), 0.0, 1.0))
        found[frame.frame] = latest
    return found


def suggested(drives: Sequence[Sequence[Suggestion]], num_frames: int) -> list[list[Suggestion]]:
    """The frames to label, by drive and in their order: the drives take turns, each with its best frame that is left.

    Frames of a drive are at least half of their mean distance apart, so that they are not all of one moment; nearer
    ones follow where there are too few others.
    """
    quota = -(-num_frames // max(1, len(drives)))
    gaps = [max(1, (len(drive) // quota + 1) // 2) for drive in drives]
    orders = [
        deque(sorted(range(len(drive)), key=lambda k, drive=drive: (-drive[k].value, k)))  # type: ignore[misc]
        for drive in drives
    ]
    chosen: list[list[int]] = [[] for _ in drives]
    crowded: list[deque[int]] = [deque() for _ in drives]
    num_left = num_frames
    while num_left:
        num_before = num_left
        turns = sorted(range(len(drives)), key=lambda n: -drives[n][orders[n][0]].value if orders[n] else 0.0)
        for number in turns:
            while num_left and orders[number]:
                index = orders[number].popleft()
                if all(abs(index - other) >= gaps[number] for other in chosen[number]):
                    chosen[number].append(index)
                    num_left -= 1
                    break
                crowded[number].append(index)
        if num_left == num_before:
            if not any(crowded):
                break
            gaps = [max(1, gap // 2) for gap in gaps]
            orders, crowded = crowded, [deque() for _ in drives]
    return [[drive[index] for index in sorted(indices)] for drive, indices in zip(drives, chosen, strict=True)]


def suggestions_text(suggestions: Iterable[Suggestion]) -> str:
    """The frames as CSV; `read_suggestions` reads their numbers back."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*(field.name for field in fields(Suggestion)), "value"])
    writer.writerows((*astuple(each), round(each.value, 4)) for each in suggestions)
    return text.getvalue()


def write_suggestions(texts: Mapping[Path, str]) -> None:
    """Writes each text to its file, all or none.

    Raises:
        ValueError: If a file is there that differs: somebody may have chosen frames in it.
        OSError: If one cannot be written.
    """
    for path, text in texts.items():
        if path.exists() and read_bytes(path, MAX_TEXT_BYTES) != text.encode():
            raise ValueError(
                f"{path}: expected nothing there, or the same suggestions: it has others, or was edited; rename or "
                "remove it"
            )
    with together():
        for path, text in texts.items():
            write_atomic(path, text.encode())


def read_suggestions(path: Path, sequences: Mapping[int, str] | None = None) -> frozenset[int]:
    """The numbers of the frames in the CSV at `path`, by its column `frame`.

    Args:
        path: The file.
        sequences: By number, the sequence of each frame that there is: a file that names another one in its column
            `sequence` is about other frames with the same numbers. None does not check it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it has no such column or no line after it, a line has more or fewer cells than the first, a
            number is none or that of no frame, or a sequence is another one; the message names the line.
    """
    try:
        rows = list(csv.reader(line.decode("utf-8-sig") for line in read_lines(path)))
    except csv.Error as error:
        raise ValueError(f"{path}: expected a CSV file, got {csv_words(error)}") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected a CSV file: {error}") from None
    if not rows or "frame" not in rows[0]:
        raise ValueError(f"{path}: line 1: expected a column called frame, got {shortened(rows[0] if rows else '')}")
    for name in ("frame", "sequence"):
        if rows[0].count(name) > 1:
            raise ValueError(f"{path}: line 1: expected one column called {name}, got {rows[0].count(name)}")
    if len(rows) < 2:
        raise ValueError(f"{path}: line 2: expected at least one frame, got none")
    column, sequence_column = (rows[0].index(name) if name in rows[0] else -1 for name in ("frame", "sequence"))
    frames = set()
    for line, row in enumerate(rows[1:], start=2):
        text = row[column] if column < len(row) else ""
        if not (text.isascii() and text.isdigit() and len(text) < 17):
            raise ValueError(f"{path}: line {line}: frame: expected a number, got {shortened(text)}")
        if len(row) != len(rows[0]):
            raise ValueError(f"{path}: line {line}: expected {len(rows[0])} cells, as in line 1, got {len(row)}")
        if sequences is not None and int(text) not in sequences:
            raise ValueError(
                f"{path}: line {line}: frame: expected one of the {len(sequences)} frames here, got {text}"
            )
        frames.add(int(text))
        named = row[sequence_column] if sequence_column >= 0 else ""
        known = (sequences or {}).get(int(text), named)
        if named not in ("", known):
            raise ValueError(
                f"{path}: line {line}: sequence: expected {repr(known) if known else 'none'} as of frame {text}, got "
                f"{shortened(named)}"
            )
    return frozenset(frames)
