"""The parts of the live loop, each alone."""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import socket
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.faulty import live_config
from foreglow.config import LiveConfig
from foreglow.pipeline import Pipeline
from foreglow.runs.folder import OutputFolder
from foreglow.runs.json_lines import LineSink
from foreglow.runs.tally import MAX_FAULT_NAMES
from foreglow.runtime.health import Health
from foreglow.runtime.live import LiveLoop, Paced
from foreglow.runtime.live.background import NUM_WAITING, Background
from foreglow.runtime.live.faults import MAX_EVENTS, FaultBook
from foreglow.runtime.live.kept_results import KeptResults
from foreglow.runtime.live.loop import SWITCH_S, quick_switching
from foreglow.runtime.live.mailbox import Arrival, Mailbox
from foreglow.runtime.live.notify import ServiceNotifier
from foreglow.runtime.live.watch import FrameWatch
from foreglow.runtime.run import KeepingSink
from foreglow.types import Frame, FrameResult, Image
from tests.runtime.live.stand_ins import Keeper
from tests.stand_ins import ListSource, night_frames, result_of

PERIOD_NS = 50_000_000


def arrival(number: int) -> Arrival:
    return Arrival(Frame(np.zeros((2, 2), np.uint8), number), number)


def test_the_newest_frame_wins() -> None:
    mailbox = Mailbox()
    for number in range(5):
        mailbox.put(arrival(number))
    taken = mailbox.take(0.0)
    assert taken is not None
    assert taken.arrived_ns == 4
    assert (mailbox.num_put, mailbox.num_dropped) == (5, 4)
    assert mailbox.take(0.0) is None


def test_lossless_waits() -> None:
    mailbox = Mailbox(is_lossless=True)

    def put_all() -> None:
        for number in range(20):
            mailbox.put(arrival(number))

    thread = threading.Thread(target=put_all)
    thread.start()
    taken = [one.arrived_ns for _ in range(20) if (one := mailbox.take(10.0)) is not None]
    thread.join()
    assert taken == list(range(20))
    assert mailbox.num_dropped == 0


def test_closed_mailbox_lets_everybody_go() -> None:
    mailbox = Mailbox(is_lossless=True)
    mailbox.put(arrival(0))
    thread = threading.Thread(target=mailbox.put, args=(arrival(1),))
    thread.start()
    mailbox.close()
    thread.join(10.0)
    assert not thread.is_alive()
    assert mailbox.take(10.0) is None


def test_book_of_faults() -> None:
    now = [0]
    book = FaultBook(lambda: now[0], ("camera",))
    book.note("camera")
    assert not book.active
    book.note("camera", ["gone"], "unplugged")
    now[0] = 3
    book.note("camera", ["gone", "slow"])
    book.note("bus", ["failed"])
    assert book.active == ("gone", "slow", "failed")
    now[0] = 5
    book.note("camera", ["slow"])
    assert book.unheeded == ("gone", "slow")
    assert book.heeded() == ("gone", "slow")  # what was since the last time, too; a bus is none of the beam's business
    assert not book.unheeded
    assert book.heeded() == ("slow",)
    book.note("camera")
    assert book.heeded() == ()
    assert [(one.fault, one.from_ns, one.until_ns, one.detail) for one in book.events] == [
        ("gone", 0, 5, "unplugged"),
        ("slow", 3, 5, ""),
        ("failed", 3, None, ""),
    ]
    assert dict(book.counts) == {"gone": 1, "slow": 1, "failed": 1}


def test_a_book_of_faults_whose_names_have_numbers_does_not_grow() -> None:
    book = FaultBook(lambda: 0, ())
    for number in range(MAX_FAULT_NAMES + 5):
        book.note("guard", ["map_lost"] if number % 2 else [f"score {number}"])
    for number in range(2 * MAX_FAULT_NAMES):
        book.note("guard", [f"tile {number}"])
    assert len(book.counts) == MAX_FAULT_NAMES + 1
    assert book.counts["map_lost"] == (MAX_FAULT_NAMES + 5) // 2
    assert book.counts.total() == 3 * MAX_FAULT_NAMES + 5


