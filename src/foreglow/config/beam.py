"""The configuration of the beam: its policy, lit streets, and the guard."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import Field, model_validator

from foreglow.config.fields import FrozenModel
from foreglow.types.frame import MAX_SPEED_MPS

Speed: TypeAlias = Annotated[float, Field(ge=0, le=MAX_SPEED_MPS)]
RangeLimit: TypeAlias = Annotated[
    tuple[Annotated[float, Field(ge=0, le=10_000)], Annotated[float, Field(gt=0, le=1e9)]], Field(strict=False)
]
"""The range from which a limit holds, metres, and the limit."""


class BeamConfig(FrozenModel):
    """Parameters of the beam stage; `docs/beam.md` describes the policies.

    Of our policies, only `foreglow` uses `latency_s`, `coverage`, `min_confidence`, `min_hidden_confidence` and `ask`.

    Attributes:
        policy: `none` for no commands, `low` or `high` for that beam alone, `paper` (the brightest track alone),
            `foreglow` (all tracks, and the place where a hidden vehicle will appear), or a policy of your own,
            `module:Name`.
        headlamps: TOML file that describes the lamps, see `foreglow.photometry`; None for those that ship.
        latency_s: Time from a frame's exposure to the light that follows from it; gaps are placed where vehicles will
            be after it.
        margin_deg: Margin of a gap to either side, also for lamps that are aimed badly.
        led_limit_lx: Largest illuminance by a single LED at the eyes that a gap protects.
        coverage: The gap for a hidden vehicle covers this share of the probability of where it will appear.
        min_direct: A track is taken for a lamp in sight, front or rear, if its probability of that is above this.
        min_confidence: A gap for a lamp opens when its track, or the vehicle that it leads, has this confidence.
        min_hidden_confidence: The same for a hidden vehicle, by the track of its light.
        hold_s: A gap stays so long after its track was last seen, and an LED stays dark so long after its gap has gone.
        restore_s: Time in which an LED brightens from off to full, also after low beam; the guard's `brightening_s` if
            that is longer.
        ask: Whether a shallow, short dip asks of light without a lamp in sight if it is our own, before a gap opens.
        response: Of the camera, for `ask`: black level, levels above it in which grey is proportional to light, and
            levels for e times the light from there on, in 255ths of white. By default that of PVDN's camera.
    """

    policy: str = "none"
    headlamps: Annotated[Path, Field(strict=False)] | None = None
    latency_s: Annotated[float, Field(ge=0, le=2)] = 0.15
    margin_deg: Annotated[float, Field(ge=0, le=10)] = 0.3
    led_limit_lx: Annotated[float, Field(gt=0, le=100)] = 0.03
    coverage: Annotated[float, Field(ge=0, lt=1)] = 0.8
    min_direct: Annotated[float, Field(ge=0, le=1)] = 0.5
    min_confidence: Annotated[float, Field(ge=0, le=1)] = 0.4
    min_hidden_confidence: Annotated[float, Field(ge=0, le=1)] = 0.5
    hold_s: Annotated[float, Field(ge=0, le=10)] = 0.3
    restore_s: Annotated[float, Field(gt=0, le=10)] = 0.5
    ask: bool = False
    response: Annotated[
        tuple[Annotated[float, Field(ge=0, lt=255)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]],
        Field(strict=False),
    ] = (7.6, 38.0, 14.0)


class LitStreetConfig(FrozenModel):
    """Parameters of what finds lit streets, where the high beam stays off; `docs/beam.md` describes it.

    Attributes:
        enabled: Whether there is low beam on lit roads; `beam.policy` decides everywhere else.
        min_elevation_deg: Lowest elevation above the horizontal at which a bright spot may be a lamp on a post.
        max_elevation_deg: Highest elevation.
        min_brightness: Such a spot has at least this share of the greatest value of the image's format.
        max_size_deg: And is at most so wide and high.
        on_s: For so long two lamps or more must be in view before the road counts as lit; eight times as long for one.
        off_s: For so long none must be in view before the road counts as dark again.
    """

    enabled: bool = True
    min_elevation_deg: Annotated[float, Field(ge=0, le=90)] = 4.0
    max_elevation_deg: Annotated[float, Field(ge=0, le=90)] = 20.0
    min_brightness: Annotated[float, Field(gt=0, le=1)] = 0.35
    max_size_deg: Annotated[float, Field(gt=0, le=90)] = 4.0
    on_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    off_s: Annotated[float, Field(gt=0, le=60)] = 3.0

    @model_validator(mode="after")
    def _check(self) -> LitStreetConfig:
        if self.min_elevation_deg > self.max_elevation_deg:
            raise ValueError(
                f"min_elevation_deg: expected at most max_elevation_deg, {self.max_elevation_deg:g}, "
                f"got {self.min_elevation_deg:g}"
            )
        return self


class GuardConfig(FrozenModel):
    """Parameters of the guard, which checks every beam command; `docs/guard.md` describes what it enforces.

    Attributes:
        max_age_s: Largest age of an image when its command is checked.
        max_gap_s: Longest time between two frames; after a longer one there is low beam, and light returns slowly.
        brightening_s: Shortest time in which an LED brightens from dark to full, at least 0.1 s, as light that comes
            back at once would dazzle whoever was missed for a frame; dimming is immediate.
        low_below_mps: Low beam below this speed: 32 km/h, from public notes on 49 CFR 571.108.
        high_above_mps: High beam is allowed again above this speed.
        needs_speed: Whether an unknown speed is a fault; otherwise it counts as high enough.
        max_same_images: Largest number of images in a row with the same content; one more is a frozen camera.
        max_saturated: Largest share of pixels at `white_level`.
        min_bright: An image is black if no pixel is brighter than this share of `white_level`.
        white_level: Largest pixel value, for all stages of the pipeline; None for that of the image's type, 255 or
            65,535.
        led_limits_cd: Ranges from which limits hold (m, the first 0), and the limits: the largest intensity of one
            lamp's LEDs towards a vehicle (cd). From 50 m on these are what UN R123 allows a lamp towards oncoming
            drivers at 50, 100 and 200 m, less the 350 cd that UN R112 allows its low beam. Nearer, it is what 3.1 lx
            at 15 m (49 CFR 571.108) leaves of two lamps with 200 cd of stray light each. All are from public notes,
            not from the official texts.
        range_sigmas: A vehicle may be nearer or farther than its range by so many standard deviations.
        min_range_m: The nearest that a vehicle of unknown range may be.
        eyes_above_m: Drivers' eyes are up to so far above the lamps (R123's test points).
    """

    max_age_s: Annotated[float, Field(gt=0, le=10)] = 0.3
    max_gap_s: Annotated[float, Field(gt=0, le=10)] = 0.2
    brightening_s: Annotated[float, Field(ge=0.1, le=60)] = 0.5
    low_below_mps: Speed = 32.0 / 3.6
    high_above_mps: Speed = 35.0 / 3.6
    needs_speed: bool = True
    max_same_images: Annotated[int, Field(ge=1, le=1000)] = 2
    max_saturated: Annotated[float, Field(gt=0, le=1)] = 0.25
    min_bright: Annotated[float, Field(ge=0, lt=1)] = 0.05
    white_level: Annotated[int | None, Field(ge=1, le=65535)] = None
    led_limits_cd: Annotated[tuple[RangeLimit, ...], Field(strict=False, min_length=1)] = (
        (0.0, 150.0),
        (50.0, 275.0),
        (100.0, 1400.0),
        (200.0, 5100.0),
    )
    range_sigmas: Annotated[float, Field(gt=0, le=10)] = 0.5
    min_range_m: Annotated[float, Field(ge=5, le=100)] = 15.0
    eyes_above_m: Annotated[float, Field(ge=0, le=5)] = 0.5

    @model_validator(mode="after")
    def _check(self) -> GuardConfig:
        if self.low_below_mps > self.high_above_mps:
            raise ValueError(
                f"low_below_mps: expected at most high_above_mps, {self.high_above_mps:g}, got {self.low_below_mps:g}"
            )
        ranges_m, limits_cd = zip(*self.led_limits_cd, strict=True)
        is_growing = all(before < after for before, after in pairwise(ranges_m))
        if ranges_m[0] != 0 or not is_growing or list(limits_cd) != sorted(limits_cd):
            raise ValueError(
                "led_limits_cd: expected ranges that grow from 0 on, and limits that do not fall, got "
                f"{self.led_limits_cd}"
            )
        return self
