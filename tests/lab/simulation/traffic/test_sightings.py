"""Lamps as the camera draws them."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from foreglow.datasets.simulated import LampTruth
from foreglow.geometry import Pose
from foreglow.lab.simulation.scenes.scene import RoadSpec, VehicleSpec
from foreglow.lab.simulation.traffic.actors import actors_at
from foreglow.lab.simulation.traffic.sightings import Sightings
from foreglow.lab.simulation.world.road import Road
from tests.lab.simulation.cameras import camera

CAMERA = camera(1280, 960)
HERE = Pose(np.array([0.0, -1.75, 1.2]), np.eye(3))


@pytest.mark.parametrize(("s_m", "num_points"), [(20.0, 10), (300.0, 2)])
def test_a_face_near_by_is_drawn_as_wide_as_it_is_with_the_same_light(s_m: float, num_points: int) -> None:
    spec = VehicleSpec(lane="own", timetable=((0.0, s_m), (10.0, s_m + 200.0)))
    actor = actors_at((spec,), (Road(RoadSpec()), ()), Pose(np.zeros(3), np.eye(3)), 0.0, 2)[0]
    sightings = Sightings(cast("Any", None), CAMERA, HERE, (), 0.0)
    lamps = tuple(
        LampTruth(
            name=lamp.name,
            is_rear=lamp.is_rear,
            position_world_m=lamp.placed.world_from_lamp.position_m,
            position_px=tuple(sightings.project(lamp.placed.world_from_lamp.position_m).tolist()),
            radius_m=lamp.placed.radius_m,
            intensity_cd=1.0,
            visible_share=float(lamp.is_rear),
        )
        for lamp in actor.lamps
    )
    points = sightings.lamp_points(actor, lamps, only_rear=True)
    assert len(points.illuminances_lx) == num_points
    expected_lx = sum(sightings.illuminance_lx(lamp.placed, HERE.position_m) for lamp in actor.lamps if lamp.is_rear)
    assert points.illuminances_lx.sum() == pytest.approx(expected_lx, rel=0.01)
    left = points.positions_px[: num_points // 2]
    wide_px = float(np.ptp(left[:, 0])) + 2 * points.radii_px[0]
    if num_points > 2:
        rear = next(lamp for lamp in actor.lamps if lamp.is_rear)
        distance_m = float(np.linalg.norm(rear.placed.world_from_lamp.position_m - HERE.position_m))
        assert wide_px == pytest.approx(rear.face_m[0] / distance_m * CAMERA.focal_px[0], rel=0.05)
        assert left.mean(0) == pytest.approx(sightings.project(rear.placed.world_from_lamp.position_m), abs=0.2)
