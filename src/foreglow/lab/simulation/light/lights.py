"""The lamps as the rays' kernels read them: one buffer of lamps, and one of all their tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foreglow.lab.simulation.light.lamps import PlacedLamp
from foreglow.lab.simulation.light.llvm import angle_rad, clipped, dr, greatest, mi
from foreglow.lab.simulation.light.raycast import Number
from foreglow.photometry import IntensityTable


@dataclass
class Light:
    """What one lamp sends to a point; a field has one value a ray.

    Attributes:
        direction: Unit vector from the point to the lamp, in the world.
        distance_m: To the lamp.
        intensity_cd: Towards the point.
    """

    direction: Number
    distance_m: Number
    intensity_cd: Number


class Lights:
    """All lamps of a frame; their number, tables and poses change without a new kernel."""

    def __init__(self) -> None:
        """No lamps at first."""
        self._tables: list[IntensityTable] = []
        self._starts: dict[int, int] = {}
        self._candela = mi.Float(np.zeros(1, np.float32))
        self.switch_on([], 0)

    def switch_on(self, lamps: Sequence[PlacedLamp], num_layers: int) -> None:
        """Takes these lamps in place of those before; those of a layer lie together from now on."""
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

    def summed(self, slots: Number, luminance: Callable[[Number], Number]) -> Number:
        """The sum over each layer's lamps of `luminance(number)`, which has one value a ray.

        Loops on the device, so that neither the number of lamps nor that of layers needs another kernel. It adds in
        registers and writes every value once: Dr.Jit's scattered sums take the lanes apart, at which LLVM 19 aborts.

        Args:
            places: For each ray, where in a layer its sum goes; all places below the number of rays, once each.
            luminance: From the number of a lamp.

        Returns:
            In the order layer, place.
        """
        num = dr.width(slots)
        out = dr.empty(mi.Float, num * self.num_layers)
        stride = dr.opaque(mi.UInt32, num)
        num_layers = dr.opaque(mi.UInt32, self.num_layers)

        def layer_step(layer: Number, number: Number) -> tuple[Number, Number]:
            end = dr.gather(mi.UInt32, self._layer_starts, layer + 1)
            number, total = dr.while_loop(
                (number, dr.zeros(mi.Float, num)),
                lambda number, _total: number < end,
                lambda number, total: (number + 1, total + luminance(number)),
            )
            dr.scatter(out, total, layer * stride + slots)
            return layer + 1, number

        first = dr.zeros(mi.UInt32, num)
        dr.while_loop((first, mi.UInt32(first)), lambda layer, _number: layer < num_layers, layer_step)
        return out

    def position(self, number: Number) -> Number:
        """Where the lamps called `number`, one a ray, are in the world, metres."""
        return dr.gather(mi.Point3f, self._positions, number)

    def towards(self, points: Number, number: Number) -> Light:
        """What the lamps called `number`, one a ray, send to `points`; bilinear, as `IntensityTable.towards`."""
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
        """Sends the tables to the renderer, unless they are those of the frame before."""
        tables = list({id(lamp.table): lamp.table for lamp in lamps}.values())
        if not tables or (len(tables) == len(self._tables) and all(map(_is_same, tables, self._tables))):
            return
        starts = np.cumsum([0, *(table.intensities_cd.size for table in tables)])
        self._tables = tables  # kept alive, so that no other table gets the same id
        self._starts = {id(table): int(start) for table, start in zip(tables, starts, strict=False)}
        self._candela = mi.Float(np.concatenate([table.intensities_cd.ravel() for table in tables]))


def _is_same(first: object, second: object) -> bool:
    return first is second
