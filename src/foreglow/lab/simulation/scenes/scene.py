"""The scenario language: a frozen `Scene` describes a whole drive; `scene_file` reads and writes it as TOML.

Positions along a road are arc lengths `s` in metres; offsets `t` are metres to the left of its centre line. Traffic
keeps to the right unless the road says otherwise. Angles are in degrees, for people to write; profiles are lists of
pairs, interpolated in between.
"""

from __future__ import annotations

import itertools
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import Field, model_validator

from foreglow.calibration.values import MIN_FOCAL_PX, Intrinsics, Position, Turn
from foreglow.geometry import MAX_DISTORTION, MAX_FOCAL_PX, check_centre, check_distortion
from foreglow.lab.simulation.scenes.surroundings import (
    MAX_ALONG_M,
    Along,
    Blur,
    Factor,
    FactorOrNone,
    Listed,
    Luminance,
    Profile,
    Share,
    Side,
    SpecModel,
    SurroundingsSpec,
    TimeSpan,
    Timetable,
)

VehicleKind: TypeAlias = Literal["car", "van", "lorry", "motorcycle", "semitrailer", "bicycle"]
Beam: TypeAlias = Literal["low", "high", "off"]
EgoBeam: TypeAlias = Literal["low", "high", "matrix"]
EGO_BEAMS: tuple[EgoBeam, ...] = get_args(EgoBeam)

LOW_BEAM_FIELDS = ("low_beam_file", "carpet", "stray")
"""Fields of `EgoSpec` that change the low beam of `beam = "low"`; matrix lamps and high beam have their own light."""

Shoulder: TypeAlias = Annotated[float, Field(ge=0, le=5)]
_Term: TypeAlias = Annotated[float, Field(ge=-MAX_DISTORTION, le=MAX_DISTORTION)]
_Pixel: TypeAlias = Annotated[float, Field(ge=-1_000_000, le=1_000_000)]
MAX_COUNT = 1000
"""Of lanes, side roads, lights of a vehicle and frames: far beyond what a drive has."""

LaneNumber: TypeAlias = Annotated[int, Field(ge=0, le=MAX_COUNT)]

MIN_MEDIAN_M = 1.0
"""Width of the narrowest median: a concrete barrier is 0.6 m wide."""


def _check_growing(name: str, profile: tuple[tuple[float, float], ...]) -> None:
    positions = [position for position, _ in profile]
    if any(later <= earlier for earlier, later in itertools.pairwise(positions)):
        raise ValueError(f"{name}: expected growing positions, got {positions}")


class Branch(SpecModel):
    """A straight side road that meets the main one.

    Attributes:
        s_m: Arc length at which it meets the main road's centre line.
        angle_deg: Its direction away from the junction, to the left of the main road's; 90 leaves to the left.
        length_m: Its length.
    """

    s_m: Along
    angle_deg: Annotated[float, Field(ge=-180, le=180)]
    length_m: Annotated[float, Field(gt=0, le=5000)] = 120.0


