"""World, air and lamps in the form that the kernels read: one buffer of lamps, and one of all their tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Pose
from foreglow.lab.simulation.light.lamps import PlacedLamp
from foreglow.lab.simulation.light.llvm import angle_rad, clipped, dr, greatest, mi
from foreglow.lab.simulation.light.raycast import Number, Solids
from foreglow.lab.simulation.scenes.scene import WeatherSpec
from foreglow.photometry import IntensityTable

GLOW_HEIGHT = 0.12
"""Sine of the elevation over which the glow above the horizon falls to a third: 7 degrees."""


@dataclass
class Light:
    """The light of one lamp at a point; each field has one value per ray.

    Attributes:
        direction: Unit vector from the point to the lamp, in the world.
        distance_m: Distance to the lamp.
        intensity_cd: Intensity of the lamp towards the point.
    """

    direction: Number
    distance_m: Number
    intensity_cd: Number


class Lights:
    """All lamps of a frame; their number, tables and poses can change without compiling a new kernel."""

    def __init__(self) -> None:
        """Begins without lamps."""
        self._tables: list[IntensityTable] = []
        self._starts: dict[int, int] = {}
        self._candela = mi.Float(np.zeros(1, np.float32))
        self.switch_on([], 0)

    def switch_on(self, lamps: Sequence[PlacedLamp], num_layers: int) -> None:
        """Replaces the lamps; those of the same layer are stored together."""
        self._send_tables(lamps)
        lamps = sorted(lamps, key=lambda lamp: lamp.layer)
        ends = np.searchsorted([lamp.layer for lamp in lamps], np.arange(max(num_layers, 1) + 1))
        self._layer_starts = mi.UInt32(ends.astype(np.uint32))
        self.num_layers = max(num_layers, 1)  # a kernel needs somewhere to write
        numbers = np.zeros((max(len(lamps), 1), 16), np.float32)
        layouts = np.zeros((max(len(lamps), 1), 4), np.uint32)
        for number, layout, lamp in zip(numbers, layouts, lamps, strict=False):
            azimuths, elevations = lamp.table.azimuths_deg, lamp.table.elevations_deg
            number[:3] = lamp.world_from_lamp.position_m
            number[3:9] = lamp.world_from_lamp.rotation[:, :2].T.ravel()
            number[9] = lamp.scale
            number[10:12] = azimuths[0], 1.0 / (azimuths[1] - azimuths[0])
            number[12:14] = elevations[0], 1.0 / (elevations[1] - elevations[0])
            layout[:3] = len(azimuths), len(elevations), self._starts[id(lamp.table)]
        self._positions = mi.Float(numbers[:, :3].ravel())
        self._numbers = mi.Float(numbers.ravel())
        self._layouts = mi.UInt32(layouts.ravel())

    def summed(self, slots: Number, is_lit: Number, luminance: Callable[[Number], Number]) -> Number:
        """The sum of `luminance(number)`, which has one value per ray, over the lamps of each layer.

        The loop runs on the device, so that the kernel does not depend on the numbers of lamps and layers. It adds in
        registers and writes every value once, since Dr.Jit's scattered sums make LLVM 19 abort.

        Args:
            slots: For each ray, the slot of its sum within a layer; a permutation of the numbers of the rays.
            is_lit: For each ray, whether there is anything to light; the sums of others are 0. Rays that are computed
                together pass over all lamps if none of them has anything, such as those to the sky.
            luminance: A function of the number of a lamp.

        Returns:
            The sums, ordered by layer and slot.
        """
        num = dr.width(slots)
        out = dr.empty(mi.Float, num * self.num_layers)
        stride = dr.opaque(mi.UInt32, num)
        num_layers = dr.opaque(mi.UInt32, self.num_layers)

        def layer_step(layer: Number) -> tuple[Number]:
            start, end = (dr.gather(mi.UInt32, self._layer_starts, at) for at in (layer, layer + 1))
            _, total = dr.while_loop(
                (start, dr.zeros(mi.Float, num)),
                lambda number, _total: (number < end) & is_lit,
                lambda number, total: (number + 1, total + luminance(number)),
            )
            dr.scatter(out, total, layer * stride + slots)
            return (layer + 1,)

        dr.while_loop((dr.zeros(mi.UInt32, num),), lambda layer: layer < num_layers, layer_step)
        return out

    def position(self, number: Number) -> Number:
        """Positions of the lamps called `number`, one per ray, in the world, metres."""
        return dr.gather(mi.Point3f, self._positions, number)

    def towards(self, points: Number, number: Number) -> Light:
        """The light at `points` of the lamps `number`, one per ray; bilinear, as in `IntensityTable.towards`."""
        a, b, c, d = (dr.gather(mi.Vector4f, self._numbers, number * 4 + part) for part in range(4))
        layout = dr.gather(mi.Vector4u, self._layouts, number)
        forward, left = mi.Vector3f(a.w, b.x, b.y), mi.Vector3f(b.z, b.w, c.x)
        way = mi.Point3f(a.x, a.y, a.z) - points
        distance = dr.norm(way)
        direction = way / greatest(distance, 1e-4)
        x, y, z = (-dr.dot(direction, axis) for axis in (forward, left, dr.cross(forward, left)))
        columns = (dr.rad2deg(angle_rad(y, x)) - c.z) * c.w
        rows = (dr.rad2deg(angle_rad(z, dr.sqrt(x * x + y * y))) - d.x) * d.y
        last_column, last_row = mi.Float(layout.x - 1), mi.Float(layout.y - 1)
        is_inside = (columns >= 0) & (columns <= last_column) & (rows >= 0) & (rows <= last_row)
        column, row = clipped(dr.floor(columns), 0, last_column - 1), clipped(dr.floor(rows), 0, last_row - 1)
        corner = layout.z + mi.UInt32(row) * layout.x + mi.UInt32(column)
        u, v = columns - column, rows - row

        def candela(offset: Number) -> Number:
            return dr.gather(mi.Float, self._candela, corner + offset, is_inside)

        lower = dr.lerp(candela(0), candela(1), u)
        upper = dr.lerp(candela(layout.x), candela(layout.x + 1), u)
        return Light(direction, distance, dr.lerp(lower, upper, v) * c.y)

    def _send_tables(self, lamps: Sequence[PlacedLamp]) -> None:
        """Sends the tables to the renderer, unless they are those of the previous frame."""
        tables = list({id(lamp.table): lamp.table for lamp in lamps}.values())
        if not tables or (len(tables) == len(self._tables) and all(map(_is_same, tables, self._tables))):
            return
        starts = np.cumsum([0, *(table.intensities_cd.size for table in tables)])
        self._tables = tables  # kept alive, so that no other table gets the same id
        self._starts = {id(table): int(start) for table, start in zip(tables, starts, strict=False)}
        self._candela = mi.Float(np.concatenate([table.intensities_cd.ravel() for table in tables]))


def _is_same(first: object, second: object) -> bool:
    return first is second


@dataclass
class Space:
    """A frame's world, lamps and camera.

    Attributes:
        world: The triangles.
        lights: The lamps.
        origin: Position of the camera in the world, metres.
        rotation: Rotation of world_from_camera.
        darkest_cd_m2: Light below this is left out.
    """

    world: Solids
    lights: Lights
    origin: Number
    rotation: Number
    darkest_cd_m2: Number


@dataclass
class Air:
    """The air's properties, as parameters of the kernels.

    Attributes:
        scattering_per_m: Scattering coefficient.
        asymmetry: Henyey-Greenstein's parameter.
        sky_cd_m2: Luminance of the sky.
        glow_cd_m2: What its horizon has more.
    """

    scattering_per_m: Number
    asymmetry: Number
    sky_cd_m2: Number
    glow_cd_m2: Number

    def sky_towards(self, direction: Number) -> Number:
        """Luminance of the sky in a direction of the world."""
        return self.sky_cd_m2 + self.glow_cd_m2 * dr.exp(-dr.abs(direction.z) / GLOW_HEIGHT)


def space_of(world: Solids, lights: Lights, world_from_camera: Pose, darkest_cd_m2: float) -> Space:
    """The space of one frame."""
    axes = [[_parameter(value) for value in row] for row in world_from_camera.rotation]
    origin = mi.Point3f(*(_parameter(value) for value in world_from_camera.position_m))
    return Space(world, lights, origin, mi.Matrix3f(axes), _parameter(darkest_cd_m2))


def air_of(weather: WeatherSpec) -> Air:
    """The air of one frame."""
    values = (weather.scattering_per_m, weather.asymmetry, weather.sky_cd_m2, weather.glow_cd_m2)
    return Air(*(_parameter(value) for value in values))


def _parameter(value: float | np.floating) -> Number:
    """A number that is passed to a kernel, rather than compiled into it."""
    return dr.opaque(mi.Float, float(value))
