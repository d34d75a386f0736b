"""A simulated drive as a source of frames with all that is known about each; the caller may set our lamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from foreglow.config import preset
from foreglow.datasets.simulated.light_maps import reduced
from foreglow.datasets.simulated.shares import BoxShares, load_arrow
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.camera.view import View
from foreglow.lab.simulation.drive_camera import DriveCamera
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.labels.shares import box_shares
from foreglow.lab.simulation.light.render import QUALITIES
from foreglow.lab.simulation.moment import Moments
from foreglow.lab.simulation.scenes.scene import CameraSpec, Scene
from foreglow.lab.simulation.variants import draw_variants
from foreglow.photometry import Headlamps, read_headlamps
from foreglow.proposals import Proposer, make_proposer
from foreglow.types import Frame


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
        self.settings = QUALITIES[quality]
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
        given = np.array(levels, np.float64)
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
    profiles: Sequence[CameraProfile],
    num_variants: int = 1,
    quality: str = "training",
    presets: Sequence[str] = (),
) -> Iterator[tuple[DriveFrame, ...]]:
    """The moments of `scene`, each rendered once and exposed by every camera, and in every variant.

    Args:
        scene: The drive's specification.
        profiles: The cameras.
        num_variants: Variants of the drive; the first one is the scene itself.
        quality: Quality of the rendering.
        presets: Presets of the pipeline in whose proposals the light is told apart by its source.

    Yields:
        For each moment, the frames in the order of the profiles; those of one profile in the order of the variants.

    Raises:
        ValueError: If the quality or a preset is unknown, or a profile does not fit the rendering.
    """
    source = Drive(scene, quality)
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


def check_exposures(profiles: Sequence[CameraProfile], scenes: Sequence[Scene], presets: Sequence[str] = ()) -> None:
    """Checks that every profile sees only what is rendered, and that presets and what writes their shares are there.

    Raises:
        ModuleNotFoundError: If the extra `parquet` is not installed.
        ValueError: If that is not so; the message names profile, field and expectation.
    """
    for name in presets:
        preset(name)
    if presets:
        load_arrow()  # now, rather than at the end of the first drive
    for scene in scenes:
        for profile in profiles:
            View(profile, camera_of(scene.camera))
