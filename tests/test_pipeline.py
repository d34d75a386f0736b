"""The pipeline: the same result for the same frame, whoever drives it."""

from __future__ import annotations

import copy
import pickle
import threading
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from foreglow.beam import BeamPolicy
from foreglow.beam.faults import GuardFault
from foreglow.config import DistanceConfig, PipelineConfig, TrackerConfig, preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.distance import RangeEstimator
from foreglow.pipeline import Pipeline, Stages
from foreglow.proposals import BACKENDS
from foreglow.stopwatch import Stopwatch
from foreglow.tracking import Tracker, make_tracker
from foreglow.types import BeamCommand, BeamMode, Detections, Frame, FrameResult, Ranges, Tracks, Vehicles
from tests.stand_ins import REFERENCE, night_frames, night_image, tracks_of


def identity(result: FrameResult) -> tuple[object, ...]:
    """All of a result but its run-times."""
    detections = result.detections
    scored = None if detections is None else (detections.scores.tolist(), detections.is_accepted.tolist())
    ranges, tracks = result.ranges, result.tracks
    ranged = None if ranges is None else (repr(ranges.ranges_m.tolist()), ranges.sigmas_m.tolist())
    arrays = [] if tracks is None else [field.name for field in fields(tracks) if field.name != "vehicles"]
    followed = None if tracks is None else repr([getattr(tracks, name).tolist() for name in arrays])
    return result.frame, result.timestamp_ns, result.proposals.boxes_xyxy_px.tolist(), scored, ranged, followed


def test_same_results_twice_and_in_any_company() -> None:
    frames = night_frames(4)
    pipeline = Pipeline(REFERENCE)
    first = [identity(result) for result in pipeline.run(frames)]
    pipeline.reset()
    assert [identity(result) for result in pipeline.run(frames)] == first
    assert [identity(Pipeline(REFERENCE).step(frame)) for frame in frames] == first
    assert any(boxes for _, _, boxes, *_ in first)


