"""The annotated picture of one frame: the frame brightened, its boxes and scores, and a caption below it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.tone import Tone
from foreglow.types import Frame, FrameResult, Tracks, TrackState
from foreglow.types.arrays import check_kind, check_optional
from foreglow.types.kinds import KIND_WORDS, told_kinds

Picture: TypeAlias = NDArray[np.uint8]
"""A colour picture, shape (height, width, 3), uint8, blue green red."""

Rectangle: TypeAlias = tuple[int, int, int, int]
"""x1, y1, x2, y2 in picture pixels, half-open."""

Colour: TypeAlias = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""

SMALLEST_WIDTH_PX = 960
"""Narrower frames are enlarged by a whole factor to at least this width, so that text and lines are legible."""

LARGEST_HEIGHT_PX = 2160
"""No frame is enlarged beyond this height."""

ACCEPTED_BGR = (120, 235, 90)
KIND_BGR: Mapping[str | None, Colour] = MappingProxyType(
    {
        "front_lamp": (90, 240, 255),
        "rear_lamp": (95, 85, 255),
        "front_light": ACCEPTED_BGR,
        "rear_light": (255, 120, 235),
        None: ACCEPTED_BGR,
    }
)
"""Of accepted boxes: lamps yellow and red as they are, light of front lamps green, of rear lamps pink."""

REJECTED_BGR = (180, 160, 145)
PROPOSAL_BGR = (70, 190, 250)
TRACK_BGR = (255, 190, 90)
CAPTION_BGR = (215, 215, 215)
CAPTION_GROUND_BGR = (26, 22, 20)
LABEL_GROUND_BGR = (18, 15, 14)

SMALLEST_CAPTION = 0.5
"""A caption that is too long is not made smaller than this share of its size."""

_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Measures:
    """Sizes of what is drawn, in picture pixels.

    Attributes:
        enlargement: Whole factor from frame to picture.
        thin_px: Line width of proposals and rejected boxes.
        bold_px: Line width of accepted boxes.
        margin_px: How far outside its edge a box is drawn, so that it does not cover the light.
        label_scale: Size of the scores, in OpenCV's font units.
        caption_scale: Size of the caption, in OpenCV's font units.
        caption_px: Height of the strip below the frame.
    """

    enlargement: int
    thin_px: int
    bold_px: int
    margin_px: int
    label_scale: float
    caption_scale: float
    caption_px: int

    @classmethod
    def of(cls, width_px: int, height_px: int) -> Measures:
        """The sizes for a frame of `width_px` columns and `height_px` rows.

        >>> Measures.of(64, 64).enlargement, Measures.of(640, 360).enlargement, Measures.of(2872, 1622).enlargement
        (15, 2, 1)
        """
        enlargement = min(-(-SMALLEST_WIDTH_PX // width_px), max(1, LARGEST_HEIGHT_PX // height_px))
        unit = enlargement * width_px / 1280
        thin_px = max(1, round(unit))
        return cls(
            enlargement=enlargement,
            thin_px=thin_px,
            bold_px=max(2, round(2 * unit)),
            margin_px=max(3, round(4 * unit)),
            label_scale=max(0.42, 0.5 * unit),
            caption_scale=max(0.5, 0.58 * unit),
            caption_px=2 * max(16, round(18 * unit)),
        )


@dataclass(frozen=True, slots=True)
class _Mark:
    """A box to draw, in picture pixels, and its score's text, empty for none."""

    rectangle: Rectangle
    colour_bgr: Colour
    line_px: int
    text: str


def annotate(frame: Frame, result: FrameResult, tone: Tone | None = None) -> Picture:
    """The picture of `frame` with what the pipeline made of it; width and height are even.

    Without a classifier every proposal has a thin amber box. With one, accepted boxes are bold and green, or in the
    colour of their kind, which the caption names, rejected ones thin and grey, each with its score. Around them
    plausible tracks are blue, with number, range, standard deviation and kind: bold where they are confirmed, thin
    where they coast. Boxes are drawn just outside their edges.

    Args:
        frame: The frame.
        result: Its result.
        tone: How grey values become visible; None suits the curve to this frame.

    Raises:
        ValueError: If one of them is something else.
    """
    check_kind("frame", frame, Frame)
    check_kind("result", result, FrameResult)
    check_optional("tone", tone, Tone)
    measures = Measures.of(frame.width_px, frame.height_px)
    grey = (tone or Tone.of(frame.image)).apply(frame.image)
    if measures.enlargement > 1:
        factor = measures.enlargement
        grey = np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR), np.uint8)
    height_px, width_px = grey.shape
    picture = np.empty((_even(height_px + measures.caption_px), _even(width_px), 3), np.uint8)
    picture[height_px:] = CAPTION_GROUND_BGR
    picture[:, width_px:] = CAPTION_GROUND_BGR
    cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR, dst=picture[:height_px, :width_px])
    marks = _marks(result, measures, (width_px, height_px))
    if result.tracks is not None:
        marks += _track_marks(result.tracks, measures, (width_px, height_px))
    for mark in marks:
        x1, y1, x2, y2 = mark.rectangle
        cv2.rectangle(picture, (x1, y1), (x2 - 1, y2 - 1), mark.colour_bgr, mark.line_px, cv2.LINE_8)
    _draw_labels(picture, marks, measures, (width_px, height_px))
    _draw_caption(picture, _caption(frame, result), measures, height_px)
    return picture


