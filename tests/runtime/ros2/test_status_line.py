"""The line says what the nodes report; no node is started."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from foreglow.photometry import NUM_LEDS
from foreglow.runtime.ros2 import status_line
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.node import diagnostics
from foreglow.runtime.ros2.results import beam_message
from foreglow.runtime.ros2.status_line import STALE_S, StatusLine
from foreglow.types import BeamCommand, BeamMode

pytestmark = pytest.mark.ros


class NoNode:
    """Takes subscriptions, and hands messages to them."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Any] = {}

    def create_subscription(self, _: Any, topic: str, callback: Any, __: Any) -> None:
        self.callbacks[topic] = callback


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> NoNode:
    node, now = NoNode(), iter(range(100))
    monkeypatch.setattr(status_line, "make_ros_node", lambda *_: node)
    monkeypatch.setattr(status_line, "Receiver", lambda _: None)
    monkeypatch.setattr("foreglow.runtime.ros2.status_line.time.monotonic", lambda: float(next(now)))
    return node


def report(ros: NoNode, name: str, frames: int, dropped: int = 0, *faults: str) -> None:
    values = {"frames": str(frames), "dropped": str(dropped), "faults": " ".join(faults)}
    ros.callbacks["/diagnostics"](diagnostics(name, Header(0), faults, values))


def test_the_line_has_frames_losses_beam_and_faults(ros: NoNode) -> None:
    line = StatusLine(["detector", "beam"])
    assert line.text(0.0) == "0 frames, 0.0 a second; no command yet; starting detector, beam"
    report(ros, "detector", 20, 3)
    report(ros, "beam", 18)
    assert line.text(1.0) == "18 frames, 0.0 a second; no command yet; dropped detector 3"
    levels = np.full((2, NUM_LEDS), 0.5)
    ros.callbacks["beam"](beam_message(Header(5), BeamCommand(5, BeamMode.GLARE_FREE, levels)))
    report(ros, "detector", 38, 3)
    report(ros, "beam", 36, 0, "input_missing")
    assert line.text(3.0) == "36 frames, 9.0 a second; glare-free; dropped detector 3; faults input_missing"
    assert line.text(3.0 + STALE_S).endswith("silent detector, beam")


def test_a_node_that_starts_again_counts_from_there(ros: NoNode) -> None:
    line = StatusLine(["beam"])
    for frames in (100, 2, 20):
        report(ros, "beam", frames)
        text = line.text(float(frames == 20) + 1.0)
    assert text == "20 frames, 18.0 a second; no command yet"


def test_what_is_over_is_not_said_to_go_on(ros: NoNode) -> None:
    """A beam that had died still had light, and frames that had stopped still their rate."""
    line = StatusLine(["tracking", "beam"])
    ros.callbacks["beam"](beam_message(Header(5), BeamCommand(5, BeamMode.GLARE_FREE, np.full((2, NUM_LEDS), 0.5))))
    for second, frames in enumerate((18, 36, 36, 36, 36)):
        report(ros, "tracking", 2 * frames)
        report(ros, "beam", frames)
        text = line.text(2.0 * second)
        if second == 1:
            assert text == "36 frames, 9.0 a second; glare-free"
    assert text == "36 frames, 0.0 a second; no command"
    report(ros, "tracking", 90)
    assert line.text(12.5) == "90 frames, 0.0 a second; no command; silent beam"
    assert line.text(100.0) == "0 frames, 0.0 a second; no command; silent tracking, beam"


def test_what_others_report_does_no_harm(ros: NoNode) -> None:
    """The network's topics are open to all: a number that is none ended the network, and names were kept for ever."""
    line = StatusLine(["beam"])
    for name, frames in (("beam", "many"), ("beam", "9" * 5000), *((f"node {k}", "1") for k in range(50))):
        ros.callbacks["/diagnostics"](diagnostics(name, Header(0), (), {"frames": frames}))
        assert line.text(0.0).startswith("0 frames, ")
    assert list(line._reports) == ["beam"]
    report(ros, "beam", 1, 0, "\x1b[2J")
    assert line.text(0.0).endswith("faults \\x1b[2J")
