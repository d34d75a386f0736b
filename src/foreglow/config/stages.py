"""The configuration of each stage, as a frozen model.

Sizes in pixels are those of the paper's camera and scale with the image's width, as `ProposalConfig` describes.
"""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from foreglow.config.fields import ONE_OF, FrozenModel

Dispatch: TypeAlias = Literal["auto", "baseline", "avx2", "avx512"]
"""Instruction set of the native core: `auto` takes the best one that the processor has."""


Corner: TypeAlias = Annotated[int, Field(strict=True, le=2**31 - 1)]
"""A row or column of a frame, pixels."""


WorkingSide = Annotated[int, Field(ge=64, le=4096)]


class ProposalConfig(FrozenModel):
    """Parameters of the proposal stage; the defaults are the paper's optimum with the published code's unstated steps.

    All sizes are pixels of the *working image*, for a frame of `reference_width_px` columns. A frame of W columns
    is reduced by the whole factor f = max(1, round(reduction * W / reference_width_px)); what then remains of the
    difference in width, r = (W // f) / (reference_width_px / reduction), scales the lengths by r and the areas by
    r squared, so that a preset means the same angles in any resolution of the same camera. Set
    `reference_width_px` to the width of your own frames to have sizes in plain pixels.

    Attributes:
        kappa: Weight of the contrast term in the threshold, no unit (paper: kappa).
        window_px: Side of the square of the local mean; only `window_px // 2` is used (paper: w).
        eps: Keeps the contrast term finite, no unit (published code only).
        min_deviation: Boxes at or below this mean absolute deviation are dropped, in units of the frame's dynamic
            range (paper: s).
        gap_px: Pixels at most this far apart, in the L-infinity sense, join into one blob (paper: d).
        min_area_px: Smallest area of a box (published code only).
        max_area_px: Largest area of a box; infinity for no limit (published code only).
        min_width_px: Smallest width of a box (published code only).
        split_saddle: A blob is split between two peaks of light where the saddle between them is at most this share of
            the lower one, above the frame's black; 0 never splits (published). `proposals.splitting` has the rule.
        reduction: How many frame pixels make one working pixel along each axis at the reference width.
        reference_width_px: Width of the frame that all sizes are relative to.
        working_size_px: Width and height that every frame is resized to, bilinearly and whatever its shape, in place of
            the reduction by a whole factor; all sizes are then pixels of that image. None to reduce.
        normalise: Stretch every frame to [0, 1] by its own minimum and maximum (published code only).
        blur_width_px: Columns of the Gaussian kernel, 1, 3 or 5; 1 switches off. Does not scale.
        blur_height_px: Rows of the Gaussian kernel, 1 or 3; 1 switches off. Does not scale.
        blur_sigma_px: Standard deviation of the Gaussian, both axes.
        window: `published` reads columns x-h+1..x+h and rows y-h+1..y+h without row 0 and column 0, h = window_px//2,
            as the published code does; `centred` reads x-h..x+h, y-h..y+h.
        region_xyxy_px: The part of the frame in which boxes are proposed, half-open, pixels of the actual frame; None
            for all of it. A region larger than the frame is cut; one outside the frame is an error.

    Source: Ewecker et al., arXiv 2107.11302, eq. for T and the parameter table; published code for the rest.
    """

    kappa: Annotated[float, Field(ge=0, le=10)] = 0.4
    window_px: Annotated[int, Field(ge=2, le=512)] = 19
    eps: Annotated[float, Field(gt=0, le=1)] = 1e-3
    min_deviation: Annotated[float, Field(ge=0, le=1)] = 0.01
    gap_px: Annotated[int, Field(ge=1, le=64)] = 4
    min_area_px: Annotated[float, Field(ge=0, le=1e9)] = 11.0
    max_area_px: Annotated[float, Field(gt=0, allow_inf_nan=True)] = 1999.0
    min_width_px: Annotated[float, Field(ge=0, le=16384)] = 6.0
    split_saddle: Annotated[float, Field(ge=0, le=1)] = 0.0
    reduction: Annotated[int, Field(ge=1, le=16)] = 2
    reference_width_px: Annotated[int, Field(ge=64, le=16384)] = 1280
    working_size_px: Annotated[tuple[WorkingSide, WorkingSide], Field(strict=False)] | None = None
    normalise: bool = True
    blur_width_px: Annotated[Literal[1, 3, 5], ONE_OF] = 5
    blur_height_px: Annotated[Literal[1, 3], ONE_OF] = 3
    blur_sigma_px: Annotated[float, Field(gt=0, le=100)] = 2.0
    window: Literal["published", "centred"] = "published"
    region_xyxy_px: Annotated[tuple[Corner, Corner, Corner, Corner], Field(strict=False)] | None = None
    backend: Literal["native", "reference"] = "native"
    dispatch: Dispatch = "auto"

    @model_validator(mode="after")
    def _check(self) -> ProposalConfig:
        if self.region_xyxy_px is not None:
            x1, y1, x2, y2 = self.region_xyxy_px
            if not (0 <= x1 < x2 and 0 <= y1 < y2):
                raise ValueError(f"region_xyxy_px: expected 0 <= x1 < x2 and 0 <= y1 < y2, got {self.region_xyxy_px}")
            if self.working_size_px is not None:
                raise ValueError("region_xyxy_px: expected none with working_size_px, which takes the whole frame")
        if self.min_area_px > self.max_area_px:
            raise ValueError(
                f"min_area_px: expected at most max_area_px, {self.max_area_px:g}, got {self.min_area_px:g}"
            )
        return self

    def check_region(self, height_px: int, width_px: int) -> None:
        """Checks that `region_xyxy_px` is a part of a frame of this size.

        Raises:
            ValueError: If it lies outside: an empty region must be a mistake.
        """
        if self.region_xyxy_px is None:
            return
        x1, y1, _, _ = self.region_xyxy_px
        if x1 >= width_px or y1 >= height_px:
            raise ValueError(
                f"proposals.region_xyxy_px: expected a part of the frame, "
                f"{list(self.region_xyxy_px)} lies outside its {width_px}x{height_px} px"
            )