def _even(length_px: int) -> int:
    return length_px + length_px % 2


def _marks(result: FrameResult, measures: Measures, size_px: tuple[int, int]) -> list[_Mark]:
    detections = result.detections
    if detections is None:
        boxes = result.proposals.boxes_xyxy_px.tolist()
        return [_Mark(_around(box, measures, size_px), PROPOSAL_BGR, measures.thin_px, "") for box in boxes]
    marks = []
    accepted, kinds = detections.is_accepted, told_kinds(detections.light_kinds)
    for index in np.argsort(accepted, kind="stable").tolist():
        is_accepted = bool(accepted[index])
        marks.append(
            _Mark(
                _around(detections.boxes_xyxy_px[index].tolist(), measures, size_px),
                KIND_BGR[kinds[index]] if is_accepted else REJECTED_BGR,
                measures.bold_px if is_accepted else measures.thin_px,
                f"{detections.scores[index]:.2f}",
            )
        )
    return marks


def _track_marks(tracks: Tracks, measures: Measures, size_px: tuple[int, int]) -> list[_Mark]:
    """The plausible tracks, outside the boxes that they follow; none of what has left the picture."""
    marks = []
    for index in np.flatnonzero(tracks.is_plausible).tolist():
        box = np.rint(tracks.boxes_xyxy_px[index]).astype(int).tolist()
        rectangle = _around(box, measures, size_px, num_margins=2)
        if rectangle[0] < rectangle[2] and rectangle[1] < rectangle[3]:
            line_px = measures.bold_px if tracks.states[index] == TrackState.CONFIRMED else measures.thin_px
            marks.append(_Mark(rectangle, TRACK_BGR, line_px, track_text(tracks, index)))
    return marks


def track_text(tracks: Tracks, index: int) -> str:
    """Number, range and standard deviation, and kind, as far as they are known, such as `#3 85+-12 m, rear lamp`."""
    text = f"#{tracks.ids[index]}{range_text(tracks.ranges_m[index], tracks.sigmas_m[index])}"
    kind = told_kinds(tracks.light_kinds)[index]
    return text if kind is None else f"{text}, {KIND_WORDS[kind]}"


def range_text(range_m: float, sigma_m: float) -> str:
    """Such as ` 85+-12 m`; empty where the range is unknown."""
    if np.isnan(range_m):
        return ""
    return f" {range_m:.0f} m" if np.isinf(sigma_m) else f" {range_m:.0f}+-{sigma_m:.0f} m"


def _around(box: Sequence[int], measures: Measures, size_px: tuple[int, int], num_margins: int = 1) -> Rectangle:
    """`box` in picture pixels with the margin around it, cut to the picture."""
    (width_px, height_px), factor, margin_px = size_px, measures.enlargement, num_margins * measures.margin_px
    return (
        max(0, box[0] * factor - margin_px),
        max(0, box[1] * factor - margin_px),
        min(width_px, box[2] * factor + margin_px),
        min(height_px, box[3] * factor + margin_px),
    )


def _draw_labels(picture: Picture, marks: Sequence[_Mark], measures: Measures, size_px: tuple[int, int]) -> None:
    """Writes the scores beside their boxes, where they cover neither a box nor another score."""
    taken = [mark.rectangle for mark in marks]
    for mark in reversed(marks):  # accepted ones choose first
        if not mark.text:
            continue
        (width_px, height_px), _ = cv2.getTextSize(mark.text, _FONT, measures.label_scale, measures.thin_px)
        label = place_label(mark.rectangle, (width_px + 6, height_px + 6), taken, size_px)
        taken.append(label)
        darken(picture, label)
        origin = (label[0] + 3, label[3] - 4)
        _write(picture, mark.text, origin, measures.label_scale, mark.colour_bgr, measures.thin_px)


