"""Lines of sight: what the camera sees of lamps and bodies, light at drivers' eyes, and the faces of fixed lights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import LampTruth
from foreglow.geometry import Camera, Floats, Pose
from foreglow.lab.simulation.camera.optics import LampPoints
from foreglow.lab.simulation.light.lamps import FIXED_LAYER, PlacedBody, PlacedLamp
from foreglow.lab.simulation.light.render import Renderer
from foreglow.lab.simulation.traffic.actors import Actor, LitLamp
from foreglow.lab.simulation.world.furniture import FixedLight
from foreglow.photometry import IntensityTable, illuminance_lx, street_lamp, traffic_light, window

DISC = np.array(
    [(0.0, 0.0), *((share * np.cos(a), share * np.sin(a)) for share in (0.5, 0.95) for a in np.arange(6) * np.pi / 3)]
)
"""Points spread over a lamp's disc, in units of its radius."""

SMALLEST_FACE_PX = 3.0
"""A lamp whose face is smaller in the image is drawn as its disc."""

MAX_FACE_DISCS = 7
"""Discs in a row that draw a face."""

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
        positions, illuminances, radii = [np.zeros((0, 2))], [np.zeros(0)], [np.zeros(0)]
        for lamp, lit in zip(lamps, actor.lamps, strict=True):
            if lamp.visible_share <= 0 or (only_rear and not lamp.is_rear):
                continue
            distance = float(np.linalg.norm(lamp.position_world_m - self.camera_m))
            illuminance = lamp.visible_share * self.illuminance_lx(lit.placed, self.camera_m)
            points, radius_m = np.array([lamp.position_px]), lamp.radius_m
            if self.radius_px(max(lit.face_m), distance) > SMALLEST_FACE_PX:
                points, radius_m = self._face_px(lit)
            positions.append(points)
            illuminances.append(np.full(len(points), illuminance / len(points)))
            radii.append(np.full(len(points), self.radius_px(radius_m, distance)))
        return LampPoints(np.concatenate(positions), np.concatenate(illuminances), np.concatenate(radii))

    def _face_px(self, lamp: LitLamp) -> tuple[Floats, float]:
        """Points on the face of a lamp, shape (N, 2), of overlapping discs that draw it, and their radius in metres."""
        width, height = lamp.face_m
        radius_m = min(lamp.face_m) / 2
        num_y, num_z = (min(MAX_FACE_DISCS, 2 * round(size / min(lamp.face_m)) - 1) for size in lamp.face_m)
        y, z = (
            (np.arange(num) - (num - 1) / 2) * (size - 2 * radius_m) / max(num - 1, 1)
            for num, size in ((num_y, width), (num_z, height))
        )
        local = np.stack([np.zeros(num_y * num_z), *(axis.ravel() for axis in np.meshgrid(y, z))], -1)
        world = lamp.placed.world_from_lamp.to_outer(local)
        return np.array([self.project(point) for point in world]), radius_m

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


EGO_EYE_M = np.array([1.45, 0.35, 1.2])
"""Our driver's eye in the vehicle's frame, in a car for right-hand traffic."""

FARTHEST_LAMP_M = 400.0
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
        direct *= facing * (distances < FARTHEST_LAMP_M)
        if float(direct.sum()) < FAINTEST_LX:
            return 0.0
        return float((direct * self._sightings.is_free(positions, eye_m, ignore_body)).sum())


FARTHEST_DRAWN_M = 600.0
"""Lights further away are not drawn, but for those of places in the distance."""

PANE = np.array([(y, z) for z in (-1 / 3, 0.0, 1 / 3) for y in (-0.25, 0.25)])
"""Points that draw a light's face, in its width and height."""

SMALL_PX = 8.0
"""A face that is smaller in the image is drawn as one disc."""


class FixedLights:
    """The fixed lights of a scene."""

    def __init__(self, lights: Sequence[FixedLight]) -> None:
        self._lights = tuple(light for light in lights if light.intensity_cd > 0)
        self._positions_m = np.array([light.pose.position_m for light in self._lights]).reshape(-1, 3)

    def lamps_near(self, position_m: Floats) -> list[PlacedLamp]:
        """The lights that light what a camera at `position_m`, shape (3,), sees; windows of flats light nothing."""
        distances = np.linalg.norm(self._positions_m - position_m, axis=1)
        return [
            PlacedLamp(light.pose, _table(light), FIXED_LAYER, light.intensity_cd)
            for light, distance in zip(self._lights, distances, strict=True)
            if distance < light.reach_m and light.kind != "window"
        ]

    def points(self, sightings: Sightings) -> LampPoints:
        """The faces of the lights as the camera sees them, a few points each; screens are surfaces of the world."""
        faces, illuminances, radii = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0)]
        camera_m = sightings.camera_m
        for light, position_m in zip(self._lights, self._positions_m, strict=True):
            distance = float(np.linalg.norm(camera_m - position_m))
            if light.kind == "screen" or (distance > FARTHEST_DRAWN_M and light.kind != "far_lamp"):
                continue
            towards = light.pose.to_body(camera_m)
            intensity = float(_table(light).towards(towards)) * light.intensity_cd
            if intensity <= 0:
                continue
            is_small = sightings.radius_px(max(light.size_m), distance) < SMALL_PX
            pane = PANE[:1] * 0.0 if is_small else PANE
            # Slightly in front of the face, which otherwise would hide its own points.
            faces.append(light.pose.to_outer(np.column_stack([np.full(len(pane), 0.03), pane * light.size_m])))
            cell_m = np.sqrt(light.size_m[0] * light.size_m[1] / len(pane) / np.pi)
            illuminance = intensity / len(pane) / distance**2 * sightings.attenuation(distance)
            illuminances.append(np.full(len(pane), illuminance))
            radii.append(np.full(len(pane), sightings.radius_px(float(cell_m), distance)))
        points = np.concatenate(faces)
        seen = sightings.visible_points(points)
        positions = [sightings.project(point) for point in points[seen]]
        return LampPoints(
            np.array(positions).reshape(-1, 2), np.concatenate(illuminances)[seen], np.concatenate(radii)[seen]
        )


def _table(light: FixedLight) -> IntensityTable:
    tables = {"street_lamp": street_lamp, "signal": traffic_light}
    return tables.get(light.kind, window)()
