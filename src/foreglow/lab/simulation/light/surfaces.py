"""Properties of a surface at the hit of a ray: material, texture, markings, water and snow."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from foreglow.lab.simulation.light.llvm import clipped, dr, greatest, least, mi
from foreglow.lab.simulation.light.raycast import Hit, Number
from foreglow.lab.simulation.scenes.scene import RoadSpec
from foreglow.lab.simulation.world.materials import MATERIALS, column, material_number
from foreglow.lab.simulation.world.road import has_several_lanes, lane_lines

NOISE_TEXELS = 512
NOISE_BLUR_TEXELS = 1.2
"""Standard deviation of the noise's blur, with which its features are about three texels wide."""

TEXEL_M = (0.02, 0.1, 0.5, 2.5)
"""Sizes of a texel: the same noise is used at four scales, with features of 6 cm to 7.5 m."""

FEATURE_TEXELS = 3.0

SCREEN_TEXEL_M = 0.12
"""Size of a texel of the picture on a billboard or in a shop window, whose features are about 0.4 m wide."""

CURVATURE_PER_M = {
    "rail": 14.0,
    "metal_post": 25.0,
    "leaf": 15.0,
    "grass_blade": 30.0,
    "paint_dark": 1.5,
    "paint_light": 1.5,
    "glass": 1.0,
}
"""Rotation of a material's normals per metre at scales below its triangles: the beads of a rail have radii of some
centimetres. A pixel that covers a whole bead shows a rough surface instead of sparkles.
"""

LEAF_SIZE_M = {"leaf": 0.06, "grass_blade": 0.02}
"""Size of leaves and blades, many of which are in one pixel from some distance on."""

ROUGH = tuple(
    material.name
    for material in MATERIALS
    if material.name == "bark" or (material.kind in ("road", "verge", "wall") and material.roughness > 0.4)
    if not material.transmission
)
"""Materials made of grains and holes, unlike paint, metal and glass."""

IN_SNOWFALL = {"bark": (0.25, 0.35), "snow": (0.2, 0.4)}
"""Albedo and variation of materials while it is snowing: bark to which snow sticks, and thin snow on grass."""

COUNTRY_REFLECTOR = 400.0
"""Retroreflection of reflectors on roads of two lanes, by which they flare as in PVDN's frames; motorways, which were
compared with clips, keep that of the material.
"""

MARKING_WIDTH_M = 0.12
EDGE_LINE_INSET_M = 0.2
DASH_M, DASH_PERIOD_M = 4.0, 12.0
"""Lines of German country roads (RMS): narrow, 0.12 m; dashes of 4 m with gaps of 8 m."""

TRACK_HALF_GAUGE_M, TRACK_WIDTH_M = 0.75, 0.28

WET_ROUGHNESS = 0.23
"""Roughness of a fully wet road; with less it would become a mirror, which real asphalt never is."""

BRANCH_OFFSET_M = 50.0
"""A carriageway with a greater |t| belongs to a side road and has no markings."""


@dataclass
class Surface:
    """Properties of the surfaces that rays hit, for shading; each field has one value per ray.

    Attributes:
        is_hit: Whether the ray hits anything.
        position: Position in the world, metres.
        outward: Normal without bumps, on the ray's side.
        normal: Normal with bumps.
        view: Unit vector to the camera.
        albedo: Diffuse reflectance.
        specular: Reflectance of the glossy part at normal incidence.
        alpha: Width of the GGX distribution: roughness squared, and the variation of normals within the pixel.
        transmission: Share of the diffuse light that leaves on the other side.
        retroreflection: Coefficient of retroreflection, cd/lx/m^2.
        is_beaded: Whether the retroreflection is that of glass beads on the ground, not of a sign's sheeting.
        is_rough: Whether it is made of grains and holes, unlike smooth paint or leaves.
        film: Share under a film of water, which reflects light at grazing angles.
        canopy: Share of the pixel that shows leaves of all orientations, 0..1.
    """

    is_hit: Number
    position: Number
    outward: Number
    normal: Number
    view: Number
    albedo: Number
    specular: Number
    alpha: Number
    transmission: Number
    retroreflection: Number
    is_beaded: Number
    is_rough: Number
    film: Number
    canopy: Number


