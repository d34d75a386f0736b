"""The picture of a beam: sizes, sides and places; never a picture compared pixel by pixel."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from foreglow.display.beam_view import (
    AHEAD_M,
    ASIDE_M,
    CELLS,
    FAULT_BGR,
    GAP_BGR,
    LIT_LED_BGR,
    BeamView,
    RoadLight,
    place_on_scale,
)
from foreglow.display.overlay import TRACK_BGR, Picture
from foreglow.geometry import Camera, Pose
from foreglow.photometry import NUM_LEDS, illuminance_lx, read_headlamps
from foreglow.types import BeamCommand, BeamMode, Frame, RoadAhead
from tests.bombs import grid_headlamps
from tests.stand_ins import night_image, tracks_of

HEIGHT_PX = 540
VIEW = BeamView(read_headlamps(), HEIGHT_PX)
MOUNT = Pose(np.array([1.8, 0.0, 1.3]), np.eye(3))
CAMERA = Camera(128, 96, (130.0, 130.0), (64.0, 48.0), (0.0,) * 5, MOUNT)
CAMERA_WIDTH_PX = 720
FULL = BeamCommand(0, BeamMode.FULL, np.ones((2, NUM_LEDS)))


def frame_of(camera: Camera | None = CAMERA, road: RoadAhead | None = None) -> Frame:
    return Frame(night_image(1), timestamp_ns=0, camera=camera, road=road)


def gap_command(right_deg: float, left_deg: float, range_m: float = 80.0) -> BeamCommand:
    levels = np.ones((2, NUM_LEDS))
    azimuths_deg = read_headlamps().left.matrix.azimuths_deg
    levels[:, (azimuths_deg > right_deg - 1) & (azimuths_deg < left_deg + 1)] = 0.0
    gaps = np.radians([[right_deg, left_deg]])
    return BeamCommand(0, BeamMode.GLARE_FREE, levels, gaps, np.array([range_m]))


def columns_with(picture: Picture, colour: tuple[int, int, int]) -> np.ndarray:
    """Where something of that colour is drawn, thin lines included."""
    return np.flatnonzero((np.abs(picture.astype(int) - colour) < 40).all(axis=2).any(axis=0))


@pytest.mark.slow
@pytest.mark.parametrize(("width_px", "height_px"), [(128, 96), (640, 360), (65, 99), (1280, 960)])
@pytest.mark.parametrize("wanted_px", [360, 541])
def test_any_size_gives_an_even_picture(width_px: int, height_px: int, wanted_px: int) -> None:
    frame = Frame(np.zeros((height_px, width_px), np.uint16), timestamp_ns=0)
    picture = BeamView(read_headlamps(), wanted_px).picture(frame, FULL)
    assert picture.dtype == np.uint8
    assert abs(picture.shape[0] - wanted_px) <= 1
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    assert picture.shape[1] == pytest.approx(picture.shape[0] * (width_px / height_px + 4 / 9), abs=3)


def test_illuminance_is_that_of_the_lamps() -> None:
    lamps, rng = read_headlamps(), np.random.default_rng(2)
    levels = rng.random((2, NUM_LEDS))
    found = RoadLight(lamps, height_m=0.3).illuminance_lx(levels)
    assert found.shape == CELLS
    for row, column in ((0, 0), (40, 90), (100, 120), (CELLS[0] - 8, CELLS[1] // 2)):
        point = np.array([AHEAD_M - (row + 0.5), ASIDE_M - 0.25 * (column + 0.5), 0.3])
        expected = sum(
            illuminance_lx(lamp.matrix.table(level), lamp.vehicle_from_lamp, point)
            for lamp, level in zip((lamps.left, lamps.right), levels, strict=True)
        )
        assert found[row, column] == pytest.approx(expected, rel=1e-4)


def test_gaps_are_dark_where_they_are() -> None:
    """5 degrees to the left, 100 m ahead: 8.7 m left of the middle."""
    light = RoadLight(read_headlamps(), height_m=1.2)
    full, gapped = (light.illuminance_lx(command.levels) for command in (FULL, gap_command(4.0, 6.0)))
    row, inside, opposite = 20, round((ASIDE_M - 8.7) / 0.25), round((ASIDE_M + 8.7) / 0.25)
    assert gapped[row, inside] < 0.1 * full[row, inside]
    assert gapped[row, opposite] == pytest.approx(full[row, opposite], rel=1e-3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_gaps_lie_on_their_side(sign: float) -> None:
    right_deg, left_deg = sorted((sign * 4.0, sign * 8.0))
    picture = VIEW.picture(frame_of(), gap_command(right_deg, left_deg))
    camera, panel = picture[:, :CAMERA_WIDTH_PX], picture[130:, CAMERA_WIDTH_PX:]
    middle_px = CAMERA_WIDTH_PX / 2 - sign * np.tan(np.radians(6.0)) * 130 * HEIGHT_PX / 96
    assert np.median(columns_with(camera, GAP_BGR)) == pytest.approx(middle_px, abs=40)
    assert (columns_with(panel, GAP_BGR).mean() < panel.shape[1] / 2) == (sign > 0)


def test_leds_are_drawn_as_the_driver_sees_them() -> None:
    """LED 0 of the left lamp: its lowest row, furthest to the right."""
    levels = np.zeros((2, NUM_LEDS))
    dark = VIEW.picture(frame_of(), BeamCommand(0, BeamMode.GLARE_FREE, levels))
    levels[0, 0] = 1.0
    lit = VIEW.picture(frame_of(), BeamCommand(0, BeamMode.GLARE_FREE, levels))
    rows, columns = np.nonzero((lit != dark).any(axis=2)[70:110, CAMERA_WIDTH_PX:])
    assert 95 < columns.min() <= columns.max() < 120
    assert rows.min() > 15


def test_more_leds_than_pixels_are_drawn_all_the_same(tmp_path: Path) -> None:
    file = tmp_path / "lamps.toml"
    file.write_text(grid_headlamps("").replace("num_columns = 28", "num_columns = 300").replace("1.2", "0.1"))
    lamps = read_headlamps(file)
    full = BeamCommand(0, BeamMode.FULL, np.ones((2, lamps.num_leds)))
    picture = BeamView(lamps, HEIGHT_PX).picture(frame_of(), full)
    lit = (np.abs(picture[:, CAMERA_WIDTH_PX:].astype(int) - LIT_LED_BGR) < 10).all(axis=2)
    assert lit.any(axis=0).sum() > 190  # of the 210 columns of both lamps


def test_without_calibration_road_or_range_the_rest_is_drawn() -> None:
    command = gap_command(4.0, 6.0, np.nan)
    picture = VIEW.picture(frame_of(None), command)
    assert not len(columns_with(picture[:, :CAMERA_WIDTH_PX], GAP_BGR))
    assert len(columns_with(picture[:, CAMERA_WIDTH_PX:], GAP_BGR))


def test_a_gap_for_something_far_beyond_the_map_is_drawn() -> None:
    picture = VIEW.picture(frame_of(), gap_command(4.0, 6.0, 1e12))
    assert len(columns_with(picture[:, CAMERA_WIDTH_PX:], GAP_BGR))


def test_gaps_behind_the_camera_are_not_drawn_into_its_picture() -> None:
    picture = VIEW.picture(frame_of(), gap_command(100.0, 120.0))
    assert not len(columns_with(picture[:, :CAMERA_WIDTH_PX], GAP_BGR))


def test_the_roads_edges_are_on_the_map() -> None:
    road = RoadAhead(np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [120.0, -10.0, 0.0]]), 3.5)
    with_road, without = (VIEW.picture(frame_of(road=r), FULL) for r in (road, None))
    changed = (with_road != without).any(axis=2)
    assert not changed[:, :CAMERA_WIDTH_PX].any()
    rows, columns = np.nonzero(changed)
    assert columns[rows > 450].max() - columns[rows > 450].min() == pytest.approx(7.0 / 50.0 * 220, abs=3)
    assert columns[rows < 200].mean() > columns[rows > 450].mean() + 15


def test_plausible_tracks_are_drawn() -> None:
    tracks = tracks_of([[20, 30, 40, 50]], ranges_m=[80.0])
    box = VIEW.picture(frame_of(), FULL, tracks)[:, :CAMERA_WIDTH_PX]
    scale = HEIGHT_PX / 96
    columns = columns_with(box, TRACK_BGR)
    assert columns.min() == pytest.approx(20 * scale, abs=5)
    tentative = dataclasses.replace(tracks, states=np.array([0]))
    assert not len(columns_with(VIEW.picture(frame_of(), FULL, tentative)[:, :CAMERA_WIDTH_PX], TRACK_BGR))


def test_faults_are_written() -> None:
    fine = VIEW.picture(frame_of(), BeamCommand.low(0, NUM_LEDS))
    faulty = VIEW.picture(frame_of(), BeamCommand.low(0, NUM_LEDS, "stale_data", *["a_long_name_of_a_fault"] * 5))
    assert not len(columns_with(fine[:60], FAULT_BGR))
    columns = columns_with(faulty[:60], FAULT_BGR)
    assert len(columns)
    assert columns.max() < fine.shape[1] - 5


def test_the_scale_is_logarithmic() -> None:
    steps = np.diff([place_on_scale(lux) for lux in (0.1, 1.0, 10.0, 100.0)])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-5)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="height_px: expected at least 360, got 200"):
        BeamView(read_headlamps(), 200)
    with pytest.raises(ValueError, match=r"expected 84 a lamp for .*, got 3"):
        VIEW.picture(frame_of(), BeamCommand.low(0, 3))