@pytest.mark.slow
def test_frame_by_frame_is_as_a_run() -> None:
    """Also where another sequence begins, of which nobody told the pipeline, and whose times go on."""
    drive = shipped_frames(0, 40)
    other = [replace(frame, sequence="other", timestamp_ns=frame.timestamp_ns + 40 * 10**9 // 18) for frame in drive]
    config = preset("foreglow").commanding(policy="high")
    stepping, running = Pipeline(config), Pipeline(config)
    stepped = [stepping.step(frame) for frame in [*drive, *other]]
    assert [identity(result) for result in stepped] == [identity(result) for result in running.run([*drive, *other])]
    before, first = stepped[39].beam, stepped[40].beam
    assert before is not None
    assert first is not None
    assert before.levels.max() > 0.0
    assert first.levels.max() == 0.0


def test_plain_array_equals_its_frame() -> None:
    image = night_image(3)
    assert identity(Pipeline(REFERENCE).step(image)) == identity(Pipeline(REFERENCE).step(Frame(image, 0)))


def test_result_carries_the_frame_and_the_stages() -> None:
    frame = night_frames(3)[2]
    result = Pipeline(REFERENCE).step(frame)
    assert (result.frame, result.timestamp_ns) == (4, 100_000_000)
    assert list(result.stage_ms) == ["proposals"]
    assert result.detections is None
    assert Pipeline(REFERENCE).dispatch is None


def shipped_frames(first: int, count: int) -> list[Frame]:
    dataset = PVDN(shipped_drive())
    return [dataset.read(image_id) for image_id in dataset.frame_ids[first : first + count]]


def test_the_whole_chain() -> None:
    frames = shipped_frames(60, 12)
    pipeline = Pipeline()
    results = list(pipeline.run(frames))
    assert list(results[0].stage_ms) == ["proposals", "classifier", "distance", "tracking"]
    for result in results:
        assert result.detections is not None
        assert result.ranges is not None
        assert result.ranges.detections is result.detections
        assert result.tracks is not None
        assert result.tracks.detections.max(initial=-1) < len(result.detections)
    last = results[-1]
    assert last.tracks is not None
    assert last.tracks.is_plausible.any()
    assert np.isfinite(last.tracks.ranges_m).any()
    pipeline.reset()
    assert [identity(result) for result in pipeline.run(frames)] == [identity(result) for result in results]


def test_without_a_camera_there_are_tracks_and_no_ranges() -> None:
    frames = [replace(frame, camera=None, motion=None, road=None) for frame in shipped_frames(60, 3)]
    last = list(Pipeline().run(frames))[-1]
    assert last.ranges is None
    assert "distance" not in last.stage_ms
    assert last.tracks is not None
    assert len(last.tracks)
    assert np.isnan(last.tracks.ranges_m).all()


def test_stages_can_be_switched_off() -> None:
    config = preset("foreglow").model_copy(
        update={"distance": DistanceConfig(estimator="none"), "tracker": TrackerConfig(method="none")}
    )
    result = Pipeline(config).step(shipped_frames(60, 1)[0])
    assert (result.ranges, result.tracks) == (None, None)
    assert list(result.stage_ms) == ["proposals", "classifier"]


def test_a_stage_is_made_when_it_is_asked_for() -> None:
    config = preset("foreglow").changed("classifier", model=Path("absent.onnx"))
    stages = Stages(config)
    assert stages.tracker is stages.tracker is not None
    assert stages.beam is None
    with pytest.raises(FileNotFoundError, match=r"absent\.onnx"):
        _ = stages.classifier
    with pytest.raises(FileNotFoundError, match=r"absent\.onnx"):
        Pipeline(config)


def test_a_stopwatch_times_one_part_after_another(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks_ns = iter([5_000_000, 7_000_000, 10_000_000, 20_000_000])
    monkeypatch.setattr("foreglow.stopwatch.time.perf_counter_ns", lambda: next(ticks_ns))
    stopwatch = Stopwatch()
    stopwatch.begin("first")
    stopwatch.begin("second")
    assert stopwatch.part == "second"
    assert stopwatch.times_ms == {"first": 2.0}
    stopwatch.end()
    stopwatch.end()  # there is no part to end
    assert stopwatch.part is None
    assert stopwatch.times_ms == {"first": 2.0, "second": 3.0}


def test_plain_array_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="expected uint8 or uint16, got float64"):
        Pipeline(REFERENCE).step(np.zeros((80, 80)))


def test_frames_are_taken_one_by_one() -> None:
    taken = []

    def source() -> Iterator[Frame]:
        for frame in night_frames(3):
            taken.append(frame.frame)
            yield frame

    next(Pipeline(REFERENCE).run(source()))
    assert taken == [0]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("region", [(128, 0, 200, 50), (0, 96, 50, 200), (500, 500, 501, 501)])
def test_region_outside_the_frame_is_an_error(backend: str, region: tuple[int, int, int, int]) -> None:
    proposals = REFERENCE.proposals.model_copy(update={"backend": backend, "region_xyxy_px": region})
    with pytest.raises(ValueError, match=r"region_xyxy_px: expected a part of the frame, \[.*128x96 px"):
        Pipeline(PipelineConfig(proposals=proposals)).step(night_image())


@pytest.mark.parametrize("backend", BACKENDS)
def test_region_that_reaches_beyond_the_frame_is_cut(backend: str) -> None:
    whole, larger = (
        REFERENCE.proposals.model_copy(update={"backend": backend, "region_xyxy_px": region})
        for region in (None, (0, 0, 2**31 - 1, 2**31 - 1))
    )
    expected = Pipeline(PipelineConfig(proposals=whole)).step(night_image()).proposals.boxes_xyxy_px
    found = Pipeline(PipelineConfig(proposals=larger)).step(night_image()).proposals.boxes_xyxy_px
    assert len(expected) > 0
    assert found.tolist() == expected.tolist()


def test_a_second_thread_inside_is_refused() -> None:
    inside, leave = threading.Event(), threading.Event()

    def now_ns() -> int:
        inside.set()
        leave.wait(10.0)
        return 0

    image = np.zeros((96, 128), np.uint8)
    pipeline = Pipeline(preset("foreglow").commanding())
    thread = threading.Thread(target=pipeline.step, args=(image,), kwargs={"now_ns": now_ns})
    thread.start()
    assert inside.wait(10.0)
    with pytest.raises(RuntimeError, match="another thread is inside"):
        pipeline.step(image)
    leave.set()
    thread.join()
    assert pipeline.step(image).frame == 0


def test_a_reset_while_a_frame_is_under_way_is_refused() -> None:
    pipeline = Pipeline(preset("foreglow").commanding())

    def now_ns() -> int:
        with pytest.raises(RuntimeError, match=r"Pipeline\.reset: another thread is inside"):
            pipeline.reset()
        return 0

    assert pipeline.step(np.zeros((96, 128), np.uint8), now_ns=now_ns).frame == 0


def test_sequences_share_no_history() -> None:
    first, second = shipped_frames(30, 3), [replace(frame, sequence="other") for frame in shipped_frames(40, 3)]
    pipeline = Pipeline()
    together = [identity(result) for result in pipeline.run([*first, *second])]
    pipeline = Pipeline()
    apart = [identity(result) for frames in (first, second) for result in pipeline.run(frames)]
    assert together == apart == [identity(result) for frames in (first, second) for result in Pipeline().run(frames)]


def test_a_loop_over_step_gives_what_run_gives() -> None:
    first, second = shipped_frames(60, 12), [replace(frame, sequence="other") for frame in shipped_frames(72, 4)]
    pipeline = Pipeline(preset("foreglow").commanding(policy="high"))
    stepped = [pipeline.step(frame) for frame in [*first, *second]]
    ran = [result for frames in (first, second) for result in Pipeline(pipeline.config).run(frames)]
    assert [identity(result) for result in stepped] == [identity(result) for result in ran]
    levels = [result.beam.levels.sum() for result in stepped if result.beam is not None]
    assert levels[11] > levels[12] == 0  # the times go on, and yet the light begins anew


class Stumbling(Tracker):
    """Loses a frame, the third one, and counts how often it begins anew."""

    def __init__(self, config: TrackerConfig | None = None, *, lost: int = 3) -> None:
        self.lost = lost
        self.tracker = make_tracker(config or preset("foreglow").tracker)
        self.num_frames = self.num_resets = 0

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
        self.num_frames += 1
        if self.num_frames == self.lost:
            raise ArithmeticError
        return self.tracker.update(frame, detections, ranges)

    def reset(self) -> None:
        self.num_resets += 1
        self.tracker.reset()


def test_the_frame_after_an_error_begins_anew() -> None:
    tracker, frames = Stumbling(), shipped_frames(60, 6)
    pipeline = Pipeline(tracker=tracker)
    before = [identity(pipeline.step(frame)) for frame in frames[:2]]
    assert tracker.num_resets == 1
    with pytest.raises(ArithmeticError):
        pipeline.step(frames[2])
    after = [identity(pipeline.step(frame)) for frame in frames[3:]]
    assert tracker.num_resets == 2
    assert [before, after] == [[identity(r) for r in Pipeline().run(part)] for part in (frames[:2], frames[3:])]


def test_an_error_does_not_make_damage_usual() -> None:
    """Where an image is half stuck, the guard still knows so after the frame that a stage has lost."""
    frames = shipped_frames(0, 52)
    middle = frames[0].width_px // 2
    for number in range(40, 52):
        image = frames[number].image.copy()
        image[:, :middle] = frames[39].image[:, :middle]
        frames[number] = replace(frames[number], image=image)
    pipeline = Pipeline(preset("foreglow").commanding(policy="high"), tracker=Stumbling(lost=45))
    faults: list[tuple[str, ...]] = []
    for number, frame in enumerate(frames, start=1):
        if number == 45:
            with pytest.raises(ArithmeticError):
                pipeline.step(frame)
            continue
        beam = pipeline.step(frame).beam
        assert beam is not None
        faults.append(beam.faults)
    assert not any(faults[1:40])
    assert all(GuardFault.DAMAGED in found for found in faults[41:])


class Thinking(BeamPolicy):
    """A policy whose every command takes a second of the frames' clock."""

    def __init__(self) -> None:
        self.clock_ns = 0

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:  # noqa: ARG002
        self.clock_ns += 1_000_000_000
        return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, 84)))


