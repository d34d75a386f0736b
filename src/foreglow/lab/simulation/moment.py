"""The moments of a drive: all light in linear layers, before any camera. Every exposure is arithmetic on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import cv2
import numpy as np

from foreglow.datasets.simulated import LampTruth
from foreglow.geometry import Camera, Floats, Pose
from foreglow.lab.simulation.camera.exposure import LinearLight, VehicleLayers
from foreglow.lab.simulation.camera.motion_blur import MotionBlur, blur
from foreglow.lab.simulation.camera.optics import Image, LampPoints
from foreglow.lab.simulation.camera.streaks import FallingParticles
from foreglow.lab.simulation.light.lamps import EGO_LAYER, FIRST_VEHICLE_LAYER, FIXED_LAYER, PlacedLamp, mesh_name
from foreglow.lab.simulation.light.render import Rendered, Renderer, RenderSettings
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.traffic.actors import Actor, actors_at, ego_lamps, ego_tables
from foreglow.lab.simulation.traffic.kinematics import BodyMotion, VehicleState, ego_state
from foreglow.lab.simulation.traffic.sightings import Eyes, FixedLights, Sightings
from foreglow.lab.simulation.variants import AS_IT_IS, Variant
from foreglow.lab.simulation.world.bodies import BODIES
from foreglow.lab.simulation.world.mesh import Mesh
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.world.world import build_world
from foreglow.lab.simulation.writing.street_data import STREET_STREAM, StreetDataError, StreetMap
from foreglow.photometry import Headlamps
from foreglow.street import StreetMessage

Background: TypeAlias = tuple[Image, tuple[Image, ...], Image, Image | None]
"""All light but that of vehicles; images whose sum is our own part of it, before motion blurs it; rain or snow in it;
the motion in the image."""

SKY_M = 1e4
"""Stands for the distance of the sky."""

NO_POINTS = LampPoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0))

SHARE_COLUMNS = 640
"""In an image of more columns, it is asked for every second pixel or fewer which share of our light is left."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenVehicle:
    """Another vehicle in a moment, as a camera with the rendering's whole field of view sees it.

    Attributes:
        actor: Its place, body and lamps.
        lamps: Its lamps.
        points: Its lamps in sight, as points of light.
        rear_points: The rear lamps among them.
        box_px: Box around its projection; None outside the image.
        body_share: Visible share of its body.
        range_m: Its distance.
    """

    actor: Actor
    lamps: tuple[LampTruth, ...]
    points: LampPoints
    rear_points: LampPoints
    box_px: tuple[int, int, int, int] | None
    body_share: float
    range_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The light of a moment, and all that is known about it.

    Attributes:
        number: Number of the frame in the drive.
        time_s: Time since the begin of the drive.
        ego: Our own vehicle.
        vehicles: The other vehicles, in the order of their layers.
        rendered: Luminance by layer: fixed, own, each vehicle; then the parts of layers that are told apart.
        low_layer: Layer with our low beam alone; None if our lamps are not told apart.
        rear_layers: For each vehicle, the layer with its rear lamps alone; None if not told apart, or not lit.
        own: Our headlamps.
        own_layers: The layers of their light: one, or one for each lamp.
        own_shares: Shape (H, W) each, the shares of these layers that shine; None for all of it.
        own_low: Their low beam alone.
        fixed: Street lamps nearby.
        fixed_points: Street lamps and windows in sight.
        sightings: Lines of sight.
        street: The street message.
    """

    number: int
    time_s: float
    ego: VehicleState
    vehicles: tuple[SeenVehicle, ...]
    rendered: Rendered
    low_layer: int | None
    rear_layers: tuple[int | None, ...]
    own: tuple[PlacedLamp, ...]
    own_layers: tuple[int, ...]
    own_shares: tuple[Image, ...] | None
    own_low: tuple[PlacedLamp, ...]
    fixed: tuple[PlacedLamp, ...]
    fixed_points: LampPoints
    sightings: Sightings
    street: StreetMessage
    _backgrounds: dict[tuple[float, float, float], Background] = field(default_factory=dict, repr=False)
    _eyes_lx: dict[Variant, tuple[tuple[dict[str, float], ...], dict[str, float]]] = field(
        default_factory=dict, repr=False
    )
    _directions: list[tuple[Image, Image, Image]] = field(default_factory=list, repr=False)

    def vehicles_in(self, variant: Variant) -> tuple[SeenVehicle, ...]:
        """The vehicles, without the lamps of those that are off, and with those of others out of sight."""
        return tuple(_changed(seen, variant) for seen in self.vehicles)

    def own_in(self, variant: Variant) -> tuple[PlacedLamp, ...]:
        """Our headlamps at the variant's strength; a negative scale takes the low beam out of the whole light."""
        if not variant.changes_own:
            return self.own
        whole = tuple(replace(lamp, scale=lamp.scale * variant.high) for lamp in self.own)
        low = tuple(replace(lamp, scale=lamp.scale * (variant.low - variant.high)) for lamp in self.own_low)
        return (*whole, *low)

    def eyes_lx(self, variant: Variant) -> tuple[tuple[dict[str, float], ...], dict[str, float]]:
        """Illuminance by source at every vehicle's driver's eye, and at our own driver's."""
        if variant not in self._eyes_lx:
            actors = [seen.actor for seen in self.vehicles_in(variant)]
            eyes = Eyes(self.sightings, actors, self.own_in(variant), self.fixed)
            theirs = tuple(eyes.at_vehicle(index) for index in range(len(actors)))
            self._eyes_lx[variant] = theirs, eyes.at_ego(self.ego.pose)
        return self._eyes_lx[variant]


