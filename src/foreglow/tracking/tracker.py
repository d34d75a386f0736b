"""The life of a track: predict, associate, correct, confirm, end."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from foreglow.config import TrackerConfig
from foreglow.geometry import Camera, Floats
from foreglow.tracking.alpha_beta import correct, frames_in, gain_in, moving_mean, predict, steady_betas
from foreglow.tracking.association import (
    ASSOCIATIONS,
    UNASSIGNED,
    Assignment,
    corners,
    is_duplicate,
    is_range_apart,
    overlaps,
)
from foreglow.tracking.confirmation import CONFIRMATIONS, Company, Observations, scores_with_ranges
from foreglow.tracking.interface import Tracker
from foreglow.tracking.looming import fused, looming_ranges, rate_noise
from foreglow.tracking.measurements import Measurements, measurements
from foreglow.tracking.restlessness import restlessness, scores_of_restless
from foreglow.tracking.states import RANGE, SIZES, TrackStates, unmeasured
from foreglow.tracking.track_range import (
    RANGE_RATE_SIGMA_MPS,
    filtered_sigmas,
    mean_of,
    median_of,
    remembered,
)
from foreglow.tracking.vehicles import VehicleGroups
from foreglow.types import MIN_STEP_S, Detections, Frame, Ranges, Tracks, TrackState, Vehicles
from foreglow.types.arrays import check_kind, check_optional
from foreglow.types.kinds import direct_of_kinds

MIN_SIZE_PX = 1.0
"""Predicted boxes never become smaller than this."""

MAX_TRACKS = 512
"""More are not followed: those with the fewest detections end, tentative ones first."""


class AlphaBetaTracker(Tracker):
    """The paper's tracker, with the further options that `TrackerConfig` names.

    With the clock `time`, a frame with the time and the boxes of the previous frame counts as a repetition, and the
    same tracks are returned. Any other frame that is not later than the previous one ends all tracks, and so does a
    gap longer than `max_gap_s`; ids are not reused. With either clock, an image of another size ends all tracks.

    Source: Ewecker et al., arXiv 2107.11302, section on tracking.
    """

    def __init__(self, config: TrackerConfig) -> None:
        check_kind("config", config, TrackerConfig)
        self._config = config
        self._alphas = np.repeat([config.alpha_centre, config.alpha_size, config.alpha_range], [2, 2, 1])
        self._assign = ASSOCIATIONS[config.association]
        self._rule = CONFIRMATIONS[config.confirmation](config)
        self._vehicles = VehicleGroups(config) if config.vehicle_gate else None
        self._num_ranges = 0 if config.range_filter == "alpha_beta" else config.num_ranges
        # Half a frame of tolerance, since frames come somewhat early or late.
        self._max_missing_s = (config.max_misses + 0.5) / config.rate_hz
        self._max_miss_s = max(config.max_misses, 1) / config.rate_hz
        self.reset()

    def reset(self) -> None:
        """Forgets all tracks, as at the start of a sequence; ids begin again."""
        self._now_s, self._num_frames = 0.0, 1.0
        self._company = Company()
        self._timestamp_ns: int | None = None
        self._size_px: tuple[int, int] | None = None
        self._boxes: NDArray[np.int32] = np.zeros((0, 4), np.int32)
        self._next_id = 0
        self._states = self._born(0)
        if self._vehicles is not None:
            self._vehicles.reset()
        self._tracks = self._as_tracks(self._states, corners(self._states.values), None)

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
        """The tracks after `frame`; of the frame only its time, size, camera and motion are used."""
        check_kind("frame", frame, Frame)
        check_kind("detections", detections, Detections)
        check_optional("ranges", ranges, Ranges)
        if self._is_again(frame, detections):
            return self._tracks
        step_s = self._step_s(frame)
        size_px = frame.width_px, frame.height_px
        if not 0.0 < step_s <= self._config.max_gap_s or size_px != (self._size_px or size_px):
            self._states, self._company = self._born(0), Company()
            if self._vehicles is not None:
                self._vehicles.forget()
            step_s = 1.0 / self._config.rate_hz
        step_s = max(step_s, MIN_STEP_S)  # rates divide by it
        self._now_s += step_s
        self._num_frames = frames_in(step_s, self._config.rate_hz)
        self._size_px = size_px
        self._timestamp_ns, self._boxes = frame.timestamp_ns, detections.boxes_xyxy_px

        found = measurements(detections, ranges, self._config.min_score)
        self._predict(frame, step_s)
        assigned = self._associated(found)
        is_free = np.ones(len(found), np.bool_)
        is_free[assigned[assigned != UNASSIGNED]] = False
        if is_free.any():
            beginning = np.flatnonzero(is_free)
            self._states = self._states.joined(self._born(len(beginning)))
            assigned = np.concatenate([assigned, beginning])
        taken = self._with_looming(found.taken(assigned), frame)
        if self._config.restless_evidence:
            self._watch(taken, frame)
        self._correct(taken, step_s)
        scores = self._scores(detections, ranges)
        if self._vehicles is None:
            self._confirm(scores)
        self._end(frame)
        states, vehicles = self._states, None
        boxes_xyxy_px = corners(states.values)
        if self._vehicles is not None:
            states.is_plausible, vehicles = self._vehicles.update(
                self._now_s, states, boxes_xyxy_px, self._evidence(scores), self._num_frames
            )
        self._tracks = self._as_tracks(states, boxes_xyxy_px, vehicles)
        return self._tracks

    def _is_again(self, frame: Frame, detections: Detections) -> bool:
        return (
            self._config.clock == "time"
            and frame.timestamp_ns == self._timestamp_ns
            and np.array_equal(detections.boxes_xyxy_px, self._boxes)
        )

    def _step_s(self, frame: Frame) -> float:
        if self._config.clock == "frames" or self._timestamp_ns is None:
            return 1.0 / self._config.rate_hz
        return (frame.timestamp_ns - self._timestamp_ns) / 1e9

    @property
    def _weight(self) -> float:
        """Of the newest value in moving means."""
        return float(gain_in(self._config.alpha_confidence, self._num_frames))

    def _born(self, count: int) -> TrackStates:
        ids = np.arange(self._next_id, self._next_id + count)
        self._next_id += count
        return unmeasured(ids, self._now_s, self._num_ranges, self._rule.memory_size)

    def _predict(self, frame: Frame, step_s: float) -> None:
        values = predict(self._states.values, self._states.rates, step_s)
        camera, motion = frame.camera, frame.motion
        if self._config.compensate_yaw and camera is not None and motion is not None and motion.is_possible:
            values[:, :2] += turn_shift_px(camera, values[:, :2], motion.yaw_rate_radps * step_s)
        values[:, 2:RANGE] = np.maximum(values[:, 2:RANGE], MIN_SIZE_PX)
        self._states.values = values

    def _associated(self, found: Measurements) -> Assignment:
        states, config = self._states, self._config
        if not (len(states) and len(found)):
            return np.full(len(states), UNASSIGNED)
        enlargements = (config.enlargement if config.enlarge_tracks else 1.0, config.enlargement)
        overlap = self._overlaps(found.values, found.sigmas_m, enlargements)
        return self._assign(overlap, config.min_iou)

    def _overlaps(self, values: Floats, sigmas_m: Floats, enlargements: tuple[float, float] = (1.0, 1.0)) -> Floats:
        """Overlap of each track with each box of `values`, both enlarged; 0 where their ranges are too far apart."""
        states, gate = self._states, self._config.range_gate
        overlap = overlaps(corners(states.values, enlargements[0]), corners(values, enlargements[1]))
        if np.isfinite(gate):
            ranges_m = (states.values[:, RANGE], values[:, RANGE])
            overlap[is_range_apart(ranges_m, (states.sigmas_m, sigmas_m), gate)] = 0.0
        return overlap

    def _with_looming(self, taken: Measurements, frame: Frame) -> Measurements:
        """The measurements, their ranges fused with those that follow from the growth of the boxes."""
        if not self._config.use_looming or frame.motion is None:
            return taken
        sizes, rates = self._states.values[:, SIZES], self._states.rates[:, SIZES]
        areas_px = sizes.prod(axis=1)
        rates_px_per_s = 0.5 * np.sqrt(areas_px) * (rates / sizes).sum(axis=1)
        alpha = float(gain_in(self._config.alpha_size, self._num_frames))
        noise = rate_noise(alpha, float(steady_betas(alpha)), self._num_frames / self._config.rate_hz)
        looming = looming_ranges(np.sqrt(areas_px), rates_px_per_s, frame.motion.speed_mps, noise)
        ranges_m, sigmas_m = fused((taken.values[:, RANGE], taken.sigmas_m), looming)
        is_taken = taken.detections != UNASSIGNED
        values = taken.values.copy()
        values[is_taken, RANGE] = ranges_m[is_taken]
        return dataclasses.replace(taken, values=values, sigmas_m=np.where(is_taken, sigmas_m, taken.sigmas_m))

    def _watch(self, taken: Measurements, frame: Frame) -> None:
        """Updates how restless each light is; without a camera, as if the image were 53 degrees wide, as PVDN's is."""
        states, found_px = self._states, taken.values[:, 0]
        focal_px = float(frame.width_px if frame.camera is None else frame.camera.focal_px[0])
        since_s = self._now_s - states.measured_s[:, 0]
        moved_px = found_px - states.found_px
        newest = restlessness(moved_px - states.drifts_pxps * since_s, focal_px, since_s * self._config.rate_hz)
        states.restless = moving_mean(states.restless, newest, self._weight)
        states.drifts_pxps = np.where(np.isnan(moved_px), states.drifts_pxps, moved_px / since_s)
        states.found_px = np.where(np.isnan(found_px), states.found_px, found_px)

    def _correct(self, taken: Measurements, step_s: float) -> None:
        """Corrects each track by its measurement."""
        states = self._states
        is_hit = taken.detections != UNASSIGNED
        since_s = self._now_s - states.measured_s
        alphas = gain_in(self._alphas, self._num_frames)
        gains = (alphas, steady_betas(alphas))
        states.values, states.rates = correct(states.values, states.rates, taken.values, since_s, gains)
        states.measured_s = np.where(np.isnan(taken.values), states.measured_s, self._now_s)
        states.confidences = moving_mean(states.confidences, taken.scores, self._weight)
        states.light_kinds = moving_mean(states.light_kinds, taken.light_kinds, self._weight)
        states.num_hits = states.num_hits + is_hit
        states.num_misses = np.where(is_hit, 0, states.num_misses + 1)
        # A single miss ends no track, however long the gap before it.
        states.missing_s = np.where(is_hit, 0.0, states.missing_s + min(step_s, self._max_miss_s))
        states.detections = taken.detections
        self._correct_sigmas(taken, step_s)

    def _scores(self, detections: Detections, ranges: Ranges | None) -> Floats:
        """The scores of all detections as evidence, and NaN at the end: for the index -1, a track without one."""
        scores = detections.scores.astype(np.float64)
        if ranges is not None and self._config.range_evidence:
            scores = scores_with_ranges(scores, ranges.ranges_m, self._config.range_evidence)
        return np.append(scores, np.nan)

    def _evidence(self, scores: Floats) -> Floats:
        """Of the scores of all detections, that of each track's, shape (M,), as evidence; NaN where it was missed."""
        states, taken = self._states, scores[self._states.detections]
        weight = self._config.restless_evidence
        if not weight:
            return taken
        return scores_of_restless(taken, states.restless, direct_of_kinds(states.light_kinds), weight)

    def _confirm(self, scores: Floats) -> None:
        """Updates which tracks are plausible, each by itself."""
        states = self._states
        observed = Observations(
            scores=self._evidence(scores),
            num_hits=states.num_hits,
            confidences=states.confidences,
            was_plausible=states.is_plausible,
            since_others_s=self._company.since_others_s(states.ids, self._now_s),
            num_frames=self._num_frames,
        )
        states.memory, states.is_plausible = self._rule.update(states.memory, observed)
        self._company.note(states.ids[states.is_plausible], self._now_s)

    def _correct_sigmas(self, taken: Measurements, step_s: float) -> None:
        """Updates the standard deviations of the ranges, and the history where ranges are averaged."""
        states = self._states
        if self._num_ranges:
            states.range_history = remembered(states.range_history, taken.values[:, RANGE])
            states.sigma_history = remembered(states.sigma_history, taken.sigmas_m)
            unmeasured_s = self._now_s - states.measured_s[:, RANGE]
            states.sigmas_m = mean_of(states.sigma_history) + RANGE_RATE_SIGMA_MPS * unmeasured_s  # (2), `track_range`
        else:
            alpha = float(gain_in(self._config.alpha_range, self._num_frames))
            states.sigmas_m = filtered_sigmas(states.sigmas_m, taken.sigmas_m, step_s, alpha)

    def _end(self, frame: Frame) -> None:
        """Ends tracks that were missed for too long, have left the image, or duplicate another track."""
        states = self._states
        x, y = states.values[:, 0], states.values[:, 1]
        is_outside = (x < 0) | (y < 0) | (x >= frame.width_px) | (y >= frame.height_px)
        is_over = (states.missing_s > self._max_missing_s) | (is_outside & (states.num_misses > 0))
        if self._config.merge_iou < 1.0 and states.num_misses.any():  # two that were detected are no duplicates
            overlap = self._overlaps(states.values, states.sigmas_m)
            is_over |= is_duplicate(overlap, states.num_misses == 0, states.num_hits, self._config.merge_iou)
        if len(states) > MAX_TRACKS:
            ranking = np.lexsort((states.ids, -states.num_hits, ~states.is_plausible, is_over))
            is_over[ranking[MAX_TRACKS:]] = True
        if is_over.any():
            self._states = states.where(~is_over)

    def _as_tracks(self, states: TrackStates, boxes_xyxy_px: Floats, vehicles: Vehicles | None) -> Tracks:
        seen = np.where(states.num_misses > 0, TrackState.COASTING, TrackState.CONFIRMED)
        ranges_m, sigmas_m = states.values[:, RANGE], states.sigmas_m
        if self._num_ranges:
            average = mean_of if self._config.range_filter == "mean" else median_of
            ranges_m = average(states.range_history)
        # A light that has been predicted past the camera has no range any more.
        is_known = ranges_m > 0.0
        return Tracks(
            ids=states.ids,
            states=np.where(states.is_plausible, seen, TrackState.TENTATIVE),
            boxes_xyxy_px=boxes_xyxy_px,
            confidences=states.confidences,
            num_hits=states.num_hits,
            num_misses=states.num_misses,
            ages_s=self._now_s - states.births_s,
            ranges_m=np.where(is_known, ranges_m, np.nan),
            sigmas_m=np.where(is_known, sigmas_m, np.inf),
            detections=states.detections,
            light_kinds=states.light_kinds,
            vehicles=vehicles,
        )


def turn_shift_px(camera: Camera, centres_px: Floats, turn_rad: float) -> Floats:
    """Pixels x, y, shape (M, 2), by which distant points move when the vehicle turns to the left by `turn_rad`.

    To first order, without lens distortion and the camera's own tilt: accurate to a tenth of the shift, which is some
    ten pixels for a turn between two frames.

    Source: Longuet-Higgins and Prazdny, The interpretation of a moving retinal image, 1980, rotation about y.
    """
    normal = (centres_px - camera.centre_px) / camera.focal_px
    u = normal[:, :1]
    flow = np.concatenate([1.0 + u * u, u * normal[:, 1:]], axis=1)
    return np.asarray(flow * camera.focal_px * turn_rad)
