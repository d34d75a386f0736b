"""Camera profiles: how light becomes an image, as a frozen model that is read from and written to TOML.

Angles are in degrees and lengths on the image in pixels of the camera's own image. A profile without a `[view]` has the
size of the rendering. The section `[imager]` with `model = "scene"` takes lens, imager and noise from each scene's own
sensor, which are PVDN's; `[lens]` then only adds to that lens.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, Field, model_validator

from foreglow.config import read_toml, validated
from foreglow.datasets.pvdn.schema import Name
from foreglow.lab.simulation.scenes.scene import SensorSpec
from foreglow.lab.simulation.scenes.surroundings import Blur, Factor, FactorOrNone, Luminance, Share, SpecModel

Angle = Annotated[float, Field(gt=0, le=60)]
Direction = Annotated[float, Field(ge=-360, le=360)]
Listed = Field(max_length=20)
MAX_SCATTERED = 0.9


class ViewSpec(SpecModel):
    """The part of the rendered field of view that the camera sees, about the middle of the rendering's columns.

    Attributes:
        width_px: Columns of the image; None for those of the rendering.
        height_px: Rows of the image; None for those of the rendering.
        focal_px: Focal length; None sees the rendering's whole width.
        up: Which rows of the rendering it sees, from 0, the lowest ones, to 1, the highest: a camera that is tilted up.
    """

    width_px: Annotated[int, Field(ge=32, le=8192)] | None = None
    height_px: Annotated[int, Field(ge=24, le=8192)] | None = None
    focal_px: Annotated[float, Field(gt=0, le=100_000)] | None = None
    up: Share = 0.5

    @model_validator(mode="after")
    def _check(self) -> ViewSpec:
        if (self.width_px is None) != (self.height_px is None):
            raise ValueError("width_px: expected together with height_px, got one of them")
        if self.focal_px is not None and self.width_px is None:
            raise ValueError(f"focal_px: expected together with width_px and height_px, got {self.focal_px:g} alone")
        return self


class VeilSpec(SpecModel):
    """Light that glass, dirt or drops scatter: share / (angle_deg² + t²)^(exponent / 2) at the angle t.

    Attributes:
        share: Share of the light that is scattered within 30 degrees.
        angle_deg: Angle up to which the veil is flat.
        exponent: Fall over the angle beyond; 2 is dirt, 3 clean glass.
    """

    share: Annotated[float, Field(ge=0, le=0.5)]
    angle_deg: Angle = 0.3
    exponent: Annotated[float, Field(ge=1, le=6)] = 2.0


class GhostSpec(SpecModel):
    """A second image of every lamp: at centre + scale (lamp - centre) + shift, as a disc.

    Attributes:
        strength: Share of the lamp's light.
        scale: 1 for the windscreen's double image, negative for images that the lens mirrors through its centre.
        shift_deg: To the right and down.
        radius_deg: Radii across and down.
        softness: Width of the disc's edge, as a share of the radius.
        roughness: Standard deviation of the radius over the directions, as a share of it: smears are no discs.
    """

    strength: Annotated[float, Field(ge=0, le=0.2)]
    scale: Annotated[float, Field(ge=-4, le=4)] = 1.0
    shift_deg: tuple[Direction, Direction] = (0.0, 0.0)
    radius_deg: tuple[Angle, Angle] = (0.05, 0.05)
    softness: Share = 0.3
    roughness: Annotated[float, Field(ge=0, le=0.5)] = 0.0


class StreakSpec(SpecModel):
    """Arms of light around every lamp: a star of the aperture, or streaks across the wiper's direction.

    Attributes:
        share: Share of the light in all arms.
        num_arms: Number of the arms, evenly spread.
        angle_deg: Direction of the first one, anticlockwise from the right.
        length_deg: Length over which they fall to a third.
        width_deg: Their width.
        of_surfaces: Whether bright surfaces, such as reflectors, have them as well as lamps.
    """

    share: Annotated[float, Field(ge=0, le=0.2)]
    num_arms: Annotated[int, Field(ge=1, le=36)] = 6
    angle_deg: Direction = 0.0
    length_deg: Angle = 0.6
    width_deg: Angle = 0.06
    of_surfaces: bool = False


class LensSpec(SpecModel):
    """Lens and windscreen.

    Attributes:
        core_px: Standard deviation of the point spread's core.
        vignetting: Exponent on the natural cos^4 fall-off.
        veils: What scatters light.
        ghosts: Second images.
        streaks: Arms of light.
        variety: Standard deviation, over the drives, of the logarithm of all shares, strengths, radii and lengths: no
            two windscreens are equally dirty.
    """

    core_px: Blur = 0.8
    vignetting: FactorOrNone = 1.0
    veils: Annotated[tuple[VeilSpec, ...], Listed] = ()
    ghosts: Annotated[tuple[GhostSpec, ...], Listed] = ()
    streaks: Annotated[tuple[StreakSpec, ...], Listed] = ()
    variety: Share = 0.0

    @property
    def scattered_share(self) -> float:
        """Share of the light in all veils and streaks."""
        return sum(veil.share for veil in self.veils) + sum(streak.share for streak in self.streaks)

    @model_validator(mode="after")
    def _check(self) -> LensSpec:
        if self.scattered_share > MAX_SCATTERED:
            raise ValueError(
                f"veils: expected shares of veils and streaks of up to {MAX_SCATTERED} together, got "
                f"{self.scattered_share:g}"
            )
        return self


class CarSpec(SpecModel):
    """Our own car in the image, which stands still there.

    Attributes:
        bonnet_share: Share of the image's height that the bonnet hides at the middle of its lower edge.
        bonnet_cd_m2: Luminance of the bonnet.
        num_reflections: Patches of the dashboard's light in the windscreen.
        reflection_cd_m2: Luminance of the brightest patch.
    """

    bonnet_share: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    bonnet_cd_m2: Luminance = 0.002
    num_reflections: Annotated[int, Field(ge=0, le=20)] = 0
    reflection_cd_m2: Luminance = 0.05


SCENE_FIELDS = ("sensitivity", "late_gain", "grain_px", "row_noise")
"""Fields of an imager that change a scene's own sensor."""


