"""The picture of a beam: left the camera, right the LEDs of both headlamps and their light on the road from above."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.overlay import (
    CAPTION_BGR,
    CAPTION_GROUND_BGR,
    TRACK_BGR,
    Colour,
    Picture,
    Rectangle,
    darken,
    overlap_px,
    place_label,
    track_text,
)
from foreglow.display.pen import Pen
from foreglow.display.tone import Tone
from foreglow.geometry import Camera, Floats, rotation_angles_rad
from foreglow.photometry import Headlamp, Headlamps
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, RoadAhead, Tracks, TrackState

AHEAD_M = 120.0
"""From the vehicle's origin to the upper border of the map."""

ASIDE_M = 25.0
"""From its middle to the left and right border."""

CELLS = (120, 200)
"""Rows and columns of the map's own grid: 1 m along the road, 0.25 m across."""

DARKEST_LX, BRIGHTEST_LX = 0.05, 200.0
"""Ends of the logarithmic colour scale."""

TICKS_LX = (0.1, 1.0, 10.0, 100.0)

CHUNK = 4000
"""Points whose light is computed at once."""


class RoadLight:
    """What a pair of headlamps shines on the places of a level plane, with all that does not change worked out once.

    The illuminance is that of a surface that faces the lamps, as everywhere in Foreglow.
    """

    def __init__(self, headlamps: Headlamps, height_m: float = 0.0) -> None:
        """The light in the plane z = `height_m`: 0 is the road; at drivers' eyes, 1.2, low beam hides no gap."""
        rows, columns = CELLS
        ahead = AHEAD_M * (1.0 - (np.arange(rows) + 0.5) / rows)
        left = ASIDE_M * (1.0 - 2.0 * (np.arange(columns) + 0.5) / columns)
        x, y = np.meshgrid(ahead, left, indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, height_m)], axis=1)
        base, leds = [], []
        for first in range(0, len(points), CHUNK):
            base_lx, leds_lx = headlamps.illuminance_lx(points[first : first + CHUNK])
            base.append(base_lx)
            leds.append(leds_lx.reshape(len(base_lx), -1).astype(np.float32))
        self._base_lx = np.concatenate(base).astype(np.float32)
        self._leds_lx = np.concatenate(leds)

    def illuminance_lx(self, levels: NDArray[np.float64]) -> NDArray[np.float32]:
        """Shape `CELLS`: furthest row first, from left to right as the driver sees it; `levels` has shape (2, L)."""
        lit = self._leds_lx @ levels.ravel().astype(np.float32)
        return (self._base_lx + lit).reshape(CELLS)

    def picture(self, levels: NDArray[np.float64], width_px: int, height_px: int) -> Picture:
        """The map in colour; `colours` says which stands for what."""
        shares = _share(np.maximum(self.illuminance_lx(levels), 1e-6))
        smooth = cv2.resize(shares, (width_px, height_px), interpolation=cv2.INTER_LINEAR)
        return colours(np.asarray(smooth, np.float32))


def colours(shares: NDArray[np.float32]) -> Picture:
    """The colours of places on the scale, shape (height, width), 0 (`DARKEST_LX`) to 1 (`BRIGHTEST_LX`)."""
    values = np.rint(255.0 * np.clip(shares, 0.0, 1.0)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(values, cv2.COLORMAP_INFERNO), np.uint8)


def place_on_scale(lux: float) -> float:
    """Where an illuminance lies on the colour scale, 0 to 1 within it.

    >>> place_on_scale(DARKEST_LX), place_on_scale(BRIGHTEST_LX)
    (0.0, 1.0)
    """
    return float(_share(np.array(lux, np.float64)))


def _share(lux: NDArray[np.float32] | NDArray[np.float64]) -> NDArray[np.float32]:
    return np.asarray(np.log(lux / DARKEST_LX) / np.log(BRIGHTEST_LX / DARKEST_LX), np.float32)


DEFAULT_HEIGHT_PX = 1080
SMALLEST_HEIGHT_PX = 360

EYE_HEIGHT_M = 1.2
"""Of drivers of cars, above the road."""

PANEL_SHARE = 4 / 9
"""Width of the right side over the picture's height: beside a camera of 4:3 this makes 16:9."""

MARGIN = 20
"""Around everything on the right side, in pixels of a picture of 1080 rows, as all sizes here."""

CAPTION = 12
"""Height of the text on the right side."""

LABEL = 11
"""Height of the text beside boxes and gaps."""

ROAD_STEP_M = 4.0
"""Between the corners of the road's edges as they are drawn: lines of many short pieces look like beads."""

