"""From light in linear layers to the camera's image, and to the image without one vehicle's light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.simulation.camera.motion_blur import blur, sheared
from foreglow.lab.simulation.camera.optics import Image, LampPoints, Optics
from foreglow.lab.simulation.camera.view import View
from foreglow.lab.simulation.labels.artifacts import Surroundings, VehicleLight

FAINTEST_CD_M2 = 1e-6
"""A layer that exceeds this nowhere is left out: a ten-thousandth of a grey level in the short exposure."""


class Imager(Protocol):
    """What an exposure needs of a camera: `Sensor`, or `ElectronImager`.

    Attributes:
        sees_colour: Whether `expected_grey` and `capture` take the red part of the light, as their last argument.
        readout_s: Time between the first and the last row.
    """

    sees_colour: bool
    readout_s: float

    @property
    def exposure_s(self) -> float:
        """Time for which the shutter is open."""
        ...

    @property
    def optics(self) -> Optics:
        """The lens."""
        ...

    def meter(self, luminance: Image, time_s: float) -> None:
        """Adapts to the light on the pixels of the image to be taken next."""
        ...

    def expected_grey(self, luminance: Image, *red: Any) -> Image:
        """Grey levels for the light on the pixels, without noise."""
        ...

    def noise_grey(self, luminance: Image) -> Image:
        """Standard deviation of the noise in grey levels."""
        ...

    def capture(self, luminance: Image, frame: int, *red: Any) -> NDArray[np.uint8]:
        """The image of the light on the pixels."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class VehicleLayers:
    """The light of a vehicle before any lens; images have shape (H, W), cd/m².

    Attributes:
        surface_cd_m2: Reflected by surfaces.
        haze_cd_m2: Scattered by the air.
        points: Its lamps in sight.
        rear_cd_m2: The part of both images that is of rear lamps; None if that is not known.
        rear_points: The rear lamps among `points`.
    """

    surface_cd_m2: Image
    haze_cd_m2: Image
    points: LampPoints
    rear_cd_m2: Image | None
    rear_points: LampPoints


@dataclass(frozen=True, slots=True, eq=False)
class LinearLight:
    """All light of a moment by source, before any lens; images have shape (H, W), cd/m².

    The light of our own lamps and of street lamps is blurred by our motion; the light of other vehicles is not, since
    it is mostly far away, where little moves.

    Attributes:
        background: The light of the sky, street lamps and our own lamps, blurred by our motion, and rain or snow.
        own: Images whose sum is the part of it that our own lamps make, not blurred.
        streaks: The rain or snow in it.
        fixed_points: Street lamps and windows in sight.
        vehicles: The light of each vehicle; None for one that is off.
        flow_px: Shape (H, W, 2), motion in the image while the shutter is open; None without motion.
        depth_m: Along each pixel's ray.
        materials: Numbers of the materials.
    """

    background: Image
    own: tuple[Image, ...]
    streaks: Image
    fixed_points: LampPoints
    vehicles: tuple[VehicleLayers | None, ...]
    flow_px: Image | None
    depth_m: Image
    materials: NDArray[np.uint8]


