"""What the viewer shows of one frame, as Rerun's archetypes with the paths of their entities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from foreglow.display.beam_view import (
    DARK_LED_BGR,
    EDGE_BGR,
    FAINT_BGR,
    FAULT_BGR,
    GAP_BGR,
    LIT_LED_BGR,
    MODES,
    gap_outline_px,
    road_edge,
)
from foreglow.display.overlay import (
    CAPTION_BGR,
    KIND_BGR,
    PROPOSAL_BGR,
    REJECTED_BGR,
    TRACK_BGR,
    Colour,
    Rectangle,
    place_label,
    track_text,
)
from foreglow.display.tone import Tone
from foreglow.display.viewer.blueprint import SIDES
from foreglow.display.viewer.outputs import Entities
from foreglow.geometry import Camera, Floats
from foreglow.rays import RayCaster
from foreglow.types import BeamCommand, Detections, Frame, Proposals, RoadAhead, Tracks, TrackState
from foreglow.types.kinds import KIND_WORDS, tells_rear, told_kinds

FARTHEST_M = 200.0
"""Where directions without a range end, from the vehicle's origin."""

DISTANCES_M = (25.0, 50.0, 100.0, 150.0, 200.0)
"""Of the arcs that show how far away something is."""

ARC_STEP_RAD = math.radians(1.0)
"""Between the corners of an arc, at most."""

ARC_HALF_RAD = math.radians(12.0)
"""How far the arcs of distance reach to either side: so far that they are whole where the viewer opens."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackBars:
    """Where M tracks are, seen from above.

    Attributes:
        places_m: Shape (M, 2), the middle of the box at the track's range; NaN where the range is unknown.
        bars_m: For each track a closed line, shape (5, 2): its standard deviation to either side along the viewing
            ray, and the width of its box across; where the range is unknown, the two borders of where it is from the
            camera to `FARTHEST_M`. A range without a standard deviation is a line across, shape (2, 2).
    """

    places_m: Floats
    bars_m: tuple[Floats, ...]


def road_lines_m(road: RoadAhead) -> tuple[Floats, Floats, Floats]:
    """Centre line, left and right edge from above, shape (N, 2) each."""
    return road_edge(road, 0.0), road_edge(road, 1.0), road_edge(road, -1.0)


def arc_m(distance_m: float, from_rad: float, until_rad: float) -> Floats:
    """Points at a distance from the vehicle's origin, shape (N, 2), from one azimuth to another.

    >>> arc_m(10.0, 0.0, 0.01).round(2).tolist()
    [[10.0, 0.0], [10.0, 0.1]]
    """
    num = 2 + int(abs(until_rad - from_rad) / ARC_STEP_RAD)
    azimuths = np.linspace(from_rad, until_rad, num)
    return distance_m * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)


def gap_sector_m(borders_rad: Floats, range_m: float) -> Floats:
    """The corners of a dark gap from above, shape (N, 2): the vehicle's origin, then an arc from right to left.

    Args:
        borders_rad: Shape (2,), right and left azimuth, as in `BeamCommand.gaps_rad`.
        range_m: To what the gap is for; it reaches `FARTHEST_M` where that is unknown (NaN) or farther away.
    """
    right, left = borders_rad.tolist()
    reach_m = FARTHEST_M if math.isnan(range_m) else min(range_m, FARTHEST_M)
    return np.vstack([np.zeros((1, 2)), arc_m(reach_m, right, left)])


def fan_triangles(num_corners: int) -> NDArray[np.uint32]:
    """The triangles that fill a sector of so many corners, shape (N, 3), all from the first corner.

    >>> fan_triangles(4).tolist()
    [[0, 1, 2], [0, 2, 3]]
    """
    seconds = np.arange(1, num_corners - 1, dtype=np.uint32)
    return np.stack([np.zeros_like(seconds), seconds, seconds + 1], axis=1)


def track_bars(camera: Camera, tracks: Tracks, caster: RayCaster) -> TrackBars:
    """Where the tracks are.

    Raises:
        ValueError: If the camera's distortion cannot be undone.
    """
    boxes, count = tracks.boxes_xyxy_px, len(tracks)
    pixels = np.empty((3, count, 2))
    pixels[0, :, 0], pixels[1, :, 0], pixels[2, :, 0] = boxes[:, 0], 0.5 * (boxes[:, 0] + boxes[:, 2]), boxes[:, 2]
    pixels[..., 1] = 0.5 * (boxes[:, 1] + boxes[:, 3])
    rays = caster.cast(camera, pixels.reshape(-1, 2))
    origin, directions = rays.origin_m[:2], rays.directions[:, :2].reshape(3, count, 2)
    middles_m = origin + tracks.ranges_m[:, np.newaxis] * directions[1]
    bars = tuple(
        _bar(origin, directions[0, index], directions[2, index], range_m, sigma_m)
        for index, (range_m, sigma_m) in enumerate(zip(tracks.ranges_m.tolist(), tracks.sigmas_m.tolist(), strict=True))
    )
    return TrackBars(middles_m, bars)


def _bar(origin: Floats, left: Floats, right: Floats, range_m: float, sigma_m: float) -> Floats:
    """The bar of one track between the rays through its box's left and right border."""
    if math.isnan(range_m):
        return np.stack([origin + FARTHEST_M * left, origin, origin + FARTHEST_M * right])
    if math.isinf(sigma_m):
        return np.stack([origin + range_m * left, origin + range_m * right])
    near_m, far_m = max(0.0, range_m - sigma_m), range_m + sigma_m
    corners = [near_m * left, far_m * left, far_m * right, near_m * right, near_m * left]
    return np.stack([origin + corner for corner in corners])