GAP_BGR = (214, 226, 92)
FAULT_BGR = (96, 96, 255)
FAINT_BGR = (138, 130, 124)
EDGE_BGR = (196, 190, 184)
DARK_LED_BGR = (52, 46, 42)
LIT_LED_BGR = (206, 240, 255)

MODES: dict[BeamMode, tuple[str, Colour]] = {
    BeamMode.LOW: ("LOW BEAM", (110, 205, 250)),
    BeamMode.GLARE_FREE: ("GLARE-FREE HIGH BEAM", GAP_BGR),
    BeamMode.FULL: ("FULL HIGH BEAM", (255, 190, 120)),
}

GAP_ELEVATIONS_DEG = (-1.0, 4.0)
"""From where to where a gap is drawn in the camera's picture: about as high as the LEDs shine."""

UNKNOWN_RANGE_M = 100.0
"""Where a gap of unknown range is drawn: far away the camera's place does not matter."""

GAP_TINT = 0.12
"""How much of its colour a gap takes on in the camera's picture."""


class BeamView:
    """Draws pictures of one height for one pair of headlamps."""

    def __init__(self, headlamps: Headlamps, height_px: int = DEFAULT_HEIGHT_PX, map_height_m: float = 0.0) -> None:
        """A view; the headlamps' light on every place of the road is worked out here, once.

        Args:
            headlamps: What shines.
            height_px: Of the pictures; an odd one becomes even.
            map_height_m: How high above the road the map of the light lies; 0 is what the road gets,
                `EYE_HEIGHT_M` what drivers get in their eyes.

        Raises:
            ValueError: If the height is below `SMALLEST_HEIGHT_PX`.
        """
        if height_px < SMALLEST_HEIGHT_PX:
            raise ValueError(f"height_px: expected at least {SMALLEST_HEIGHT_PX}, got {height_px}")
        self._headlamps = headlamps
        self._light = RoadLight(headlamps, map_height_m)
        self._map_title = f"light {map_height_m:g} m above the road" if map_height_m else "light on the road"
        self._height_px = _even(height_px)
        self._pen = Pen(self._height_px)

    def picture(
        self, frame: Frame, command: BeamCommand, tracks: Tracks | None = None, tone: Tone | None = None
    ) -> Picture:
        """The picture of `frame` and the beam that follows from it; width and height are even.

        Args:
            frame: What the camera saw; with a calibration the gaps are drawn into it, with a road its edges on the map.
            command: The beam.
            tracks: What is followed; plausible ones are drawn.
            tone: How grey values become visible; None suits the curve to this frame.

        Raises:
            ValueError: If the command is for lamps with another number of LEDs.
        """
        if command.levels.shape[1] != self._headlamps.num_leds:
            raise ValueError(
                f"BeamCommand.levels: expected {self._headlamps.num_leds} a lamp for {self._headlamps.name!r}, "
                f"got {command.levels.shape[1]}"
            )
        panel = np.empty((self._height_px, _even(PANEL_SHARE * self._height_px), 3), np.uint8)
        panel[:] = CAPTION_GROUND_BGR
        y_px = self._draw_caption(panel, frame, command)
        y_px = self._draw_matrices(panel, command, y_px + self._pen.px(36))
        self._draw_road(panel, frame.road, command, y_px + self._pen.px(44))
        return np.hstack([self._camera(frame, command, tracks, tone or Tone.of(frame.image)), panel])

    def draw(self, frame: Frame, result: FrameResult, tone: Tone | None = None) -> Picture:
        """The picture of a frame whose result has a beam, as `reports.video` draws."""
        assert result.beam is not None
        return self.picture(frame, result.beam, result.tracks, tone)

    def _camera(self, frame: Frame, command: BeamCommand, tracks: Tracks | None, tone: Tone) -> Picture:
        scale = self._height_px / frame.height_px
        size_px = (_even(frame.width_px * scale), self._height_px)
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        grey = cv2.resize(tone.apply(frame.image), size_px, interpolation=how)
        picture = np.repeat(np.asarray(grey, np.uint8)[:, :, np.newaxis], 3, axis=2)
        taken: list[Rectangle] = []
        if tracks is not None:
            self._draw_tracks(picture, tracks, scale, taken)
        if frame.camera is not None:
            for borders_rad, range_m in zip(command.gaps_rad, command.gap_ranges_m, strict=True):
                self._draw_gap(picture, scale * gap_outline_px(frame.camera, borders_rad, range_m), range_m, taken)
        return picture

    def _draw_gap(self, picture: Picture, outline_px: Floats, range_m: float, taken: list[Rectangle]) -> None:
        """Tints what a gap covers in the camera's picture, and writes how far away that is which it is for."""
        outline_px = np.clip(outline_px[np.isfinite(outline_px).all(1)], -1e4, 1e4)
        if len(outline_px) < 3:
            return
        x1, y1 = np.maximum(np.floor(outline_px.min(0)), 0).astype(int).tolist()
        x2, y2 = np.maximum(np.ceil(outline_px.max(0)), 0).astype(int).tolist()
        around = picture[y1:y2, x1:x2]
        if around.size:
            tinted = around.copy()
            cv2.fillPoly(tinted, [np.rint(outline_px - (x1, y1)).astype(np.int32)], GAP_BGR, cv2.LINE_AA)
            around[:] = cv2.addWeighted(tinted, GAP_TINT, around, 1.0 - GAP_TINT, 0.0)
        self._pen.line(picture, outline_px, GAP_BGR)
        if not np.isnan(range_m):
            text = f"{range_m:.0f} m"
            width_px, height_px = self._label_px(text)
            left = round(outline_px[:, 0].mean() - width_px / 2)
            top = round(outline_px[:, 1].min()) - height_px - self._pen.px(3)
            while any(overlap_px((left, top, left + width_px, top + height_px), label) for label in taken):
                top -= height_px  # above the label of the neighbour
            self._label(picture, text, (left, top, left + width_px, top + height_px), GAP_BGR, taken)

    def _draw_tracks(self, picture: Picture, tracks: Tracks, scale: float, taken: list[Rectangle]) -> None:
        margin_px = self._pen.px(4)
        plausible = np.flatnonzero(tracks.is_plausible)
        boxes_px = np.rint(tracks.boxes_xyxy_px[plausible] * scale).astype(int)
        boxes_px += np.array([-margin_px, -margin_px, margin_px, margin_px])
        rectangles: list[Rectangle] = [(x1, y1, x2, y2) for x1, y1, x2, y2 in boxes_px.tolist()]
        taken += rectangles
        for index, (x1, y1, x2, y2) in zip(plausible, rectangles, strict=True):
            width = 2.2 if tracks.states[index] == TrackState.CONFIRMED else 1.0
            self._pen.line(picture, [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)], TRACK_BGR, width)
            text = track_text(tracks, int(index))
            height_px, width_px = picture.shape[:2]
            label = place_label((x1, y1, x2, y2), self._label_px(text), taken, (width_px, height_px))
            self._label(picture, text, label, TRACK_BGR, taken)

    def _label_px(self, text: str) -> tuple[int, int]:
        return self._pen.width_px(text, LABEL) + self._pen.px(8), self._pen.px(LABEL + 8)

    def _label(self, picture: Picture, text: str, label: Rectangle, colour: Colour, taken: list[Rectangle]) -> None:
        """Writes `text` on dark ground, and takes that place."""
        taken.append(label)
        darken(picture, label)
        self._pen.write(picture, text, (label[0] + self._pen.px(4), label[3] - self._pen.px(4)), colour, LABEL)

    def _draw_caption(self, panel: Picture, frame: Frame, command: BeamCommand) -> int:
        """Mode, when and where, and what is wrong; returns the lower border."""
        pen, left_px = self._pen, self._pen.px(MARGIN)
        mode, colour = MODES[command.mode]
        pen.write(panel, mode, (left_px, pen.px(MARGIN + 20)), colour, 20)
        words = [frame.sequence, f"frame {frame.frame}", f"{frame.timestamp_ns / 1e9:.2f} s"]
        if frame.motion is not None:
            words.append(f"{3.6 * frame.motion.speed_mps:.0f} km/h")
        pen.write(
            panel, "   ".join(word for word in words if word), (left_px, pen.px(MARGIN + 50)), CAPTION_BGR, CAPTION
        )
        faults = _listed(command.faults, pen, panel.shape[1] - 2 * left_px) or "no faults"
        pen.write(panel, faults, (left_px, pen.px(MARGIN + 74)), FAULT_BGR if command.faults else FAINT_BGR, CAPTION)
        return pen.px(MARGIN + 74)

    def _draw_matrices(self, panel: Picture, command: BeamCommand, top_px: int) -> int:
        """The LEDs of both lamps as the driver sees their light, and below them the gaps; returns the lower border."""
        pen, margin_px = self._pen, self._pen.px(MARGIN)
        width_px = (panel.shape[1] - 3 * margin_px) // 2
        num_columns = self._headlamps.num_columns
        num_rows = self._headlamps.num_leds // num_columns
        height_px = min(num_rows * pen.px(20), pen.px(140))
        lamps = (("left", self._headlamps.left), ("right", self._headlamps.right))
        for index, (side, lamp) in enumerate(lamps):
            left_px = margin_px + index * (width_px + margin_px)
            levels = command.levels[index].reshape(num_rows, num_columns)[::-1, ::-1]
            pen.write(panel, f"{side} lamp", (left_px, top_px), CAPTION_BGR, CAPTION)
            right = (left_px + width_px, top_px)
            pen.write(panel, f"{100 * levels.mean():.0f} %", right, FAINT_BGR, CAPTION, anchor="right")
            y_px = np.rint(top_px + pen.px(12) + np.linspace(0, height_px, num_rows + 1)).astype(int)
            x_px = np.rint(left_px + np.linspace(0, width_px, num_columns + 1)).astype(int)
            for row in range(num_rows):
                for column in range(num_columns):
                    top, left = y_px[row], x_px[column]
                    bottom, right = max(y_px[row + 1] - 1, top + 1), max(x_px[column + 1] - 1, left + 1)
                    cell = panel[top:bottom, left:right]
                    cell[:] = _mixed(DARK_LED_BGR, LIT_LED_BGR, float(levels[row, column]))
            for borders_rad in command.gaps_rad:
                right_px, left_end_px = left_px + width_px * _places_across(lamp, borders_rad)
                below_px = y_px[-1] + pen.px(5)
                pen.line(panel, [(left_end_px, below_px), (right_px, below_px)], GAP_BGR, 2.5)
        return top_px + pen.px(12) + height_px + pen.px(8)

    def _draw_road(self, panel: Picture, road: RoadAhead | None, command: BeamCommand, top_px: int) -> None:
        pen, margin_px = self._pen, self._pen.px(MARGIN)
        left_px, right_px, bottom_px = margin_px, panel.shape[1] - margin_px, panel.shape[0] - pen.px(66)
        pen.write(panel, self._map_title, (left_px, top_px), CAPTION_BGR, CAPTION)
        pen.write(panel, "lx, facing the lamps", (right_px, top_px), FAINT_BGR, CAPTION, anchor="right")
        shown = panel[top_px + pen.px(12) : bottom_px, left_px:right_px]
        shown[:] = self._light.picture(command.levels, shown.shape[1], shown.shape[0])
        self._draw_distances(shown)
        if road is not None:
            for side in (1.0, -1.0):
                pen.line(shown, _on_map(road_edge(road, side), shown), EDGE_BGR, 1.5)
        for borders_rad, range_m in zip(command.gaps_rad, command.gap_ranges_m, strict=True):
            for border_rad in borders_rad:
                beyond = 2 * AHEAD_M * np.array([np.cos(border_rad), np.sin(border_rad)])
                pen.line(shown, _on_map(np.stack([0.05 * beyond, beyond]), shown), GAP_BGR, 1.2)
            if range_m < 2 * AHEAD_M:  # neither unknown nor far beyond the map
                middle_rad = borders_rad.mean()
                dot_px = _on_map(range_m * np.array([[np.cos(middle_rad), np.sin(middle_rad)]]), shown)[0]
                cv2.circle(shown, tuple(np.rint(dot_px).astype(int).tolist()), pen.px(6), GAP_BGR, -1, cv2.LINE_AA)
        car = _on_map(np.array([[0.0, 0.9], [3.2, 0.9], [3.8, 0.6], [3.8, -0.6], [3.2, -0.9], [0.0, -0.9]]), shown)
        cv2.fillPoly(shown, [np.rint(car).astype(np.int32)], EDGE_BGR, cv2.LINE_AA)
        self._draw_scale(panel, left_px, right_px, bottom_px + pen.px(20))

    def _draw_distances(self, shown: Picture) -> None:
        """Faint lines across, every 20 m."""
        pen, lined = self._pen, shown.copy()
        ahead_m = np.arange(20.0, AHEAD_M, 20.0)
        y_px = _on_map(np.stack([ahead_m, np.zeros_like(ahead_m)], axis=1), shown)[:, 1]
        for y in y_px:
            pen.line(lined, [(0, y), (shown.shape[1], y)], EDGE_BGR, 1.0)
        cv2.addWeighted(lined, 0.3, shown, 0.7, 0.0, dst=shown)
        for distance_m, y in zip(ahead_m, y_px, strict=True):
            pen.write(shown, f"{distance_m:.0f} m", (pen.px(6), y - pen.px(5)), EDGE_BGR, 10)

    def _draw_scale(self, panel: Picture, left_px: int, right_px: int, top_px: int) -> None:
        pen = self._pen
        bar = panel[top_px : top_px + pen.px(10), left_px:right_px]
        bar[:] = colours(np.linspace(0.0, 1.0, bar.shape[1], dtype=np.float32)[np.newaxis])
        for lux in TICKS_LX:
            x_px = left_px + place_on_scale(lux) * (right_px - left_px)
            below_px = top_px + pen.px(14)
            pen.line(panel, [(x_px, below_px - pen.px(4)), (x_px, below_px)], CAPTION_BGR, 1.0)
            pen.write(panel, f"{lux:g}", (x_px, below_px + pen.px(16)), CAPTION_BGR, 11, anchor="middle")


