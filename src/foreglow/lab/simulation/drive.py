"""A simulated drive as a source of frames with all that is known about each, by one camera or several.

The caller may set our lamps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from foreglow.config import preset
from foreglow.datasets.simulated import LampTruth, VehicleTruth
from foreglow.datasets.simulated.light_maps import reduced
from foreglow.datasets.simulated.production import ProductionSystem
from foreglow.datasets.simulated.shares import BoxShares, load_arrow
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.lab.simulation.camera.exposure import Exposure, Imager
from foreglow.lab.simulation.camera.imager import ElectronImager
from foreglow.lab.simulation.camera.profile import MAX_SCATTERED, CameraProfile
from foreglow.lab.simulation.camera.sensor import Sensor
from foreglow.lab.simulation.camera.view import View
from foreglow.lab.simulation.camera.windscreen import Windscreen
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.labels.categories import ImageCategories
from foreglow.lab.simulation.labels.instances import Annotator
from foreglow.lab.simulation.labels.shares import box_shares
from foreglow.lab.simulation.light.render import QUALITIES
from foreglow.lab.simulation.moment import Moment, Moments
from foreglow.lab.simulation.scenes.scene import CameraSpec, Scene
from foreglow.lab.simulation.variants import AS_IT_IS, Variant, draw_variants
from foreglow.numbers import checked_floats
from foreglow.photometry import Headlamps, read_headlamps
from foreglow.proposals import Proposer, make_proposer
from foreglow.street import road_from_message
from foreglow.types import EgoMotion, Frame
from foreglow.types.arrays import check_kind, check_optional
from foreglow.wording import check_one_of

MAX_TAIL_SHARE = 0.2
"""Largest share of the scene's own veiling glare in any variant."""


class DriveCamera:
    """A camera along a drive, with all that passes from frame to frame: metering, stream, instances of labels.

    Attributes:
        camera: Its calibration.
        latest: The exposure that was taken last; None before the first.
    """

    def __init__(
        self, scene: Scene, rendered: Camera, profile: CameraProfile | None = None, variant: Variant = AS_IT_IS
    ) -> None:
        """The camera of `profile` in `scene`; None for the scene's own.

        Raises:
            ValueError: If the profile's view does not fit the rendering.
        """
        self._scene = scene
        self._variant = variant
        check_optional("profile", profile, CameraProfile)
        self._view = None if profile is None else View(profile, rendered)
        self.camera = rendered if self._view is None else self._view.camera
        self._imager = _imager(scene, self.camera, profile, variant)
        self._annotator = Annotator(scene, self.camera)
        self._categories = ImageCategories(scene.vehicles, scene.labels)
        self._production = ProductionSystem()
        self.latest: Exposure | None = None

    def expose(self, moments: Moments, moment: Moment, beside: Exposure | None = None) -> Exposure:
        """The exposure of a moment; moments must come in the order of time. `beside` is as for `Exposure`."""
        light = moments.light(moment, self._imager.exposure_s, self._variant)
        self.latest = Exposure(self._imager, light, self._view, moment.time_s, beside)
        return self.latest

    def beside(self, first: DriveCamera, known: DriveFrame, moments: Moments, moment: Moment) -> DriveFrame:
        """`known`, which `first` made of a moment, with the image of one that differs from it only by our own light."""
        image = self.expose(moments, moment, first.latest).captured(moment.number)
        return replace(known, frame=replace(known.frame, image=image))

    def frame(self, moments: Moments, moment: Moment) -> DriveFrame:
        """Exposes and labels a moment; moments must come in the order of time."""
        scene = self._scene
        exposure = self.expose(moments, moment)
        image = exposure.captured(moment.number)
        eyes_lx, own_eye_lx = moment.eyes_lx(self._variant)
        vehicles = []
        for index, seen in enumerate(moment.vehicles_in(self._variant)):
            lamps = tuple(self._lamp(lamp) for lamp in seen.lamps)
            marks = self._annotator.annotate(index, seen.actor, lamps, exposure, moment.sightings.camera_m)
            vehicles.append(
                VehicleTruth(
                    vehicle_id=seen.actor.vehicle_id,
                    kind=seen.actor.spec.kind,
                    pose=seen.actor.state.pose,
                    speed_mps=seen.actor.state.speed_mps,
                    size_m=seen.actor.body.size_m,
                    box_centre_m=np.asarray(seen.actor.body.box_centre_m),
                    box_xyxy_px=seen.box_px if self._view is None else self._view.box_px(seen.box_px),
                    visible_share=seen.body_share,
                    range_m=seen.range_m,
                    lamps=lamps,
                    artifacts=marks.artifacts,
                    candidates=marks.candidates,
                    eye_world_m=seen.actor.eye_world_m,
                    eye_lx=eyes_lx[index],
                )
            )
        timestamp_ns = round(moment.time_s * 1e9)
        is_detected = bool(self._production.update(timestamp_ns, vehicles))
        ego = moment.ego
        depth_m = moment.rendered.depth_m
        return DriveFrame(
            image_id=moment.number,
            timestamp_ns=timestamp_ns,
            frame=Frame(
                image,
                timestamp_ns,
                moment.number,
                f"{scene.name}/{scene.seed}",
                camera=self.camera,
                motion=EgoMotion(ego.speed_mps, ego.yaw_rate_radps),
                road=road_from_message(moment.street),
            ),
            camera=self.camera,
            ego_pose=ego.pose,
            ego_s_m=ego.s_m,
            ego_speed_mps=ego.speed_mps,
            ego_yaw_rate_radps=ego.yaw_rate_radps,
            vehicles=tuple(vehicles),
            category=self._categories.update(tuple(vehicles), is_detected),
            is_production_detected=is_detected,
            street=moment.street,
            depth_m=depth_m if self._view is None else self._view.nearest(depth_m),
            ego_eye_lx=own_eye_lx,
        )

    def _lamp(self, lamp: LampTruth) -> LampTruth:
        """The lamp in this camera's image, in which it may be out of sight."""
        if self._view is None:
            return lamp
        x, y = self._view.points_px(np.array([lamp.position_px]))[0].tolist()
        return replace(lamp, position_px=(x, y), visible_share=lamp.visible_share if self._view.holds(x, y) else 0.0)