class Surfaces:
    """Materials, textures and the road's state, in the form that the kernels read."""

    def __init__(self, road: RoadSpec, seed: int, *, is_snowing: bool = False) -> None:
        """The textures follow from `seed`; the road's state is passed to the kernels, not compiled into them.

        While it is snowing, bark is white in patches, the snow beside the road is thin, and the road is evenly wet.
        """
        noise = _noise(np.random.default_rng([seed, 71]))
        self._noise = mi.Texture2f(
            mi.TensorXf(noise), filter_mode=dr.FilterMode.Linear, wrap_mode=dr.WrapMode.Repeat, use_accel=False
        )
        self._materials = mi.Float(_material_records(road, is_snowing).ravel())
        values = {
            "lane_m": road.lane_width_m,
            "wear": road.wear,
            "wetness": road.wetness,
            "uneven": 0.05 if is_snowing else 0.25,
            "dash_m": {"dashed": DASH_M, "solid": DASH_PERIOD_M, "none": 0.0}[road.centre_marking],
            "edge_m": MARKING_WIDTH_M if road.has_edge_marking else 0.0,
            # The noise is roughly normal, so that this quantile leaves the wanted share under snow.
            "bare": NormalDist().inv_cdf(float(np.clip(1.0 - road.snow, 1e-4, 1.0 - 1e-4))) if road.snow else 1e3,
        }
        self._road = {name: dr.opaque(mi.Float, float(value)) for name, value in values.items()}
        self._lines = lane_lines(road) if has_several_lanes(road) else ()
        self._first_lane_m = dr.opaque(mi.Float, road.lane_m(0) - road.lane_width_m / 2)

    def at(self, hit: Hit, direction: Number, pixel_rad: Number) -> Surface:
        """The surfaces hit by rays in `direction`; a pixel has the angle `pixel_rad`."""
        first = dr.gather(mi.Vector4f, self._materials, hit.material * 2, hit.is_hit)
        second = dr.gather(mi.Vector4f, self._materials, hit.material * 2 + 1, hit.is_hit)
        across_m = hit.distance_m * pixel_rad
        # A pixel's footprint on the surface is longer along the view; its mean size limits what can be resolved.
        slant = greatest(-dr.dot(hit.normal, direction), 0.02)
        footprint_m = across_m * dr.rsqrt(slant)
        u, v, u_axis, v_axis = _flat_coordinates(hit)
        tone, slope_u, slope_v, patches, lost_slope = mi.Float(0), mi.Float(0), mi.Float(0), mi.Float(0), mi.Float(0)
        for texel_m in TEXEL_M:
            seen = clipped(1.5 - footprint_m / (FEATURE_TEXELS * texel_m), 0.0, 1.0)
            value = self._noise.eval(mi.Point2f(u, v) / (NOISE_TEXELS * texel_m))
            tone += 0.5 * seen * value[0]
            slope_u += 0.5 * seen * value[1]
            slope_v += 0.5 * seen * value[2]
            patches += (0.2 if texel_m < 0.5 else 0.65) * seen * value[3]
            lost_slope += 0.25 * (1.0 - seen * seen)
        variation, bump = second.y, second.z
        albedo = first.x * dr.exp(variation * tone)
        surface = Surface(
            is_hit=hit.is_hit,
            position=hit.position,
            outward=hit.normal,
            normal=hit.normal,
            view=-direction,
            albedo=albedo,
            specular=first.y,
            alpha=dr.square(first.z),
            transmission=first.w,
            retroreflection=second.x,
            is_beaded=hit.material == material_number("marking"),
            is_rough=_is_one_of(hit.material, ROUGH),
            film=mi.Float(0.0),
            canopy=_canopy(hit.material, footprint_m),
        )
        streak = self._streaks(hit, u, v, footprint_m)
        self._build_walls(surface, hit, u, v, footprint_m, streak)
        bump = self._pave(surface, hit, bump, footprint_m, patches, streak)
        surface.normal = _bumped(hit.normal, bump * (slope_u * u_axis + slope_v * v_axis), surface.view)
        # Source: Tokuyoshi, Kaplanyan: Improved geometric specular antialiasing, 2019 (normals that a pixel averages).
        turned = dr.square(0.5 * second.w * footprint_m) + dr.square(bump) * lost_slope
        surface.alpha = dr.sqrt(dr.square(surface.alpha) + least(2.0 * turned, 0.18))
        surface.albedo = clipped(surface.albedo, 0.005, 0.9)
        return surface

    def glow_cd_m2(self, hit: Hit) -> Number:
        """Luminance of what shines by itself, a screen: its coordinates are the luminance and how much it varies."""
        u, v, _, _ = _flat_coordinates(hit)
        picture = dr.exp(0.6 * self._noise.eval(mi.Point2f(u, v) / (NOISE_TEXELS * SCREEN_TEXEL_M))[0])
        glow = hit.coordinates_m.x * dr.lerp(1.0, picture, hit.coordinates_m.y)
        return dr.select(hit.material == material_number("screen"), glow, 0.0)

    def _streaks(self, hit: Hit, u: Number, v: Number, footprint_m: Number) -> Number:
        """Noise that is stretched along the road, and vertically on walls."""
        is_road = hit.material == material_number("road")
        s, t = hit.coordinates_m.x, hit.coordinates_m.y
        texel = dr.select(is_road, mi.Point2f(s / 1.2, t / 0.06), mi.Point2f(u / 0.06, v / 0.9))
        seen = clipped(1.5 - footprint_m / 0.25, 0.0, 1.0)
        return seen * self._noise.eval(texel / NOISE_TEXELS)[0]

    def _build_walls(
        self, surface: Surface, hit: Hit, u: Number, v: Number, footprint_m: Number, streak: Number
    ) -> None:
        """Courses of bricks, joints of concrete panels, and streaks left by rain."""
        is_brick = hit.material == material_number("brick")
        is_concrete = hit.material == material_number("concrete")
        is_plaster = hit.material == material_number("plaster")
        course = dr.floor(v / 0.075)
        along = u + dr.select(course - 2.0 * dr.floor(course / 2.0) > 0.5, 0.125, 0.0)
        beds = _stripes(v, 0.075, 0.011, footprint_m)
        mortar = 1.0 - (1.0 - beds) * (1.0 - _stripes(along, 0.25, 0.011, footprint_m))
        joints = 1.0 - (1.0 - _stripes(u, 2.5, 0.025, footprint_m)) * (1.0 - _stripes(v, 0.6, 0.012, footprint_m))
        surface.albedo = dr.select(is_brick, dr.lerp(surface.albedo, 0.3, mortar), surface.albedo)
        surface.albedo = dr.select(is_concrete, surface.albedo * (1.0 - 0.55 * joints), surface.albedo)
        washed = dr.exp(0.12 * streak)
        surface.albedo = dr.select(is_concrete | is_plaster, surface.albedo * washed, surface.albedo)

    def _pave(
        self, surface: Surface, hit: Hit, bump: Number, footprint_m: Number, patches: Number, streak: Number
    ) -> Number:
        """Markings, wheel tracks, water and snow on the carriageway; returns the remaining bump."""
        road = self._road
        s, t = hit.coordinates_m.x, hit.coordinates_m.y
        is_road = hit.material == material_number("road")
        is_main = is_road & (dr.abs(t) < BRANCH_OFFSET_M)
        across_m = footprint_m * dr.sqrt(greatest(dr.dot(surface.outward, surface.view), 0.02))
        track_m = dr.abs(dr.abs(self._beside_lane_m(t)) - TRACK_HALF_GAUGE_M) / TRACK_WIDTH_M
        track = dr.select(is_main, dr.exp(-dr.square(track_m)), 0.0)
        worn = road["wear"] * track
        albedo = surface.albedo * dr.exp(0.05 * streak + 0.12 * worn - 0.08 * patches * road["wear"])
        kept = clipped(1.0 - road["wear"] * (0.55 + 0.35 * patches + 0.25 * streak), 0.1, 1.0)
        paint = dr.select(is_main, least(self._painted(s, t, across_m, footprint_m), 1.0) * kept, 0.0)
        marking = MATERIALS[material_number("marking")]
        albedo = dr.lerp(albedo, marking.albedo, paint)
        # Water fills the pores and makes the surface darker and smoother, most of all in the tracks.
        wet = clipped(road["wetness"] * (1.0 + road["uneven"] * patches + 0.3 * track), 0.0, 1.0)
        albedo *= 1.0 - 0.5 * wet
        road_roughness = MATERIALS[material_number("road")].roughness
        roughness = dr.lerp(road_roughness * (1.0 - 0.08 * worn + 0.03 * streak), WET_ROUGHNESS, wet)
        paint_retro = marking.retroreflection * paint * (1.0 - 0.8 * wet)  # the beads are under water
        snow = clipped((patches + 0.5 * streak - 1.2 * track + 0.4 - road["bare"]) * 3.0 + 0.5, 0.0, 1.0)
        albedo, roughness = dr.lerp(albedo, 0.7, snow), dr.lerp(roughness, 0.6, snow)
        surface.albedo = dr.select(is_road, albedo, surface.albedo)
        surface.alpha = dr.select(is_road, dr.square(roughness), surface.alpha)
        surface.retroreflection = dr.select(is_road, paint_retro * (1.0 - snow), surface.retroreflection)
        surface.film = dr.select(is_road, wet * (1.0 - snow), 0.0)
        surface.is_beaded |= is_road
        return dr.select(is_road, dr.lerp(bump * (1.0 - 0.7 * wet), 0.06, snow), bump)

    def _beside_lane_m(self, t: Number) -> Number:
        """Distance from the middle of the lane."""
        if not self._lines:
            return dr.abs(t) - 0.5 * self._road["lane_m"]
        lanes = (dr.abs(t) - self._first_lane_m) / self._road["lane_m"]
        return (lanes - dr.floor(lanes) - 0.5) * self._road["lane_m"]

    def _painted(self, s: Number, t: Number, across_m: Number, footprint_m: Number) -> Number:
        """Share of the footprint that is under the paint of lines."""
        if not self._lines:
            edge = _stripe(dr.abs(t) - (self._road["lane_m"] - EDGE_LINE_INSET_M), self._road["edge_m"], across_m)
            return edge + _stripe(t, MARKING_WIDTH_M, across_m) * _dashes(s, self._road["dash_m"], footprint_m)
        paint = mi.Float(0.0)
        for line in self._lines:
            along = _stripes(s, line.period_m, line.dash_m, footprint_m) if line.dash_m < line.period_m else 1.0
            paint += _stripe(dr.abs(t) - line.offset_m, line.width_m, across_m) * along
        return paint