class StandingConfig(FrozenModel):
    """What stands still in the image while we drive, such as reflections of our own car, and is left out.

    Attributes:
        enabled: Whether it is.
        learn_s: A region is learnt when it has stood still for so long, driving all the time.
        forget_s: It is forgotten when it has not been the same for so long.
        min_speed_mps: Nothing is learnt below this speed, where the speed is known.
        max_shift_px: It stands still while it moves by at most this in either axis, pixels of the actual frame.
        max_change: It looks the same while at most this share of its variance is new, up to its contrast.
        max_area: Learnt regions cover at most this share of the image, together.
    """

    enabled: bool = False
    learn_s: Annotated[float, Field(gt=0, le=3600)] = 20.0
    forget_s: Annotated[float, Field(gt=0, le=10)] = 2.0
    min_speed_mps: Annotated[float, Field(gt=0, le=100)] = 5.0
    max_shift_px: Annotated[float, Field(gt=0, le=1)] = 0.25
    max_change: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    max_area: Annotated[float, Field(gt=0, le=0.1)] = 0.02


class ClassifierConfig(FrozenModel):
    """Parameters of the classification stage.

    Attributes:
        model: Path of the ONNX model, relative to the working directory (also in a file), or the name of one that
            ships, `foreglow`; None leaves the proposals unclassified.
        support: The crop reaches this many times the box's width and height to either side of its centre; None for
            the value in the model's metadata, or the paper's M = 2 if there is none. A training takes its recipe's.
        score_threshold: A proposal is accepted if its score is above this.
        num_threads: Threads used for inference.
        device: `cpu`, or `cuda` for a GPU where ONNX Runtime has it.
        colour: Whether light is told to be of a front or a rear lamp by its colour, too, where the camera has one.
    """

    model: Annotated[Path, Field(strict=False)] | None = None
    support: Annotated[int | None, Field(ge=1, le=16)] = None
    score_threshold: Annotated[float, Field(ge=0, le=1)] = 0.5
    num_threads: Annotated[int, Field(ge=1, le=256)] = 1
    device: Literal["cpu", "cuda"] = "cpu"
    colour: bool = True


class DistanceConfig(FrozenModel):
    """Parameters of the distance stage; `foreglow.distance` describes the estimators.

    Attributes:
        estimator: `gp` (ground plane), `psd_3d`, `psd_3d_plus`, `psd_2d` (predictive street data), `road_surface`,
            `none` for no ranges, or an estimator of your own, `module:Name`. Those that need a road give no range where
            the frame has none.
        heuristic: How the ranges of a box's pixels become the range of the box (paper); `road_surface` has its own
            rule.
        all_pixels: Whether `maximum`, `minimum`, `mean` and `median` go by every pixel of the box, as the paper's,
            instead of 3 x 3 of them.
        pitch: The body's pitch against the road: `fixed` takes the calibration's, `motion` adds that of
            `Frame.motion` where it is known (simulated drives, ROS 2 and recordings of them; CAN logs do not tell it),
            `markings` estimates it from the markings in the image.
        align: Whether `road_surface` corrects our pose on the road: yaw and lateral offset from the markings in the
            image, the position along the road from our yaw rate. Otherwise it trusts the map, and assumes that we
            keep the lane.
        model: TOML file with the model of `road_surface`, as `fit-ranges` writes it; None for the one that ships.
    """

    estimator: str = "gp"
    heuristic: Literal["centre", "maximum", "minimum", "lowest", "mean", "median"] = "centre"
    all_pixels: bool = False
    pitch: Literal["fixed", "motion", "markings"] = "fixed"
    align: bool = False
    model: Annotated[Path, Field(strict=False)] | None = None