class Moments:
    """A drive in progress: the world, the renderer, and what moves in it."""

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        settings: RenderSettings,
        headlamps: Headlamps,
        *,
        is_split: bool = False,
        is_relit: bool = False,
    ) -> None:
        """Builds the world.

        Args:
            scene: The drive's specification.
            camera: The camera of the rendering.
            settings: Quality of the rendering.
            headlamps: Our matrix headlamps.
            is_split: Whether rear lamps and our low beam get layers of their own, which costs a few more rays.
            is_relit: Whether our lamps get a layer each, so that moments can be `relit`.
        """
        self._headlamps = headlamps
        self._scene = scene
        self._camera = camera
        self._is_split, self._is_relit = is_split, is_relit
        self._world = build_world(scene)
        self._lights = FixedLights(self._world.lights)
        self._body_motion = BodyMotion(scene.seed, scene.ego.body_motion)
        mesh = self._world.mesh
        self._renderer = Renderer(
            mesh,
            _body_meshes(scene),
            camera,
            settings,
            road=scene.road,
            seed=scene.seed,
            is_snowing=scene.weather.snow_mm_h > 0,
        )
        self._share_rays: Image | None = None
        self._particles = FallingParticles(scene.weather, camera, scene.seed)
        self._motion_blur = MotionBlur(camera)
        self._map = StreetMap(Road(scene.road), StreetDataError(), np.random.default_rng([scene.seed, STREET_STREAM]))

    def at(self, number: int, led_levels: Floats) -> Moment:
        """Renders a moment; moments must come in the order of time."""
        scene, time_s = self._scene, self._scene.time_s(number)
        ego = self._ego(time_s)
        view = self._view(ego)
        roads = (self._world.road, self._world.branches)
        actors = actors_at(scene.vehicles, roads, ego.pose, time_s, FIRST_VEHICLE_LAYER)
        bodies = [actor.placed_body for actor in actors]
        own = self._own(ego.pose, led_levels)
        fixed = self._lights.lamps_near(view.position_m)
        theirs = [lamp.placed for actor in actors for lamp in actor.lamps]
        num_layers = FIRST_VEHICLE_LAYER + sum(actor.layer is not None for actor in actors)
        own_layers: tuple[int, ...] = (EGO_LAYER,)
        if self._is_relit:
            own_layers = EGO_LAYER, num_layers
            own = own[0], replace(own[1], layer=num_layers)
            num_layers += 1
        own_low, low_layer, repeated = own, None, list[PlacedLamp]()
        rear_layers: tuple[int | None, ...] = (None,) * len(actors)
        if self._is_split:
            own_low = self._own(ego.pose, np.zeros_like(led_levels), is_low=True)
            low_layer, rear_layers, repeated = _parts(own_low, actors, num_layers)
        num_repeated = len({lamp.layer for lamp in repeated})
        rendered = self._renderer.render(
            view,
            [*fixed, *own, *theirs, *repeated],
            num_layers + num_repeated,
            bodies,
            scene.weather,
            num_repeated=num_repeated,
        )
        sightings = Sightings(self._renderer, self._camera, view, bodies, scene.weather.scattering_per_m)
        return Moment(
            number=number,
            time_s=time_s,
            ego=ego,
            vehicles=tuple(_seen(index, actor, sightings) for index, actor in enumerate(actors)),
            rendered=rendered,
            low_layer=low_layer,
            rear_layers=rear_layers,
            own=own,
            own_layers=own_layers,
            own_shares=None,
            own_low=own_low,
            fixed=tuple(fixed),
            fixed_points=self._lights.points(sightings),
            sightings=sightings,
            street=self._map.message(ego.s_m),
        )

    def relit(self, moment: Moment, led_levels: Floats) -> Moment:
        """A moment of these, which are `is_relit`, at levels of our LEDs below those that it was rendered at.

        What a lamp lights changes as its intensity in that direction does: a factor for each lamp and pixel. Light that
        the air scatters on the way there is taken to change as what is behind it.
        """
        own = self._own(moment.ego.pose, led_levels)
        if not moment._directions:
            moment._directions.extend(self._lamp_directions(moment, lamp) for lamp in moment.own)
        size = (self._camera.width_px, self._camera.height_px)
        shares = []
        for lamp, (column, row, whole_cd) in zip(own, moment._directions, strict=True):
            left_cd = cv2.remap(lamp.table.intensities_cd, column, row, cv2.INTER_LINEAR)
            share = np.divide(left_cd, whole_cd, out=np.zeros_like(whole_cd), where=whole_cd > 0)
            shares.append(np.asarray(cv2.resize(share, size, interpolation=cv2.INTER_LINEAR), np.float32))
        return replace(moment, own=own, own_shares=tuple(shares), _backgrounds={}, _eyes_lx={})

    def _lamp_directions(self, moment: Moment, lamp: PlacedLamp) -> tuple[Image, Image, Image]:
        """Where what is seen is in a lamp's table, column and row, and the intensity of the lamp towards it."""
        if self._share_rays is None:
            step = max(1, self._camera.width_px // SHARE_COLUMNS)
            sizes = self._camera.width_px, self._camera.height_px
            columns, rows = (np.arange(step / 2, size, step) for size in sizes)
            self._share_rays = self._camera.rays(np.stack(np.meshgrid(columns, rows), -1)).astype(np.float32)
        shape = self._share_rays.shape[:2]
        depth_m = cv2.resize(moment.rendered.depth_m, shape[::-1], interpolation=cv2.INTER_NEAREST)
        points = self._share_rays * np.nan_to_num(depth_m, nan=SKY_M)[..., np.newaxis]
        view, pose = self._view(moment.ego), lamp.world_from_lamp
        turn = (pose.rotation.T @ view.rotation).astype(np.float32)
        x, y, z = np.moveaxis(points @ turn.T + pose.to_body(view.position_m).astype(np.float32), -1, 0)
        azimuths, elevations = (np.degrees(np.arctan2(*sides)) for sides in ((y, x), (z, np.hypot(x, y))))
        column, row = (
            ((angles - grid[0]) / (grid[1] - grid[0])).astype(np.float32)
            for angles, grid in ((azimuths, lamp.table.azimuths_deg), (elevations, lamp.table.elevations_deg))
        )
        return column, row, np.asarray(cv2.remap(lamp.table.intensities_cd, column, row, cv2.INTER_LINEAR))

    def light(self, moment: Moment, exposure_s: float, variant: Variant = AS_IT_IS) -> LinearLight:
        """The light of a moment for a camera whose shutter is open for some time around it."""
        key = exposure_s, variant.low, variant.high
        if key not in moment._backgrounds:
            moment._backgrounds[key] = self._background(moment, exposure_s, variant)
        background, own, streaks, flow_px = moment._backgrounds[key]
        return LinearLight(
            background=background,
            own=own,
            streaks=streaks,
            fixed_points=moment.fixed_points,
            vehicles=tuple(
                None if seen.actor.vehicle_id in variant.off else _layers(moment, index, seen)
                for index, seen in enumerate(moment.vehicles_in(variant))
            ),
            flow_px=flow_px,
            depth_m=moment.rendered.depth_m,
            materials=moment.rendered.materials,
        )

    def _background(self, moment: Moment, exposure_s: float, variant: Variant) -> Background:
        """All light but that of vehicles, while the shutter is open."""
        rendered, half_s = moment.rendered, exposure_s / 2
        begin, end = (self._view(self._ego(moment.time_s + shift)) for shift in (-half_s, half_s))
        own_lamps, depth_m = moment.own_in(variant), rendered.depth_m
        streaks = self._particles.luminance(moment.time_s - half_s, 2 * half_s, (begin, end), own_lamps, depth_m)
        before_from_after = Pose(begin.to_body(end.position_m), begin.rotation.T @ end.rotation)
        flow_px = self._motion_blur.flow_px(_still_depth_m(moment), before_from_after)
        layers = [(rendered.surface_cd_m2[layer], rendered.haze_cd_m2[layer]) for layer in moment.own_layers]
        own = [image for pair in layers for image in pair]
        if moment.own_shares is not None:
            own = [share * image for share, pair in zip(moment.own_shares, layers, strict=True) for image in pair]
        if variant.changes_own:
            low = EGO_LAYER if moment.low_layer is None else moment.low_layer
            parts = (rendered.surface_cd_m2[low], rendered.haze_cd_m2[low])
            high, more = np.float32(variant.high), np.float32(variant.low - variant.high)
            own = [high * whole + more * part for whole, part in zip(own, parts, strict=True)]
        background = rendered.ambient_cd_m2.copy()
        for image in (rendered.surface_cd_m2[FIXED_LAYER], rendered.haze_cd_m2[FIXED_LAYER], *own):
            background += image
        background = blur(background, flow_px)
        background += streaks
        return background, tuple(own), streaks, flow_px

    def _own(self, pose: Pose, led_levels: Floats, *, is_low: bool = False) -> tuple[PlacedLamp, ...]:
        ego = self._scene.ego
        if is_low and ego.beam == "high":
            ego = ego.model_copy(update={"beam": "low"})
        return ego_lamps(ego, pose, ego_tables(ego, led_levels, self._headlamps), EGO_LAYER, self._headlamps)

    def _ego(self, time_s: float) -> VehicleState:
        return ego_state(self._scene.ego, self._world.road, self._body_motion, time_s)

    def _view(self, ego: VehicleState) -> Pose:
        """world_from_camera."""
        return ego.pose @ self._camera.vehicle_from_camera


def _still_depth_m(moment: Moment) -> Image:
    """Depths at which what stands still would move through the image as what is seen does.

    A body at our own speed is as if infinitely far away, and one that comes towards us as if nearer.
    """
    depth_m, bodies = moment.rendered.depth_m, moment.rendered.bodies
    ahead, own_mps = moment.ego.pose.rotation[:, 0], moment.ego.speed_mps
    factors = [1.0]  # of the fixed world
    for seen in moment.vehicles:
        state = seen.actor.state
        along_mps = state.speed_mps * float(state.pose.rotation[:, 0] @ ahead)
        factors.append(own_mps / max(abs(own_mps - along_mps), 0.01))
    return depth_m * np.array(factors, np.float32)[bodies + 1]


def _body_meshes(scene: Scene) -> dict[str, Mesh]:
    """The bodies that the scene needs, as the renderer calls them."""
    return {mesh_name(spec.kind, spec.is_light): BODIES[spec.kind].painted(spec.is_light) for spec in scene.vehicles}


def _parts(
    own_low: Sequence[PlacedLamp], actors: Sequence[Actor], first: int
) -> tuple[int, tuple[int | None, ...], list[PlacedLamp]]:
    """Layers from `first` on for our low beam and each vehicle's rear lamps, and the lamps in them."""
    repeated = [replace(lamp, layer=first) for lamp in own_low]
    layers: list[int | None] = []
    for actor in actors:
        rear = [] if actor.layer is None else [lamp.placed for lamp in actor.lamps if lamp.is_rear]
        layer = first + 1 + sum(known is not None for known in layers)
        repeated += [replace(lamp, layer=layer) for lamp in rear]
        layers.append(layer if rear else None)
    return first, tuple(layers), repeated


def _seen(index: int, actor: Actor, sightings: Sightings) -> SeenVehicle:
    lamps = sightings.lamps(actor)
    return SeenVehicle(
        actor=actor,
        lamps=lamps,
        points=sightings.lamp_points(actor, lamps),
        rear_points=sightings.lamp_points(actor, lamps, only_rear=True),
        box_px=sightings.box_xyxy_px(actor),
        body_share=sightings.body_share(index, actor),
        range_m=sightings.range_m(actor),
    )


def _changed(seen: SeenVehicle, variant: Variant) -> SeenVehicle:
    """The vehicle as it is in a variant."""
    if seen.actor.vehicle_id in variant.off:
        return replace(seen, actor=replace(seen.actor, lamps=()), lamps=(), points=NO_POINTS, rear_points=NO_POINTS)
    if seen.actor.vehicle_id in variant.unseen:
        lamps = tuple(replace(lamp, visible_share=0.0) for lamp in seen.lamps)
        return replace(seen, lamps=lamps, points=NO_POINTS, rear_points=NO_POINTS)
    return seen


def _layers(moment: Moment, index: int, seen: SeenVehicle) -> VehicleLayers:
    """The light of the vehicle at `index`, whose lamps are `seen`."""
    rendered, layer, rear = moment.rendered, seen.actor.layer, moment.rear_layers[index]
    if layer is None:
        dark = np.broadcast_to(np.float32(0.0), rendered.ambient_cd_m2.shape)  # takes no memory
        return VehicleLayers(dark, dark, seen.points, None, seen.rear_points)
    return VehicleLayers(
        rendered.surface_cd_m2[layer],
        rendered.haze_cd_m2[layer],
        seen.points,
        None if rear is None else rendered.surface_cd_m2[rear] + rendered.haze_cd_m2[rear],
        seen.rear_points,
    )