def _noise(generator: np.random.Generator) -> NDArray[np.float32]:
    """Four periodic fields of smooth noise, each with mean 0 and variance 1; shape (rows, columns, 4)."""
    white = generator.standard_normal((NOISE_TEXELS, NOISE_TEXELS, 4))
    smooth = gaussian_filter(white, (NOISE_BLUR_TEXELS, NOISE_BLUR_TEXELS, 0), mode="wrap")
    smooth -= smooth.mean((0, 1))
    return np.asarray(smooth / smooth.std((0, 1)), np.float32)


def _material_records(road: RoadSpec, is_snowing: bool) -> NDArray[np.float32]:
    """Eight floats of each material, shape (len(MATERIALS), 8)."""
    fields = ("albedo", "specular", "roughness", "transmission", "retroreflection", "variation", "bump")
    curvatures = np.array([CURVATURE_PER_M.get(material.name, 0.0) for material in MATERIALS], np.float32)
    records = np.stack([*(column(field) for field in fields), curvatures], -1)
    if not has_several_lanes(road):
        records[material_number("reflector"), fields.index("retroreflection")] = COUNTRY_REFLECTOR
    if is_snowing:
        for name, changed in IN_SNOWFALL.items():
            records[material_number(name), [0, 5]] = changed
    return records


