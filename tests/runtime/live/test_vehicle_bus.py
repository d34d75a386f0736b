"""Speed and road from a live bus, as from a log."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.datasets.vehicle_logs import VehicleFiles, write_can_log
from foreglow.runtime.live.vehicle_bus import VehicleBus
from foreglow.street import road_from_message
from foreglow.types import EgoMotion, Frame
from tests.datasets.vehicle_logs.messages import message as street_message

can = pytest.importorskip("can")
pytest.importorskip("cantools")


@pytest.fixture
def buses() -> Iterator[tuple[VehicleBus, Any]]:
    bus = VehicleBus("virtual:car")
    with can.Bus(interface="virtual", channel="car", fd=True) as sender:
        yield bus, sender
    bus.close()


def until(is_done: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 20
    while not is_done():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def frame_now() -> Frame:
    return Frame(np.zeros((96, 128), np.uint8), time.monotonic_ns())


def test_what_the_car_tells(tmp_path: Path, buses: tuple[VehicleBus, Any]) -> None:
    bus, sender = buses
    data = VehicleFiles(log=bus.log)
    assert data.motion(frame_now()) is None  # nothing was told yet
    assert data.road(frame_now()) is None
    write_can_log(tmp_path / "car.log", [(0, street_message())], [(1, EgoMotion(25.0, 0.02))])
    for message in can.LogReader(tmp_path / "car.log"):
        sender.send(message)
    until(lambda: data.motion(frame_now()) is not None)
    motion = data.motion(frame_now())
    assert motion is not None
    assert (motion.speed_mps, motion.yaw_rate_radps) == pytest.approx((25.0, 0.02))
    road, expected = data.road(frame_now()), road_from_message(street_message())
    assert road is not None
    assert expected is not None
    np.testing.assert_allclose(road.points_m, expected.points_m[: len(road)])  # straight, and we drive on
    time.sleep(0.6)
    assert data.motion(frame_now()) is None  # a car that falls silent is not believed for long


def test_broken_frames_are_passed_over(tmp_path: Path, buses: tuple[VehicleBus, Any]) -> None:
    bus, sender = buses
    write_can_log(tmp_path / "car.log", [], [(1, EgoMotion(25.0, 0.02))])
    (message,) = can.LogReader(tmp_path / "car.log")
    sender.send(can.Message(arbitration_id=message.arbitration_id, is_extended_id=message.is_extended_id, data=b"\x01"))
    sender.send(can.Message(arbitration_id=0x7FF, data=b"\x01", is_extended_id=False))
    until(lambda: bus.num_broken == 1)
    sender.send(message)
    until(lambda: not bus.log.is_empty)


def test_what_is_to_be_said_of_the_bus(tmp_path: Path, buses: tuple[VehicleBus, Any]) -> None:
    bus, sender = buses
    assert bus.lines == [
        "virtual:car: expected messages of StreetSegment, StreetPosition, EgoMotion, with values, got none"
    ]
    write_can_log(tmp_path / "car.log", [], [(1, EgoMotion(25.0, 0.02))])
    (message,) = can.LogReader(tmp_path / "car.log")
    for _ in range(3):
        sender.send(can.Message(arbitration_id=message.arbitration_id, is_extended_id=False, data=b"\x01"))
    sender.send(message)
    until(lambda: not bus.log.is_empty)
    (line,) = bus.lines
    assert line.startswith("virtual:car: ")
    assert line.endswith(" (messages left out: 3)")


def test_a_bus_that_vanishes_is_opened_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As an adapter that is unplugged: its socket says so once, and stays silent when the adapter is there again."""
    monkeypatch.setattr("foreglow.runtime.can_output.REOPEN_S", 0.05)
    write_can_log(tmp_path / "car.log", [], [(1, EgoMotion(25.0, 0.02))])
    (message,) = can.LogReader(tmp_path / "car.log")
    opened: list[Any] = []

    class Unplugged:
        def __init__(self) -> None:
            self.errors = [] if opened else [OSError(19, "No such device")]

        def set_filters(self, filters: list[dict[str, Any]]) -> None:
            assert {one["can_id"] for one in filters} >= {message.arbitration_id}

        def recv(self, timeout: float) -> Any:
            if self.errors:
                raise self.errors.pop()
            time.sleep(min(timeout, 0.01))
            return message if len(opened) == 4 else None

        def shutdown(self) -> None:
            pass

    def connect(**_: object) -> Any:
        opened.append(Unplugged())
        if 1 < len(opened) < 4:
            raise OSError(19, "No such device")
        return opened[-1]

    monkeypatch.setattr(can, "Bus", connect)
    bus = VehicleBus("can9")
    until(lambda: bus.log.has("speed"))
    bus.close()
    assert bus.lines == ["can9: failed: [Errno 19] No such device (times it was opened again: 1)"]


def test_a_bus_whose_driver_hangs_does_not_keep_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    is_over = threading.Event()

    class Hanging:
        def recv(self, _: float) -> None:
            is_over.wait(60.0)

        def shutdown(self) -> None:
            pass

    monkeypatch.setattr("foreglow.runtime.live.vehicle_bus.open_bus", lambda *_: Hanging())
    monkeypatch.setattr("foreglow.runtime.live.vehicle_bus.HANGING_S", 0.1)
    bus = VehicleBus("can9")
    bus.close()
    assert any(thread.name.startswith("live ") for thread in threading.enumerate())
    is_over.set()


def test_old_values_are_forgotten() -> None:
    from foreglow.datasets.vehicle_logs import CanLog

    log = CanLog(keep_s=1.0)
    for number in range(100):
        log.add_number("speed", number * 100_000_000, float(number))
    assert len(log._numbers["speed"].times_ns) == 11
    assert (log.first_ns, log.last_ns) == (0, 9_900_000_000)


def test_a_bus_that_is_silent_for_hours_ends_no_camera() -> None:
    from foreglow.datasets.vehicle_logs import CanLog

    log, two_hours_ns = CanLog(keep_s=1.0), 7200 * 10**9
    log.add_number("speed", 0, 20.0)
    log.add_number("yaw_rate", 0, 0.0)
    late = Frame(np.zeros((96, 128), np.uint8), two_hours_ns)
    data = VehicleFiles(log=log, is_live=True)
    assert (data.motion(late), data.road(late), data.is_reported(late)) == (None, None, None)
    log.add_number("speed", two_hours_ns, 20.0)
    log.add_number("yaw_rate", two_hours_ns, 0.0)
    motion = data.motion(late)
    assert motion is not None
    assert motion.speed_mps == 20.0