class RoadSpec(SpecModel):
    """Course and surface of the main road, and the side roads.

    Attributes:
        length_m: Length of the road, which begins at s = 0.
        lane_width_m: Width of every lane.
        num_lanes: Lanes in either direction.
        median: What stands between the directions: nothing, a concrete barrier, or two guardrails on grass.
        median_m: Width of the strip between the directions.
        barrier_m: Height of the concrete barrier: 0.9 m, or up to 1.2 m, which hides the lamps of cars.
        shoulders_m: Widths of the paved strips on either side of a direction's lanes: at the median, and at the edge.
        traffic: The side to which traffic keeps.
        curvature_per_m: Signed curvature over s, positive to the left; linear in between, so that bends begin and
            end with clothoids; constant beyond the ends.
        elevation_m: Height over s; a smooth curve passes through the points.
        superelevation: Cross slope for each 1/100 m of curvature, up to 6 %; roads lean into their bends.
        centre_marking: Dashes, a solid line, or none.
        has_edge_marking: Whether there are lines at the edges.
        edge_line_m: Width of the lines at the edges and beside the median, where that has a width.
        wear: From 0, new, to 1, worn: markings fade, wheel tracks shine.
        wetness: From 0, dry, to 1, wet: the surface becomes darker and glossy.
        snow: Share of the carriageway that is covered with snow.
        branches: Side roads.
    """

    length_m: Annotated[float, Field(ge=50, le=5000)] = 500.0
    lane_width_m: Annotated[float, Field(ge=2, le=5)] = 3.5
    num_lanes: Annotated[int, Field(ge=1, le=5)] = 1
    median: Literal["none", "barrier", "rails"] = "none"
    median_m: Annotated[float, Field(ge=0, le=20)] = 0.0
    barrier_m: Annotated[float, Field(ge=0.5, le=2)] = 0.9
    shoulders_m: tuple[Shoulder, Shoulder] = (0.0, 0.0)
    traffic: Side = "right"
    curvature_per_m: Profile = ((0.0, 0.0),)
    elevation_m: Profile = ((0.0, 0.0),)
    superelevation: Annotated[float, Field(ge=0, le=0.2)] = 0.04
    centre_marking: Literal["dashed", "solid", "none"] = "dashed"
    has_edge_marking: bool = True
    edge_line_m: Annotated[float, Field(ge=0.05, le=0.5)] = 0.3
    wear: Share = 0.3
    wetness: Share = 0.0
    snow: Share = 0.0
    branches: Listed[tuple[Branch, ...]] = ()

    @model_validator(mode="after")
    def _check(self) -> RoadSpec:
        _check_growing("curvature_per_m", self.curvature_per_m)
        _check_growing("elevation_m", self.elevation_m)
        tightest = max(abs(curvature) for _, curvature in self.curvature_per_m)
        if tightest > 0.05:
            raise ValueError(f"curvature_per_m: expected radii of at least 20 m, got {1 / tightest:.1f} m")
        if self.median != "none" and self.median_m < MIN_MEDIAN_M:
            raise ValueError(f"median_m: expected at least {MIN_MEDIAN_M:g} m under a median, got {self.median_m:g}")
        return self

    @property
    def half_width_m(self) -> float:
        """From the centre line to either edge of the carriageway."""
        return self.median_m / 2 + self.shoulders_m[0] + self.num_lanes * self.lane_width_m + self.shoulders_m[1]

    @property
    def mirror(self) -> int:
        """1 where traffic keeps to the right, -1 where it keeps to the left: the factor on offsets and turns."""
        return 1 if self.traffic == "right" else -1

    def lane_m(self, number: int | None = None) -> float:
        """From the centre line to the middle of a lane; lanes count from the median, None is the one at the edge."""
        lane = self.num_lanes - 1 if number is None else number
        return self.median_m / 2 + self.shoulders_m[0] + (lane + 0.5) * self.lane_width_m


class VehicleSpec(SpecModel):
    """Another road user with its time table.

    Attributes:
        kind: The kind of vehicle.
        lane: `oncoming` comes towards us in its lane, `own` drives ahead in ours, `parked_left` and `parked_right`
            stand at the edge, `branch` drives on a side road.
        branch: Number of the side road for the lane `branch`.
        is_towards: On a side road: whether it drives towards the main road. Parked: whether it faces us.
        timetable: Pairs (time in s, arc length in m) along its road; smooth in between, at constant speed beyond.
        lane_number: Which lane of its direction, counted from the median; None for the one at the edge.
        lateral_m: Offset to the left of the road's centre line; None for the middle of the lane.
        brakes_s: Spans of time in which its brake lamps are on.
        beam: The beam of its headlamps.
        low_beam_file: An IES file for the low beam instead of the built-in table.
        brightness: Factor on all its lamps.
        yaw_aim_deg: Misalignment of the headlamps to the left.
        pitch_aim_deg: Misalignment of the headlamps upwards.
        is_light: Whether its paint is light.
        lights_up_to_m: How near to us it has to be for what its lamps light to count; further away, only the lamps
            themselves are seen, which costs little.
    """

    kind: VehicleKind = "car"
    lane: Literal["oncoming", "own", "parked_left", "parked_right", "branch"] = "oncoming"
    branch: Annotated[int, Field(ge=0, le=MAX_COUNT)] = 0
    is_towards: bool = True
    timetable: Timetable = ((0.0, 300.0), (10.0, 100.0))
    lane_number: LaneNumber | None = None
    lateral_m: Annotated[float, Field(ge=-500, le=500)] | None = None
    brakes_s: Listed[tuple[TimeSpan, ...]] = ()
    beam: Beam = "low"
    low_beam_file: str | None = None
    brightness: Factor = 1.0
    yaw_aim_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    pitch_aim_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    is_light: bool = False
    lights_up_to_m: Annotated[float, Field(gt=0, le=MAX_ALONG_M)] | None = None