class ImagerSpec(SpecModel):
    """The imager: light to numbers.

    Attributes:
        model: `scene` is the scene's own sensor, PVDN's, with `SCENE_FIELDS`; `electrons` has the fields after these.
        sensitivity: Of the scene's own sensor, times what the scene draws.
        late_gain: Amplification of what the response of the scene's own sensor gives, black included: the part of its
            gain that comes after the response. Light and noise in the linear part are as without it.
        grain_px: Grain of the noise of the scene's own sensor, as `SensorSpec` has it.
        row_noise: Factor on the noise of its rows.
        colour: `bayer` weighs red light as colour filters and luma do, and correlates noise; `mono` sees all alike.
        response_e: Electrons of a pixel for 1 cd/m² and one second.
        full_well_e: Electrons at which a pixel is full.
        read_noise_e: Standard deviation without light, electrons.
        fixed_pattern: Standard deviation of single pixels' sensitivity.
        column_pattern_e: Standard deviation of the columns' offsets, electrons.
        bits: Bits of the converter.
        bloom: Share of the light beyond a full pixel that spills into its neighbours.
        bloom_px: Standard deviation of the spilling.
    """

    model: Literal["scene", "electrons"] = "electrons"
    sensitivity: Factor = 1.0
    late_gain: Annotated[float, Field(gt=0, le=10)] = 1.0
    grain_px: Annotated[float, Field(ge=0, le=20)] = 0.0
    row_noise: FactorOrNone = 1.0
    colour: Literal["mono", "bayer"] = "bayer"
    response_e: Factor = 8000.0
    full_well_e: Factor = 9000.0
    read_noise_e: FactorOrNone = 3.0
    fixed_pattern: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    column_pattern_e: FactorOrNone = 0.3
    bits: Annotated[int, Field(ge=6, le=24)] = 10
    bloom: Share = 0.0
    bloom_px: Blur = 2.0


