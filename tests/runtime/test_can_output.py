"""Commands into CAN logs and onto buses: what is read back says the same."""

from __future__ import annotations

import errno
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.beam.messages import (
    GAPS_ID,
    LEVELS_IDS,
    NUM_COUNTS,
    RAMP_S,
    CanFrame,
    CommandEncoder,
    decode_gaps,
    decode_levels,
    decode_part,
)
from foreglow.beam.receiver import LampReceiver, ReceiverConfig
from foreglow.config import BeamConfig, GuardConfig
from foreglow.photometry import NUM_LEDS
from foreglow.runtime.can_output import LOG_SUFFIXES, MAX_SEND_S, CanBus, CanLogSink
from foreglow.runtime.live.outlet import LIMIT_S
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, Proposals

can = pytest.importorskip("can")

MS = 1_000_000
PERIOD = 55 * MS
IMAGE = np.zeros((2, 2), np.uint8)


def command_at(time_ns: int, level: float = 1.0) -> BeamCommand:
    return BeamCommand(
        time_ns, BeamMode.GLARE_FREE, np.full((2, NUM_LEDS), level), np.array([[-0.1, 0.05]]), np.array([77.0])
    )


def result_at(time_ns: int, level: float = 1.0) -> tuple[Frame, FrameResult]:
    beam = command_at(time_ns, level)
    return Frame(IMAGE, time_ns), FrameResult(0, time_ns, Proposals(np.zeros((0, 4), np.int32)), None, beam=beam)


def without_beam(time_ns: int) -> tuple[Frame, FrameResult]:
    return Frame(IMAGE, time_ns), FrameResult(0, time_ns, Proposals(np.zeros((0, 4), np.int32)), None)


def read(path: Path, suffix: str) -> list[Any]:
    reader = {".asc": can.ASCReader, ".blf": can.BLFReader, ".log": can.CanutilsLogReader}[suffix]
    with path.open("rb" if suffix == ".blf" else "r") as file, reader(file) as log:
        return list(log)