class EgoSpec(SpecModel):
    """Our own vehicle.

    Attributes:
        timetable: Pairs (time in s, arc length in m), as for other vehicles.
        lane_number: Which of our lanes, counted from the median; None for the one at the edge.
        traffic: The side of traffic for which its low beam is made.
        beam: `matrix` is the low beam of the matrix lamps plus their 2 x 84 LEDs, whose levels the caller sets for
            each frame; all on at first.
        low_beam_file: An IES file for the low beam instead of the built-in table. This and the next two are of the beam
            `low` alone: matrix lamps and the high beam have light of their own.
        carpet: Wide and near light of the built-in low beam: 1 for modern lamps, 0.4 for old ones, see `low_beam`.
        stray: Factor on the stray light of the built-in low beam: 1 for clean lamps, several for lamps under slush.
        brightness: Factor on the headlamps.
        yaw_aim_deg: Misalignment of the headlamps to the left.
        pitch_aim_deg: Misalignment of the headlamps upwards.
        body_motion: Factor on pitch, roll and heave of the body on its springs; 0 for a smooth ride.
        stray_m: How far we stray from the middle of our lane, to either side in turn; the map does not know.
    """

    timetable: Timetable = ((0.0, 20.0), (10.0, 200.0))
    lane_number: LaneNumber | None = None
    traffic: Side = "right"
    beam: EgoBeam = "low"
    low_beam_file: str | None = None
    carpet: Annotated[float, Field(gt=0, le=1)] = 1.0
    stray: Annotated[float, Field(ge=0, le=100)] = 1.0
    brightness: Factor = 1.0
    yaw_aim_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    pitch_aim_deg: Annotated[float, Field(ge=-5, le=5)] = 0.0
    body_motion: Annotated[float, Field(ge=0, le=10)] = 1.0
    stray_m: Annotated[float, Field(ge=0, le=1.5)] = 0.0

    @property
    def changed_low_beam(self) -> tuple[str, ...]:
        """Those of `LOW_BEAM_FIELDS` that are not as they are by default."""
        usual = type(self).model_fields
        return tuple(name for name in LOW_BEAM_FIELDS if getattr(self, name) != usual[name].default)

    def with_beam(self, beam: EgoBeam) -> EgoSpec:
        """Our vehicle with another beam; unless that is `low`, `LOW_BEAM_FIELDS` have their defaults."""
        usual = {name: type(self).model_fields[name].default for name in LOW_BEAM_FIELDS}
        return self.model_copy(update={"beam": beam, **({} if beam == "low" else usual)})


class WeatherSpec(SpecModel):
    """Haze, precipitation, and the light of the sky.

    Attributes:
        scattering_per_m: Scattering coefficient of the haze; 4e-4 is clear air, 3e-3 is mist.
        asymmetry: Henyey-Greenstein parameter of the haze.
        rain_mm_h: Rate of rain.
        snow_mm_h: Rate of snow, as water.
        sky_cd_m2: Luminance of the sky; 2e-4 is a cloudy night far from towns, 5e-3 is near a town.
        glow_cd_m2: What the horizon has more than the sky above, the glow of towns.
    """

    scattering_per_m: Annotated[float, Field(ge=0, le=10)] = 4e-4
    asymmetry: Annotated[float, Field(gt=-1, lt=1)] = 0.75
    rain_mm_h: Annotated[float, Field(ge=0, le=500)] = 0.0
    snow_mm_h: Annotated[float, Field(ge=0, le=500)] = 0.0
    sky_cd_m2: Luminance = 3e-4
    glow_cd_m2: Luminance = 0.0


