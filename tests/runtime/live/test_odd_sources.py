"""Sources of one's own that go wrong: the loop ends with a line, with what it had, and in low beam."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks.faulty import Lamps, ScriptedCamera, live_config
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveEndedError, LiveLoop, Paced
from foreglow.types import Frame
from tests.runtime.live.stand_ins import run_live
from tests.stand_ins import ListSource

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("thing", ["hello", None])
def test_a_source_that_yields_no_frames_ends_with_a_line(thing: Any, drive: list[Frame]) -> None:
    class Foreign(Paced):
        def __iter__(self) -> Iterator[Frame]:
            yield from drive[:3]
            yield thing

    with pytest.raises(LiveEndedError, match=rf"expected a Frame, got {type(thing).__name__}$"):
        run_live(Foreign(ListSource(drive), math.inf), live_config())


@pytest.mark.parametrize("num_frames", [0, 3])
def test_what_a_source_raises_unforeseen_costs_no_results(num_frames: int, drive: list[Frame]) -> None:
    class Broken(Paced):
        def __iter__(self) -> Iterator[Frame]:
            yield from drive[:num_frames]
            raise IndexError("out of range")

    source = Broken(ListSource(drive), math.inf)
    if num_frames == 0:
        with pytest.raises(IndexError, match="out of range"):
            run_live(source, live_config())
        return
    with pytest.raises(LiveEndedError, match="out of range") as ended:
        run_live(source, live_config())
    assert isinstance(ended.value.__cause__, IndexError)
    assert ended.value.summary.run.num_frames == num_frames
    assert not ended.value.summary.run.is_complete


@pytest.mark.parametrize(
    ("wrong", "words"),
    [(1.5, "now_ns: expected nanoseconds as a whole number: .*float"), (RuntimeError("clock"), "^clock$")],
)
def test_a_source_whose_clock_fails_ends_the_loop_with_low_beam(drive: list[Frame], wrong: Any, words: str) -> None:
    num_asked = 0

    class Odd(ScriptedCamera):
        def now_ns(self) -> int:
            nonlocal num_asked
            num_asked += 1
            if num_asked < 200:
                return super().now_ns()
            if isinstance(wrong, Exception):
                raise wrong
            return wrong  # type: ignore[no-any-return]

    lamps = Lamps()
    configuration = live_config()
    loop = LiveLoop(Odd(drive, is_live=True), lambda: Pipeline(configuration), configuration, outputs=[lamps])
    with pytest.raises(LiveEndedError, match=words) as ended:
        loop.run()
    assert 0 < ended.value.summary.run.num_frames < len(drive)
    assert lamps.is_low[-1]