def test_a_fault_from_before_the_first_frame_has_a_length(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns, now_s = [3_600_000_000_000], [100.0]
    monkeypatch.setattr("foreglow.runtime.live.faults.time.monotonic", lambda: now_s[0])
    book = FaultBook(lambda: now_ns[0], ("camera",))
    watch = FrameWatch(LiveConfig(), 0.05, book, speed=2.0, max_silence_s=None)
    watch.lost("not there yet")
    now_ns[0], now_s[0] = 7_000_000_000, 101.5  # the frames' own times
    watch.arrived(Frame(np.zeros((2, 2), np.uint8), 7_000_000_000))
    assert [(one.from_ns, one.until_ns) for one in book.events] == [(4_000_000_000, 7_000_000_000)]
    book.note("bus", ["failed"])
    now_ns[0] = 0  # another sequence
    watch.arrived(Frame(np.zeros((2, 2), np.uint8), 0, sequence="second"))
    now_ns[0] = -1
    book.note("bus")
    assert (book.events[1].from_ns, book.events[1].until_ns) == (0, 0)


def test_book_keeps_no_more_than_it_says() -> None:
    book = FaultBook(lambda: 0, ())
    for _ in range(MAX_EVENTS + 10):
        book.note("camera", ["gone"])
        book.note("camera")
    assert len(book.events) == MAX_EVENTS
    assert book.counts["gone"] == MAX_EVENTS + 10


def frames_at(*times: float) -> list[Frame]:
    return [Frame(np.zeros((2, 2), np.uint8), round(one * PERIOD_NS)) for one in times]


def test_watch_of_a_slow_camera() -> None:
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(slow_frames=1.6, num_steady=3), 0.05, book, max_silence_s=None)
    seen = []
    for frame in frames_at(0, 1, 2, 4, 5, 7, 9, 11, 12, 13, 14, 15):
        assert watch.arrived(frame)
        seen.append(set(book.active))
    lost, slow = {"frame_lost"}, {"camera_slow"}  # the second late one in a row is slow, until three came in time
    #               0      1      2      4     5      7     9     11    12    13    14     15
    assert seen == [set(), set(), set(), lost, set(), lost, slow, slow, slow, slow, set(), set()]
    (event,) = (event for event in book.events if event.fault == "camera_slow")
    assert event.detail == "100 ms between frames, expected 50"  # as of a camera without its --rate


def test_watch_of_a_camera_that_is_late_again() -> None:
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(retry_s=0.01, silent_frames=100.0), 0.05, book, speed=10.0, max_silence_s=None)
    for frame in frames_at(0, 1, 2, 4):
        watch.arrived(frame)
    assert not watch.listen()
    time.sleep(0.02)  # four frames' time at this speed
    assert watch.listen()
    assert list(book.active) == ["frame_lost", "camera_slow"]


def test_watch_of_the_order() -> None:
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(), 0.05, book, max_silence_s=None)
    assert [watch.arrived(frame) for frame in frames_at(0, 1, 1, 0.5, 2)] == [True, True, False, False, True]
    assert book.counts["frame_out_of_order"] == 1
    other = Frame(np.zeros((2, 2), np.uint8), 0, sequence="another")
    assert watch.arrived(other)  # sequences share no time


@pytest.mark.parametrize("image", [np.zeros((4, 2), np.uint8), np.zeros((2, 2), np.uint16)])
def test_watch_of_another_size_with_another_sequence(image: Image) -> None:
    """As of a folder whose images change: the guard, which begins anew with the sequence, does not know."""
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(), 0.05, book, max_silence_s=None)
    (first,) = frames_at(0)
    watch.arrived(first)
    for sequence in ("another", "a third"):
        watch.arrived(dataclasses.replace(first, sequence=sequence))
        assert not book.active
    seen = []
    for number in range(42):
        frame = Frame(image, round(number * PERIOD_NS), sequence="resized")
        watch.arrived(frame)
        seen.append(list(book.active))
    assert seen == [["sequence_resized"]] * 40 + [[]] * 2


