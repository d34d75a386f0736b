from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.geometry import Camera, MountSigmas, Pose, rotation

ANGLES = st.floats(-3.0, 3.0)
NOWHERE = Pose(np.zeros(3), np.eye(3))


def camera(**changes: object) -> Camera:
    fields: dict[str, object] = {
        "width_px": 1280,
        "height_px": 960,
        "focal_px": (1312.0, 1300.0),
        "centre_px": (650.0, 470.0),
        "distortion": (-0.05, 0.02, 1e-3, -5e-4, 0.0),
        "vehicle_from_camera": NOWHERE,
    }
    return Camera(**(fields | changes))  # type: ignore[arg-type]


@given(ANGLES, ANGLES, ANGLES)
def test_a_rotation_is_one(yaw: float, pitch: float, roll: float) -> None:
    turned = rotation(yaw, pitch, roll)
    assert np.allclose(turned @ turned.T, np.eye(3))
    assert np.isclose(np.linalg.det(turned), 1.0)


@pytest.mark.parametrize(
    ("angles", "body", "outer"),
    [
        ((np.pi / 2, 0, 0), [1, 0, 0], [0, 1, 0]),  # left turn: forward becomes left
        ((0, np.pi / 2, 0), [1, 0, 0], [0, 0, 1]),  # nose up
        ((0, 0, np.pi / 2), [0, 1, 0], [0, 0, 1]),  # roll to the right lifts the left side
    ],
)
def test_signs_of_the_angles(angles: tuple[float, float, float], body: list[float], outer: list[float]) -> None:
    assert np.allclose(rotation(*angles) @ body, outer)


@given(ANGLES, ANGLES, st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_pose_there_and_back(yaw: float, pitch: float, point: list[float]) -> None:
    pose = Pose(np.array([1.0, -2.0, 3.0]), rotation(yaw, pitch))
    assert np.allclose(pose.to_body(pose.to_outer(point)), point)
    inner = Pose(np.array(point), rotation(0.3))
    assert np.allclose((pose @ inner).to_outer([1.0, 2.0, 3.0]), pose.to_outer(inner.to_outer([1.0, 2.0, 3.0])))


@pytest.mark.parametrize(
    ("position", "turned", "message"),
    [
        ([0, 0], np.eye(3), "position_m"),
        ([0, np.nan, 0], np.eye(3), "position_m"),
        ([0, 0, 0], 2 * np.eye(3), "rotation"),
        ([0, 0, 0], np.full((3, 3), np.nan), "rotation"),
    ],
)
def test_bad_poses(position: list[float], turned: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Pose(np.array(position, float), turned)


def test_pose_keeps_its_own_arrays() -> None:
    position = np.zeros(3)
    pose = Pose(position, np.eye(3))
    position[0] = 5.0
    assert pose.position_m[0] == 0.0


def test_projection_of_the_axis_and_of_the_sides() -> None:
    plain = camera(distortion=(0.0,) * 5)
    assert np.allclose(plain.project([10.0, 0.0, 0.0]), plain.centre_px)
    assert plain.project([10.0, 1.0, 0.0])[0] < plain.centre_px[0]  # left is to smaller x
    assert plain.project([10.0, 0.0, 1.0])[1] < plain.centre_px[1]  # up is to smaller y
    assert np.allclose(plain.project([10.0, -1.0, 0.0])[0] - plain.centre_px[0], 131.2)
    assert np.isnan(plain.project([-1.0, 0.0, 0.0])).all()


@given(st.floats(0, 1280), st.floats(0, 960))
def test_ray_through_a_pixel_meets_it_again(x: float, y: float) -> None:
    ray = camera().rays([x, y])
    assert np.isclose(np.linalg.norm(ray), 1.0)
    assert np.allclose(camera().project(7.0 * ray), [x, y], atol=1e-6)


def test_projection_agrees_with_opencv() -> None:
    import cv2

    mounted = camera()
    points = np.array([[20.0, 3.0, -1.0], [8.0, -2.5, 1.5], [300.0, -40.0, 2.0]])
    in_opencv = np.stack([-points[:, 1], -points[:, 2], points[:, 0]], -1)
    matrix = np.array([[1312.0, 0, 650.0], [0, 1300.0, 470.0], [0, 0, 1]])
    expected, _ = cv2.projectPoints(in_opencv, np.zeros(3), np.zeros(3), matrix, np.array(mounted.distortion))
    assert np.allclose(mounted.project(points), expected[:, 0], atol=1e-9)


def test_a_scaled_camera_sees_the_same_directions() -> None:
    half = camera().scaled(640, 480)
    assert np.allclose(half.rays([100.0, 200.0]), camera().rays([200.0, 400.0]))
    assert half.pixel_solid_angle_sr == pytest.approx(4 * camera().pixel_solid_angle_sr)


@pytest.mark.parametrize(
    "changes",
    [{"width_px": 0}, {"focal_px": (0.0, 1.0)}, {"focal_px": (np.nan, 900.0)}, {"centre_px": (np.inf, 1.0)},
     {"focal_px": (900.0, np.nan)}, {"focal_px": (900.0, np.inf)}, {"centre_px": (1.0, np.nan)},
     {"distortion": (np.nan, 0.0, 0.0, 0.0, 0.0)}, {"distortion": (0.0, 0.0, 0.0, 0.0, 1e7)},
     {"focal_px": (1e7, 1.0)}, {"centre_px": (1e6, 1.0)}, {"centre_px": (640.0, -2561.0)},
     {"width_px": 2**70}, {"height_px": 2**20 + 1}, {"focal_px": (4.2, 4.2)}],
)  # fmt: skip
def test_bad_cameras(changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="Camera"):
        camera(**changes)


def test_numbers_of_a_camera_do_not_change_later() -> None:
    focal_px = np.array([900.0, 900.0])
    made = camera(focal_px=focal_px)
    focal_px[0] = 1.0
    assert made.focal_px == (900.0, 900.0)
    assert made == camera(focal_px=[900.0, 900.0], vehicle_from_camera=made.vehicle_from_camera)


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("focal_px", 5, "expected 2 numbers, got 5"),
        ("focal_px", ("a", "b"), "expected numbers, got "),
        ("centre_px", None, "expected numbers, got None"),
        ("distortion", (0.0,) * 4, "expected 5 numbers, got "),
        ("distortion", [[0.0], [0.0, 1.0]], "expected numbers, got "),
        ("width_px", "1280", "expected a whole number, got '1280'"),
        ("height_px", 960.5, "expected a whole number, got 960.5"),
        ("vehicle_from_camera", None, "expected Pose, got NoneType"),
        ("mount_sigmas", 0.1, "expected MountSigmas, got float"),
    ],
)
def test_a_camera_refuses_values_of_another_type(field: str, value: object, complaint: str) -> None:
    with pytest.raises(ValueError, match=rf"^Camera\.{field}: {complaint}"):
        camera(**{field: value})


