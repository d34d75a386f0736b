"""A simulated drive as a source of frames, with all that is known of each, and our lamps under the caller's control."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.photometry import NUM_LEDS
from foreglow.simulation.actors import Actor, actors_at, ego_lamps, ego_tables
from foreglow.simulation.annotation import Annotator
from foreglow.simulation.bodies import BODIES
from foreglow.simulation.categories import ImageCategories
from foreglow.simulation.exposure import Exposer
from foreglow.simulation.lamps import PlacedLamp
from foreglow.simulation.kinematics import BodyMotion, VehicleState, ego_state
from foreglow.simulation.production import ProductionSystem
from foreglow.simulation.render import Renderer, render_settings
from foreglow.simulation.road import branch_road
from foreglow.simulation.scene import CameraSpec, Scene
from foreglow.simulation.sightings import Sightings
from foreglow.simulation.truth import DriveFrame, VehicleTruth
from foreglow.simulation.world import build_world
from foreglow.types import Frame

FIXED_LAYER, EGO_LAYER, FIRST_VEHICLE_LAYER = 0, 1, 2

EGO_EYE_M = np.array([1.45, 0.35, 1.2])
"""Our driver's eye in the vehicle."""

STREET_LAMP_REACH_M = 120.0
"""Street lamps further from the camera light nothing in its picture that matters; they themselves are still seen."""


def camera_of(spec: CameraSpec) -> Camera:
    """The calibrated camera that `spec` describes."""
    centre = spec.centre_px or (spec.width_px / 2, spec.height_px / 2)
    yaw, pitch, roll = (float(np.radians(angle)) for angle in (spec.yaw_deg, spec.pitch_deg, spec.roll_deg))
    mount = Pose(np.array(spec.mount_m), rotation(yaw, pitch, roll))
    return Camera(spec.width_px, spec.height_px, (spec.focal_px, spec.focal_px), centre, spec.distortion, mount)


class Drive:
    """One drive; iterating yields its frames, each rendered when it is asked for.

    A `FrameSource` like any data set. With `Scene.ego.beam = "matrix"` the caller sets our headlamps' LED levels at any
    time; they count from the next frame on. The renderer needs the extra `sim`.

    Attributes:
        name: The scenario's name and the seed.
        rate_hz: Frames a second.
        num_frames: Frames of the drive.
        skipped: Always empty: nothing can be unreadable.
        latest: All that is known of the frame that was yielded last; None before the first.
    """

    def __init__(self, scene: Scene, quality: str = "training") -> None:
        """A drive through `scene`; the world is built when the first frame is asked for.

        Args:
            scene: What happens.
            quality: How finely it is rendered: `fast`, `training` or `fine`.

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
        self._settings = render_settings(quality)
        self._led_levels: Floats = np.ones((2, NUM_LEDS))

    def set_led_levels(self, levels: ArrayLike) -> None:
        """Sets our matrix headlamps for the frames to come.

        Args:
            levels: Shape (2, 84), left and right lamp, each 0 (off) to 1.

        Raises:
            ValueError: If the shape or a value is wrong, or the scene's ego beam is not `matrix`.
        """
        if self.scene.ego.beam != "matrix":
            raise ValueError(f"set_led_levels: expected a scene with ego.beam = 'matrix', got {self.scene.ego.beam!r}")
        given = np.array(levels, np.float64)
        if given.shape != (2, NUM_LEDS) or not ((given >= 0) & (given <= 1)).all():
            raise ValueError(f"set_led_levels: expected (2, {NUM_LEDS}) numbers from 0 to 1, got shape {given.shape}")
        self._led_levels = given

    def __iter__(self) -> Iterator[Frame]:
        for one in self.frames():
            yield one.frame

    def frames(self) -> Iterator[DriveFrame]:
        """The frames with all that is known of them; each call begins the drive anew."""
        run = _Run(self.scene, self.camera, self._settings)
        for number in range(self.scene.num_frames):
            self.latest = run.frame(number, self._led_levels)
            yield self.latest


class _Run:
    """A drive under way: the world, the renderer, and what is remembered from frame to frame."""

    def __init__(self, scene: Scene, camera: Camera, settings: RenderSettings) -> None:
        world = build_world(scene)
        bodies = {
            f"{kind}/{paint}": body.painted(paint == "light")
            for kind, body in BODIES.items()
            for paint in ("light", "dark")
            if any(one.kind == kind and one.is_light == (paint == "light") for one in scene.vehicles)
        }
        self._scene = scene
        self._camera = camera
        self._world = world
        self._body_motion = BodyMotion(scene.seed, scene.ego.body_motion)
        self._renderer = Renderer(world.mesh, bodies, camera, settings, road=scene.road, seed=scene.seed)
        self._exposer = Exposer(scene, camera, world)
        self._annotator = Annotator(scene)
        self._categories = ImageCategories(scene.vehicles, scene.labels)
        self._production = ProductionSystem()

    def frame(self, number: int, led_levels: Floats) -> DriveFrame:
        """Renders, exposes and labels one frame."""
        scene, time_s = self._scene, number / self._scene.rate_hz
        timestamp_ns = round(time_s * 1e9)
        ego = ego_state(scene.ego, self._world.road, self._body_motion, time_s)
        camera_pose = ego.pose @ self._camera.vehicle_from_camera
        roads = (self._world.road, self._world.branches)
        actors = actors_at(scene.vehicles, roads, ego.pose, time_s, FIRST_VEHICLE_LAYER)
        bodies = [actor.placed_body for actor in actors]
        own = ego_lamps(scene.ego, ego.pose, ego_tables(scene.ego, led_levels), EGO_LAYER)
        fixed = self._world.street_lamps_near(camera_pose.position_m, STREET_LAMP_REACH_M, FIXED_LAYER)
        theirs = [lamp.placed for actor in actors for lamp in actor.lamps]
        num_layers = FIRST_VEHICLE_LAYER + len(actors)
        rendered = self._renderer.render(camera_pose, [*fixed, *own, *theirs], num_layers, bodies, scene.weather)
        sightings = Sightings(self._renderer, self._camera, camera_pose, bodies, scene.weather.scattering_per_m)
        lamps = [sightings.lamps(actor) for actor in actors]
        exposure = self._exposer.expose(rendered, actors, lamps, sightings, ...)
