"""The table of faults: each is recorded, means low beam within two frames, and ends when its cause does."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import pytest

from benchmarks.faulty import PERIOD_S, STAGES, WRONG_FRAMES, Lamps, ScriptedCamera, Step, live_config, spoil
from foreglow.beam.faults import GuardFault
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveEndedError, LiveFault, LiveLoop
from foreglow.types import BeamMode, Frame
from tests.runtime.live.stand_ins import Keeper, run_live

pytestmark = pytest.mark.slow

BEGIN, END = 20, 30
"""In these frames something is wrong; there are 60."""


@pytest.mark.parametrize("fault", WRONG_FRAMES)
def test_wrong_frames(fault: str, drive: list[Frame]) -> None:
    wrong = WRONG_FRAMES[fault](drive[BEGIN:END])
    num_until_low = 2 if fault == GuardFault.FROZEN else 0
    source = ScriptedCamera([*drive[:BEGIN], *wrong, *drive[END:60]])
    summary, lamps = run_live(source, live_config())
    commands = lamps.of_frames()
    assert all(commands[frame.timestamp_ns].mode != BeamMode.LOW for frame in drive[1:BEGIN])
    for frame in wrong[num_until_low:]:
        assert commands[frame.timestamp_ns].mode == BeamMode.LOW
        assert fault in commands[frame.timestamp_ns].faults
    assert commands[drive[END + 2].timestamp_ns].mode != BeamMode.LOW  # light comes back
    assert summary.fault_counts[fault] == 1
    event = next(event for event in summary.faults if event.fault == fault)
    assert event.until_ns is not None


def test_frames_out_of_order(drive: list[Frame]) -> None:
    frames = [*drive[:BEGIN], *drive[BEGIN - 10 : BEGIN], *drive[END:60]]
    keeper = Keeper()
    summary, lamps = run_live(ScriptedCamera(frames), live_config(silent_frames=20.0), sinks=[keeper])
    first = lamps.is_low.index(True, 1)  # light begins to return after the first frame
    assert BEGIN - 2 <= first <= BEGIN  # one frame may be under way, and one wait
    num_low = len(commands_with(lamps, LiveFault.OUT_OF_ORDER))
    assert num_low >= 10 + 1  # each of them, and the next one in order
    assert all(lamps.is_low[first : first + num_low])
    assert not any(lamps.is_low[first + num_low + 1 : -1])
    assert [frame.timestamp_ns for frame, _ in keeper.results] == [
        frame.timestamp_ns for frame in (*drive[:BEGIN], *drive[END:60])
    ]
    assert summary.fault_counts[LiveFault.OUT_OF_ORDER] == 1


@pytest.mark.parametrize(
    ("stage", "error"),
    [
        *((stage, ZeroDivisionError) for stage in STAGES),
        ("distance", SystemExit),
        ("beam", KeyboardInterrupt),
        ("beam", GeneratorExit),
    ],
)
def test_stage_that_raises(stage: str, error: type[BaseException], drive: list[Frame]) -> None:
    raising = {frame.timestamp_ns for frame in drive[BEGIN : BEGIN + 2]}

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, stage, lambda now_ns: fail() if now_ns in raising else None)
        return pipeline

    def fail() -> None:
        raise error("planted")

    configuration = live_config()
    keeper = Keeper()
    summary, lamps = run_live(ScriptedCamera(drive[:60]), configuration, make, [keeper])
    commands = lamps.of_frames()
    for frame in drive[BEGIN : BEGIN + 3]:  # the third is the one that shows that it goes on
        assert commands[frame.timestamp_ns].mode == BeamMode.LOW
        assert LiveFault.STAGE_FAILED in commands[frame.timestamp_ns].faults
    assert commands[drive[BEGIN + 4].timestamp_ns].mode != BeamMode.LOW
    assert summary.run.num_frames == 58
    assert summary.fault_counts == {LiveFault.STAGE_FAILED: 1}
    assert summary.faults[0].detail == f"{stage}: {error.__name__}: planted"
    assert summary.faults[0].until_ns is not None
    assert keeper.ends == ["close"]


def test_a_stage_that_raises_ends_no_fault_of_the_guard(drive: list[Frame]) -> None:
    """Nobody has judged the frames in which it raised; "all is well again" would be wrong."""
    unknown = [dataclasses.replace(frame, motion=None) for frame in drive[:30]]
    raising = {frame.timestamp_ns for frame in unknown[10:20:3]}

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, "distance", lambda now_ns: 1 // 0 if now_ns in raising else None)
        return pipeline

    configuration, keeper = live_config(), Keeper()
    summary, _ = run_live(ScriptedCamera(unknown), configuration, make, [keeper])
    assert summary.fault_counts[GuardFault.NO_SPEED] == 1
    assert summary.fault_counts[LiveFault.STAGE_FAILED] >= 1
    begun = next(index for index, faults in enumerate(keeper.faults) if GuardFault.NO_SPEED in faults)
    assert all(GuardFault.NO_SPEED in faults for faults in keeper.faults[begun:])


def test_stage_that_raises_always_until_the_pipeline_is_made_anew(drive: list[Frame]) -> None:
    made: list[Pipeline] = []

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        if not made:
            spoil(pipeline, "tracking", lambda now_ns: 1 // 0 if now_ns >= drive[BEGIN].timestamp_ns else None)
        made.append(pipeline)
        return pipeline

    configuration = live_config(max_failures=3)
    summary, lamps = run_live(ScriptedCamera(drive[:60]), configuration, make)
    assert len(made) == 2
    assert summary.run.num_frames == 57
    assert lamps.of_frames()[drive[BEGIN + 5].timestamp_ns].mode != BeamMode.LOW


def test_stage_that_hangs_comes_back(drive: list[Frame]) -> None:
    released = threading.Event()

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, "classifier", lambda now_ns: released.wait(20) if now_ns == drive[BEGIN].timestamp_ns else None)
        return pipeline

    configuration = live_config(abandon_s=15.0)
    watching = threading.Thread(target=release_when_low, args=(lamps := Watched(), released))
    watching.start()
    summary, _ = run_live(ScriptedCamera(drive[:60], is_live=True), configuration, make, lamps=lamps)
    watching.join()
    assert LiveFault.STAGE_HANGS in lamps.commands[lamps.first_low].faults
    hung = next(event for event in summary.faults if event.fault == LiveFault.STAGE_HANGS)
    assert hung.detail == "classifier"
    assert hung.until_ns is not None
    assert lamps.of_frames()[drive[BEGIN].timestamp_ns].mode == BeamMode.LOW  # what it brought late is not shone
    assert not lamps.is_low[-2]  # and light comes back
    assert summary.num_dropped > 0


def test_stage_that_hangs_for_good(drive: list[Frame]) -> None:
    never = threading.Event()
    made: list[Pipeline] = []

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        if not made:
            spoil(pipeline, "distance", lambda now_ns: never.wait(60) if now_ns >= drive[BEGIN].timestamp_ns else None)
        made.append(pipeline)
        return pipeline

    configuration = live_config(abandon_s=0.3)
    summary, lamps = run_live(ScriptedCamera(drive, is_live=True), configuration, make)
    never.set()
    assert len(made) == 2
    assert {LiveFault.STAGE_HANGS, LiveFault.NO_PIPELINE} <= summary.fault_counts.keys()
    assert not lamps.is_low[-2]


def test_too_many_hang(drive: list[Frame]) -> None:
    never = threading.Event()

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, "distance", lambda _: never.wait(60))
        return pipeline

    configuration = live_config(abandon_s=0.2)
    with pytest.raises(LiveEndedError, match="distance: hung 3 times") as ended:
        run_live(ScriptedCamera(drive, is_live=True), configuration, make)
    never.set()
    assert not ended.value.summary.run.is_complete


@pytest.mark.parametrize("num_hanging", [1, 99])
def test_a_new_pipeline_that_hangs_while_it_is_made(drive: list[Frame], num_hanging: int) -> None:
    never = threading.Event()
    configuration, keeper = live_config(rebuild_s=0.3, abandon_s=0.1, max_step_s=10.0), Keeper()
    broken, spare = Pipeline(configuration), Pipeline(configuration)
    num_made = 0

    def fail(now_ns: int) -> None:
        if now_ns >= drive[BEGIN].timestamp_ns:
            raise ArithmeticError

    def make() -> Pipeline:
        nonlocal num_made
        num_made += 1
        if 1 < num_made <= 1 + num_hanging:
            never.wait(60)
        return broken if num_made == 1 else spare

    spoil(broken, "proposals", fail)
    source = ScriptedCamera(drive, is_live=True)
    if num_hanging == 1:
        summary, lamps = run_live(source, configuration, make, sinks=[keeper])
        assert not lamps.is_low[-2]
    else:
        with pytest.raises(LiveEndedError, match="making a pipeline: hung 3 times") as ended:
            run_live(source, configuration, make, sinks=[keeper])
        summary = ended.value.summary
        assert num_made == 4
    never.set()
    assert LiveFault.NO_PIPELINE in summary.fault_counts
    assert any("making a pipeline" in details for details in keeper.details)


def test_a_source_without_frames_is_given_up() -> None:
    source = ScriptedCamera(*[[OSError("no camera")] for _ in range(99)], is_live=True, is_endless=True)
    configuration, lamps, keeper = live_config(retry_s=0.1), Lamps(), Keeper()
    loop = LiveLoop(
        source, lambda: Pipeline(configuration), configuration, outputs=[lamps], sinks=[keeper], give_up_s=1.0
    )
    with pytest.raises(LiveEndedError, match="no frame for 1 s: OSError: no camera") as ended:
        loop.run()
    summary = ended.value.summary
    assert (summary.run.num_frames, summary.run.is_complete) == (0, False)
    assert [event.detail for event in summary.faults] == ["OSError: no camera"]
    assert lamps.commands
    assert "OSError: no camera" in keeper.details


def test_camera_gone_and_back(drive: list[Frame]) -> None:
    script: list[Step] = [*drive[:BEGIN], 1.0, *drive[BEGIN:60]]
    summary, lamps = run_live(ScriptedCamera(script, is_live=True), live_config())
    gone = next(event for event in summary.faults if event.fault == LiveFault.CAMERA_GONE)
    assert gone.until_ns is not None
    while_gone = [one for one in lamps.commands if one.faults == (LiveFault.CAMERA_GONE,)]
    assert len(while_gone) >= 5  # again and again, so that the lamps do not fall silent
    assert all(one.mode == BeamMode.LOW for one in while_gone)
    commands = lamps.of_frames()
    assert LiveFault.CAMERA_GONE in commands[drive[BEGIN].timestamp_ns].faults
    assert not lamps.is_low[-2]


def test_lost_camera_is_opened_anew(drive: list[Frame]) -> None:
    source = ScriptedCamera(
        [*drive[:10], OSError("unplugged")], [OSError("not yet")], drive[10:], is_live=True, is_endless=True
    )
    summary, lamps = run_live(source, live_config(retry_s=0.2), limit=28)
    assert summary.run.num_frames == 28
    gone = next(event for event in summary.faults if event.fault == LiveFault.CAMERA_GONE)
    assert gone.detail == "OSError: unplugged"
    assert commands_with(lamps, LiveFault.CAMERA_GONE)
    assert not lamps.is_low[-2]


def test_camera_that_wants_to_end_the_program_is_opened_anew(drive: list[Frame]) -> None:
    source = ScriptedCamera([*drive[:10], SystemExit(3)], drive[10:], is_live=True, is_endless=True)
    summary, _ = run_live(source, live_config(retry_s=0.1), limit=15)
    assert summary.run.num_frames == 15
    assert any(event.detail == "SystemExit: 3" for event in summary.faults)


def test_slow_camera(drive: list[Frame]) -> None:
    frames = [*drive[:BEGIN], *drive[BEGIN:50:2], *drive[50:70]]  # half the rate: 9 Hz
    summary, lamps = run_live(ScriptedCamera(frames), live_config())
    commands = lamps.of_frames()
    assert commands[drive[BEGIN - 2].timestamp_ns].mode != BeamMode.LOW
    for frame in drive[BEGIN + 4 : 50 : 2]:  # the second frame that came late, and all after it
        assert LiveFault.CAMERA_SLOW in commands[frame.timestamp_ns].faults
    assert commands[drive[58].timestamp_ns].mode != BeamMode.LOW
    assert summary.fault_counts == {LiveFault.FRAME_LOST: 1, LiveFault.CAMERA_SLOW: 1}


def test_one_missing_frame_is_noted_alone(drive: list[Frame]) -> None:
    frames = [*drive[:BEGIN], *drive[BEGIN + 1 : 60]]
    summary, lamps = run_live(ScriptedCamera(frames), live_config())
    assert summary.fault_counts == {LiveFault.FRAME_LOST: 1}
    assert summary.faults[0].detail.startswith("111 ms before ")
    assert summary.faults[0].until_ns is not None
    assert not any(command.faults for command in lamps.commands)
    assert not any(lamps.is_low[1:-1])


def test_bus_that_fails_for_a_while(drive: list[Frame]) -> None:
    class Failing(Lamps):
        def send(self, command: Any) -> None:
            if drive[BEGIN].timestamp_ns <= command.timestamp_ns < drive[END].timestamp_ns:
                raise OSError("can0: buffer full")
            super().send(command)

    summary, _ = run_live(ScriptedCamera(drive[:60]), live_config(), lamps=Failing())
    assert summary.fault_counts == {LiveFault.BUS: 1}
    assert summary.faults[0].detail == "can0: buffer full"
    assert summary.faults[0].until_ns is not None
    assert summary.run.num_frames == 60


@pytest.mark.parametrize("method", ["send", "close"])
def test_bus_whose_driver_raises_what_it_likes(method: str, drive: list[Frame]) -> None:
    class Broken(Lamps):
        pass

    def fail(*_: object) -> None:
        raise RuntimeError("unplugged")

    broken, keeper, second = Broken(), Keeper(), Lamps()
    setattr(broken, method, fail)
    configuration = live_config()
    source = ScriptedCamera(drive[:10])
    make, outputs = (lambda: Pipeline(configuration)), [broken, second]
    summary = LiveLoop(source, make, configuration, outputs=outputs, sinks=[keeper]).run()
    assert summary.run.num_frames == len(keeper.results) == 10
    assert keeper.ends == ["close"]
    assert summary.fault_counts == {LiveFault.BUS: 1}
    assert summary.faults[0].detail == "unplugged"
    assert second.commands[-1].mode == BeamMode.LOW


def test_signals_in_a_row_do_not_disturb_the_end(drive: list[Frame]) -> None:
    class Pressing(Keeper):
        """Somebody who presses Ctrl-C again and again until the sinks are closed."""

        def close(self) -> None:
            for _ in range(5):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.02)
            super().close()

    first, second = Pressing(), Keeper()
    summary, lamps = run_live(ScriptedCamera(drive[:5]), live_config(), sinks=[first, second])
    assert summary.run.num_frames == 5
    assert (first.ends, second.ends) == (["close"], ["close"])
    assert lamps.is_low[-1]


def test_recording_that_fails(drive: list[Frame]) -> None:
    class FullDisk(Keeper):
        def write(self, frame: Frame, result: Any) -> None:
            if len(self.results) == 5:
                raise OSError(28, "No space left on device", "x.mcap")
            super().write(frame, result)

    broken, well = FullDisk(), Keeper()
    summary, lamps = run_live(ScriptedCamera(drive[:40]), live_config(), sinks=[broken, well])
    assert summary.run.num_frames == 40
    assert not any(lamps.is_low[1:-1])  # recording is not driving
    assert "No space left" in summary.sink_errors[0]
    assert summary.num_unrecorded > 0
    assert LiveFault.NOT_RECORDED in summary.fault_counts
    assert (broken.ends, well.ends) == (["close"], ["close"])
    assert len(well.results) == 40


def test_command_that_comes_too_late(drive: list[Frame]) -> None:
    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, "tracking", lambda now_ns: time.sleep(0.4) if now_ns == drive[BEGIN].timestamp_ns else None)
        return pipeline

    configuration = live_config(max_step_s=5.0, abandon_s=10.0)
    _, lamps = run_live(ScriptedCamera(drive[:60], is_live=True), configuration, make)
    assert GuardFault.TOO_OLD in lamps.of_frames()[drive[BEGIN].timestamp_ns].faults
    assert not lamps.is_low[-2]


class Watched(Lamps):
    """Lamps whose first low beam after there was light somebody waits for."""

    def __init__(self) -> None:
        super().__init__()
        self.went_low = threading.Event()

    @property
    def first_low(self) -> int:
        return self.is_low.index(True, 1)

    def send(self, command: Any) -> None:
        super().send(command)
        if command.mode == BeamMode.LOW and len(self.commands) > 1:
            self.went_low.set()


def release_when_low(lamps: Watched, released: threading.Event) -> None:
    lamps.went_low.wait(20)
    time.sleep(3 * PERIOD_S)
    released.set()


def commands_with(lamps: Lamps, fault: str) -> list[Any]:
    return [one for one in lamps.commands if fault in one.faults]


def test_pipeline_that_cannot_be_made_leaves_nothing(drive: list[Frame]) -> None:
    def make() -> Pipeline:
        raise FileNotFoundError("no such model")

    keeper = Keeper()
    with pytest.raises(FileNotFoundError, match="no such model"):
        run_live(ScriptedCamera(drive[:5]), live_config(), make, [keeper])
    assert keeper.ends == ["discard"]


@pytest.mark.process
def test_a_replay_that_hardly_moves_ends_when_it_shall(drive: list[Frame]) -> None:
    camera = ScriptedCamera(drive[:3], is_live=True)
    camera.speed = 1e-9
    running = threading.Thread(target=run_live, args=(camera, live_config()), kwargs={"limit": 1}, daemon=True)
    running.start()
    running.join(60.0)
    assert not running.is_alive()


def test_a_process_that_was_stopped_blames_no_stage() -> None:
    """As a machine that was asleep: low beam, but the pipeline that is asked to go on at once need not be replaced."""
    process = subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True)
    os.waitpid(process.pid, os.WUNTRACED)
    time.sleep(4.0)
    process.send_signal(signal.SIGCONT)
    counts = json.loads(process.communicate(timeout=120)[0])
    assert LiveFault.STAGE_HANGS in counts
    assert LiveFault.NO_PIPELINE not in counts


STOPPED = """
import json, os, signal, time
from benchmarks.faulty import ScriptedCamera, live_config, spoil
from foreglow.datasets import open_source, shipped_drive
from foreglow.pipeline import Pipeline
from tests.runtime.live.stand_ins import run_live

drive, configuration = list(open_source(shipped_drive())), live_config(max_step_s=0.5, abandon_s=1.5)

stops = [signal.SIGSTOP]

def stop(now_ns):
    if now_ns > drive[5].timestamp_ns and stops:
        os.kill(os.getpid(), stops.pop())
        time.sleep(1.0)  # what the stage takes itself: too long, but not so long that it is abandoned

def make():
    pipeline = Pipeline(configuration)
    spoil(pipeline, "classifier", stop)
    return pipeline

summary, _ = run_live(ScriptedCamera(drive[:30], is_live=True), configuration, make)
print(json.dumps(summary.fault_counts))
"""