class ExposureSpec(SpecModel):
    """Exposure, fixed or metered.

    Attributes:
        seconds: Time for which the shutter is open.
        gain: Amplification; a metered camera begins with it.
        metering: `fixed`, or the `average` of the image or of its `centre` is held at the target.
        target: Mean linear signal that a metered camera holds, before the compensation, 0..1.
        compensation_ev: Powers of two on the target.
        lag_s: Time constant of a metered camera.
        max_gain: Largest amplification.
        min_gain: Smallest; below 1 the shutter closes earlier.
        readout_s: Time between the first and the last row of a rolling shutter.
    """

    seconds: Annotated[float, Field(gt=0, le=0.5)] = 1 / 30
    gain: Factor = 8.0
    metering: Literal["fixed", "average", "centre"] = "fixed"
    target: Annotated[float, Field(gt=0, lt=1)] = 0.05
    compensation_ev: Annotated[float, Field(ge=-6, le=6)] = 0.0
    lag_s: Annotated[float, Field(gt=0, le=3600)] = 0.5
    max_gain: Factor = 32.0
    min_gain: Factor = 0.1
    readout_s: Annotated[float, Field(ge=0, le=0.1)] = 0.0

    @model_validator(mode="after")
    def _check(self) -> ExposureSpec:
        if self.min_gain > self.max_gain:
            raise ValueError(f"min_gain: expected up to max_gain {self.max_gain:g}, got {self.min_gain:g}")
        return self


class ToneSpec(SpecModel):
    """From the linear signal to grey levels of 8 bits.

    Attributes:
        curve: `gamma`, `filmic` (a shoulder that keeps highlights) or `hdr` (a logarithm).
        gamma: Exponent of the curve's inverse; 1 is linear.
        strength: Height of the shoulder or of the logarithm: ratio of white and the end of the linear part.
        crush: Share of the range that becomes black.
        toe: Share of the range over which it does: with 0 at once, so that faint light and its noise end at an edge.
        black_level: Grey level of black.
        white_level: Grey level of white.
        smooth: Share of the fine detail that spatial denoising removes where it is weaker than `noise_level`.
        denoise: Share of the previous image where nothing moves: temporal denoising.
        noise_level: Grey levels below which a difference counts as noise.
        sharpen: Amount of unsharp masking.
        sharpen_px: Its radius.
    """

    curve: Literal["gamma", "filmic", "hdr"] = "gamma"
    gamma: Annotated[float, Field(gt=0, le=5)] = 2.2
    strength: Annotated[float, Field(ge=1, le=1e5)] = 4.0
    crush: Annotated[float, Field(ge=0, lt=1)] = 0.0
    toe: Share = 0.0
    black_level: Annotated[float, Field(ge=0, lt=128)] = 0.0
    white_level: Annotated[float, Field(gt=128, le=255)] = 255.0
    smooth: Share = 0.0
    denoise: Annotated[float, Field(ge=0, lt=1)] = 0.0
    noise_level: Factor = 6.0
    sharpen: Annotated[float, Field(ge=0, le=5)] = 0.0
    sharpen_px: Blur = 1.0


def _available(codec: str) -> str:
    import av

    library = {"h264": "libx264", "h265": "libx265"}[codec]
    try:
        av.codec.Codec(library, "w")
    except (ValueError, LookupError) as error:
        raise ValueError(f"expected an encoder that PyAV has, {library} is not there") from error
    return codec


class EncoderSpec(SpecModel):
    """Compression by a real encoder, with frames predicted from others.

    Attributes:
        codec: The format.
        kbps: Bit rate.
        rate_hz: Frames a second of the camera: an image has kbps / rate_hz bits. In a drive of a lower rate, where less
            can be predicted, it has up to four times as many.
        key_every: Frames from one that is not predicted to the next.
    """

    codec: Annotated[Literal["h264", "h265"], AfterValidator(_available)] = "h264"
    kbps: Annotated[float, Field(ge=1, le=200_000)] = 4000.0
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 30.0
    key_every: Annotated[int, Field(ge=1, le=1000)] = 30