Entity = tuple[str, Any]

THIN_PX, BOLD_PX = 0.75, 1.5
"""Half widths of lines in the camera's image and, as the viewer's own points, in the bird's-eye view."""

MARGIN_PX = 4.0
"""How far outside its edge a box is drawn, so that it does not cover the light; tracks twice as far."""

LETTER_SHARES = 0.0105, 0.036
"""Width of a letter and height of a line of the viewer's words, as shares of the image's width where it opens."""

GAP_OPACITY = 70
"""Of the filled sectors, of 255."""

HEIGHTS_M = {"road": 0.0, "gaps": 0.05, "tracks": 0.3}
"""Of what lies flat in the bird's-eye view, so that one thing is above the other."""

CAR_HALF_M, CAR_CENTRE_M = (2.3, 0.9, 0.7), (1.4, 0.0, 0.7)
"""Our car: half of its length, width and height, and its middle in the vehicle's frame."""


def fixed_entities() -> Entities:
    """What stays: the arcs of distance, our car, and what modes of the beam look like."""
    arcs = [_flat(arc_m(distance_m, -ARC_HALF_RAD, ARC_HALF_RAD), "road") for distance_m in DISTANCES_M]
    ends = [arc[0] for arc in arcs]
    labels = [f"{distance_m:.0f} m" for distance_m in DISTANCES_M]
    names = {mode: mode.name.lower() for mode in MODES}
    values = [names[mode] for mode in MODES]
    words = [words.lower() for words, _ in MODES.values()]
    colours = [_rgb(colour) for _, colour in MODES.values()]
    modes = rr.StateConfiguration(values=values, labels=words, colors=colours)
    style = rr.SeriesPoints(colors=_rgb(PROPOSAL_BGR), markers="circle", marker_sizes=2.0)
    return [
        ("map", rr.ViewCoordinates.FLU),
        ("map/distances", rr.LineStrips3D(arcs, colors=_rgb(FAINT_BGR), radii=rr.Radius.ui_points(0.5))),
        ("map/distances/labels", _named_places(np.array(ends), labels, FAINT_BGR)),
        ("map/car", rr.Boxes3D(centers=CAR_CENTRE_M, half_sizes=CAR_HALF_M, colors=_rgb(EDGE_BGR), fill_mode="solid")),
        ("states/beam", modes),
        ("plots/scores", style),
        ("plots/ms/total", rr.SeriesLines(colors=_rgb(CAPTION_BGR), widths=2.0, names="total")),
    ]


def image_entity(frame: Frame, tone: Tone, jpeg_quality: int | None) -> Entity:
    """The frame as people can see it, 8 bits, as JPEG of a quality or, with None, exactly."""
    grey = tone.apply(frame.image)
    if jpeg_quality is None:
        return "camera/image", rr.Image(grey)
    encoded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])[1]
    return "camera/image", rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")


def box_entities(proposals: Proposals, detections: Detections | None) -> Entities:
    """Proposals thin, amber where nothing classified them and grey where they were rejected; detections bold.

    Detections have the colour of their kind, green where that is unknown.
    """
    if detections is None:
        return [("camera/proposals", _boxes(proposals.boxes_xyxy_px, [PROPOSAL_BGR], THIN_PX))]
    accepted = detections.is_accepted
    colours = [KIND_BGR[kind] for kind in told_kinds(detections.light_kinds[accepted])]
    return [
        ("camera/proposals", _boxes(detections.boxes_xyxy_px[~accepted], [REJECTED_BGR], THIN_PX)),
        ("camera/detections", _boxes(detections.boxes_xyxy_px[accepted], colours, BOLD_PX)),
    ]