@pytest.mark.parametrize("suffix", [".blf", ".log"])
def test_times_that_are_no_dates(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"beam{suffix}"
    sink = CanLogSink(path)
    for number in range(2):
        sink.write(*result_at(10_000 * 10**9 + number * PERIOD))
    sink.close()
    found = read(path, suffix)
    assert found[0].timestamp == pytest.approx(10_000.0, abs=1e-3)
    assert found[-1].timestamp == pytest.approx(10_000.0 + PERIOD / 1e9, abs=1e-3)


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
def test_log_comes_back(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"beam{suffix}"
    sink, encoder = CanLogSink(path, ramp_s=1.0), CommandEncoder(1.0)
    expected: list[CanFrame] = []
    for number in range(6):
        frame, result = result_at(1_700_000_000 * 10**9 + number * PERIOD, number / 5)
        sink.write(frame, result)
        assert result.beam is not None
        expected += encoder.frames(result.beam)
        sink.write(*without_beam(frame.timestamp_ns + MS))
    assert not path.exists()
    sink.close()
    assert list(tmp_path.iterdir()) == [path]
    messages = read(path, suffix)
    assert [(message.arbitration_id, bytes(message.data)) for message in messages] == expected
    assert all(message.is_fd and not message.is_extended_id for message in messages)
    assert suffix == ".log" or not any(message.is_rx for message in messages)  # our own commands are sent, not received
    times_s = np.array([message.timestamp for message in messages])
    np.testing.assert_allclose(times_s - times_s[0], np.repeat(np.arange(6), 5) * PERIOD / 1e9, atol=2e-6)
    if suffix != ".asc":
        assert times_s[0] == pytest.approx(1_700_000_000, abs=2e-3)


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
def test_times_from_zero(tmp_path: Path, suffix: str) -> None:
    sink = CanLogSink(tmp_path / "beam.partial", suffix=suffix)
    for number in range(3):
        sink.write(*result_at(number * PERIOD))
    sink.close()
    messages = read(tmp_path / "beam.partial", suffix)
    np.testing.assert_allclose([message.timestamp for message in messages[::5]], [0, 0.055, 0.11], atol=2e-6)
    assert (
        decode_levels([CanFrame(message.arbitration_id, bytes(message.data)) for message in messages[:4]]).levels.min()
        == 1.0
    )
    assert decode_gaps(messages[4].arbitration_id, bytes(messages[4].data)).gap_ranges_m == [76.0]


def test_sequences_follow_each_other(tmp_path: Path) -> None:
    """Each has times of its own; in the log, time only goes forward, and a second lies between them."""
    sink = CanLogSink(tmp_path / "beam.log")
    times_ms = {"S00001": (0, 55), "S00002": (0, 55), "S00003": (5000, 5055)}
    for sequence, its in times_ms.items():
        for time_ms in its:
            frame, result = result_at(time_ms * MS)
            sink.write(Frame(frame.image, frame.timestamp_ns, sequence=sequence), result)
    sink.close()
    messages = read(tmp_path / "beam.log", ".log")[4::5]
    expected_ms = [0, 55, 1055, 1110, 5000, 5055]
    np.testing.assert_allclose([message.timestamp for message in messages], np.array(expected_ms) / 1e3, atol=2e-6)
    times = [decode_gaps(message.arbitration_id, bytes(message.data)).header.time_ms for message in messages]
    assert times == expected_ms


def test_gaps_alone(tmp_path: Path) -> None:
    sink = CanLogSink(tmp_path / "beam.log", has_levels=False)
    for number in range(3):
        sink.write(*result_at(number * PERIOD))
    sink.close()
    messages = read(tmp_path / "beam.log", ".log")
    headers = [decode_gaps(message.arbitration_id, bytes(message.data)).header for message in messages]
    assert [header.counter for header in headers] == [0, 1, 2]


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
def test_without_commands(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"beam{suffix}"
    sink = CanLogSink(path)
    sink.write(*without_beam(0))
    sink.close()
    assert read(path, suffix) == []


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
@pytest.mark.parametrize("num_written", [0, 3])
def test_discarded_log_leaves_nothing(tmp_path: Path, suffix: str, num_written: int) -> None:
    path = tmp_path / f"beam{suffix}"
    path.write_text("older")
    sink = CanLogSink(path)
    for number in range(num_written):
        sink.write(*result_at(number * PERIOD))
    sink.discard()
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_text() == "older"


def test_discarding_after_closing_does_nothing(tmp_path: Path) -> None:
    sink = CanLogSink(tmp_path / "beam.log")
    sink.write(*result_at(0))
    sink.close()
    sink.discard()
    assert len(read(tmp_path / "beam.log", ".log")) == 5


def test_other_kinds_of_logs(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"beam\.csv: expected a CAN log that ends in \.asc, \.blf, \.log, got '\.csv'"
    ):
        CanLogSink(tmp_path / "beam.csv")
    assert list(tmp_path.iterdir()) == []


def test_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"beam\.log"):
        CanLogSink(tmp_path / "no" / "beam.log")


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = CanLogSink(tmp_path / "beam.log")

    def fail(_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sink, "_log", fail)
    with pytest.raises(OSError, match=r"No space left on device.*beam\.log"):
        sink.write(*result_at(0))


@pytest.mark.parametrize("make", [lambda: CanLogSink(Path("beam.log")), lambda: CanBus("virtual:x")])
def test_without_the_extra(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(ModuleNotFoundError) as error:
        make()
    assert error.value.name == "can"


@pytest.mark.parametrize(("interface", "channel"), [("virtual", "foreglow-beam"), ("udp_multicast", "239.74.163.2")])
def test_bus_with_lamps(interface: str, channel: str) -> None:
    if interface == "udp_multicast":
        pytest.importorskip("msgpack")
    try:
        lamps_bus = can.Bus(interface=interface, channel=channel, fd=True)
    except (OSError, can.CanError) as error:
        if interface == "virtual":
            raise
        pytest.skip(f"multicast is not possible in this network: {error}")
    with lamps_bus:
        bus, lamps = CanBus(f"{interface}:{channel}"), LampReceiver()
        for number in range(6):
            bus.send(command_at(number * PERIOD, 1.0))
            for _ in range(5):
                message = lamps_bus.recv(timeout=2.0)
                assert message is not None
                assert message.arbitration_id in (*LEVELS_IDS, GAPS_ID)
                lamps.receive(number * PERIOD + 20 * MS, message.arbitration_id, bytes(message.data))
        bus.close()
        levels, faults = lamps.shining(5 * PERIOD + 20 * MS)
        assert (levels == 1.0).all()
        assert faults == ()
        assert not lamps.shining(5 * PERIOD + 221 * MS)[0].any()


def test_other_interfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    for failure in (TypeError("no argument"), NameError("nican"), ImportError("no such driver"), AttributeError("dll")):

        def fail(failure: Exception = failure, **_: object) -> None:
            raise failure

        with monkeypatch.context() as patched:
            patched.setattr(can, "Bus", fail)
            with pytest.raises(ValueError, match=f"own:1: expected a bus whose driver .*{failure}"):
                CanBus("own:1")
    with pytest.raises(ValueError, match="nonsense:can0: expected an interface of python-can"):
        CanBus("nonsense:can0")


@pytest.mark.parametrize("group", ["10.0.0.1", "255.255.255.255", "::1", "239.74.163.2:43113", "lamps", ""])
def test_a_group_that_is_none(group: str) -> None:
    with pytest.raises(ValueError, match=rf"^udp_multicast:{group}: expected the address of a multicast group"):
        CanBus(f"udp_multicast:{group}")


@pytest.mark.parametrize("channel", ["virtual:", "socketcan:"])
def test_a_channel_without_a_name(channel: str) -> None:
    with pytest.raises(ValueError, match=f"^{channel}: expected the name of a channel behind the colon"):
        CanBus(channel)


def test_a_channel_that_socketcan_does_not_have() -> None:
    with pytest.raises(OSError, match=r"^foreglow99: .*; expected a bus of SocketCAN, or INTERFACE:CHANNEL of"):
        CanBus("foreglow99")


def test_bus_that_does_not_take_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = CanBus("virtual:foreglow-full")

    def fail(_: Any, timeout: float) -> None:
        assert 0 < timeout < PERIOD / 1e9
        raise can.CanOperationError("buffer full")

    monkeypatch.setattr(bus, "_bus", type("Bus", (), {"send": staticmethod(fail), "shutdown": lambda _: None})())
    with pytest.raises(OSError, match="virtual:foreglow-full: buffer full"):
        bus.send(command_at(0))
    bus.close()


def test_the_rest_of_a_command_is_not_sent_when_its_driver_hung(monkeypatch: pytest.MonkeyPatch) -> None:
    """Low beam was decided meanwhile, and the command with light went on when the driver did."""
    bus, sent = CanBus("virtual:foreglow-hanging"), list[int]()

    def send(message: Any, **_: Any) -> None:
        if len(sent) == 2:
            time.sleep(MAX_SEND_S + 0.05)
        sent.append(message.arbitration_id)

    monkeypatch.setattr(bus._bus, "send", send)
    with pytest.raises(OSError, match=r"foreglow-hanging: expected a bus that accepts a command within 0\.15 s"):
        bus.send(command_at(0))
    assert sent == list(LEVELS_IDS[:3])
    bus.send(command_at(PERIOD, 0.0))  # the next one is whole
    assert sent[3:] == [*LEVELS_IDS, GAPS_ID]
    bus.close()


def test_a_bus_that_vanishes_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """As an adapter that is unplugged and comes back: no command was ever sent again."""
    monkeypatch.setattr("foreglow.runtime.can_output.REOPEN_S", 0.1)
    is_there, sent, closed = [True], list[Any](), list[Any]()

    class Adapter:
        def __init__(self) -> None:
            self._is_known = True

        def send(self, message: Any, **_: object) -> None:
            self._is_known &= is_there[0]
            if not self._is_known:
                raise can.CanOperationError("No such device")
            sent.append(message)

        def shutdown(self) -> None:
            closed.append(self)

    def connect(**_: object) -> Adapter:
        if not is_there[0]:
            raise OSError(19, "No such device")
        return Adapter()

    monkeypatch.setattr(can, "Bus", connect)
    bus = CanBus("can0")
    bus.send(command_at(0))
    is_there[0] = False
    for number in range(1, 4):
        with pytest.raises(OSError, match=r"^can0: .*No such device"):
            bus.send(command_at(number * PERIOD))
        time.sleep(0.11)
    is_there[0] = True
    bus.send(command_at(4 * PERIOD))
    assert len(sent) == 10
    counters = [decode_part(message.arbitration_id, bytes(message.data)).header.counter for message in sent[::5]]
    assert (counters[1] - counters[0]) % NUM_COUNTS == 4
    bus.close()
    assert len(closed) == 2


@pytest.mark.parametrize("max_age_s", [0.3, None])
def test_lamps_do_not_carry_out_what_comes_after_a_hang(max_age_s: float | None) -> None:
    """Also where a driver keeps a whole command back itself: lamps without commands are at low beam by then."""
    encoder, lamps = CommandEncoder(), LampReceiver(ReceiverConfig(max_age_s=max_age_s))
    for number in range(6):
        for frame in encoder.frames(command_at(number * PERIOD)):
            lamps.receive(number * PERIOD, *frame)
    assert lamps.shining(5 * PERIOD)[0].all()
    late_ns = 6 * PERIOD + round(LIMIT_S * 1e9)
    for frame in encoder.frames(command_at(6 * PERIOD)):
        lamps.receive(late_ns, *frame)
        assert not lamps.shining(late_ns)[0].any()


def test_bus_that_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**_: Any) -> None:
        raise can.CanInitializationError("no such device")

    monkeypatch.setattr(can, "Bus", fail)
    with pytest.raises(OSError, match="can7: no such device"):
        CanBus("can7")


def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    sink = CanLogSink(tmp_path / "beam.blf.partial", suffix=".blf")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, hard))
    try:
        with pytest.raises(OSError, match="File too large"):  # noqa: PT012  until its buffers are full
            for number in range(5000):
                sink.write(*result_at(number * PERIOD))
            sink.close()
        sink.discard()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_a_driver_that_fails_while_sending(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = CanBus("virtual:failing")

    def fail(*_: object, **__: object) -> None:
        raise TypeError("not what the driver takes")

    monkeypatch.setattr(bus._bus, "send", fail)
    with pytest.raises(OSError, match="virtual:failing: not what the driver takes"):
        bus.send(command_at(0))
    bus.close()


def test_lamps_that_take_gaps_brighten_slowly_unless_told_otherwise(tmp_path: Path) -> None:
    """As slowly as policies and the guard let light return."""
    assert max(BeamConfig().restore_s, GuardConfig().brightening_s) == RAMP_S
    sink = CanLogSink(tmp_path / "beam.log", has_levels=False)
    sink.write(*result_at(PERIOD))
    sink.close()
    with can.Bus(interface="virtual", channel="foreglow-ramp") as lamps_bus:
        bus = CanBus("virtual:foreglow-ramp", has_levels=False)
        bus.send(command_at(PERIOD))
        received = lamps_bus.recv(timeout=2.0)
        bus.close()
    for message in (received, *read(tmp_path / "beam.log", ".log")):
        assert decode_gaps(GAPS_ID, bytes(message.data)).ramp_s >= RAMP_S
