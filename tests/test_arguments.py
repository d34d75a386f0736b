"""What a public function is given is checked: a wrong kind, shape, sign or NaN ends in a message that names it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.beam.gap_writer import GapWriter
from foreglow.beam.occurrence import Occurrence
from foreglow.calibration import calibration_to_toml, read_calibration, read_intrinsics
from foreglow.config import BeamConfig
from foreglow.datasets import LabelledImage, PVDNWriter, Sequence, open_source
from foreglow.datasets.vehicle_logs import CanLog
from foreglow.geometry import Camera, Pose, rotation, rotation_angles_rad
from foreglow.lab.evaluation import break_down, examine, match_lights
from foreglow.lab.evaluation.bootstrap import paired_bootstrap, percentile_interval, scene_counts
from foreglow.lab.evaluation.boxes.breakdown import LightMatches
from foreglow.lab.evaluation.boxes.matching import match_boxes
from foreglow.lab.learning.recipes import RECIPES, changed
from foreglow.lab.simulation import (
    Drive,
    Scene,
    adapted,
    draw_scenes,
    drive_exposures,
    long_drives,
    read_scene,
    resized,
    scenario,
    scene_to_toml,
    side_by_side,
    with_beam,
    without_traffic,
)
from foreglow.lab.simulation.variants import draw_variants
from foreglow.maps import CentreLine, GeographicOrigin, PoseTrack, RoadMap
from foreglow.photometry import (
    Headlamp,
    Headlamps,
    IntensityTable,
    MatrixLamp,
    illuminance_lx,
    low_beam,
    matrix_beam,
    read_headlamps,
    read_ies,
    read_lamp_file,
    read_ldt,
)
from foreglow.photometry.limits import FMVSS_ONCOMING, UN_R123
from foreglow.runs.predictions import Predictions
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.runtime.parallel_run import Opening
from foreglow.types import Frame, RoadAhead

POSE = Pose(np.array([1.9, 0.0, 1.3]), np.eye(3))
CAMERA = Camera(64, 48, (60.0, 60.0), (32.0, 24.0), (0.0,) * 5, POSE)
LAMPS, LAMP, TABLE = read_headlamps(), matrix_beam("left"), low_beam()
MATRIX = with_beam(Scene(), "matrix")
MATCHES = match_boxes({1: np.zeros((0, 2))}, Predictions({1: np.zeros((0, 4))}, {1: np.zeros(0)}))
LINE = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
ROAD, ORIGIN = CentreLine(LINE, 3.0), GeographicOrigin(48.0, 9.0)
ROADS = RoadMap([ROAD])
PLACES = Occurrence(np.zeros(2), np.ones(2), np.full(2, 0.5))
UNMADE_MATCHES: Any = object.__new__(LightMatches)
NOTHING: Any = None
"""Beside something wrong, which is found first."""

NO_NUMBERS = [None, "x", {}, object(), [[1, 2], [3]], 10**400, np.array([1j] * 3), np.ones(3, np.bool_)]
NO_VECTORS = [*NO_NUMBERS, 1.5, [], [[1.0, 2.0]], np.zeros((2, 4))]
NO_ROWS = [*NO_VECTORS, [1.0, 2.0, 3.0], [[math.nan] * 3], [[math.inf, 0.0, 0.0]]]
NO_COUNT: list[Any] = [None, "x", -1, 1.5, math.nan, math.inf, [], True, 10**400]
NO_VALUE = [None, "x", 1.5, [], object()]
NO_SHARE: list[Any] = [None, "x", 2, -1, math.nan, True]
NO_LENGTH: list[Any] = [None, "x", -5.0, 0.0, math.nan, True]
NO_TIME: list[Any] = [None, "x", 1.5, math.nan, True, 2**63]
NO_DEGREES = [*NO_NUMBERS, 181.0, [9.0, math.nan], -math.inf]
NO_PATH: list[Any] = [None, 1.5, [], b"x", ""]


def lamp(**changes: Any) -> MatrixLamp:
    names = ("base", "columns", "rows", "leds_cd", "azimuths_deg", "elevations_deg", "num_columns")
    return MatrixLamp(**{name: getattr(LAMP, name) for name in names} | changes)


def poses() -> PoseTrack:
    from scipy.spatial.transform import Rotation

    return PoseTrack(np.array([0, 10**9]), np.zeros((2, 3)), Rotation.identity(2), has_attitude=True)


CASES: dict[str, tuple[str, Callable[[Any], object], list[Any]]] = {
    "rotation": ("pitch_rad", lambda value: rotation(0.1, value), [*NO_NUMBERS, []]),
    "rotation_angles_rad": ("turned", rotation_angles_rad, [*NO_VECTORS, np.zeros((2, 3))]),
    "Pose.to_outer": ("points_body", POSE.to_outer, NO_VECTORS),
    "Pose.to_body": ("points_outer", POSE.to_body, NO_VECTORS),
    "Pose @": ("inner", lambda value: POSE @ value, NO_VALUE),
    "Camera": (
        "Camera.width_px",
        lambda value: Camera(value, 48, (9.0, 9.0), (0.0, 0.0), (0.0,) * 5, POSE),
        [True, 1.5],
    ),
    "Camera.project": ("points_camera", CAMERA.project, NO_VECTORS),
    "Camera.rays": ("pixels", CAMERA.rays, [*NO_NUMBERS, 1.5, [], [[1.0, 2.0, 3.0]]]),
    "Camera.scaled": ("width_px", lambda value: CAMERA.scaled(value, 48), [*NO_COUNT, 0]),
    "Camera.has_shape_of": ("height_px", lambda value: CAMERA.has_shape_of(64, value), [*NO_COUNT, 0]),
    "RoadAhead": (
        "RoadAhead.cross_slopes",
        lambda value: RoadAhead(LINE, 3.0, value),
        ["x", [2.5, 2.5], [math.nan] * 2],
    ),
    "read_calibration": ("path", read_calibration, NO_PATH),
    "read_calibration mount": ("mount", lambda value: read_calibration("a.toml", value), ["x", 1.5, POSE]),
    "read_intrinsics": ("path", read_intrinsics, NO_PATH),
    "read_intrinsics choice": ("choice", lambda value: read_intrinsics("a.txt", value), ["x", 2]),
    "calibration_to_toml": ("camera", calibration_to_toml, NO_VALUE),
    "read_headlamps": ("path", read_headlamps, NO_PATH[1:]),
    "read_lamp_file": ("path", read_lamp_file, NO_PATH),
    "read_ies": ("path", read_ies, NO_PATH),
    "read_ldt": ("path", read_ldt, NO_PATH),
    "intensities_cd": ("directions", LAMPS.intensities_cd, [*NO_ROWS, np.zeros((1, 3)), np.ones((2, 2, 3))]),
    "illuminance_lx": ("points_vehicle", LAMPS.illuminance_lx, NO_ROWS),
    "greatest_cd": (
        "azimuths_deg",
        lambda value: LAMPS.greatest_cd(value, np.linspace(-5, 5, 5)),
        [*NO_NUMBERS, 1.0, [], [1.0], [2.0, 1.0], [0.0, math.nan], [-181.0, 0.0]],
    ),
    "MatrixLamp base": ("MatrixLamp.base", lambda value: lamp(base=value), NO_VALUE),
    "MatrixLamp rows": ("MatrixLamp.rows", lambda value: lamp(rows=value), NO_VALUE),
    "MatrixLamp leds_cd": ("MatrixLamp.leds_cd", lambda value: lamp(leds_cd=value), [*NO_VALUE, -LAMP.leds_cd]),
    "MatrixLamp azimuths_deg": ("MatrixLamp.azimuths_deg", lambda value: lamp(azimuths_deg=value), NO_VECTORS),
    "MatrixLamp num_columns": ("MatrixLamp.num_columns", lambda value: lamp(num_columns=value), [*NO_COUNT, 0, 5]),
    "MatrixLamp.table": ("levels", LAMP.table, [*NO_VECTORS, np.full(84, math.nan), np.full(84, 2.0)]),
    "Headlamp": ("Headlamp.matrix", lambda value: Headlamp(POSE, value), NO_VALUE),
    "Headlamps": ("Headlamps.left", lambda value: Headlamps("x", value, LAMPS.right), NO_VALUE),
    "IntensityTable": (
        "IntensityTable.azimuths_deg",
        lambda value: IntensityTable(value, TABLE.elevations_deg, TABLE.intensities_cd),
        NO_VECTORS,
    ),
    "IntensityTable.intensities_cd": (
        "IntensityTable.intensities_cd",
        lambda value: IntensityTable([0, 1], [0, 1], value),  # type: ignore[arg-type]
        [*NO_VECTORS, [[1, -1]] * 2, [[1, 1e300]] * 2],
    ),
    "IntensityTable.towards": ("directions", TABLE.towards, [*NO_VECTORS, [math.nan] * 3]),
    "photometry.illuminance_lx": (
        "points_world",
        lambda value: illuminance_lx(TABLE, POSE, value),
        [*NO_VECTORS, [math.nan] * 3],
    ),
    "photometry.illuminance_lx table": ("table", lambda value: illuminance_lx(value, POSE, LINE), NO_VALUE),
    "low_beam": ("carpet", low_beam, [None, "x", 0.0, -1.0, 1.5, math.nan]),
    "low_beam stray": ("stray", lambda value: low_beam(1.0, value), [None, "x", -1.0, math.inf, math.nan]),
    "IlluminanceLimits.at": ("range_m", FMVSS_ONCOMING.at, NO_NUMBERS),
    "IntensityLimit.illuminance_lx": ("num_lamps", UN_R123[0].illuminance_lx, [*NO_COUNT, 0]),
    "scenario": ("seed", lambda value: scenario("curve", value), NO_COUNT),
    "draw_scenes": ("scenes", lambda value: draw_scenes(value, 1), [*NO_COUNT, 0]),
    "draw_scenes seed": ("seed", lambda value: draw_scenes(1, value), NO_COUNT),
    "long_drives": ("scenes", lambda value: long_drives(value, 1, "val"), [*NO_COUNT, 0]),
    "draw_variants": ("variants", lambda value: draw_variants(Scene(), value), [*NO_COUNT, 0]),
    "resized": ("scene", lambda value: resized(value, 64, 48), NO_VALUE),
    "resized size": ("camera.width_px", lambda value: resized(Scene(), value, 48), [*NO_COUNT, 0]),
    "adapted": ("size_px", lambda value: adapted(Scene(), value, 18.0, "day"), [*NO_VALUE, (64,)]),
    "with_beam": ("scene", lambda value: with_beam(value, "low"), NO_VALUE),
    "without_traffic": ("scene", without_traffic, NO_VALUE),
    "scene_to_toml": ("scene", scene_to_toml, NO_VALUE),
    "read_scene": ("path", read_scene, NO_PATH),
    "Drive": ("scene", Drive, NO_VALUE),
    "Drive headlamps": ("headlamps", lambda value: Drive(Scene(), "fast", value), ["x", 0, []]),
    "Drive.set_led_levels": ("set_led_levels", lambda value: Drive(MATRIX, "fast").set_led_levels(value), NO_VECTORS),
    "drive_exposures": ("profiles", lambda value: next(drive_exposures(Scene(), value)), [None, 1.5]),
    "drive_exposures profile": ("profile", lambda value: next(drive_exposures(Scene(), [value])), ["x", 1.5]),
    "side_by_side": ("led_levels", lambda value: next(side_by_side(MATRIX, value)), NO_VALUE),
    "scene_counts": ("matches", lambda value: scene_counts(value, {1: 1}, 0.5), NO_VALUE),
    "scene_counts sequence_of": ("sequence_of", lambda value: scene_counts(MATCHES, value, 0.5), [*NO_VALUE, {}]),
    "scene_counts threshold": (
        "threshold",
        lambda value: scene_counts(MATCHES, {1: 1}, value),
        [None, "x", 2, math.nan],
    ),
    "match_lights": ("labels", lambda value: match_lights(value, Predictions({}, {})), NO_VALUE),
    "break_down": ("matched", lambda value: break_down(value, 0.5), NO_VALUE),
    "break_down threshold": ("threshold", lambda value: break_down(UNMADE_MATCHES, value), NO_SHARE),
    "examine": ("detector", lambda value: examine(NOTHING, NOTHING, 0.5, value), NO_VALUE[::2]),
    "examine threshold": ("threshold", lambda value: examine(NOTHING, NOTHING, value, "ours"), NO_SHARE),
    "Predictions.light_kinds": (
        "Predictions.light_kinds: image 7",
        lambda value: Predictions({7: np.zeros((1, 4))}, {7: np.ones(1)}, light_kinds={7: value}),
        [np.ones((1, 4)), np.array([[math.nan, 1.0, 0.0, 0.0]]), np.zeros((0, 4)), [[1.0, 0.0, 0.0, 0.0]]],
    ),
    "GeographicOrigin": (
        "GeographicOrigin.latitude_deg",
        lambda value: GeographicOrigin(value, 9.0),
        [*NO_VALUE[:2], True],
    ),
    "GeographicOrigin range": ("GeographicOrigin", lambda value: GeographicOrigin(0.0, value), [181, math.nan]),
    "GeographicOrigin.local": ("longitudes_deg", lambda value: ORIGIN.local(48.0, value), NO_DEGREES),
    "GeographicOrigin.yaw_rad": ("latitudes_deg", lambda value: ORIGIN.yaw_rad(value, 9.0, 0.0), [*NO_DEGREES, 91.0]),
    "RoadMap": ("RoadMap.origin", lambda value: RoadMap([ROAD], value), NO_VALUE[1:]),
    "RoadMap.ahead": ("pose", ROADS.ahead, [*NO_VALUE, (1.0, 2.0)]),
    "RoadMap.ahead length_m": ("length_m", lambda value: ROADS.ahead(POSE, value), NO_LENGTH),
    "RoadMap.hindrance": ("pose", ROADS.hindrance, NO_VALUE),
    "CentreLine.ahead": ("pose", ROAD.ahead, [*NO_VALUE, (1.0, 2.0)]),
    "CentreLine.ahead length_m": ("length_m", lambda value: ROAD.ahead(POSE, value), NO_LENGTH),
    "CentreLine.ahead error": (
        "error_bound_m",
        lambda value: ROAD.ahead(POSE, 9.0, value),
        [None, "x", -1.0, math.nan],
    ),
    "PoseTrack.pose": ("timestamp_ns", lambda value: poses().pose(value), NO_TIME),
    "PoseTrack.is_reported": ("timestamp_ns", lambda value: poses().is_reported(value), NO_TIME),
    "CanLog.motion": ("timestamp_ns", CanLog().motion, NO_TIME),
    "CanLog.street": ("timestamp_ns", CanLog().street, NO_TIME),
    "Occurrence.nearest_m": ("share", PLACES.nearest_m, NO_SHARE),
    "GapWriter.command": (
        "gaps",
        lambda value: GapWriter(BeamConfig(), LAMPS).command(0, [value]),
        [*NO_VALUE, (-0.1, 0.1, 20.0, 40.0, True)],
    ),
    "CameraOptions delay_s": ("delay_s", lambda value: CameraOptions(delay_s=value), [*NO_VALUE, -1, math.inf, True]),
    "CameraOptions size_px": ("size_px", lambda value: CameraOptions(size_px=value), [*NO_VALUE[1:], (0, 1), (1.5, 2)]),
    "CameraOptions data": ("data", lambda value: CameraOptions(data=value), NO_VALUE[1:]),
    "CameraOptions seed": ("seed", lambda value: CameraOptions(seed=value), NO_COUNT),
    "CameraOptions quality": ("quality", lambda value: CameraOptions(quality=value), [None, 1.5]),
    "Opening": ("function", lambda value: Opening(value, ()), NO_VALUE),
    "Opening arguments": ("arguments", lambda value: Opening(open_source, value), NO_VALUE),
    "changed": ("base", lambda value: changed(value, {}), NO_VALUE),
    "changed fields": ("fields", lambda value: changed(RECIPES["paper"], value), NO_VALUE),
    "changed network": ("recipe: network", lambda value: changed(RECIPES["paper"], {"network": value}), NO_VECTORS),
    "paired_bootstrap": (
        "counts_b",
        lambda value: paired_bootstrap(np.ones((3, 3)), value),
        [*NO_NUMBERS, [[math.nan] * 3]],
    ),
    "paired_bootstrap num_resamples": (
        "num_resamples",
        lambda value: paired_bootstrap(np.ones((3, 3)), np.ones((3, 3)), num_resamples=value),
        [*NO_COUNT, 0],
    ),
    "percentile_interval": (
        "seed",
        lambda value: percentile_interval(np.ones((3, 3)), lambda counts: counts[..., 0], seed=value),
        NO_COUNT,
    ),
}
"""By function, the argument as it is told, how it is called, and what is wrong."""


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_argument_is_named(name: str) -> None:
    argument, call, wrong = CASES[name]
    for value in wrong:
        with pytest.raises(ValueError, match=rf"^{argument}: expected ") as refused:
            call(value)
        assert len(str(refused.value)) < 300


def test_no_image_of_a_data_set_has_a_negative_id(tmp_path: Path) -> None:
    image = Frame(np.zeros((64, 64), np.uint8), timestamp_ns=0, frame=-1)
    with PVDNWriter(tmp_path / "val") as writer:
        with pytest.raises(ValueError, match="val: image id: expected a whole number of at least 0, got -1"):
            writer.add_sequence(Sequence.plain(1), [LabelledImage(image)])
        writer.add_sequence(Sequence.plain(1), [LabelledImage(Frame(image.image, timestamp_ns=0, frame=0))])


@pytest.mark.parametrize(
    ("info", "place"),
    [
        ({"note": math.nan}, "info.note"),
        ({"tags": {1}}, "info.tags"),
        ({"a": [{"b": Path("x")}]}, "info.a.0.b"),
        ({1: 2}, "info"),
    ],
)
def test_what_json_cannot_store_is_refused_before_anything_is_written(info: Any, place: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"val: {place}: expected "):
        PVDNWriter(tmp_path / "val", info=info)
    assert list(tmp_path.iterdir()) == []
