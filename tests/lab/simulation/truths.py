"""What the simulator knows of vehicles, with ordinary values for what a test does not ask for."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from foreglow.datasets.simulated import Artifact, LampTruth, VehicleTruth
from foreglow.geometry import Pose


def artifact(x: float = 100.0, y: float = 100.0, **fields: Any) -> Artifact:
    """A marked indirect artifact on the road, ten times as strong as the default rule asks for."""
    usual = Artifact(-1, (x, y), "road", False, False, False, 60.0, 20.0, 50.0, 100)
    return dataclasses.replace(usual, **fields)


def lamp_artifact(name: str = "low_left", x: float = 100.0, **fields: Any) -> Artifact:
    usual: dict[str, Any] = {"kind": "lamp", "is_direct": True, "grey": 150.0, "lamp": name}
    return artifact(x, **(usual | fields))


def lamp(name: str = "low_left", **fields: Any) -> LampTruth:
    """A headlamp 100 m ahead of the world's origin, in full sight."""
    usual = LampTruth(name, False, np.array([100.0, 0.0, 0.7]), (50.0, 40.0), 0.08, 300.0, 1.0)
    return dataclasses.replace(usual, **fields)


def vehicle(vehicle_id: int = 0, **fields: Any) -> VehicleTruth:
    """A car 100 m away without lamps or artifacts."""
    usual = VehicleTruth(
        vehicle_id=vehicle_id,
        kind="car",
        pose=Pose(np.zeros(3), np.eye(3)),
        speed_mps=20.0,
        size_m=(4.4, 1.8, 1.5),
        box_centre_m=np.zeros(3),
        box_xyxy_px=None,
        visible_share=0.0,
        range_m=100.0,
        lamps=(),
        artifacts=(),
        candidates=(),
        eye_world_m=np.zeros(3),
        eye_lx={},
    )
    return dataclasses.replace(usual, **fields)