def test_watch_of_a_frame_with_a_wrong_time() -> None:
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(), 0.05, book, max_silence_s=None)
    an_hour = 3600e9 / PERIOD_NS
    frames = frames_at(0, 1, an_hour, 3, 4, 5)
    assert [watch.arrived(frame) for frame in frames] == [True, True, True, False, True, True]
    assert not [fault for fault in book.active if fault != "camera_slow"]


def test_watch_of_what_is_no_frame() -> None:
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(), 0.05, book, max_silence_s=None)
    watch.arrived(frames_at(0)[0])
    time.sleep(0.02)
    silent_s = watch.silent_s
    with pytest.raises(AttributeError):
        watch.arrived("a line")  # type: ignore[arg-type]
    assert watch.silent_s >= silent_s


def test_watch_of_silence() -> None:
    book = FaultBook(lambda: 0, ("camera",))
    watch = FrameWatch(LiveConfig(retry_s=0.01), 0.001, book, max_silence_s=None)
    assert not watch.listen()
    time.sleep(0.1)
    assert watch.listen()
    assert list(book.active) == ["camera_gone"]
    watch.arrived(frames_at(0)[0])
    assert not book.active


class Blocked(Keeper):
    """A sink that waits for a signal."""

    def __init__(self) -> None:
        super().__init__()
        self.released = threading.Event()

    def write(self, frame: Frame, result: object) -> None:
        self.released.wait(20)
        super().write(frame, result)  # type: ignore[arg-type]


def test_sink_that_falls_behind() -> None:
    sink = Blocked()
    background = Background(sink)
    frames = night_frames(NUM_WAITING + 10)
    for frame in frames:
        background.write(frame, result_of(frame, []))
    assert background.is_behind
    assert 9 <= background.num_lost <= 10  # one may have been taken already
    sink.released.set()
    background.close()
    assert len(sink.results) == len(frames) - background.num_lost
    assert [frame.frame for frame, _ in sink.results] == [frame.frame for frame in frames][: len(sink.results)]
    assert sink.ends == ["close"]


@pytest.mark.parametrize("num_more", [0, 5])
def test_a_recording_that_fell_behind_is_not_complete(num_more: int) -> None:
    class Recorder(Blocked, KeepingSink):
        @property
        def num_kept(self) -> int:
            return len(self.results)

    sink = Recorder()
    background = Background(sink)
    for frame in night_frames(NUM_WAITING + num_more):
        background.write(frame, result_of(frame, []))
    sink.released.set()
    background.close()
    assert sink.is_complete == (num_more == 0)


def ended(sink: Keeper) -> Background:
    """The background of a sink that was given more frames than may wait, and closed."""
    background = Background(sink)
    for frame in night_frames(NUM_WAITING + 2):
        background.write(frame, result_of(frame, []))
    background.close()
    return background


def test_reports_of_health_never_wait() -> None:
    sink = Blocked()
    background = Background(sink, is_lossless=True)
    (frame,) = night_frames(1)
    background.write(frame, result_of(frame, []))
    health = Health(0, (), 0, 0, 0, None)
    for _ in range(NUM_WAITING + 2):
        background.write_health(health)
    sink.released.set()
    background.close()
    assert len(sink.results) == 1


def test_sink_that_is_stuck_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foreglow.runtime.live.background.STUCK_S", 0.05)
    sink = Blocked()
    assert isinstance(ended(sink).error, TimeoutError)
    sink.released.set()


@pytest.mark.parametrize("error", [SystemExit, KeyboardInterrupt])
def test_sink_that_ends_its_thread_does_not(error: type[BaseException]) -> None:
    class Ending(Keeper):
        def write(self, frame: Frame, result: object) -> None:  # noqa: ARG002
            raise error

    sink = Ending()
    assert isinstance(ended(sink).error, error)
    assert sink.ends == ["close"]


def test_sink_that_cannot_be_completed() -> None:
    class Full(Keeper):
        def close(self) -> None:
            raise OSError("full")

    background = Background(Full())
    background.close()
    assert str(background.error) == "full"