UNUSED: dict[str, dict[str, tuple[str, ...]]] = {
    "electrons": {"imager": SCENE_FIELDS},
    "scene": {
        "lens": ("core_px", "vignetting"),
        "imager": tuple(name for name in ImagerSpec.model_fields if name not in ("model", *SCENE_FIELDS)),
        "exposure": tuple(ExposureSpec.model_fields),
        "tone": tuple(ToneSpec.model_fields),
    },
}
"""By the imager's model, the fields of each section that have no effect; an encoder has none with `scene` either."""


class CameraProfile(SpecModel):
    """A camera behind a windscreen.

    Attributes:
        name: The file's name; the folder of its data set.
        about: What it is meant for.
        cycle: PVDN's cycle under which its images are stored; for a scene's sensor also the exposure.
        view: The part of the rendering that it sees.
        lens: Lens and windscreen.
        car: Our own car in the image.
        imager: Light to numbers.
        exposure: How long, how much amplified.
        tone: Numbers to grey levels.
        encoder: Compression; None for none.
    """

    name: Name
    about: str = ""
    cycle: Literal["day", "night"] = "night"
    view: ViewSpec = ViewSpec()
    lens: LensSpec = LensSpec()
    car: CarSpec = CarSpec()
    imager: ImagerSpec = ImagerSpec()
    exposure: ExposureSpec = ExposureSpec()
    tone: ToneSpec = ToneSpec()
    encoder: EncoderSpec | None = None

    @model_validator(mode="after")
    def _check(self) -> CameraProfile:
        model = self.imager.model
        for part, names in UNUSED[model].items():
            given = getattr(self, part)
            for name in names:
                if getattr(given, name) != type(given).model_fields[name].default:
                    raise ValueError(f"{part}.{name}: expected none with imager.model {model}, which does not use it")
        if model == "scene" and self.encoder is not None:
            raise ValueError("encoder: expected none with imager.model scene, which does not use it")
        return self

    def scene_sensor(self, sensor: SensorSpec) -> SensorSpec:
        """A scene's own `sensor` in the exposure of this profile."""
        late_gain = self.imager.late_gain
        changed: dict[str, object] = {
            "exposure": self.cycle,
            "grey_per_cd_m2": sensor.grey_per_cd_m2 * self.imager.sensitivity,
            "black_level": sensor.black_level * late_gain,
            "knee": sensor.knee * late_gain,
            "log_slope": sensor.log_slope * late_gain,
            "grain_px": self.imager.grain_px,
            "row_noise": sensor.row_noise * self.imager.row_noise,
        }
        return sensor.model_copy(update=changed)


PROFILES = tuple(
    sorted(file.name.removesuffix(".toml") for file in (files(__package__) / "profiles").iterdir() if file.is_file())
)
"""Names of the profiles that ship."""


def read_profile(name_or_path: str) -> CameraProfile:
    """The profile that ships under a name, or the one in a TOML file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the name is unknown, the file is not TOML, or a field is unknown or out of range; the message
            names file, field and expectation.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        if name_or_path not in PROFILES:
            known = ", ".join(PROFILES)
            raise ValueError(f"--camera: expected one of {known}, or a TOML file, got {name_or_path!r}")
        path = Path(str(files(__package__) / "profiles" / f"{name_or_path}.toml"))
    fields = {"name": path.stem, **read_toml(path)}
    return validated(CameraProfile, fields, str(path))


def read_profiles(listed: str) -> tuple[CameraProfile, ...]:
    """The profiles whose names or paths are `listed` with commas between them.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a profile is broken or two have the same name.
    """
    profiles = tuple(read_profile(part.strip()) for part in listed.split(","))
    names = [profile.name for profile in profiles]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"--camera: expected different names, {twice!r} comes twice")
    return profiles


def profile_to_toml(profile: CameraProfile) -> str:
    """`profile` as TOML text with all fields that have an effect, which `read_profile` reads back equal; None is left
    out.
    """
    fields: dict[str, Any] = profile.model_dump(mode="json", exclude_none=True)
    for part, names in UNUSED[profile.imager.model].items():
        fields[part] = {name: value for name, value in fields[part].items() if name not in names}
    return tomli_w.dumps({name: value for name, value in fields.items() if value != {}})