class Exposure:
    """One exposure: the image, and the light on the pixels by source."""

    _fixed: Image | None
    _indirect: list[Image | None]
    _direct: list[Image | None]
    _rears: list[tuple[Image | None, Image | None]]
    _red: Image | None

    def __init__(
        self,
        imager: Imager,
        light: LinearLight,
        view: View | None = None,
        time_s: float = 0.0,
        beside: Exposure | None = None,
    ) -> None:
        """Passes all light through the lens.

        Args:
            imager: The camera.
            light: The light by source.
            view: The camera's part of the rendering; None for all of it.
            time_s: Time since the begin of the drive, for cameras that meter.
            beside: An exposure of the same kind of camera, in which only our own light differs; None for none.
        """
        self._imager, self._light, self._view = imager, light, view
        self._total = imager.optics.spread(self._seen(light.background))
        if imager.optics.static_cd_m2 is not None:
            self._total += imager.optics.static_cd_m2
        if beside is None:
            self._spread_others(light)
        else:
            self._fixed, self._indirect, self._direct = beside._fixed, beside._indirect, beside._direct
            self._rears, self._red = beside._rears, beside._red
        for spread in (self._fixed, *self._indirect, *self._direct):
            if spread is not None:
                self._total += spread
        imager.meter(self._total, time_s)

    def _spread_others(self, light: LinearLight) -> None:
        """Passes the light of street lamps, windows and vehicles through the lens."""
        points, vehicles = light.fixed_points, light.vehicles
        self._fixed = self._lamps(points) if len(points.illuminances_lx) else None
        self._indirect, self._direct = [], []
        for layers in vehicles:
            self._indirect.append(None if layers is None else self._on_pixels(layers.surface_cd_m2 + layers.haze_cd_m2))
            self._direct.append(None if layers is None else self._points_on_pixels(layers.points))
        self._rears = [(None, None)] * len(vehicles)
        self._red = None
        if self._imager.sees_colour:
            self._rears = [(None, None) if layers is None else self._rear_on_pixels(layers) for layers in vehicles]
            for part in (part for parts in self._rears for part in parts if part is not None):
                self._red = part.copy() if self._red is None else self._red + part

    @cached_property
    def _grey(self) -> Image:
        """The image without noise."""
        return self._grey_of(self._total, self._red)

    @cached_property
    def _noise(self) -> Image:
        return self._imager.noise_grey(self._total)

    def captured(self, frame: int) -> NDArray[np.uint8]:
        """The image, shape (H, W), uint8, with the noise of frame number `frame`."""
        total, red, flow_px = self._total, self._red, self._light.flow_px
        if self._imager.readout_s > 0 and flow_px is not None:
            across = np.dstack([self._seen(np.ascontiguousarray(flow_px[..., axis])) for axis in (0, 1)])
            scale = 1.0 if self._view is None else self._view.scale
            motion_px = across * np.float32(scale * self._imager.readout_s / self._imager.exposure_s)
            total = sheared(total, motion_px)
            red = None if red is None else sheared(red, motion_px)
        return self._imager.capture(total, frame, *self._colours(red))

    def light_of(self, vehicle: int, *, is_rear: bool) -> VehicleLight | None:
        """The images with and without the light of `vehicle`, an index; None if none of its indirect light is seen."""
        indirect = self._indirect[vehicle]
        if indirect is None:
            return None
        rear_direct, rear_indirect = self._rears[vehicle]
        without, red = self._total - indirect, _less(self._red, rear_indirect)
        grey_without_indirect = self._grey_of(without, red)
        grey_without = grey_without_indirect
        direct = self._direct[vehicle]
        if direct is not None:
            grey_without = self._grey_of(without - direct, _less(red, rear_direct))
        return VehicleLight(self._grey, grey_without_indirect, grey_without, is_rear)

    def surroundings_of(self, vehicle: int) -> Surroundings:
        """Everything else that the labels of `vehicle`, an index, need."""
        layers, light = self._light.vehicles[vehicle], self._light
        if layers is None:
            share = np.zeros_like(light.depth_m)
        else:
            haze = layers.haze_cd_m2
            share = haze / np.maximum(haze + layers.surface_cd_m2, np.float32(1e-12))
        if self._view is None:
            return Surroundings(self._noise, light.materials, light.depth_m, share)
        materials, depth_m = self._view.nearest(light.materials), self._view.nearest(light.depth_m)
        return Surroundings(self._noise, materials, depth_m, self._view.light(share))

    def lamp_peaks_grey(self, vehicle: int, positions_px: Sequence[tuple[float, float]]) -> list[float]:
        """Grey levels that the lamps of `vehicle`, an index, add at their positions; 0 outside the image."""
        direct = self._direct[vehicle]
        if direct is None:
            return [0.0] * len(positions_px)
        added = self._grey - self._grey_of(self._total - direct, _less(self._red, self._rears[vehicle][0]))
        height, width = added.shape
        peaks = []
        for x, y in positions_px:
            is_inside = 0 <= x < width and 0 <= y < height  # NaN is not
            row, column = (int(y), int(x)) if is_inside else (0, 0)
            around = added[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
            peaks.append(float(around.max()) if is_inside else 0.0)
        return peaks

    def by_source(self) -> NDArray[np.float32]:
        """Light on the pixels by its source, shape (6, H, W), cd/m², in the order of `SOURCES` of the shares.

        Source: light is linear, so that the six images add up to all light on the pixels.
        """
        light = self._light
        shape = self._total.shape
        images = np.zeros((6, *shape), np.float32)
        for index, layers in enumerate(light.vehicles):
            if layers is None:
                continue
            rear = self._rear_on_pixels(layers)
            for number, (whole, part) in enumerate(
                zip((self._direct[index], self._indirect[index]), rear, strict=True)
            ):
                if whole is not None:
                    images[2 * number] += _less(whole, part)
                if part is not None:
                    images[2 * number + 1] += part
        own = blur(np.sum(light.own, axis=0, dtype=np.float32), light.flow_px) + light.streaks
        images[4] = self._imager.optics.spread(self._seen(own))
        if self._imager.optics.static_cd_m2 is not None:
            images[4] += self._imager.optics.static_cd_m2
        images[5] = self._total - images[:5].sum(0)
        return images

    def _seen(self, image: Image) -> Image:
        return image if self._view is None else self._view.light(image)

    def _lamps(self, points: LampPoints) -> Image:
        return self._imager.optics.draw_points(points if self._view is None else self._view.lamps(points))

    def _on_pixels(self, luminance: Image) -> Image | None:
        is_lit = float(luminance.max()) > FAINTEST_CD_M2
        return self._imager.optics.spread(self._seen(luminance)) if is_lit else None

    def _points_on_pixels(self, points: LampPoints) -> Image | None:
        return self._lamps(points) if float(points.illuminances_lx.sum()) > 0 else None

    def _rear_on_pixels(self, layers: VehicleLayers) -> tuple[Image | None, Image | None]:
        """The light of rear lamps in sight, and the light of rear lamps on something."""
        on_something = None if layers.rear_cd_m2 is None else self._on_pixels(layers.rear_cd_m2)
        return self._points_on_pixels(layers.rear_points), on_something

    def _grey_of(self, total: Image, red: Image | None) -> Image:
        return self._imager.expected_grey(total, *self._colours(red))

    def _colours(self, red: Image | None) -> tuple[Image, ...]:
        return () if red is None else (red,)


def _less(whole: Any, part: Image | None) -> Any:
    """`whole` without `part`, both images or None."""
    return whole if whole is None or part is None else whole - part
