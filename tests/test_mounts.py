"""The camera of a frame is for its size, on a vehicle, and looks ahead, wherever it comes from."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import Camera, Pose, rotation
from foreglow.types import Frame


@pytest.mark.parametrize(
    ("position_m", "turned"),
    [
        ([30.1, 0.0, 1.3], np.eye(3)), ([1.9, 300.0, 1.3], np.eye(3)), ([1.9, 0.0, 0.0], np.eye(3)),
        ([1.9, 0.0, -1.3], np.eye(3)), ([1.9, 0.0, 10.1], np.eye(3)), ([1e308, 0.0, 1.3], np.eye(3)),
        ([1.9, 0.0, 1.3], np.diag([-1.0, -1.0, 1.0])), ([1.9, 0.0, 1.3], np.diag([1.0, -1.0, -1.0])),
        ([1.9, 0.0, 1.3], rotation(yaw_rad=0.8)), ([1.9, 0.0, 1.3], rotation(pitch_rad=-0.8)),
    ],
)  # fmt: skip
def test_a_camera_is_on_a_vehicle_and_looks_ahead(position_m: list[float], turned: np.ndarray) -> None:
    camera = Camera(8, 4, (9.0, 9.0), (4.0, 2.0), (0.0,) * 5, Pose(np.array(position_m), turned))
    field = "position_m" if np.array_equal(turned, np.eye(3)) else "rotation"
    with pytest.raises(ValueError, match=rf"^a.png: Frame\.camera\.vehicle_from_camera\.{field}: expected "):
        Frame(np.zeros((4, 8), np.uint8), 0, path="a.png", camera=camera)


def test_a_camera_may_be_turned_to_the_limit() -> None:
    for turn in np.radians([[45.0, 0.0, 0.0], [0.0, -45.0, 0.0], [45.0, 45.0, -45.0]]):
        pose = Pose(np.array([-30.0, 10.0, 10.0]), rotation(*turn))
        camera = Camera(8, 4, (9.0, 9.0), (4.0, 2.0), (0.0,) * 5, pose)
        assert Frame(np.zeros((4, 8), np.uint8), 0, camera=camera).camera is camera


def test_a_frame_refuses_the_calibration_of_another_size() -> None:
    camera = Camera(8, 4, (9.0, 9.0), (4.0, 2.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
    assert Frame(np.zeros((4, 8), np.uint8), 0, camera=camera).camera is camera
    with pytest.raises(ValueError, match=r"a.png: Frame.camera: expected .* 16x8 px, got one for 8x4 px"):
        Frame(np.zeros((8, 16), np.uint8), 0, path="a.png", camera=camera)
