"""Faults of camera, bus and sinks: each is recorded, means low beam within two frames, and ends when its cause does."""

from __future__ import annotations

import dataclasses
import math
import os
import signal
import threading
import time
from typing import Any

import pytest

from benchmarks.faulty import WRONG_FRAMES, Lamps, ScriptedCamera, Step, live_config
from foreglow.beam.faults import GuardFault
from foreglow.config import PipelineConfig, preset
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveEndedError, LiveFault, LiveLoop, Paced
from foreglow.types import BeamMode, Frame
from tests.runtime.live.stand_ins import BEGIN, END, Keeper, run_live
from tests.stand_ins import ListSource

pytestmark = pytest.mark.slow


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


def test_a_replay_without_pauses_knows_which_frames_are_faulty(drive: list[Frame]) -> None:
    """Its clock is that of the reader, which may be some frames ahead."""
    wrong, keeper = WRONG_FRAMES[GuardFault.FROZEN](drive[BEGIN:END]), Keeper()
    source = Paced(ListSource([*drive[:BEGIN], *wrong, *drive[END:60]]), math.inf)
    summary, _ = run_live(source, live_config(), sinks=[keeper])
    faulty = [frame for frame, result in keeper.results if result.beam and GuardFault.FROZEN in result.beam.faults]
    after = next(frame for frame, _ in keeper.results if frame.timestamp_ns > faulty[-1].timestamp_ns)
    (event,) = (event for event in summary.faults if event.fault == GuardFault.FROZEN)
    assert (event.from_ns, event.until_ns) == (faulty[0].timestamp_ns, after.timestamp_ns)


def test_a_stage_that_fails_in_such_a_replay_does_so_at_its_frame(drive: list[Frame]) -> None:
    class Failing:
        config, count = live_config(), 0

        def __init__(self) -> None:
            self._pipeline = Pipeline(self.config)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._pipeline, name)

        def step(self, frame: Frame, **options: Any) -> Any:
            if frame is drive[BEGIN]:
                raise RuntimeError("bad luck")
            return self._pipeline.step(frame, **options)

    summary, _ = run_live(Paced(ListSource(drive[:60]), math.inf), live_config(), Failing)
    (event,) = (event for event in summary.faults if event.fault == LiveFault.STAGE_FAILED)
    assert (event.from_ns, event.until_ns) == (drive[BEGIN].timestamp_ns, drive[BEGIN + 1].timestamp_ns)


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
    assert summary.num_out_of_order == 10


def test_a_camera_that_the_configuration_does_not_fit_ends_it(drive: list[Frame]) -> None:
    """It is not opened again, as one that is lost."""
    configuration = live_config().changed("proposals", region_xyxy_px=(9000, 0, 9100, 100))
    with pytest.raises(ValueError, match=r"proposals\.region_xyxy_px: expected a part of the frame, \[9000"):
        run_live(ScriptedCamera(drive[:3], is_live=True, is_endless=True), configuration)


@pytest.mark.parametrize(
    "configuration",
    [preset("foreglow"), preset("foreglow").detector_only, preset("baseline").changed("beam", policy="high")],
    ids=["no policy", "no tracker", "no model"],
)
def test_a_pipeline_that_commands_no_beam_is_refused(drive: list[Frame], configuration: PipelineConfig) -> None:
    """The lamps stayed in low beam, and nothing said why."""
    with pytest.raises(ValueError, match="make_pipeline: expected one that commands a beam"):
        run_live(ScriptedCamera(drive[:3]), configuration)


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


def test_light_comes_back_slowly_when_the_bus_does(drive: list[Frame]) -> None:
    class Failing(Lamps):
        def send(self, command: Any) -> None:
            if drive[BEGIN].timestamp_ns <= command.timestamp_ns < drive[END].timestamp_ns:
                raise OSError("can0: buffer full")
            super().send(command)

    _, lamps = run_live(ScriptedCamera(drive[:60]), live_config(), lamps=Failing())
    commands = lamps.of_frames()
    assert commands[drive[BEGIN - 1].timestamp_ns].levels.max() == 1.0
    first = commands[drive[END].timestamp_ns]
    assert (first.mode, first.faults) == (BeamMode.LOW, (LiveFault.BUS,))
    assert 0.0 < commands[drive[END + 1].timestamp_ns].levels.max() < 0.2
    assert commands[drive[END + 12].timestamp_ns].levels.max() == 1.0


