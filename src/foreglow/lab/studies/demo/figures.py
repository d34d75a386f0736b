"""A picture of a drive's story: first light, detection, confirmation, dimming, sight, each with the light enlarged."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.overlay import ACCEPTED_BGR, PROPOSAL_BGR, TRACK_BGR, Colour, Picture
from foreglow.display.tone import Tone
from foreglow.lab.evaluation import Predictions
from foreglow.lab.studies.demo.metrics import Moment, Story
from foreglow.lab.studies.demo.page import PLACES, conclusion, first_words, found_word
from foreglow.types import Frame
from foreglow.whole_files import write_atomic

# The sheet is drawn at twice its size and reduced at the end, so that text and lines are smooth; lengths are in pixels
# of the large one.
REDUCTION = 2
TILE_PX = (1280, 720)
MARGIN_PX, GAP_PX = 56, 36
TITLE_PX, CAPTION_PX, TIMELINE_PX = 130, 150, 190
NUM_COLUMNS = 3
TITLE_SCALE = 2.0

LENS_PX = (448, 280)
LENS_FACTOR = 4
"""The enlargement of the light, and how many times it is enlarged."""

LENS_PEAK, LENS_MAX_GAIN = 235.0, 2.0
"""The brightest of the enlargement is lifted to this grey, but by no more than this factor."""

HORIZON_SHARE = 0.62
"""How far down in its tile the light is, so that there is dark sky above it for the enlargement."""

GROUND_BGR = (26, 22, 20)
TEXT_BGR = (232, 230, 228)
FAINT_BGR = (150, 146, 142)
LIGHT_BGR = (70, 190, 250)
SIGHT_BGR = (250, 225, 190)
BEAM_BGR = (220, 130, 235)
FADED_BGR = (112, 100, 90)
"""Colour of rejected boxes."""

MOMENTS = ("light", "found", "confirmed", "dimmed", "sight", "reported")
"""What may be shown of a story."""

_FONT = cv2.FONT_HERSHEY_DUPLEX


@dataclass(frozen=True, slots=True)
class _Scene:
    """A moment with what is drawn of it.

    Attributes:
        words: What happens, for the caption.
        note: A few more words; may be empty.
        colour_bgr: Of its number and its enlargement.
        gap_rad: Right and left border of the dark gap in which the vehicle comes into sight; None without one.
    """

    moment: Moment
    words: str
    note: str
    colour_bgr: Colour
    frame: Frame
    gap_rad: tuple[float, float] | None


def write_moments(
    path: Path,
    story: Story,
    frames: Sequence[Frame],
    predictions: Predictions,
    threshold: float,
    names: Collection[str] = MOMENTS,
) -> None:
    """Writes the picture of `story` to `path`, as PNG.

    Raises:
        OSError: If the file cannot be written.
    """
    picture = moments_picture(story, frames, predictions, threshold, names)
    write_atomic(path, cv2.imencode(".png", picture)[1].tobytes())


def moments_picture(
    story: Story,
    frames: Sequence[Frame],
    predictions: Predictions,
    threshold: float,
    names: Collection[str] = MOMENTS,
) -> Picture:
    """The picture of `story`.

    Args:
        story: What happens.
        frames: Those of all its moments.
        predictions: Of the run; for the boxes.
        threshold: Boxes with a score above this are accepted.
        names: The moments to show, of `MOMENTS`.
    """
    scenes = _scenes(story, frames, names, is_classified=predictions.is_scored)
    num_columns, num_rows = min(len(scenes), NUM_COLUMNS), -(-len(scenes) // NUM_COLUMNS)
    width_px = 2 * MARGIN_PX + num_columns * TILE_PX[0] + (num_columns - 1) * GAP_PX
    row_px = TILE_PX[1] + CAPTION_PX
    height_px = TITLE_PX + num_rows * row_px + TIMELINE_PX
    sheet: Picture = np.full((height_px, width_px, 3), GROUND_BGR, np.uint8)
    title = f"The {story.vehicle} was {conclusion(story, is_classified=predictions.is_scored)}"
    title_px = cv2.getTextSize(title, _FONT, TITLE_SCALE, 2)[0][0]
    scale = TITLE_SCALE * min(1.0, (width_px - 2 * MARGIN_PX) / title_px)
    _write(sheet, title, (MARGIN_PX, TITLE_PX - 44), scale, TEXT_BGR)
    tone = Tone.of(scenes[0].frame.image)
    centre_y = float(np.mean([scene.moment.light.position_px[1] / scene.frame.width_px for scene in scenes]))
    for index, scene in enumerate(scenes):
        row, column = divmod(index, NUM_COLUMNS)
        top, left = TITLE_PX + row * row_px, MARGIN_PX + column * (TILE_PX[0] + GAP_PX)
        tile = _tile(scene, tone, centre_y, predictions, threshold)
        sheet[top : top + TILE_PX[1], left : left + TILE_PX[0]] = tile
        _draw_caption(sheet, scene, index + 1, (left, top + TILE_PX[1]))
    _draw_timeline(sheet, story, scenes, TITLE_PX + num_rows * row_px)
    small = (width_px // REDUCTION, height_px // REDUCTION)
    return np.asarray(cv2.resize(sheet, small, interpolation=cv2.INTER_AREA), np.uint8)


def _scenes(story: Story, frames: Sequence[Frame], names: Collection[str], *, is_classified: bool) -> list[_Scene]:
    looks = {
        "light": (first_words(story), LIGHT_BGR),
        "found": (found_word(is_classified), ACCEPTED_BGR),
        "confirmed": ("confirmed by the tracker", TRACK_BGR),
        "dimmed": ("beam dark where it will be", BEAM_BGR),
        "sight": (f"{story.vehicle} in sight", SIGHT_BGR),
        "reported": ("the production system reports it", TEXT_BGR),
    }
    scenes = []
    for (name, moment), frame in zip(story.moments.items(), frames, strict=True):
        if name not in names:
            continue
        note = "" if name == "sight" else PLACES.get(moment.light.kind, f"on {moment.light.kind}")
        if name == "found" and not math.isnan(moment.score):
            note += f", score {moment.score:.2f}"
        gap_rad = (story.gaps_rad or {}).get(moment.time_s)
        scenes.append(_Scene(moment, looks[name][0], note, looks[name][1], frame, gap_rad))
    return scenes


def _tile(scene: _Scene, tone: Tone, centre_y: float, predictions: Predictions, threshold: float) -> Picture:
    """The part of the image around the horizon, its boxes, and the light enlarged in the sky."""
    factor = TILE_PX[0] / scene.frame.width_px
    grey = tone.apply(scene.frame.image)
    method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    whole = np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=method), np.uint8)
    rows = max(whole.shape[0], TILE_PX[1])
    picture = np.zeros((rows, TILE_PX[0], 3), np.uint8)
    picture[: whole.shape[0], : whole.shape[1]] = whole[:, : TILE_PX[0], None]
    x, y = (factor * value for value in scene.moment.light.position_px)
    lens = _lens(picture, (x, y))
    if scene.gap_rad is not None:
        _draw_gap(picture, scene.frame, scene.gap_rad, factor)
    _draw_boxes(picture, scene.frame.frame, predictions, threshold, factor)
    top = min(max(round(centre_y * TILE_PX[0] - HORIZON_SHARE * TILE_PX[1]), 0), rows - TILE_PX[1])
    tile = picture[top : top + TILE_PX[1]]
    _draw_lens(tile, lens, (round(x), round(y) - top), scene.colour_bgr)
    return tile


def _draw_gap(picture: Picture, frame: Frame, gap_rad: tuple[float, float], factor: float) -> None:
    """Lines at the borders of a dark gap, and a tint between them."""
    assert frame.camera is not None
    azimuths = np.array(gap_rad)
    directions = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(2)], axis=-1)
    columns = frame.camera.project(directions @ frame.camera.vehicle_from_camera.rotation)[:, 0]
    right, left = np.clip(np.rint(factor * columns), 0, picture.shape[1] - 1).astype(int).tolist()
    inside = picture[:, left : right + 1]
    inside[:] = (0.85 * inside + 0.15 * np.array(BEAM_BGR)).astype(np.uint8)
    for x in (left, right):
        cv2.line(picture, (x, 0), (x, picture.shape[0]), BEAM_BGR, 3, cv2.LINE_AA)


def _lens(picture: Picture, at_px: tuple[float, float]) -> Picture:
    """What is around a point, enlarged, and brightened where it is faint."""
    width, height = LENS_PX[0] // LENS_FACTOR, LENS_PX[1] // LENS_FACTOR
    left = min(max(round(at_px[0]) - width // 2, 0), picture.shape[1] - width)
    top = min(max(round(at_px[1]) - height // 2, 0), picture.shape[0] - height)
    part = picture[top : top + height, left : left + width]
    enlarged = np.asarray(cv2.resize(part, LENS_PX, interpolation=cv2.INTER_CUBIC), np.float64)
    gain = min(max(LENS_PEAK / max(float(enlarged.max()), 1.0), 1.0), LENS_MAX_GAIN)
    return np.clip(gain * enlarged, 0, 255).astype(np.uint8)


def _draw_lens(tile: Picture, lens: Picture, at_px: tuple[int, int], colour_bgr: Colour) -> None:
    """Puts the enlargement where it hides neither the light nor the road: above it, or below if there is no room."""
    (width, height), (half_x, half_y) = LENS_PX, (LENS_PX[0] // LENS_FACTOR // 2, LENS_PX[1] // LENS_FACTOR // 2)
    x, y = at_px
    left = min(max(x - width // 2, 28), TILE_PX[0] - width - 28)
    is_above = y - half_y - height - 60 >= 0
    top = 28 if is_above else TILE_PX[1] - height - 28
    edge, inner = (top + height, y - half_y) if is_above else (top, y + half_y)
    for corner, source in ((left, x - half_x), (left + width, x + half_x)):
        cv2.line(tile, (corner, edge), (source, inner), colour_bgr, 2, cv2.LINE_AA)
    cv2.rectangle(tile, (x - half_x, y - half_y), (x + half_x, y + half_y), colour_bgr, 2, cv2.LINE_AA)
    tile[top : top + height, left : left + width] = lens
    cv2.rectangle(tile, (left, top), (left + width, top + height), colour_bgr, 4, cv2.LINE_AA)


def _draw_boxes(picture: Picture, image_id: int, predictions: Predictions, threshold: float, factor: float) -> None:
    """Accepted boxes bold and green, rejected ones thin and dark, unscored ones amber."""
    boxes = predictions.boxes_xyxy_px.get(image_id, np.empty((0, 4)))
    scores: NDArray[np.float64] = predictions.scores.get(image_id, np.empty(0))
    for index in np.argsort(scores > threshold, kind="stable").tolist():  # accepted ones last, on top
        x1, y1, x2, y2 = (round(factor * value) for value in boxes[index].tolist())
        colour_bgr, line_px = (ACCEPTED_BGR, 4) if scores[index] > threshold else (FADED_BGR, 2)
        if not predictions.is_scored:
            colour_bgr, line_px = PROPOSAL_BGR, 2
        cv2.rectangle(picture, (x1 - 6, y1 - 6), (x2 + 5, y2 + 5), colour_bgr, line_px, cv2.LINE_AA)


def _draw_caption(sheet: Picture, scene: _Scene, number: int, corner_px: tuple[int, int]) -> None:
    left, top = corner_px
    _draw_number(sheet, number, (left + 34, top + 62), scene.colour_bgr)
    _write(sheet, f"{scene.moment.time_s:.2f} s", (left + 90, top + 82), 1.9, scene.colour_bgr)
    _write(sheet, scene.words, (left + 360, top + 62), 1.15, TEXT_BGR)
    _write(sheet, scene.note, (left + 360, top + 108), 1.0, FAINT_BGR)


def _draw_timeline(sheet: Picture, story: Story, scenes: Sequence[_Scene], top_px: int) -> None:
    """The drive from its beginning to its end, with the moments' numbers and the time that was won."""
    left, right, y = MARGIN_PX + 34, sheet.shape[1] - MARGIN_PX - 34, top_px + 70
    scale = (right - left) / max(story.duration_s, 1e-9)

    def x_of(time_s: float) -> int:
        return left + int(scale * time_s + 0.5)

    cv2.line(sheet, (left, y), (right, y), FAINT_BGR, 4, cv2.LINE_AA)
    for second in range(math.floor(story.duration_s) + 1):
        cv2.line(sheet, (x_of(second), y - 10), (x_of(second), y + 10), FAINT_BGR, 3, cv2.LINE_AA)
        _write(sheet, f"{second} s", (x_of(second) - 22, y + 84), 0.95, FAINT_BGR)
    if story.times.lead_s > 0:
        begin, end = x_of(story.times.found_s), x_of(story.times.lamp_s)
        cv2.rectangle(sheet, (begin, y - 9), (end, y + 9), ACCEPTED_BGR, -1, cv2.LINE_AA)
        _write_centred(sheet, f"{story.times.lead_s:.2f} s ahead", (begin + end) // 2, y - 28, ACCEPTED_BGR)
    latest = -math.inf
    for number, scene in enumerate(scenes, start=1):
        latest = max(latest + 60, x_of(scene.moment.time_s))
        _draw_number(sheet, number, (round(latest), y), scene.colour_bgr)


def _draw_number(sheet: Picture, number: int, centre_px: tuple[int, int], colour_bgr: Colour) -> None:
    cv2.circle(sheet, centre_px, 28, colour_bgr, -1, cv2.LINE_AA)
    _write(sheet, str(number), (centre_px[0] - 13, centre_px[1] + 15), 1.2, GROUND_BGR)


def _write_centred(sheet: Picture, text: str, x_px: int, y_px: int, colour_bgr: Colour) -> None:
    width = cv2.getTextSize(text, _FONT, 1.0, 2)[0][0]
    left = min(max(x_px - width // 2, MARGIN_PX), sheet.shape[1] - MARGIN_PX - width)
    _write(sheet, text, (left, y_px), 1.0, colour_bgr)


def _write(sheet: Picture, text: str, origin_px: tuple[int, int], scale: float, colour_bgr: Colour) -> None:
    cv2.putText(sheet, text, origin_px, _FONT, scale, colour_bgr, 2, cv2.LINE_AA)