def track_entity(tracks: Tracks) -> Entity:
    """The tracks in the image: bold where confirmed, thin where they coast, thin and grey while they are tentative."""
    boxes = rr.Boxes2D(
        array=_grown(tracks.boxes_xyxy_px, 2.0 * MARGIN_PX),
        array_format=rr.Box2DFormat.XYXY,
        colors=_track_colours(tracks),
        radii=_track_radii(tracks),
    )
    return "camera/tracks", boxes


def word_entity(frame: Frame, detections: Detections | None, tracks: Tracks | None) -> Entity:
    """What the boxes are, beside them, where it covers least: words of the plausible tracks, scores of detections."""
    named: list[tuple[NDArray[Any], str, Colour]] = []
    if tracks is not None:
        for index in np.flatnonzero(tracks.is_plausible).tolist():
            box = _grown(tracks.boxes_xyxy_px[index], 2.0 * MARGIN_PX)
            named.append((box, track_words(tracks, index), TRACK_BGR))
    if detections is not None:
        boxes = _grown(detections.accepted_boxes_xyxy_px, MARGIN_PX)
        scores = detections.scores[detections.is_accepted].tolist()
        kinds = told_kinds(detections.light_kinds[detections.is_accepted])
        for box, score, kind in zip(boxes, scores, kinds, strict=True):
            named.append((box, f"{score:.2f}" if kind is None else f"{score:.2f} {KIND_WORDS[kind]}", KIND_BGR[kind]))
    letter_px, line_px = (share * frame.width_px for share in LETTER_SHARES)
    rectangles: list[Rectangle] = []
    for box, _, _ in named:
        x1, y1, x2, y2 = np.rint(box).astype(int).tolist()
        rectangles.append((x1, y1, x2, y2))
    taken, centres = list(rectangles), []
    for rectangle, (_, words, _) in zip(rectangles, named, strict=True):
        label_px = round(letter_px * len(words)), round(line_px)
        label = place_label(rectangle, label_px, taken, (frame.width_px, frame.height_px))
        taken.append(label)
        centres.append((0.5 * (label[0] + label[2]), 0.5 * (label[1] + label[3])))
    points = rr.Points2D(
        np.reshape(centres, (-1, 2)),
        labels=[words for _, words, _ in named],
        colors=[_rgb(colour) for _, _, colour in named],
        radii=0.0,
        show_labels=True,
    )
    return "camera/words", points


def track_words(tracks: Tracks, index: int) -> str:
    """Number, range and standard deviation, its kind, and its state unless it is confirmed.

    Such as `#3 85+-12 m, rear lamp, coasting`; `direct` or `indirect` where a lamp is only told from its light.
    """
    words = [track_text(tracks, index)]
    direct = float(tracks.direct_probabilities[index])
    if not (np.isnan(direct) or tells_rear(tracks.light_kinds)):
        words.append("direct" if direct > 0.5 else "indirect")
    if tracks.states[index] != TrackState.CONFIRMED:
        words.append(TrackState(tracks.states[index]).name.lower())
    return ", ".join(words)


def map_entities(frame: Frame, tracks: Tracks | None, beam: BeamCommand | None, caster: RayCaster) -> Entities:
    """Road, tracks and gaps from above, in the vehicle's frame; without a camera tracks have no place there."""
    entities: list[Entity] = []
    lines = [] if frame.road is None else [_flat(line, "road") for line in road_lines_m(frame.road)]
    widths = rr.Radius.ui_points([THIN_PX, BOLD_PX, BOLD_PX][: len(lines)])
    entities.append(("map/road", rr.LineStrips3D(lines, colors=_rgb(EDGE_BGR), radii=widths)))
    if tracks is not None and frame.camera is not None:
        bars = track_bars(frame.camera, tracks, caster)
        strips = [_flat(bar, "tracks") for bar in bars.bars_m]
        radii = rr.Radius.ui_points(_track_radii(tracks))
        entities.append(("map/tracks", rr.LineStrips3D(strips, colors=_track_colours(tracks), radii=radii)))
        is_placed = tracks.is_plausible & _is_near(bars.places_m)
        words = [track_words(tracks, index) for index in np.flatnonzero(is_placed).tolist()]
        labels = _named_places(_flat(bars.places_m[is_placed], "tracks"), words, TRACK_BGR, radius=4.0)
        entities.append(("map/tracks/places", labels))
    if beam is not None:
        entities += _gap_entities(frame, beam)
    return entities