def test_bus_whose_driver_hangs(drive: list[Frame]) -> None:
    is_over = threading.Event()

    class Hanging(Lamps):
        def send(self, command: Any) -> None:
            if command.timestamp_ns == drive[BEGIN].timestamp_ns:
                is_over.wait(60.0)
            super().send(command)

    class Ending(Keeper):
        """Has the driver go on after a while."""

        def write(self, frame: Frame, result: Any) -> None:
            super().write(frame, result)
            if frame.timestamp_ns == drive[END].timestamp_ns:
                is_over.set()

    before = set(threading.enumerate())  # another test's thread may still wait for a driver that hangs
    source = ScriptedCamera(drive[:60], is_live=True)
    hanging, second = Hanging(), Lamps()
    configuration, keeper = live_config(), Ending()
    make, outputs = (lambda: Pipeline(configuration)), [hanging, second]
    summary = LiveLoop(source, make, configuration, outputs=outputs, sinks=[keeper]).run()
    event = next(event for event in summary.faults if event.fault == LiveFault.BUS)
    assert event.detail == "Hanging takes longer than 0.2 s"
    assert event.until_ns is not None
    during = [one for one in second.commands if LiveFault.BUS in one.faults]
    assert len(during) >= 3
    assert all(one.mode == BeamMode.LOW for one in during)
    assert hanging.is_low[-1]
    for thread in set(threading.enumerate()) - before:
        thread.join(10.0)
        assert not thread.is_alive(), thread.name


def test_no_bus_waits_for_another_one(drive: list[Frame]) -> None:
    """Each takes a command only once the other one has begun to."""
    both = threading.Barrier(2)

    class Waiting(Lamps):
        def send(self, command: Any) -> None:
            both.wait(20.0)
            super().send(command)

    configuration = live_config()
    make, outputs = (lambda: Pipeline(configuration)), [Waiting(), Waiting()]
    summary = LiveLoop(ScriptedCamera(drive[:3]), make, configuration, outputs=outputs).run()
    assert not summary.fault_counts
    assert [len(one.commands) for one in outputs] == [4, 4]


def test_bus_whose_driver_never_comes_back_does_not_keep_the_loop(drive: list[Frame]) -> None:
    is_over = threading.Event()

    class Hanging(Lamps):
        def send(self, command: Any) -> None:  # noqa: ARG002
            is_over.wait(60.0)

        def close(self) -> None:
            raise AssertionError("closed from another thread while it sends")

    try:
        source = ScriptedCamera(drive[:5], is_live=True)
        summary, _ = run_live(source, live_config(), lamps=Hanging())
    finally:
        is_over.set()
    assert LiveFault.BUS in summary.fault_counts


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
                raise OSError(28, "No space left on device", "x.mcap.partial")
            super().write(frame, result)

    broken, well = FullDisk(), Keeper()
    summary, lamps = run_live(ScriptedCamera(drive[:40]), live_config(), sinks=[broken, well])
    assert summary.run.num_frames == 40
    assert not any(lamps.is_low[1:-1])  # recording is not driving
    assert summary.sink_errors == ["x.mcap: No space left on device"]
    assert summary.num_unrecorded > 0
    assert LiveFault.NOT_RECORDED in summary.fault_counts
    assert (broken.ends, well.ends) == (["close"], ["close"])
    assert len(well.results) == 40


def commands_with(lamps: Lamps, fault: str) -> list[Any]:
    return [one for one in lamps.commands if fault in one.faults]


@pytest.mark.process
def test_a_replay_that_hardly_moves_ends_when_it_shall(drive: list[Frame]) -> None:
    camera = ScriptedCamera(drive[:3], is_live=True)
    camera.speed = 1e-9
    running = threading.Thread(target=run_live, args=(camera, live_config()), kwargs={"limit": 1}, daemon=True)
    running.start()
    running.join(60.0)
    assert not running.is_alive()


def test_a_source_whose_times_stand_still_is_given_up(drive: list[Frame]) -> None:
    """Its frames cannot be used, and it went on for ever."""
    still = dataclasses.replace(drive[1], timestamp_ns=drive[0].timestamp_ns)
    script: list[Step] = [drive[0]]
    for _ in range(100):
        script += [still, 0.05]
    source = ScriptedCamera(script, is_live=True, is_endless=True)
    configuration, lamps = live_config(), Lamps()
    loop = LiveLoop(source, lambda: Pipeline(configuration), configuration, outputs=[lamps], give_up_s=1.0)
    with pytest.raises(LiveEndedError, match=r"no frame for 1 s: it is silent, or its .* still") as ended:
        loop.run()
    assert ended.value.summary.run.num_frames == 1
    assert ended.value.summary.num_out_of_order > 5
