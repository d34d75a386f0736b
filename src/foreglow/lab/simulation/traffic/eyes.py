"""Illuminance at the drivers' eyes, as a measure of glare."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foreglow.geometry import Floats, Pose
from foreglow.lab.simulation.light.lamps import PlacedLamp
from foreglow.lab.simulation.traffic.actors import Actor
from foreglow.lab.simulation.traffic.sightings import Sightings

EGO_EYE_M = np.array([1.45, 0.35, 1.2])
"""Our driver's eye in the vehicle's frame, in a car for right-hand traffic."""

FARTHEST_M = 400.0
"""Lamps further away are left out: a low beam gives less than 0.005 lx there."""

FAINTEST_LX = 1e-6


class Eyes:
    """Illuminance at eyes in one frame, on a plane perpendicular to the driver's line of sight.

    The windscreen and the driver's own vehicle do not block any light.
    """

    def __init__(
        self, sightings: Sightings, actors: Sequence[Actor], own: Sequence[PlacedLamp], fixed: Sequence[PlacedLamp]
    ) -> None:
        """Takes the frame's lamps.

        Args:
            sightings: Lines of sight in this frame.
            actors: The other vehicles.
            own: Our headlamps.
            fixed: Street lamps nearby.
        """
        self._sightings = sightings
        self._actors = actors
        self._own = own
        self._fixed = fixed

    def at_vehicle(self, index: int) -> dict[str, float]:
        """Illuminance at the eye of the vehicle at `index`, by source: `ego`, `fixed`, and other vehicles' ids."""
        actor = self._actors[index]
        eye, forward = actor.eye_world_m, actor.state.pose.rotation[:, 0]
        sources = {"ego": self._own, "fixed": self._fixed}
        sources |= {
            str(other.vehicle_id): [lamp.placed for lamp in other.lamps]
            for number, other in enumerate(self._actors)
            if number != index
        }
        return {name: self._lx(eye, forward, lamps, index) for name, lamps in sources.items()}

    def at_ego(self, pose: Pose) -> dict[str, float]:
        """Illuminance at our own driver's eye, by vehicle id."""
        eye, forward = pose.to_outer(EGO_EYE_M), pose.rotation[:, 0]
        return {
            str(actor.vehicle_id): self._lx(eye, forward, [lamp.placed for lamp in actor.lamps], None)
            for actor in self._actors
        }

    def _lx(self, eye_m: Floats, forward: Floats, lamps: Sequence[PlacedLamp], ignore_body: int | None) -> float:
        if not lamps:
            return 0.0
        positions = np.array([lamp.world_from_lamp.position_m for lamp in lamps])
        distances = np.linalg.norm(positions - eye_m, axis=1)
        facing = np.clip((positions - eye_m) @ forward / distances, 0.0, None)
        direct = np.array([self._sightings.illuminance_lx(lamp, eye_m) for lamp in lamps])
        direct *= facing * (distances < FARTHEST_M)
        if float(direct.sum()) < FAINTEST_LX:
            return 0.0
        return float((direct * self._sightings.is_free(positions, eye_m, ignore_body)).sum())