class CameraSpec(SpecModel):
    """The camera and its mount.

    Attributes:
        width_px: Columns of the image.
        height_px: Rows of the image.
        focal_px: Focal length.
        centre_px: Principal point; None for the middle of the image.
        distortion: k1, k2, p1, p2, k3, as OpenCV defines them.
        mount_m: Position in the vehicle: forward of the rear axle, left, up; limited, as are focal length and angles,
            as in a calibration, since every data set has one.
        pitch_deg: Pitch upwards.
        yaw_deg: Yaw to the left.
        roll_deg: Roll to the right.
    """

    width_px: Annotated[int, Field(ge=32, le=8192)] = 1280
    height_px: Annotated[int, Field(ge=24, le=8192)] = 960
    focal_px: Annotated[float, Field(ge=MIN_FOCAL_PX, le=MAX_FOCAL_PX)] = 1312.0
    centre_px: tuple[_Pixel, _Pixel] | None = None
    distortion: tuple[_Term, _Term, _Term, _Term, _Term] = (-0.05, 0.02, 0.0, 0.0, 0.0)
    mount_m: Position = (1.9, 0.0, 1.3)
    pitch_deg: Annotated[float, Field(ge=-30, le=30)] = -0.7
    yaw_deg: Turn = 0.0
    roll_deg: Annotated[float, Field(ge=-30, le=30)] = 0.0

    @model_validator(mode="after")
    def _check(self) -> CameraSpec:
        if self.centre_px is not None:
            check_centre(self.centre_px, (self.width_px, self.height_px), "centre_px")
        size_px, focal_px = (self.width_px, self.height_px), (self.focal_px, self.focal_px)
        centre_px = self.centre_px or (self.width_px / 2, self.height_px / 2)
        width_px, height_px = size_px
        Intrinsics(width_px=width_px, height_px=height_px, focal_px=focal_px, centre_px=centre_px).of_a_lens("focal_px")
        check_distortion(size_px, focal_px, centre_px, self.distortion, "distortion")
        return self


class SensorSpec(SpecModel):
    """Optics and imager, in grey levels of 8 bits and pixels of an image of 1280 columns.

    Attributes:
        exposure: `day` is the short exposure of PVDN's cycle, `night` the long one.
        grey_per_cd_m2: Grey levels for 1 cd/m^2 in the short exposure, in the linear part of the response.
        night_gain: Ratio of the grey levels of the long and the short exposure.
        day_exposure_s: Duration of the short exposure; estimated from motion blur in PVDN's frames, as is the next.
        night_exposure_s: Duration of the long exposure; the rest of `night_gain` is amplification, which also amplifies
            noise.
        black_level: Grey level without light.
        knee: Grey levels above black up to which the response is linear.
        log_slope: Grey levels for a factor e above the knee.
        read_noise: Standard deviation without light.
        shot_noise: Variance for each grey level of signal.
        grain_px: Standard deviation of a blur of the noise, which keeps its variance; 0 for noise as correlated as
            after demosaicing.
        column_noise: Factor on the fixed pattern of the columns.
        row_noise: Factor on the noise that a row has in common.
        core_px: Standard deviation of the point spread's core.
        middle_share: Share of the light in the exponential part.
        middle_px: Length of the exponential part.
        tail_share: Share of the light in the 1/r^2 tail (veiling glare).
        vignetting: Exponent on the natural cos^4 fall-off.
    """

    exposure: Literal["day", "night"] = "day"
    grey_per_cd_m2: Factor = 50.0
    night_gain: Factor = 8.0
    day_exposure_s: Annotated[float, Field(gt=0, le=10)] = 8e-3
    night_exposure_s: Annotated[float, Field(gt=0, le=10)] = 2.5e-2
    black_level: Annotated[float, Field(ge=0, le=255)] = 7.6
    knee: Annotated[float, Field(gt=0, le=10_000)] = 38.0
    log_slope: Annotated[float, Field(gt=0, le=10_000)] = 14.0
    read_noise: FactorOrNone = 1.35
    shot_noise: FactorOrNone = 0.05
    grain_px: Annotated[float, Field(ge=0, le=20)] = 0.0
    column_noise: FactorOrNone = 1.0
    row_noise: FactorOrNone = 1.0
    core_px: Blur = 0.8
    middle_share: Share = 0.25
    middle_px: Blur = 0.65
    tail_share: Annotated[float, Field(ge=0, le=0.2)] = 1.5e-2
    vignetting: FactorOrNone = 1.0