def _even(length_px: float) -> int:
    return 2 * round(length_px / 2)


def _listed(faults: tuple[str, ...], pen: Pen, width_px: int) -> str:
    """As many faults as fit, at least one, and the number of the others."""
    words = [fault.replace("_", " ") for fault in faults]
    for num_left_out in range(len(words)):
        more = f", {num_left_out} more" if num_left_out else ""
        text = ", ".join(words[: len(words) - num_left_out]) + more
        if pen.width_px(text, CAPTION) <= width_px:
            return text
    return words[0] if words else ""


def _mixed(dark: Colour, bright: Colour, share: float) -> Colour:
    blue, green, red = (round(d + share * (b - d)) for d, b in zip(dark, bright, strict=True))
    return blue, green, red


def gap_outline_px(camera: Camera, borders_rad: Floats, range_m: float) -> Floats:
    """The sides and the top of a gap in the camera's image, shape (N, 2), full-frame pixels; NaN behind it."""
    distance_m = UNKNOWN_RANGE_M if np.isnan(range_m) else range_m
    heights_m = camera.vehicle_from_camera.position_m[2] + distance_m * np.tan(
        np.radians(np.linspace(*GAP_ELEVATIONS_DEG, 12))
    )
    across_rad = np.linspace(borders_rad[1], borders_rad[0], 8)
    azimuths_rad = np.concatenate([np.full(12, borders_rad[1]), across_rad, np.full(12, borders_rad[0])])
    heights_m = np.concatenate([heights_m, np.full(8, heights_m[-1]), heights_m[::-1]])
    ahead, left = distance_m * np.cos(azimuths_rad), distance_m * np.sin(azimuths_rad)
    return camera.project(camera.vehicle_from_camera.to_body(np.stack([ahead, left, heights_m], axis=1)))


