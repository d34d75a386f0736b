"""One camera along a drive: exposes each moment and labels what comes out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foreglow.datasets.simulated import LampTruth, VehicleTruth
from foreglow.geometry import Camera
from foreglow.lab.simulation.camera.exposure import Exposure, Imager
from foreglow.lab.simulation.camera.imager import ElectronImager
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.camera.sensor import Sensor
from foreglow.lab.simulation.camera.view import View
from foreglow.lab.simulation.camera.windscreen import Windscreen
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.labels.annotation import Annotator
from foreglow.lab.simulation.labels.categories import ImageCategories
from foreglow.lab.simulation.labels.production import ProductionSystem
from foreglow.lab.simulation.moment import Moment, Moments
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.variants import AS_IT_IS, Variant
from foreglow.street import road_from_message
from foreglow.types import EgoMotion, Frame

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
        self._view = None if profile is None else View(profile, rendered)
        self.camera = rendered if self._view is None else self._view.camera
        self._imager = _imager(scene, self.camera, profile, variant)
        self._annotator = Annotator(scene, self.camera)
        self._categories = ImageCategories(scene.vehicles, scene.labels)
        self._production = ProductionSystem()
        self.latest: Exposure | None = None

    def expose(self, moments: Moments, moment: Moment) -> Exposure:
        """The exposure of a moment; moments must come in the order of time."""
        light = moments.light(moment, self._imager.exposure_s, self._variant)
        self.latest = Exposure(self._imager, light, self._view, moment.time_s)
        return self.latest

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
        tail = min(MAX_TAIL_SHARE, sensor.tail_share * variant.veil)
        sensor = sensor.model_copy(update={"tail_share": tail})
    if profile is None:
        return Sensor(sensor, camera, scene.seed)
    if variant.veil != 1.0:
        profile = _veiled(profile, variant.veil)
    if profile.imager.model == "scene":
        sensor = sensor.model_copy(update={"exposure": profile.cycle})
        adds = profile.lens.adds_light or profile.car.bonnet_share > 0 or profile.car.num_reflections > 0
        return Sensor(sensor, camera, scene.seed, Windscreen(profile, sensor, camera, scene.seed) if adds else None)
    return ElectronImager(profile, Windscreen(profile, sensor, camera, scene.seed), scene.seed, 1.0 / scene.rate_hz)


def _veiled(profile: CameraProfile, factor: float) -> CameraProfile:
    """The profile with stronger or weaker veils, which together keep below half of the light."""
    veils = profile.lens.veils
    factor = min(factor, 0.5 / max(sum(veil.share for veil in veils), 1e-9))
    changed = tuple(veil.model_copy(update={"share": veil.share * factor}) for veil in veils)
    return profile.model_copy(update={"lens": profile.lens.model_copy(update={"veils": changed})})