def _imager(scene: Scene, camera: Camera, profile: CameraProfile | None, variant: Variant) -> Imager:
    sensor = scene.sensor
    if variant.veil != 1.0:
        tail = min(MAX_TAIL_SHARE, 1.0 - sensor.middle_share, sensor.tail_share * variant.veil)
        sensor = sensor.model_copy(update={"tail_share": tail})
    if profile is None:
        return Sensor(sensor, camera, scene.seed)
    if variant.veil != 1.0:
        profile = _veiled(profile, variant.veil)
    if profile.imager.model == "scene":
        sensor = profile.scene_sensor(sensor)
        return Sensor(sensor, camera, scene.seed, Windscreen(profile, sensor, camera, scene.seed))
    return ElectronImager(profile, Windscreen(profile, sensor, camera, scene.seed), scene.seed, 1.0 / scene.rate_hz)


def _veiled(profile: CameraProfile, factor: float) -> CameraProfile:
    """The profile with stronger or weaker veils, which together keep below half of the light, and streaks the rest."""
    veils, streaks = profile.lens.veils, profile.lens.streaks
    largest = min(0.5, MAX_SCATTERED - sum(streak.share for streak in streaks))
    factor = min(factor, largest / max(sum(veil.share for veil in veils), 1e-9))
    changed = tuple(veil.model_copy(update={"share": veil.share * factor}) for veil in veils)
    return profile.model_copy(update={"lens": profile.lens.model_copy(update={"veils": changed})})


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
        settings: Quality of the rendering.
        headlamps: Our matrix headlamps.
        latest: The frame that was yielded last, with all that is known about it; None before the first.
    """

    def __init__(self, scene: Scene, quality: str = "training", headlamps: Headlamps | None = None) -> None:
        """A drive through `scene`; the world is built when the first frame is asked for.

        Args:
            scene: The drive's specification.
            quality: Quality of the rendering: `fast`, `training` or `fine`.
            headlamps: Our matrix headlamps; None for the built-in ones.

        Raises:
            ValueError: If the quality is unknown, the scene is none, or the headlamps are none.
        """
        check_kind("scene", scene, Scene)
        self.scene = scene
        self.name = f"{scene.name}/{scene.seed}"
        self.rate_hz: float | None = scene.rate_hz
        self.num_frames: int | None = scene.num_frames
        self.skipped: Sequence[str] = ()
        self.latest: DriveFrame | None = None
        self.camera = camera_of(scene.camera)
        check_one_of(quality, QUALITIES, "quality")
        self.settings = QUALITIES[quality]
        check_optional("headlamps", headlamps, Headlamps)
        self.headlamps = headlamps or read_headlamps()
        self._led_levels: Floats = np.ones((2, self.headlamps.num_leds))

    def set_led_levels(self, levels: ArrayLike) -> None:
        """Sets our matrix headlamps for the frames to come.

        Args:
            levels: Shape (2, L), left and right lamp, each 0 (off) to 1.

        Raises:
            ValueError: If the shape or a value is wrong, or the scene's ego beam is not `matrix`.
        """
        if self.scene.ego.beam != "matrix":
            raise ValueError(f"set_led_levels: expected a scene with ego.beam = 'matrix', got {self.scene.ego.beam!r}")
        given = checked_floats("set_led_levels", levels)
        shape = (2, self.headlamps.num_leds)
        if given.shape != shape or not ((given >= 0) & (given <= 1)).all():
            raise ValueError(f"set_led_levels: expected {shape} numbers from 0 to 1, got shape {given.shape}")
        self._led_levels = given

    def __iter__(self) -> Iterator[Frame]:
        for known in self.frames():
            yield known.frame

    def frames(self) -> Iterator[DriveFrame]:
        """The frames with all that is known about them; each call begins the drive anew."""
        moments = Moments(self.scene, self.camera, self.settings, self.headlamps)
        camera = DriveCamera(self.scene, self.camera)
        for number in range(self.scene.num_frames):
            self.latest = camera.frame(moments, moments.at(number, self._led_levels))
            yield self.latest


def side_by_side(
    scene: Scene,
    led_levels: Callable[[], Sequence[Floats]],
    quality: str = "training",
    headlamps: Headlamps | None = None,
    profile: CameraProfile | None = None,
) -> Iterator[tuple[DriveFrame, ...]]:
    """The frames of cars that drive through `scene` in each other's place, each in the light of its own lamps.

    Each moment is rendered once, so a further car costs a seventh of a drive of its own. All that is known about a
    frame but its image is the same for all: labels are those of the first car's image.

    Args:
        scene: The drive's specification, with a matrix beam.
        led_levels: What is shone in the next frame: an array of shape (2, L) for each car.
        quality: Quality of the rendering.
        headlamps: Our matrix headlamps; None for the built-in ones.
        profile: The camera; None for the scene's own.

    Raises:
        ValueError: If the quality is unknown, an argument is of another type, or the profile does not fit the
            rendering.
    """
    check_kind("led_levels", led_levels, Callable)  # type: ignore[arg-type]
    source = Drive(scene, quality, headlamps)
    moments = Moments(scene, source.camera, source.settings, source.headlamps, is_relit=True)
    whole = np.ones((2, source.headlamps.num_leds))
    cameras: list[DriveCamera] = []
    for number in range(scene.num_frames):
        levels = led_levels()
        cameras = cameras or [DriveCamera(scene, source.camera, profile) for _ in levels]
        moment = moments.at(number, whole)
        seen = [moments.relit(moment, of_car) for of_car in levels]
        known = cameras[0].frame(moments, seen[0])
        others = zip(cameras[1:], seen[1:], strict=True)
        yield known, *(camera.beside(cameras[0], known, moments, relit) for camera, relit in others)


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


def drive_exposures(
    scene: Scene,
    profiles: Sequence[CameraProfile | None],
    num_variants: int = 1,
    quality: str = "training",
    presets: Sequence[str] = (),
) -> Iterator[tuple[DriveFrame, ...]]:
    """The moments of `scene`, each rendered once and exposed by every camera, and in every variant.

    Args:
        scene: The drive's specification.
        profiles: The cameras; None for the scene's own.
        num_variants: Variants of the drive; the first one is the scene itself.
        quality: Quality of the rendering.
        presets: Presets of the pipeline in whose proposals the light is told apart by its source.

    Yields:
        For each moment, the frames in the order of the profiles; those of one profile in the order of the variants.

    Raises:
        ValueError: If the quality or a preset is unknown, or a profile does not fit the rendering.
    """
    source = Drive(scene, quality)
    check_kind("profiles", profiles, Sequence)
    check_kind("presets", presets, Sequence)
    variants = draw_variants(scene, num_variants)
    cameras = [DriveCamera(scene, source.camera, profile, variant) for profile in profiles for variant in variants]
    proposers = {name: make_proposer(preset(name).proposals) for name in presets}
    moments = Moments(scene, source.camera, source.settings, source.headlamps, is_split=True)
    led_levels = np.ones((2, source.headlamps.num_leds))
    for number in range(scene.num_frames):
        moment = moments.at(number, led_levels)
        yield tuple(_with_shares(camera.frame(moments, moment), camera, proposers) for camera in cameras)


def _with_shares(known: DriveFrame, camera: DriveCamera, proposers: Mapping[str, Proposer]) -> DriveFrame:
    """The frame with the light of each source, and its shares in each proposer's boxes."""
    if not proposers or camera.latest is None:
        return known
    light = camera.latest.by_source()
    boxes = {name: proposer.propose(known.frame.image).boxes_xyxy_px for name, proposer in proposers.items()}
    shares = tuple(BoxShares(name, found, box_shares(light, found)) for name, found in boxes.items())
    return replace(known, shares=shares, light_cd_m2=reduced(light))


def check_exposures(
    profiles: Mapping[str, CameraProfile], scenes: Sequence[Scene], presets: Sequence[str] = ()
) -> None:
    """Checks that every profile sees only what is rendered, and that presets and what writes their shares are there.

    Args:
        profiles: By where they are from, such as `--camera phone`.
        scenes: What they look at.
        presets: Names of presets of the proposals.

    Raises:
        ModuleNotFoundError: If the extra `parquet` is not installed.
        ValueError: If that is not so; the message names the profile's origin, field and expectation.
    """
    for name in presets:
        preset(name)
    if presets:
        load_arrow()  # now, rather than at the end of the first drive
    for scene in scenes:
        for origin, profile in profiles.items():
            View(profile, camera_of(scene.camera), origin)