def test_the_guard_sees_how_long_the_policy_took() -> None:
    policy = Thinking()
    pipeline = Pipeline(policy=policy)
    for frame in shipped_frames(60, 4):
        policy.clock_ns = frame.timestamp_ns
        beam = pipeline.step(frame, now_ns=lambda: policy.clock_ns).beam
        assert beam is not None
        assert GuardFault.TOO_OLD in beam.faults


class Reusing(RangeEstimator):
    """An estimator that uses the same arrays for each frame."""

    def __init__(self) -> None:
        self.ranges_m, self.sigmas_m = np.ones(100), np.ones(100)

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:  # noqa: ARG002
        self.ranges_m += 1.0
        return Ranges(detections, self.ranges_m[: len(detections)], self.sigmas_m[: len(detections)])


def test_a_plug_in_that_uses_its_arrays_again_changes_no_earlier_result() -> None:
    results = list(Pipeline(estimator=Reusing()).run(shipped_frames(60, 3)))
    assert [result.ranges.ranges_m[0] for result in results if result.ranges is not None] == [2.0, 3.0, 4.0]


class ReusingVehicles(Tracker):
    """A tracker of one vehicle that keeps its arrays, as one that is written for speed may."""

    def __init__(self) -> None:
        self.confidences = np.zeros(1)

    def reset(self) -> None:
        self.confidences[:] = 0.0

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:  # noqa: ARG002
        self.confidences += 0.125
        one = np.ones(1, np.int64)
        return replace(
            tracks_of([[1, 2, 3, 4]], ids=[1]),
            vehicles=Vehicles(one, one, self.confidences, np.ones(1, np.bool_), one, np.zeros(1, np.int64)),
        )


