"""Whole drives, small: everything from the scene to the labelled image."""

from __future__ import annotations

import functools
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN
from foreglow.datasets.pvdn.schema import ImageCategory
from foreglow.datasets.simulated import read_truth
from foreglow.lab.simulation import DatasetConfig, Scene, drive_frames, simulate, simulate_dataset
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import CameraSpec, EgoSpec, RoadSpec, SensorSpec, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import Rail, SurroundingsSpec, Verge
from foreglow.photometry import NUM_LEDS

pytestmark = pytest.mark.renderer

BARE = Verge(grass_per_m2=0.0, bank_m=0.0, ditch_m=0.0)
OPEN = SurroundingsSpec(left=BARE, right=BARE, delineator_spacing_m=0.0)
ONCOMING = VehicleSpec(timetable=((0.0, 90.0), (10.0, -110.0)))


def scene(**changes: object) -> Scene:
    """A car comes towards us on a short straight road; 160x120 pixels, three frames."""
    fields: dict[str, object] = {
        "duration_s": 3 / 18,
        "road": RoadSpec(length_m=150.0),
        "surroundings": OPEN,
        "vehicles": (ONCOMING,),
        "ego": EgoSpec(timetable=((0.0, 20.0), (10.0, 220.0)), body_motion=0.0),
        "camera": CameraSpec(width_px=160, height_px=120, focal_px=164.0),
    }
    return Scene(**(fields | changes))  # type: ignore[arg-type]


@functools.cache
def drive() -> tuple[DriveFrame, ...]:
    return tuple(drive_frames(scene()))


def test_a_drive_is_a_source_of_frames_with_the_same_bytes_when_driven_again() -> None:
    source = simulate(scene())
    frames = list(source)
    assert [frame.timestamp_ns for frame in frames] == [0, 55_555_556, 111_111_111]
    assert [frame.frame for frame in frames] == [0, 1, 2]
    assert (source.num_frames, source.rate_hz, source.skipped) == (3, 18.0, ())
    assert frames[0].image.shape == (120, 160)
    assert frames[0].image.dtype == np.uint8
    assert source.latest is not None
    assert source.latest.frame is frames[2]
    for known, first, second in zip(drive(), frames, source, strict=True):  # iterating again begins anew
        assert np.array_equal(known.frame.image, first.image)
        assert np.array_equal(known.frame.image, second.image)
    other_seed = next(iter(simulate(scene(seed=1))))
    assert not np.array_equal(frames[0].image, other_seed.image)


def test_lamps_are_labelled_where_they_shine() -> None:
    first = drive()[0]
    lamps = [artifact for artifact in first.vehicles[0].artifacts if artifact.is_direct]
    assert lamps
    assert not any(artifact.is_rear for artifact in lamps)
    x, y = lamps[0].position_px
    row, column = np.unravel_index(first.frame.image.argmax(), first.frame.image.shape)
    assert abs(column + 0.5 - x) < 4.0
    assert abs(row + 0.5 - y) < 4.0
    assert lamps[0].depth_m == pytest.approx(first.vehicles[0].range_m, rel=0.02)


def test_the_truth_of_a_vehicle_in_sight() -> None:
    first = drive()[0]
    vehicle = first.vehicles[0]
    assert vehicle.speed_mps == pytest.approx(20.0)
    assert vehicle.range_m == pytest.approx(90.0 - 3.6 - 21.9, abs=0.6)  # its lamps, our camera
    assert vehicle.visible_share > 0.8
    assert vehicle.box_xyxy_px is not None
    x1, y1, x2, y2 = vehicle.box_xyxy_px
    for lamp in vehicle.lamps:
        if not lamp.is_rear:
            assert lamp.visible_share > 0.9
            assert x1 - 1 <= lamp.position_px[0] <= x2 + 1
            assert y1 - 1 <= lamp.position_px[1] <= y2 + 1
        else:
            assert lamp.visible_share == 0.0
    assert first.category == ImageCategory.FIRST_DIRECT_SIGHT
    assert drive()[1].category == ImageCategory.DIRECT_ARTIFACTS


def test_light_at_the_eyes_grows_as_the_square_of_the_distance_falls() -> None:
    frames = [next(drive_frames(scene(vehicles=(VehicleSpec(timetable=((0.0, s),)),)))) for s in (60.0, 100.0)]
    eyes = [frame.vehicles[0].eye_lx["ego"] for frame in frames]
    ranges = [frame.vehicles[0].range_m for frame in frames]
    assert eyes[0] > eyes[1] > 0.0
    # The angle off our lamps' axis shrinks with the distance, and they are brighter there: less than the square.
    assert 1.0 < eyes[0] / eyes[1] < 1.2 * (ranges[1] / ranges[0]) ** 2
    assert all(frame.ego_eye_lx["0"] > 0 for frame in frames)


