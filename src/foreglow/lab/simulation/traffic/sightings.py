"""Visibility of lamps and bodies for the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import LampTruth
from foreglow.geometry import Camera, Floats, Pose
from foreglow.lab.simulation.camera.optics import LampPoints
from foreglow.lab.simulation.light.lamps import PlacedBody, PlacedLamp
from foreglow.lab.simulation.light.render import Renderer
from foreglow.lab.simulation.traffic.actors import Actor, LitLamp
from foreglow.photometry import illuminance_lx

DISC = np.array(
    [(0.0, 0.0), *((share * np.cos(a), share * np.sin(a)) for share in (0.5, 0.95) for a in np.arange(6) * np.pi / 3)]
)
"""Points spread over a lamp's disc, in units of its radius."""

BODY_POINTS = np.array([(x, y, z) for x in (-0.45, 0.0, 0.45) for y in (-0.45, 0.0, 0.45) for z in (-0.35, 0.1, 0.45)])
"""Points spread over a vehicle's box, in units of its size."""


class Sightings:
    """Lines of sight in one frame.

    Attributes:
        camera_m: Position of the camera in the world, shape (3,).
    """

    def __init__(
        self, renderer: Renderer, camera: Camera, camera_pose: Pose, bodies: Sequence[PlacedBody], haze_per_m: float
    ) -> None:
        """Takes the frame; every method casts its own rays.

        Args:
            renderer: Casts the rays.
            camera: The calibration.
            camera_pose: world_from_camera.
            bodies: Bodies of all vehicles, in the order of the actors.
            haze_per_m: Extinction coefficient of the air.
        """
        self._renderer = renderer
        self._camera = camera
        self._camera_pose = camera_pose
        self.camera_m = camera_pose.position_m
        self._bodies = bodies
        self._haze_per_m = haze_per_m

    def lamps(self, actor: Actor) -> tuple[LampTruth, ...]:
        """The lamps of a vehicle, as the camera sees them."""
        if not actor.lamps:
            return ()
        discs = np.concatenate([_disc_points(lamp.placed) for lamp in actor.lamps])
        is_seen = self.is_free(discs, self.camera_m).reshape(len(actor.lamps), len(DISC))
        return tuple(self._lamp(lamp, float(seen.mean())) for lamp, seen in zip(actor.lamps, is_seen, strict=True))

    def visible_points(self, points_world_m: Floats) -> NDArray[np.bool_]:
        """Which of the points, shape (N, 3), the camera sees, shape (N,); points outside the image are not seen."""
        is_seen = self._is_in_image(points_world_m)
        if is_seen.any():
            is_seen[is_seen] = self.is_free(points_world_m[is_seen], self.camera_m)
        return is_seen

    def body_share(self, index: int, actor: Actor) -> float:
        """Share of a vehicle's body that the camera sees."""
        points = actor.state.pose.to_outer(actor.body.box_centre_m + BODY_POINTS * actor.body.size_m)
        is_inside = self._is_in_image(points)
        if not is_inside.any():
            return 0.0
        is_seen = self.is_free(points[is_inside], self.camera_m, index)
        return float(is_seen.sum() / len(points))

    def box_xyxy_px(self, actor: Actor) -> tuple[int, int, int, int] | None:
        """The box around a vehicle's projection, clipped to the image; None if it is outside or behind the camera."""
        corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        world = actor.state.pose.to_outer(actor.body.box_centre_m + corners * actor.body.size_m)
        in_camera = self._camera_pose.to_body(world)
        if (in_camera[:, 0] < 0.5).any():
            return None
        pixels = self._camera.project(in_camera)
        size = (self._camera.width_px, self._camera.height_px)
        low = np.clip(np.floor(pixels.min(0)), 0, size).astype(int)
        high = np.clip(np.ceil(pixels.max(0)), 0, size).astype(int)
        if (low >= high).any():
            return None
        return (int(low[0]), int(low[1]), int(high[0]), int(high[1]))

    def lamp_points(self, actor: Actor, lamps: tuple[LampTruth, ...], *, only_rear: bool = False) -> LampPoints:
        """The lamps of a vehicle that the camera sees, as points of light; all of them, or only rear lamps."""
        seen = [index for index, lamp in enumerate(lamps) if lamp.visible_share > 0 and (lamp.is_rear or not only_rear)]
        distances = [float(np.linalg.norm(lamps[index].position_world_m - self.camera_m)) for index in seen]
        return LampPoints(
            np.array([lamps[index].position_px for index in seen]).reshape(-1, 2),
            np.array(
                [
                    lamps[index].visible_share * self.illuminance_lx(actor.lamps[index].placed, self.camera_m)
                    for index in seen
                ]
            ),
            np.array([self.radius_px(lamps[index].radius_m, d) for index, d in zip(seen, distances, strict=True)]),
        )

    def radius_px(self, radius_m: float, distance_m: float) -> float:
        """Radius in the image of a disc that faces the camera."""
        return radius_m / distance_m * self._camera.focal_px[0]

    def project(self, point_world_m: Floats) -> Floats:
        """Pixels x, y, shape (2,), of a point; NaN behind the camera."""
        return self._camera.project(self._camera_pose.to_body(point_world_m))

    def attenuation(self, distance_m: float) -> float:
        """Share of the light that passes the haze."""
        return float(np.exp(-self._haze_per_m * distance_m))

    def illuminance_lx(self, lamp: PlacedLamp, point_m: Floats) -> float:
        """Illuminance at a point, shape (3,), that faces `lamp` with only the haze in between."""
        distance = float(np.linalg.norm(point_m - lamp.world_from_lamp.position_m))
        free = float(illuminance_lx(lamp.table, lamp.world_from_lamp, point_m)) * lamp.scale
        return free * self.attenuation(distance)

    def range_m(self, actor: Actor) -> float:
        """From the camera to the middle between a vehicle's headlamps, or to its box's centre if they are off."""
        heads = [lamp.placed.world_from_lamp.position_m for lamp in actor.lamps if lamp.function == "low"]
        middle = np.mean(heads, axis=0) if heads else actor.state.pose.to_outer(actor.body.box_centre_m)
        return float(np.linalg.norm(middle - self.camera_m))

    def is_free(self, origins_m: Floats, target_m: Floats, ignore_body: int | None = None) -> NDArray[np.bool_]:
        """Whether each of `origins_m`, shape (N, 3), sees `target_m`, shape (3,), in the world; shape (N,)."""
        return self._renderer.is_visible(origins_m, target_m, self._bodies, ignore_body=ignore_body)

    def _lamp(self, lamp: LitLamp, visible_share: float) -> LampTruth:
        placed = lamp.placed
        position = placed.world_from_lamp.position_m
        x, y = self.project(position).tolist()
        towards = placed.world_from_lamp.to_body(self.camera_m)
        share = visible_share if towards[0] > 0 and self._is_in_image(position[None])[0] else 0.0
        return LampTruth(
            name=lamp.name,
            is_rear=lamp.is_rear,
            position_world_m=position,
            position_px=(x, y),
            radius_m=placed.radius_m,
            intensity_cd=float(placed.table.towards(towards)) * placed.scale,
            visible_share=share,
        )

    def _is_in_image(self, points_world_m: Floats) -> NDArray[np.bool_]:
        in_camera = self._camera_pose.to_body(points_world_m)
        # Far outside the field of view, the distortion may fold back into the image, so that the angle is checked too.
        is_ahead = in_camera[:, 0] > 0.2 * np.linalg.norm(in_camera, axis=1)
        pixels = np.nan_to_num(self._camera.project(in_camera), nan=-1.0)
        is_inside = ((pixels >= 0) & (pixels < (self._camera.width_px, self._camera.height_px))).all(1)
        return np.asarray(is_ahead & is_inside)


def _disc_points(lamp: PlacedLamp) -> Floats:
    """Points on a lamp's disc, two centimetres in front of it, shape (len(DISC), 3), in the world."""
    local = np.column_stack([np.full(len(DISC), 0.02), DISC * lamp.radius_m])
    return lamp.world_from_lamp.to_outer(local)
