"""Faults of the stages: one that raises, hangs or is late is recorded, means low beam, and is replaced if need be."""

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

from benchmarks.faulty import PERIOD_S, STAGES, Lamps, ScriptedCamera, live_config, spoil
from foreglow.beam.faults import GuardFault
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveEndedError, LiveFault
from foreglow.types import BeamMode, Frame
from tests.runtime.live.stand_ins import BEGIN, Keeper, run_live

pytestmark = pytest.mark.slow


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
    hangs, released = threading.Event(), threading.Event()

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, "classifier", lambda now_ns: hang() if now_ns == drive[BEGIN].timestamp_ns else None)
        return pipeline

    def hang() -> None:
        hangs.set()
        released.wait(20)

    configuration = live_config(abandon_s=15.0)
    watching = threading.Thread(target=release_when_low, args=(lamps := Watched(), hangs, released))
    watching.start()
    summary, _ = run_live(ScriptedCamera(drive[:60], is_live=True), configuration, make, lamps=lamps)
    watching.join()
    assert any(LiveFault.STAGE_HANGS in command.faults for command in lamps.commands)
    # On a busy machine other stages are late, too.
    hung = [event for event in summary.faults if (event.fault, event.detail) == (LiveFault.STAGE_HANGS, "classifier")]
    assert len(hung) == 1
    assert hung[0].until_ns is not None
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


@pytest.mark.parametrize("is_camera", [False, True])
def test_a_new_pipeline_that_can_never_be_made_ends_the_loop(drive: list[Frame], is_camera: bool) -> None:
    """Such as for want of memory: a recording would never end, and a camera's process has to be started again."""
    configuration, keeper = live_config(rebuild_s=0.5, retry_s=0.1), Keeper()
    broken = Pipeline(configuration)
    num_made = 0

    def fail(_: int) -> None:
        raise ArithmeticError

    def make() -> Pipeline:
        nonlocal num_made
        num_made += 1
        if num_made > 1:
            raise MemoryError("no memory left")
        return broken

    spoil(broken, "proposals", fail)
    source = ScriptedCamera(drive, is_live=is_camera)
    with pytest.raises(LiveEndedError, match=r"no pipeline for 0\.5 s: .*no memory left.*; start again") as ended:
        run_live(source, configuration, make, sinks=[keeper])
    assert num_made > 2
    assert not ended.value.summary.run.is_complete
    assert LiveFault.NO_PIPELINE in ended.value.summary.fault_counts


def test_command_that_comes_too_late(drive: list[Frame]) -> None:
    late: list[int] = []  # the first of the frames from BEGIN on that a busy machine does not drop

    def wait(now_ns: int) -> None:
        if now_ns >= drive[BEGIN].timestamp_ns and not late:
            late.append(now_ns)
            time.sleep(0.4)

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        spoil(pipeline, "tracking", wait)
        return pipeline

    configuration = live_config(max_step_s=5.0, abandon_s=10.0)
    _, lamps = run_live(ScriptedCamera(drive[:60], is_live=True), configuration, make)
    assert GuardFault.TOO_OLD in lamps.of_frames()[late[0]].faults
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


def release_when_low(lamps: Watched, hangs: threading.Event, released: threading.Event) -> None:
    hangs.wait(20)
    lamps.went_low.clear()
    lamps.went_low.wait(20)
    time.sleep(3 * PERIOD_S)
    released.set()


def test_pipeline_that_cannot_be_made_leaves_nothing(drive: list[Frame]) -> None:
    def make() -> Pipeline:
        raise FileNotFoundError("no such model")

    keeper = Keeper()
    with pytest.raises(FileNotFoundError, match="no such model"):
        run_live(ScriptedCamera(drive[:5]), live_config(), make, [keeper])
    assert keeper.ends == ["discard"]


def test_a_process_that_was_stopped_blames_no_stage() -> None:
    """As a machine that was asleep: low beam, but the pipeline that is asked to go on at once need not be replaced."""
    process = subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True)
    os.waitpid(process.pid, os.WUNTRACED)
    time.sleep(2.5)  # longer than a stage may take until it is abandoned
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

summary, _ = run_live(ScriptedCamera(drive[:60], is_live=True), configuration, make)  # 3 s: a busy machine begins late
print(json.dumps(summary.fault_counts))
"""