def _flat_coordinates(hit: Hit) -> tuple[Number, Number, Number, Number]:
    """Two texture coordinates and their directions: x and y on the ground, along and up on walls."""
    x, y, z = hit.position.x, hit.position.y, hit.position.z
    is_steep = dr.abs(hit.normal.z) < 0.7
    is_along_y = is_steep & (dr.abs(hit.normal.x) > dr.abs(hit.normal.y))
    u_axis = dr.select(is_along_y, mi.Vector3f(0, 1, 0), mi.Vector3f(1, 0, 0))
    v_axis = dr.select(is_steep, mi.Vector3f(0, 0, 1), mi.Vector3f(0, 1, 0))
    return dr.select(is_along_y, y, x), dr.select(is_steep, z, y), u_axis, v_axis


def _bumped(normal: Number, slope: Number, view: Number) -> Number:
    """The normal of a visible part of a bumpy surface: parts that are turned away are hidden by others."""
    bumped = dr.normalize(normal + slope)
    least_seen = 0.4 * greatest(dr.dot(normal, view), 0.0)
    return dr.normalize(bumped + view * greatest(least_seen - dr.dot(bumped, view), 0.0))


def _is_one_of(material: Number, names: tuple[str, ...]) -> Number:
    is_any = mi.Bool(False)
    for name in names:
        is_any |= material == material_number(name)
    return is_any


def _canopy(material: Number, footprint_m: Number) -> Number:
    size_m = mi.Float(0.0)
    for name, size in LEAF_SIZE_M.items():
        size_m = dr.select(material == material_number(name), size, size_m)
    return dr.select(size_m > 0, clipped(footprint_m / greatest(size_m, 1e-3) - 0.3, 0.0, 1.0), 0.0)


def _stripe(from_middle_m: Number, width_m: Number, footprint_m: Number) -> Number:
    """Share of the footprint that is on a stripe."""
    low = greatest(from_middle_m - 0.5 * footprint_m, -0.5 * width_m)
    high = least(from_middle_m + 0.5 * footprint_m, 0.5 * width_m)
    return clipped((high - low) / greatest(footprint_m, 1e-6), 0.0, 1.0)


def _stripes(position_m: Number, period_m: float, width_m: Number, footprint_m: Number) -> Number:
    """Share of the footprint that is on stripes, which begin at every multiple of the period."""

    def covered(end_m: Number) -> Number:
        full = dr.floor(end_m / period_m)
        return full * width_m + least(end_m - full * period_m, width_m)

    width = greatest(footprint_m, 1e-4)
    return clipped((covered(position_m + 0.5 * width) - covered(position_m - 0.5 * width)) / width, 0.0, 1.0)


def _dashes(s_m: Number, dash_m: Number, footprint_m: Number) -> Number:
    return _stripes(s_m, DASH_PERIOD_M, dash_m, footprint_m)