def test_nobody_there_nothing_labelled() -> None:
    first = next(drive_frames(scene(vehicles=())))
    assert first.vehicles == ()
    assert first.category == ImageCategory.NONE
    assert not first.is_production_detected


def test_a_hidden_car_has_no_lamps_but_its_light_is_seen_on_the_rail() -> None:
    bend = RoadSpec(length_m=220.0, curvature_per_m=((35.0, 0.0), (45.0, -0.0125)))
    hiding = SurroundingsSpec(
        left=BARE,
        right=Verge(bank_m=6.0, bank_offset_m=0.5, grass_per_m2=0.0),
        rails=(Rail(side="left", span_m=(10.0, 210.0)),),
        delineator_spacing_m=0.0,
    )
    car = VehicleSpec(timetable=((0.0, 130.0),), brightness=1.5)
    small = CameraSpec(width_px=320, height_px=240, focal_px=328.0)
    hidden = scene(road=bend, surroundings=hiding, vehicles=(car,), camera=small)
    vehicle = next(drive_frames(hidden)).vehicles[0]
    assert all(lamp.visible_share == 0.0 for lamp in vehicle.lamps)
    assert vehicle.artifacts
    assert not any(artifact.is_direct for artifact in vehicle.artifacts)


def test_a_car_ahead_shows_its_rear_lamps() -> None:
    ahead = VehicleSpec(lane="own", timetable=((0.0, 45.0), (10.0, 245.0)))
    vehicle = next(drive_frames(scene(vehicles=(ahead,)))).vehicles[0]
    assert any(artifact.is_rear and artifact.is_direct for artifact in vehicle.artifacts)
    assert not any(artifact.is_direct and not artifact.is_rear for artifact in vehicle.artifacts)


def test_led_levels_count_from_the_next_frame_on() -> None:
    source = simulate(scene(ego=EgoSpec(timetable=((0.0, 20.0),), beam="matrix", body_motion=0.0)))
    frames = iter(source)
    bright = float(next(frames).image.mean())
    assert source.latest is not None
    before_lx = source.latest.vehicles[0].eye_lx["ego"]
    source.set_led_levels(np.zeros((2, NUM_LEDS)))
    dark = float(next(frames).image.mean())
    assert source.latest.vehicles[0].eye_lx["ego"] < 0.2 * before_lx
    assert dark < bright


@pytest.mark.parametrize("levels", [np.zeros(NUM_LEDS), np.full((2, NUM_LEDS), 1.5), np.full((2, NUM_LEDS), np.nan)])
def test_bad_led_levels(levels: np.ndarray) -> None:
    source = simulate(scene(ego=EgoSpec(beam="matrix")))
    with pytest.raises(ValueError, match="set_led_levels"):
        source.set_led_levels(levels)


def test_led_levels_without_a_matrix_beam() -> None:
    with pytest.raises(ValueError, match=r"ego\.beam"):
        simulate(scene()).set_led_levels(np.zeros((2, NUM_LEDS)))


def test_unknown_quality() -> None:
    with pytest.raises(ValueError, match="expected one of fast, training, fine"):
        simulate(scene(), "best")


def test_the_long_exposure_is_brighter() -> None:
    night = next(iter(simulate(scene(sensor=SensorSpec(exposure="night")))))
    assert night.image.mean() > 1.5 * drive()[0].frame.image.mean()


def test_a_data_set_is_read_back(tmp_path: Path) -> None:
    """That processes change nothing is in `test_exposures.py` and `tests/parallel/test_same_results.py`."""
    scenes = [scene(seed=seed, duration_s=2 / 18) for seed in (1, 2)]
    config = DatasetConfig.of(seed=1, split="train", cycle="day", quality="fast")
    root = simulate_dataset(tmp_path, scenes, functools.partial(drive_frames, quality="fast"), config).root
    split, truth = PVDN(root), read_truth(root)
    assert len(split) == 4
    first = next(iter(truth)).frames[0]
    marked = [artifact for vehicle in first.vehicles for artifact in vehicle.artifacts if not artifact.is_doubtful]
    assert len(split.keypoints_px(first.image_id)) == len(marked)


def test_frames_are_rendered_one_by_one() -> None:
    endless = scene(duration_s=3600.0)
    assert len(list(islice(drive_frames(endless), 2))) == 2