def test_nor_does_one_that_uses_those_of_its_vehicles_again() -> None:
    results = list(Pipeline(tracker=ReusingVehicles()).run(shipped_frames(60, 3)))
    vehicles = [result.tracks.vehicles for result in results if result.tracks is not None]
    assert [each.confidences[0] for each in vehicles if each is not None] == [0.125, 0.25, 0.375]


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_pipeline_cannot_be_copied(copied: Callable[[Pipeline], object]) -> None:
    """Two that share their stages would mix what they remember."""
    with pytest.raises(TypeError, match=r"Pipeline: cannot be copied or pickled; make one of its config"):
        copied(Pipeline(REFERENCE))


def test_runs_of_a_pipeline_do_not_mix() -> None:
    """Two that took turns were one drive to the stages, and nothing said so; one that is not ended is forgotten."""
    pipeline, frames = Pipeline(REFERENCE), shipped_frames(60, 3)
    first = pipeline.run(frames)
    next(first)
    second = pipeline.run(frames)
    begun = next(second)
    with pytest.raises(RuntimeError, match=r"Pipeline\.run: another run has begun"):
        next(first)
    expected = [identity(result) for result in Pipeline(REFERENCE).run(frames)]
    assert [identity(result) for result in (begun, *second)] == expected


class Crowded(BeamPolicy):
    """A policy of far too many gaps."""

    def __init__(self) -> None:
        """It has no parameters."""

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:  # noqa: ARG002
        gaps = np.linspace(-1.0, 1.0, 4002).reshape(-1, 2)
        return BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, np.ones((2, 84)), gaps, np.full(len(gaps), 50.0))


def test_too_many_gaps_are_refused() -> None:
    with pytest.raises(ValueError, match=r"beam\.policy: expected at most 2000 gaps of a frame, got 2001"):
        Pipeline(policy=Crowded()).step(shipped_frames(60, 1)[0])


class Late(Reusing):
    """An estimator that returns the ranges of the frame before."""

    before: Detections | None = None

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        known, self.before = self.before or detections, detections
        return super().estimate(frame, known)


def test_ranges_of_another_frame_are_refused() -> None:
    pipeline = Pipeline(estimator=Late())
    frame = shipped_frames(60, 1)[0]  # twice, so that there are as many boxes
    pipeline.step(frame)
    with pytest.raises(ValueError, match=r"distance\.estimator: expected ranges of the detections it was given"):
        pipeline.step(frame)


def test_what_is_no_configuration_or_plug_in() -> None:
    with pytest.raises(ValueError, match=r"Pipeline\.config: expected what foreglow\.preset or .*, got 'paper'"):
        Pipeline("paper")  # type: ignore[arg-type]
    with pytest.raises(
        ValueError, match=r"policy: .* with the methods command, shone, reset; str lacks command, shone, reset"
    ):
        Pipeline(policy="low")  # type: ignore[arg-type]


def test_a_path_is_no_frames() -> None:
    with pytest.raises(TypeError, match=r"expected frames, such as foreglow\.open_source\('drive\.mp4'\), got a path"):
        next(Pipeline(REFERENCE).run(Path("drive.mp4")))  # type: ignore[arg-type]