class TrackerConfig(FrozenModel):
    """Parameters of the tracking stage; the defaults are the paper's. `docs/tracking.md` has the equations.

    The parameters marked with (p) are those of the published tracker, too.

    Attributes:
        method: `alpha_beta` (paper, and ours with other parameters), `published` (behaves like the published code),
            `none` for no tracks, or a tracker of your own, `module:Name`.
        clock: `frames` assumes 1 / `rate_hz` between frames (paper); `time` uses the timestamps.
        rate_hz: The frame rate that all numbers of frames here refer to.
        min_score: A detection is used if its score is above this (p).
        alpha_centre: Gain of the box's centre, in each frame (p).
        alpha_size: Gain of the box's width and height (p).
        alpha_range: Gain of the range (p).
        alpha_confidence: Weight of the newest score in the moving mean (p).
        range_filter: `alpha_beta` (paper), or `mean` or `median` of the last `num_ranges` ranges.
        num_ranges: Known ranges that `mean` and `median` use (paper: series of five frames).
        use_looming: Whether the growth of boxes also contributes to the range, if our speed is known; off in all
            presets, since glare does not grow like lamps.
        association: `greatest_iou` (paper: each detection takes its best track), or `optimal` (greatest total).
        enlargement: Boxes of detections are enlarged by this factor before they are compared with tracks (p).
        enlarge_tracks: Whether boxes of tracks are enlarged as well; not in the paper.
        min_iou: A detection may take a track if the IoU of these boxes is above this (p).
        range_gate: And if their ranges are at most this many standard deviations apart; infinity for no gate.
        merge_iou: A track without a detection ends if its IoU with another track is above this; 1 for never.
        compensate_yaw: Whether predicted boxes are shifted by our yaw rate, if camera and motion are known.
        max_misses: A track survives so many frames in a row without a detection (p); with `time`, as long as these
            frames would take.
        max_gap_s: After a longer gap between two frames all tracks are forgotten.
        confirmation: `frames` (paper), `m_of_n` or `evidence`.
        min_hits: Detections that make a track plausible (p): in total (`frames`), or of the last frames (`m_of_n`).
        min_confidence: And its confidence must be above this (p; used with `min_hits`).
        num_looks: The number of last frames for `m_of_n`.
        neutral_score: The score that is evidence neither for nor against light (`evidence`).
        detection_probability: Probability that light is detected in a frame while its track exists (`evidence`).
        confirm_evidence: Log-likelihood ratio above which a track becomes plausible (`evidence`).
        reject_evidence: Log-likelihood ratio down to which it stays plausible (`evidence`).
        company_evidence: Additional ratio that a second track needs beside a plausible one (`evidence`).
        company_s: Another track that was plausible so recently counts as a plausible one there (`evidence`).
        range_evidence: Weight of the range as evidence for a vehicle beside the score, where it is known; 0 for none
            (`evidence`).
        restless_evidence: Weight of how restless a light is as evidence for a vehicle beside the score, if it is no
            lamp in sight; 0 for none (`evidence`).
        vehicle_gate: Tracks whose boxes are at most so far apart, in units of their size, belong to one vehicle, and
            vehicles are confirmed instead of tracks; 0 for tracks alone.

    Source: Ewecker et al., arXiv 2107.11302, section on tracking; gains from the published code.
    """

    method: str = "alpha_beta"
    clock: Literal["frames", "time"] = "frames"
    rate_hz: Annotated[float, Field(ge=0.1, le=1000)] = 18.0
    min_score: Annotated[float, Field(ge=0, lt=1)] = 0.1
    alpha_centre: Annotated[float, Field(gt=0, le=1)] = 0.5
    alpha_size: Annotated[float, Field(gt=0, le=1)] = 0.3
    alpha_range: Annotated[float, Field(gt=0, le=1)] = 0.8
    alpha_confidence: Annotated[float, Field(gt=0, le=1)] = 0.33
    range_filter: Literal["alpha_beta", "mean", "median"] = "alpha_beta"
    num_ranges: Annotated[int, Field(ge=1, le=1000)] = 5
    use_looming: bool = False
    association: Literal["greatest_iou", "optimal"] = "greatest_iou"
    enlargement: Annotated[float, Field(ge=1, le=10)] = 1.5
    enlarge_tracks: bool = False
    min_iou: Annotated[float, Field(ge=0, lt=1)] = 0.1
    range_gate: Annotated[float, Field(gt=0, allow_inf_nan=True)] = inf
    merge_iou: Annotated[float, Field(gt=0, le=1)] = 1.0
    compensate_yaw: bool = False
    max_misses: Annotated[int, Field(ge=0, le=1000)] = 3
    max_gap_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    confirmation: Literal["frames", "m_of_n", "evidence"] = "frames"
    min_hits: Annotated[int, Field(ge=1, le=1000)] = 5
    min_confidence: Annotated[float, Field(ge=0, lt=1)] = 0.5
    num_looks: Annotated[int, Field(ge=1, le=64)] = 7
    neutral_score: Annotated[float, Field(gt=0, lt=1)] = 0.38
    detection_probability: Annotated[float, Field(gt=0, lt=1)] = 0.3
    confirm_evidence: Annotated[float, Field(ge=0, le=20)] = 1.5
    reject_evidence: Annotated[float, Field(ge=0, le=20)] = 0.0
    company_evidence: Annotated[float, Field(ge=0, le=20)] = 5.0
    company_s: Annotated[float, Field(ge=0, le=60)] = 2.0
    range_evidence: Annotated[float, Field(ge=0, le=10)] = 0.0
    restless_evidence: Annotated[float, Field(ge=0, le=10)] = 0.0
    vehicle_gate: Annotated[float, Field(ge=0, le=100)] = 0.0

    @model_validator(mode="after")
    def _check(self) -> TrackerConfig:
        if self.confirmation == "m_of_n" and self.min_hits > self.num_looks:
            raise ValueError(f"min_hits: expected at most num_looks, {self.num_looks}, got {self.min_hits}")
        if self.reject_evidence > self.confirm_evidence:
            raise ValueError(
                f"reject_evidence: expected at most confirm_evidence, {self.confirm_evidence:g}, "
                f"got {self.reject_evidence:g}"
            )
        return self