def test_a_mount_refuses_what_are_no_numbers() -> None:
    with pytest.raises(ValueError, match=r"^Pose\.position_m: expected numbers, got 'here'"):
        Pose("here", np.eye(3))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^MountSigmas\.roll_rad: expected a number, got None"):
        MountSigmas(roll_rad=None)  # type: ignore[arg-type]


@pytest.mark.parametrize("centre_px", [(-2560.0, 3520.0), (3840.0, -2560.0), (640.0, 480.0)])
def test_the_principal_point_of_a_part_of_a_larger_image(centre_px: tuple[float, float]) -> None:
    """Up to two longer sides outside: a strip at the edge of a sensor, for one."""
    assert camera(centre_px=centre_px).scaled(640, 480).centre_px == (centre_px[0] / 2, centre_px[1] / 2)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.05, 1e-3, 0.0, 0.0)])
def test_what_is_infinite_has_neither_pixel_nor_ray(distortion: tuple[float, ...]) -> None:
    seen = camera(distortion=distortion)
    points = itertools.product((5.0, math.inf, -math.inf, math.nan), repeat=3)
    infinite = np.array([point for point in points if not np.isfinite(point).all()] + [(1e-8, 1e300, 0.0)])
    assert np.isnan(seen.project(infinite)).all()
    assert np.isnan(seen.project(infinite[0])).all()
    assert np.isnan(seen.rays([[math.inf, 3.0], [3.0, -math.inf], [math.nan, 3.0]])).all()
    mixed = seen.project([[5.0, 1.0, 1.0], [math.inf, 0.0, 0.0]])
    assert np.isfinite(mixed[0]).all()
    assert np.isnan(mixed[1]).all()