class LabelRule(SpecModel):
    """When light counts as a perceivable artifact; recorded with every result, since it determines each first sight.

    `D` is the noise-free grey level that a vehicle's light adds, smoothed; pixels are those of images of 1280 columns.

    Attributes:
        min_grey: D must exceed this.
        min_contrast: D over its noise (sensor, columns, texture of the surroundings, veiling glare) must exceed this.
        min_area_px: Smallest number of pixels around a peak that reach half of it.
        saddle: Two peaks are two instances if the light between them falls below this share of the lower one.
        min_distance_px: Smallest distance between instances of one vehicle.
        max_instances: Largest number of indirect instances of a vehicle in an image that shows one of its lamps; the
            strongest are kept.
        max_hidden_instances: The same if none of its lamps is seen: people then mark the light as a whole.
        relative_strength: Peaks below this share of the vehicle's strongest peak are dropped.
        doubtful_factor: Peaks that meet the rule only with thresholds divided by this are doubtful.
        hold_frames: Number of frames for which an instance is kept while it meets the divided thresholds.
        min_visible: Share of a lamp's disc that must be seen for a direct instance.
    """

    min_grey: Factor = 15.0
    min_contrast: Factor = 37.5
    min_area_px: Factor = 25.0
    saddle: Share = 0.5
    min_distance_px: Annotated[float, Field(ge=0, le=8192)] = 20.0
    max_instances: Annotated[int, Field(ge=1, le=MAX_COUNT)] = 2
    max_hidden_instances: Annotated[int, Field(ge=1, le=MAX_COUNT)] = 1
    relative_strength: Share = 0.5
    doubtful_factor: Annotated[float, Field(ge=1, le=1_000_000)] = 4.0
    hold_frames: Annotated[int, Field(ge=0, le=MAX_COUNT)] = 3
    min_visible: Share = 0.2


class Scene(SpecModel):
    """The complete description of a drive: the same scene gives the same images.

    Attributes:
        name: Scenario that it belongs to, such as `curve`.
        seed: Seed of everything random: plants, textures, noise, body motion.
        duration_s: Duration of the drive.
        rate_hz: Frames per second.
        pair_s: Time between the two frames of a pair; None for frames at equal distances. Pairs show motion where
            frames are few: `rate_hz` / 2 pairs a second.
        road: Course and surface of the road.
        surroundings: What stands beside it.
        vehicles: The other road users.
        ego: Our own vehicle.
        weather: Air, rain, snow, sky.
        camera: Calibration and mount.
        sensor: Optics and imager.
        labels: When light counts as an artifact.
    """

    name: Annotated[str, Field(min_length=1, max_length=100)] = "straight"
    seed: Annotated[int, Field(ge=0, lt=2**53)] = 0
    duration_s: Annotated[float, Field(gt=0, le=3600)] = 9.0
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 18.0
    pair_s: Annotated[float, Field(gt=0, le=10)] | None = None
    road: RoadSpec = RoadSpec()
    surroundings: SurroundingsSpec = SurroundingsSpec()
    vehicles: Listed[tuple[VehicleSpec, ...]] = ()
    ego: EgoSpec = EgoSpec()
    weather: WeatherSpec = WeatherSpec()
    camera: CameraSpec = CameraSpec()
    sensor: SensorSpec = SensorSpec()
    labels: LabelRule = LabelRule()

    @model_validator(mode="after")
    def _check(self) -> Scene:
        if self.pair_s is not None and self.pair_s >= 2.0 / self.rate_hz:
            raise ValueError(f"pair_s: expected below 2 / rate_hz, {2.0 / self.rate_hz:g} s, got {self.pair_s:g}")
        for index, vehicle in enumerate(self.vehicles):
            if vehicle.lane == "branch" and vehicle.branch >= len(self.road.branches):
                num = len(self.road.branches)
                if not num:
                    raise ValueError(
                        f"vehicles.{index}.lane: expected one of the main road, as there is no side road in "
                        "road.branches, got 'branch'"
                    )
                raise ValueError(f"vehicles.{index}.branch: expected a side road below {num}, got {vehicle.branch}")
        numbers = {"ego": self.ego.lane_number}
        numbers |= {f"vehicles.{index}": vehicle.lane_number for index, vehicle in enumerate(self.vehicles)}
        for field, number in numbers.items():
            if number is not None and number >= self.road.num_lanes:
                raise ValueError(f"{field}.lane_number: expected a lane below {self.road.num_lanes}, got {number}")
        return self

    @property
    def num_frames(self) -> int:
        """Number of frames of the drive."""
        return max(1, round(self.duration_s * self.rate_hz))

    def time_s(self, number: int) -> float:
        """Time of frame `number` since the begin of the drive."""
        if self.pair_s is None:
            return number / self.rate_hz
        return number // 2 * 2 / self.rate_hz + number % 2 * self.pair_s