PUBLISHED_TRACKER = TrackerConfig(method="published")
"""The published code's tracker; the paper's is `TrackerConfig()`."""

OUR_TRACKER = TrackerConfig(
    clock="time",
    association="optimal",
    enlargement=2.0,
    enlarge_tracks=True,
    merge_iou=0.5,
    compensate_yaw=True,
    max_misses=6,
    confirmation="evidence",
    neutral_score=0.8,
    confirm_evidence=1.0,
    range_evidence=2.0,
    restless_evidence=1.5,
    vehicle_gate=1.0,
)
"""Chosen on validation drives, as decisions 8, 18 and 24 describe."""


class LiveConfig(FrozenModel):
    """Parameters of the live loop; `docs/live.md` describes the faults and what follows from them.

    A frame period is one over the source's rate. With the defaults there is low beam at most two frame periods after a
    frame was missing or late, or after the second wrong frame in a row.

    Attributes:
        rate_hz: The expected frame rate of a source that does not know its own.
        silent_frames: After so many frame periods without a frame the camera is gone.
        slow_frames: The camera is slow when two frames in a row each come later than so many frame periods.
        num_steady: It no longer is after so many punctual frames in a row.
        max_step_s: A stage that takes longer for a frame hangs.
        abandon_s: After this further time the pipeline that hangs is abandoned, and a new one is made; a ROS 2 node in
            which a stage hangs ends, to be started again.
        max_failures: After errors in so many frames in a row a new pipeline is made.
        rebuild_s: A new pipeline that takes longer to make than this hangs as a stage does: another one is made. If
            none can be made for so long, as that ends with an error each time, the program ends.
        retry_s: Pause between attempts to open a lost source, or to make a pipeline.
    """

    rate_hz: Annotated[float, Field(ge=0.1, le=1000)] = 18.0
    silent_frames: Annotated[float, Field(gt=1, le=100)] = 2.5
    slow_frames: Annotated[float, Field(gt=1, le=100)] = 1.6
    num_steady: Annotated[int, Field(ge=1, le=1000)] = 5
    max_step_s: Annotated[float, Field(gt=0, le=10)] = 0.08
    abandon_s: Annotated[float, Field(gt=0, le=100)] = 1.0
    max_failures: Annotated[int, Field(ge=1, le=1000)] = 3
    rebuild_s: Annotated[float, Field(gt=0, le=1000)] = 30.0
    retry_s: Annotated[float, Field(gt=0, le=100)] = 1.0
