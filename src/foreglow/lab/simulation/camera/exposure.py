"""From rendered light to the camera's image, and to the image without one vehicle's light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Pose
from foreglow.lab.simulation.camera.motion_blur import MotionBlur, blur
from foreglow.lab.simulation.camera.optics import Image, LampPoints
from foreglow.lab.simulation.camera.sensor import Sensor
from foreglow.lab.simulation.labels.artifacts import Surroundings, VehicleLight
from foreglow.lab.simulation.light.lamps import EGO_LAYER, FIRST_VEHICLE_LAYER, FIXED_LAYER
from foreglow.lab.simulation.light.render import Rendered
from foreglow.lab.simulation.scenes.scene import Scene

FAINTEST_CD_M2 = 1e-6
"""A layer that exceeds this nowhere is left out: a ten-thousandth of a grey level in the short exposure."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Lamps seen directly, by source.

    Attributes:
        fixed: Street lamps and windows.
        vehicles: Lamps of each vehicle, in the order of their layers.
    """

    fixed: LampPoints
    vehicles: tuple[LampPoints, ...]


class Exposure:
    """One exposure: the image, and the light on the pixels by source."""

    def __init__(
        self, sensor: Sensor, rendered: Rendered, points: Points, streaks: Image, flow_px: NDArray[np.float32] | None
    ) -> None:
        """Passes all light through the lens.

        The light of our own lamps and of street lamps is blurred by our motion; the light of other vehicles is not,
        since it is mostly far away, where little moves.

        Args:
            sensor: The imager and its lens.
            rendered: Luminance by layer.
            points: Lamps seen directly.
            streaks: Shape (H, W), cd/m², of rain or snow.
            flow_px: Shape (H, W, 2), motion in the image during the exposure; None without motion.
        """
        optics = sensor.optics
        self._sensor = sensor
        self._rendered = rendered
        background = rendered.ambient_cd_m2.copy()
        for layer in (FIXED_LAYER, EGO_LAYER):
            background += rendered.surface_cd_m2[layer]
            background += rendered.haze_cd_m2[layer]
        background = blur(background, flow_px)
        background += streaks
        self._total = optics.spread(background)
        if len(points.fixed.illuminances_lx):
            self._total += optics.draw_points(points.fixed)
        self._indirect: list[Image | None] = []
        self._direct: list[Image | None] = []
        for index, lamps in enumerate(points.vehicles):
            layer = FIRST_VEHICLE_LAYER + index
            light = rendered.surface_cd_m2[layer] + rendered.haze_cd_m2[layer]
            self._indirect.append(optics.spread(light) if float(light.max()) > FAINTEST_CD_M2 else None)
            self._direct.append(optics.draw_points(lamps) if float(lamps.illuminances_lx.sum()) > 0 else None)
        for image in (*self._indirect, *self._direct):
            if image is not None:
                self._total += image
        self._grey = sensor.expected_grey(self._total)
        self._noise = sensor.noise_grey(self._total)

    def captured(self, frame: int) -> NDArray[np.uint8]:
        """The image, shape (H, W), uint8, with the noise of frame number `frame`."""
        return self._sensor.capture(self._total, frame)

    def light_of(self, vehicle: int, *, is_rear: bool) -> VehicleLight | None:
        """The images with and without the light of `vehicle`, an index; None if none of its indirect light is seen."""
        indirect = self._indirect[vehicle]
        if indirect is None:
            return None
        without_indirect = self._total - indirect
        direct = self._direct[vehicle]
        grey_without_indirect = self._sensor.expected_grey(without_indirect)
        grey_without = grey_without_indirect
        if direct is not None:
            grey_without = self._sensor.expected_grey(without_indirect - direct)
        return VehicleLight(self._grey, grey_without_indirect, grey_without, is_rear)

    def surroundings_of(self, vehicle: int) -> Surroundings:
        """Everything else that the labels of `vehicle`, an index, need."""
        layer = FIRST_VEHICLE_LAYER + vehicle
        haze = self._rendered.haze_cd_m2[layer]
        share = haze / np.maximum(haze + self._rendered.surface_cd_m2[layer], np.float32(1e-12))
        return Surroundings(self._noise, self._rendered.materials, self._rendered.depth_m, share)

    def lamp_peaks_grey(self, vehicle: int, positions_px: Sequence[tuple[float, float]]) -> list[float]:
        """Grey levels that the lamps of `vehicle`, an index, add at their positions; 0 outside the image."""
        direct = self._direct[vehicle]
        if direct is None:
            return [0.0] * len(positions_px)
        added = self._grey - self._sensor.expected_grey(self._total - direct)
        height, width = added.shape
        peaks = []
        for x, y in positions_px:
            is_inside = 0 <= x < width and 0 <= y < height  # NaN is not
            row, column = (int(y), int(x)) if is_inside else (0, 0)
            around = added[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
            peaks.append(float(around.max()) if is_inside else 0.0)
        return peaks


class Exposer:
    """The camera of a drive."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self.sensor = Sensor(scene.sensor, camera, scene.seed)
        self._motion_blur = MotionBlur(camera)

    def expose(self, rendered: Rendered, points: Points, streaks: Image, shutter: tuple[Pose, Pose]) -> Exposure:
        """The exposure of a rendered frame.

        Args:
            rendered: Luminance by layer.
            points: Lamps seen directly.
            streaks: Shape (H, W), cd/m², of rain or snow.
            shutter: world_from_camera when it opens and when it closes.
        """
        begin, end = shutter
        before_from_after = Pose(begin.to_body(end.position_m), begin.rotation.T @ end.rotation)
        flow_px = self._motion_blur.flow_px(rendered.depth_m, before_from_after)
        return Exposure(self.sensor, rendered, points, streaks, flow_px)