def _gap_entities(frame: Frame, beam: BeamCommand) -> Entities:
    gaps = list(zip(beam.gaps_rad, beam.gap_ranges_m.tolist(), strict=True))
    sectors = [_flat(gap_sector_m(borders_rad, range_m), "gaps") for borders_rad, range_m in gaps]
    corners = np.concatenate([np.zeros((0, 3)), *sectors])
    starts = np.cumsum([0, *(len(sector) for sector in sectors)])
    fans = [fan_triangles(len(sector)) + np.uint32(start) for sector, start in zip(sectors, starts, strict=False)]
    triangles = np.concatenate([np.zeros((0, 3), np.uint32), *fans])
    filled: Any = rr.Clear(recursive=False)
    if sectors:
        filled = rr.Mesh3D(
            vertex_positions=corners, triangle_indices=triangles, albedo_factor=(*_rgb(GAP_BGR), GAP_OPACITY)
        )
    closed = [np.vstack([sector, sector[:1]]) for sector in sectors]
    outlines = rr.LineStrips3D(closed, colors=_rgb(GAP_BGR), radii=rr.Radius.ui_points(THIN_PX))
    entities: list[Entity] = [("map/gaps/inside", filled), ("map/gaps/borders", outlines)]
    if frame.camera is not None:
        camera = frame.camera
        lines = [gap_outline_px(camera, borders_rad, range_m) for borders_rad, range_m in gaps]
        lines = [line[np.isfinite(line).all(axis=1)] for line in lines]
        shown = [line for line in lines if len(line) > 1]
        entities.append(("camera/gaps", rr.LineStrips2D(shown, colors=_rgb(GAP_BGR), radii=THIN_PX)))
    return entities


def lamp_entities(beam: BeamCommand, num_columns: int) -> Entities:
    """The LEDs of both lamps as small pictures, as the driver sees their light: row 0 below, column 0 at the right."""
    return [
        (f"lamps/{side}", rr.Image(led_picture(levels, num_columns)))
        for side, levels in zip(SIDES, beam.levels, strict=True)
    ]


def led_picture(levels: Floats, num_columns: int) -> NDArray[np.uint8]:
    """A pixel an LED, shape (rows, columns, 3), red green blue, dark to lit.

    >>> int(led_picture(np.array([1.0, 0.0, 0.0, 0.0]), 2)[..., 0].argmax())  # the lowest row's right one
    3
    """
    grid = levels.reshape(-1, num_columns)[::-1, ::-1, np.newaxis]
    dark, lit = (np.array(_rgb(colour), np.float64) for colour in (DARK_LED_BGR, LIT_LED_BGR))
    return np.rint(dark + grid * (lit - dark)).astype(np.uint8)


def fault_words(faults: tuple[str, ...]) -> str:
    """Faults in words; empty without any."""
    return ", ".join(fault.replace("_", " ") for fault in faults)


def log_entity(text: str, *, is_fault: bool) -> Entity:
    """A line of the log."""
    level = rr.TextLogLevel.WARN if is_fault else rr.TextLogLevel.INFO
    return "log", rr.TextLog(text, level=level, color=_rgb(FAULT_BGR if is_fault else EDGE_BGR))


def _rgb(colour_bgr: Colour) -> Colour:
    blue, green, red = colour_bgr
    return red, green, blue


def _grown(boxes: NDArray[Any], margin_px: float) -> Floats:
    return np.asarray(boxes, np.float64) + margin_px * np.array([-1.0, -1.0, 1.0, 1.0])


def _boxes(boxes: NDArray[Any], colours: Sequence[Colour], radius: float) -> Any:
    """Boxes of a colour each, or all of the same."""
    return rr.Boxes2D(
        array=_grown(boxes, MARGIN_PX),
        array_format=rr.Box2DFormat.XYXY,
        colors=[_rgb(colour) for colour in colours],
        radii=radius,
    )


def _track_colours(tracks: Tracks) -> list[Colour]:
    return [_rgb(TRACK_BGR if plausible else REJECTED_BGR) for plausible in tracks.is_plausible.tolist()]


def _track_radii(tracks: Tracks) -> list[float]:
    return [BOLD_PX if state == TrackState.CONFIRMED else THIN_PX for state in tracks.states.tolist()]


def _named_places(points_m: Floats, words: list[str], colour: Colour, radius: float = 0.0) -> Any:
    radii = rr.Radius.ui_points(radius)
    return rr.Points3D(points_m, labels=words, colors=_rgb(colour), radii=radii, show_labels=True)


def _flat(points_m: Floats, layer: str) -> Floats:
    """Points of the road plane, shape (N, 2), as points of the vehicle's frame, cut off beyond `FARTHEST_M`."""
    near = points_m[_is_near(points_m)]
    return np.column_stack([near, np.full(len(near), HEIGHTS_M[layer])])


def _is_near(points_m: Floats) -> NDArray[np.bool_]:
    """Which points, shape (N, 2), are shown from above: those up to `FARTHEST_M`, none of an unknown place."""
    return np.asarray(np.hypot(points_m[:, 0], points_m[:, 1]) <= 1.001 * FARTHEST_M)