def darken(picture: Picture, label: Rectangle) -> None:
    """Makes the ground of a label so dark that its text is legible."""
    x1, y1, x2, y2 = np.maximum(label, 0).tolist()
    ground = picture[y1:y2, x1:x2]
    ground[:] = (0.35 * ground + 0.65 * np.array(LABEL_GROUND_BGR)).astype(np.uint8)


def _write(
    picture: Picture, text: str, origin: tuple[int, int], scale: float, colour_bgr: Colour, line_px: int
) -> None:
    cv2.putText(picture, text, origin, _FONT, scale, colour_bgr, line_px, cv2.LINE_AA)


def place_label(
    box: Rectangle, label_px: tuple[int, int], taken: Sequence[Rectangle], size_px: tuple[int, int]
) -> Rectangle:
    """Where a label of `label_px` goes: the place around `box`, inside the picture, that covers least of `taken`."""
    (x1, y1, x2, y2), (width_px, height_px) = box, label_px
    corners = [
        (x1, y1 - height_px - 2),
        (x1, y2 + 2),
        (x2 + 2, y1),
        (x1 - width_px - 2, y1),
        (x2 - width_px, y1 - height_px - 2),
        (x2 - width_px, y2 + 2),
        (x2 + 2, y2 - height_px),
        (x1 - width_px - 2, y2 - height_px),
    ]
    candidates = [(x, y, x + width_px, y + height_px) for x, y in corners]
    inside = [p for p in candidates if p[0] >= 0 and p[1] >= 0 and p[2] <= size_px[0] and p[3] <= size_px[1]]
    best, least = (0, 0, width_px, height_px), math.inf
    for label in inside:
        covered = sum(overlap_px(label, other) for other in taken)
        if covered < least:
            best, least = label, covered
        if not covered:
            break
    return best


def overlap_px(a: Rectangle, b: Rectangle) -> int:
    """Number of pixels that `a` and `b` share."""
    if a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]:  # of nearly all pairs
        return 0
    return (min(a[2], b[2]) - max(a[0], b[0])) * (min(a[3], b[3]) - max(a[1], b[1]))


def _caption(frame: Frame, result: FrameResult) -> list[tuple[str, Colour]]:
    where = f"{frame.sequence}  frame {frame.frame}" if frame.sequence else f"frame {frame.frame}"
    words = [(where, CAPTION_BGR)]
    count = len(result.proposals)
    if result.detections is None:
        words.append((f"{count} proposal{'' if count == 1 else 's'}, not classified", PROPOSAL_BGR))
    else:
        num_accepted = int(result.detections.is_accepted.sum())
        kinds = told_kinds(result.detections.light_kinds[result.detections.is_accepted])
        if any(kinds):
            counts = {kind: kinds.count(kind) for kind in KIND_WORDS if kind in kinds}
            words += [(f"{KIND_WORDS[kind]}: {num}", KIND_BGR[kind]) for kind, num in counts.items()]
        else:
            words.append((f"{num_accepted} light artifact{'' if num_accepted == 1 else 's'}", ACCEPTED_BGR))
        words.append((f"{count - num_accepted} rejected", REJECTED_BGR))
    if result.tracks is not None:
        num_tracks = int(result.tracks.is_plausible.sum())
        words.append((f"{num_tracks} track{'' if num_tracks == 1 else 's'}", TRACK_BGR))
    if result.stage_ms:
        words.append((f"{sum(result.stage_ms.values()):.2f} ms", CAPTION_BGR))
    return words


def _draw_caption(picture: Picture, words: Sequence[tuple[str, Colour]], measures: Measures, top_px: int) -> None:
    """Writes `words` from left to right into the strip below row `top_px`, smaller where they are too many."""
    x_px, scale = measures.caption_px // 3, measures.caption_scale
    texts_px = sum(cv2.getTextSize(text, _FONT, scale, measures.thin_px)[0][0] for text, _ in words)
    free_px = picture.shape[1] - len(words) * measures.caption_px
    scale *= min(1.0, max(SMALLEST_CAPTION, free_px / max(texts_px, 1)))
    for text, colour_bgr in words:
        (width_px, height_px), _ = cv2.getTextSize(text, _FONT, scale, measures.thin_px)
        origin = (x_px, top_px + (measures.caption_px + height_px) // 2)
        _write(picture, text, origin, scale, colour_bgr, measures.thin_px)
        x_px += width_px + measures.caption_px
