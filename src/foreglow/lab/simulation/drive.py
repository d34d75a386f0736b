"""A simulated drive as a source of frames with all that is known about each; the caller may set our lamps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from foreglow.datasets.simulated import LampTruth, VehicleTruth
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.lab.simulation.camera.exposure import Exposer, Points
from foreglow.lab.simulation.camera.streaks import FallingParticles
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.labels.annotation import Annotation, Annotator
from foreglow.lab.simulation.labels.categories import ImageCategories
from foreglow.lab.simulation.labels.production import ProductionSystem
from foreglow.lab.simulation.light.lamps import EGO_LAYER, FIRST_VEHICLE_LAYER, mesh_name
from foreglow.lab.simulation.light.render import QUALITIES, Renderer, RenderSettings
from foreglow.lab.simulation.scenes.scene import CameraSpec, Scene
from foreglow.lab.simulation.traffic.actors import Actor, actors_at, ego_lamps, ego_tables
from foreglow.lab.simulation.traffic.eyes import Eyes
from foreglow.lab.simulation.traffic.fixed_lights import FixedLights
from foreglow.lab.simulation.traffic.kinematics import BodyMotion, VehicleState, ego_state
from foreglow.lab.simulation.traffic.sightings import Sightings
from foreglow.lab.simulation.world.bodies import BODIES
from foreglow.lab.simulation.world.mesh import Mesh
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.world.world import build_world
from foreglow.lab.simulation.writing.street_data import STREET_STREAM, StreetDataError, StreetMap
from foreglow.photometry import Headlamps, read_headlamps
from foreglow.street import road_from_message
from foreglow.types import EgoMotion, Frame


def camera_of(spec: CameraSpec) -> Camera:
    """The calibrated camera that `spec` describes."""
    centre = spec.centre_px or (spec.width_px / 2, spec.height_px / 2)
    yaw, pitch, roll = (float(np.radians(angle)) for angle in (spec.yaw_deg, spec.pitch_deg, spec.roll_deg))
    mount = Pose(np.array(spec.mount_m), rotation(yaw, pitch, roll))
    return Camera(spec.width_px, spec.height_px, (spec.focal_px, spec.focal_px), centre, spec.distortion, mount)


class Drive:
    """A drive; iterating yields its frames, each rendered when it is asked for.

    A `FrameSource` like any data set. With `Scene.ego.beam = "matrix"` the caller may set our headlamps' LED levels at
    any time; they take effect with the next frame. The renderer needs the extra `sim`.

    Attributes:
        name: The scenario's name and the seed.
        rate_hz: Frames a second.
        num_frames: Frames of the drive.
        skipped: Always empty, as no frame can be unreadable.
        latest: The frame that was yielded last, with all that is known about it; None before the first.
    """

    def __init__(self, scene: Scene, quality: str = "training", headlamps: Headlamps | None = None) -> None:
        """A drive through `scene`; the world is built when the first frame is asked for.

        Args:
            scene: The drive's specification.
            quality: Quality of the rendering: `fast`, `training` or `fine`.
            headlamps: Our matrix headlamps; None for the built-in ones.

        Raises:
            ValueError: If the quality is unknown.
        """
        self.scene = scene
        self.name = f"{scene.name}/{scene.seed}"
        self.rate_hz: float | None = scene.rate_hz
        self.num_frames: int | None = scene.num_frames
        self.skipped: Sequence[str] = ()
        self.latest: DriveFrame | None = None
        self.camera = camera_of(scene.camera)
        if quality not in QUALITIES:
            raise ValueError(f"quality: expected one of {', '.join(QUALITIES)}, got {quality!r}")
        self._settings = QUALITIES[quality]
        self._headlamps = headlamps or read_headlamps()
        self._led_levels: Floats = np.ones((2, self._headlamps.num_leds))

    def set_led_levels(self, levels: ArrayLike) -> None:
        """Sets our matrix headlamps for the frames to come.

        Args:
            levels: Shape (2, L), left and right lamp, each 0 (off) to 1.

        Raises:
            ValueError: If the shape or a value is wrong, or the scene's ego beam is not `matrix`.
        """
        if self.scene.ego.beam != "matrix":
            raise ValueError(f"set_led_levels: expected a scene with ego.beam = 'matrix', got {self.scene.ego.beam!r}")
        given = np.array(levels, np.float64)
        shape = (2, self._headlamps.num_leds)
        if given.shape != shape or not ((given >= 0) & (given <= 1)).all():
            raise ValueError(f"set_led_levels: expected {shape} numbers from 0 to 1, got shape {given.shape}")
        self._led_levels = given

    def __iter__(self) -> Iterator[Frame]:
        for known in self.frames():
            yield known.frame

    def frames(self) -> Iterator[DriveFrame]:
        """The frames with all that is known about them; each call begins the drive anew."""
        run = _Run(self.scene, self.camera, self._settings, self._headlamps)
        for number in range(self.scene.num_frames):
            self.latest = run.frame(number, self._led_levels)
            yield self.latest


def simulate(scene: Scene, quality: str = "training") -> Drive:
    """The frames of a drive through `scene`, as a source to iterate over.

    Raises:
        ValueError: If the quality is unknown.
    """
    return Drive(scene, quality)


def drive_frames(scene: Scene, quality: str = "training") -> Iterator[DriveFrame]:
    """The frames of `scene` with all that is known about them.

    Raises:
        ValueError: If the quality is unknown.
    """
    return Drive(scene, quality).frames()


class _Run:
    """A drive in progress: the world, the renderer, and the state that passes from frame to frame."""

    def __init__(self, scene: Scene, camera: Camera, settings: RenderSettings, headlamps: Headlamps) -> None:
        self._headlamps = headlamps
        self._scene = scene
        self._camera = camera
        self._world = build_world(scene)
        self._lights = FixedLights(self._world.lights)
        self._body_motion = BodyMotion(scene.seed, scene.ego.body_motion)
        mesh = self._world.mesh
        self._renderer = Renderer(mesh, _body_meshes(scene), camera, settings, road=scene.road, seed=scene.seed)
        self._exposer = Exposer(scene, camera)
        self._particles = FallingParticles(scene.weather, camera, scene.seed)
        self._annotator = Annotator(scene, camera)
        self._categories = ImageCategories(scene.vehicles, scene.labels)
        self._production = ProductionSystem()
        self._map = StreetMap(Road(scene.road), StreetDataError(), np.random.default_rng([scene.seed, STREET_STREAM]))

    def frame(self, number: int, led_levels: Floats) -> DriveFrame:
        """Renders, exposes and labels a frame; frames must come in the order of time."""
        scene, time_s = self._scene, number / self._scene.rate_hz
        ego = self._ego(time_s)
        view = self._view(ego)
        roads = (self._world.road, self._world.branches)
        actors = actors_at(scene.vehicles, roads, ego.pose, time_s, FIRST_VEHICLE_LAYER)
        bodies = [actor.placed_body for actor in actors]
        own = ego_lamps(
            scene.ego, ego.pose, ego_tables(scene.ego, led_levels, self._headlamps), EGO_LAYER, self._headlamps
        )
        fixed = self._lights.lamps_near(view.position_m)
        theirs = [lamp.placed for actor in actors for lamp in actor.lamps]
        num_layers = FIRST_VEHICLE_LAYER + len(actors)
        rendered = self._renderer.render(view, [*fixed, *own, *theirs], num_layers, bodies, scene.weather)
        sightings = Sightings(self._renderer, self._camera, view, bodies, scene.weather.scattering_per_m)
        lamps = [sightings.lamps(actor) for actor in actors]
        points = Points(
            self._lights.points(sightings),
            tuple(sightings.lamp_points(actor, seen) for actor, seen in zip(actors, lamps, strict=True)),
        )
        half_s = self._exposer.sensor.exposure_s / 2
        shutter = (self._view(self._ego(time_s - half_s)), self._view(self._ego(time_s + half_s)))
        streaks = self._particles.luminance(time_s - half_s, 2 * half_s, shutter, own, rendered.depth_m)
        exposure = self._exposer.expose(rendered, points, streaks, shutter)
        image = exposure.captured(number)

        annotations = [
            self._annotator.annotate(index, actor, seen, exposure, view.position_m)
            for index, (actor, seen) in enumerate(zip(actors, lamps, strict=True))
        ]
        eyes = Eyes(sightings, actors, own, fixed)
        vehicles = tuple(
            _vehicle_truth(index, actor, lamps[index], annotations[index], sightings, eyes)
            for index, actor in enumerate(actors)
        )
        timestamp_ns = round(time_s * 1e9)
        is_detected = bool(self._production.update(timestamp_ns, vehicles))
        street = self._map.message(ego.s_m)
        return DriveFrame(
            image_id=number,
            timestamp_ns=timestamp_ns,
            frame=Frame(
                image,
                timestamp_ns,
                number,
                f"{scene.name}/{scene.seed}",
                camera=self._camera,
                motion=EgoMotion(ego.speed_mps, ego.yaw_rate_radps),
                road=road_from_message(street),
            ),
            camera=self._camera,
            ego_pose=ego.pose,
            ego_s_m=ego.s_m,
            ego_speed_mps=ego.speed_mps,
            ego_yaw_rate_radps=ego.yaw_rate_radps,
            vehicles=vehicles,
            category=self._categories.update(vehicles, is_detected),
            is_production_detected=is_detected,
            street=street,
            depth_m=rendered.depth_m,
            ego_eye_lx=eyes.at_ego(ego.pose),
        )

    def _ego(self, time_s: float) -> VehicleState:
        return ego_state(self._scene.ego, self._world.road, self._body_motion, time_s)

    def _view(self, ego: VehicleState) -> Pose:
        """world_from_camera."""
        return ego.pose @ self._camera.vehicle_from_camera


def _body_meshes(scene: Scene) -> dict[str, Mesh]:
    """The bodies that the scene needs, as the renderer calls them."""
    return {mesh_name(spec.kind, spec.is_light): BODIES[spec.kind].painted(spec.is_light) for spec in scene.vehicles}


def _vehicle_truth(
    index: int, actor: Actor, lamps: tuple[LampTruth, ...], marks: Annotation, sightings: Sightings, eyes: Eyes
) -> VehicleTruth:
    """All that is known about the vehicle `index` of the frame."""
    return VehicleTruth(
        vehicle_id=actor.vehicle_id,
        kind=actor.spec.kind,
        pose=actor.state.pose,
        speed_mps=actor.state.speed_mps,
        size_m=actor.body.size_m,
        box_centre_m=np.asarray(actor.body.box_centre_m),
        box_xyxy_px=sightings.box_xyxy_px(actor),
        visible_share=sightings.body_share(index, actor),
        range_m=sightings.range_m(actor),
        lamps=lamps,
        artifacts=marks.artifacts,
        candidates=marks.candidates,
        eye_world_m=actor.eye_world_m,
        eye_lx=eyes.at_vehicle(index),
    )