def _places_across(lamp: Headlamp, borders_rad: Floats) -> Floats:
    """Where azimuths in the vehicle lie on a lamp's columns, 0 at the left border to 1 at the right one."""
    yaw_rad = rotation_angles_rad(lamp.vehicle_from_lamp.rotation)[0]
    num_columns = lamp.matrix.num_columns
    middles_deg = lamp.matrix.azimuths_deg[:num_columns]
    half_deg = 0.5 * (middles_deg[-1] - middles_deg[0]) / max(1, num_columns - 1)
    edges_deg = np.append(middles_deg - half_deg, middles_deg[-1] + half_deg)
    from_right = np.interp(np.degrees(borders_rad - yaw_rad), edges_deg, np.linspace(0.0, 1.0, num_columns + 1))
    return np.asarray(1.0 - from_right)


def road_edge(road: RoadAhead, side: float) -> Floats:
    """The road's left (1) or right (-1) edge from above, shape (N, 2), in the vehicle's frame."""
    points = road.points_m[:, :2]
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    places_m = np.linspace(0.0, along_m[-1], 1 + max(1, round(along_m[-1] / ROAD_STEP_M)))
    points = np.stack([np.interp(places_m, along_m, points[:, axis]) for axis in (0, 1)], axis=1)
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return points + side * road.half_width_m * np.stack([-along[:, 1], along[:, 0]], axis=1)


def _on_map(points_m: Floats, shown: Picture) -> Floats:
    """Points of the vehicle from above, shape (N, 2), as pixels x, y of the map `shown`."""
    height_px, width_px = shown.shape[:2]
    x_px = (ASIDE_M - points_m[:, 1]) / (2 * ASIDE_M) * width_px
    y_px = (1.0 - points_m[:, 0] / AHEAD_M) * height_px
    return np.stack([x_px, y_px], axis=1)