def test_files_of_a_folder_end_with_the_same_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second file has no room for the third line, of which a part is there; the first has the line."""
    write = LineSink.write

    def until_full(sink: LineSink, frame: Frame, result: FrameResult) -> None:
        write(sink, frame, result)
        if sink is second and frame is frames[2]:
            os.truncate(tmp_path / "times.jsonl.partial", sink.num_bytes - 5)
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(LineSink, "write", until_full)
    frames = night_frames(4)
    with OutputFolder(tmp_path) as folder:
        kept = KeptResults(folder)
        second = kept._sinks[1]
        background = Background(kept)
        for frame in frames:
            background.write(frame, result_of(frame, [[1, 2, 9, 9]]))
        background.close()
    assert not kept.is_whole
    for name in ("frames", "times"):
        lines = (tmp_path / f"{name}.jsonl.partial").read_bytes().splitlines(keepends=True)
        assert [json.loads(line)["frame"] for line in lines] == [frame.frame for frame in frames[:2]]
        assert lines[-1].endswith(b"\n")


def test_service_notifier(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as service:
        service.bind(str(tmp_path / "notify"))
        service.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "1")
        notifier = ServiceNotifier()
        notifier.beat()
        time.sleep(0.001)
        notifier.beat()
        notifier.close()
        notifier.stop()
        told = [service.recv(100).decode() for _ in range(5)]
    assert told == ["READY=1", "WATCHDOG=1", "WATCHDOG=1", "WATCHDOG_USEC=120000000", "STOPPING=1"]


@pytest.mark.parametrize(("interval_us", "pid"), [("1", "1"), ("1", "no number"), ("１", "")])
def test_a_watchdog_for_another_process_or_without_a_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interval_us: str, pid: str
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as service:
        service.bind(str(tmp_path / "notify"))
        service.settimeout(10)
        for name, value in (("NOTIFY_SOCKET", str(tmp_path / "notify")), ("WATCHDOG_PID", pid or str(os.getpid()))):
            monkeypatch.setenv(name, value)
        monkeypatch.setenv("WATCHDOG_USEC", interval_us)
        notifier = ServiceNotifier()
        for _ in range(3):
            notifier.beat()
            time.sleep(0.001)
        notifier.close()
        notifier.stop()
        assert [service.recv(100).decode() for _ in range(2)] == ["READY=1", "STOPPING=1"]


def test_the_end_of_a_run_is_told_before_sinks_are_completed() -> None:
    """A watchdog must not end the program while a recording is completed on a slow disk."""
    keeper, ends = Keeper(), []
    configuration = live_config()
    loop = LiveLoop(
        Paced(ListSource(night_frames(2)), math.inf),
        lambda: Pipeline(configuration),
        configuration,
        sinks=[keeper],
        at_end=lambda: ends.extend(["told", *keeper.ends]),
    )
    loop.run()
    assert ends == ["told"]
    assert keeper.ends == ["close"]


def test_service_notifier_whose_socket_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "notify"
    monkeypatch.setenv("WATCHDOG_USEC", "soon")
    for address in (str(path), "@nobody", str(path) * 9):
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        notifier = ServiceNotifier()
        notifier.beat()
        notifier.stop()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as never_read:
        never_read.bind(str(path))
        monkeypatch.setenv("NOTIFY_SOCKET", str(path))
        notifier = ServiceNotifier()

        def stop_often() -> None:
            for _ in range(5000):
                notifier.stop()

        ending = threading.Thread(target=stop_often, daemon=True)
        ending.start()
        ending.join(30)
        assert not ending.is_alive()


def test_service_notifier_without_a_service(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    monkeypatch.setattr(socket, "socket", None)
    ServiceNotifier().beat()


def test_loops_of_one_process_give_the_switch_interval_back() -> None:
    """The one that began first may end first."""
    before_s = sys.getswitchinterval()
    first, second = quick_switching(), quick_switching()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
    second.__exit__(None, None, None)
    assert sys.getswitchinterval() == before_s
