from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from foreglow.geometry import Pose, rotation
from foreglow.lab.simulation.moment import _still_depth_m


def vehicle(speed_mps: float, yaw_rad: float = 0.0) -> Any:
    state = SimpleNamespace(speed_mps=speed_mps, pose=Pose(np.zeros(3), rotation(yaw_rad)))
    return SimpleNamespace(actor=SimpleNamespace(state=state))


def test_what_drives_with_us_is_as_if_far_away_and_what_comes_as_if_near() -> None:
    moment = SimpleNamespace(
        rendered=SimpleNamespace(
            depth_m=np.full((1, 5), 20.0, np.float32), bodies=np.array([[-1, 0, 1, 2, 3]], np.int16)
        ),
        ego=SimpleNamespace(pose=Pose(np.zeros(3), np.eye(3)), speed_mps=30.0),
        vehicles=[vehicle(30.0), vehicle(15.0), vehicle(30.0, np.pi), vehicle(0.0)],
    )
    still = _still_depth_m(cast("Any", moment))[0]
    assert still[1] > 10_000
    assert still[[0, 2, 3, 4]] == pytest.approx([20.0, 40.0, 10.0, 20.0])
