"""What belongs to one frame is put together, the newest wins, and nothing that is lost stalls what follows."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy")  # its header is ROS's

from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.join import Join

pytestmark = pytest.mark.ros

MS = 1_000_000
FRAME = 55 * MS


def header(number: int, sequence: str = "S") -> Header:
    return Header(1_000 * FRAME + number * FRAME, sequence)


def test_a_frame_is_whole_with_its_last_part() -> None:
    join = Join(("tracks", "image"))
    join.put("image", header(0), "i0", 1)
    assert join.take(2) is None
    assert join.missing == ("tracks",)
    join.put("tracks", header(0), "t0", 3)
    joined = join.take(4)
    assert joined == (header(0), {"image": "i0", "tracks": "t0"}, 3)
    assert join.take(5) is None
    assert join.num_dropped == 0


def test_the_newest_wins() -> None:
    join = Join(("tracks", "image"))
    for number in range(3):
        join.put("image", header(number), number, 1)
        join.put("tracks", header(number), number, 1)
    joined = join.take(2)
    assert joined is not None
    assert joined.header == header(2)
    assert join.num_dropped == 2
    assert join.take(3) is None


def test_a_lost_part_stalls_no_later_frame() -> None:
    join = Join(("tracks", "image"))
    for number in range(100):
        join.put("image", header(number), number, 1)
        if number % 3 == 0:
            join.put("tracks", header(number), number, 1)
            joined = join.take(2)
            assert joined is not None
            assert joined.header == header(number)
    assert join.num_dropped == 66


def test_the_image_after_next_does_not_drive_out_the_one_that_is_waited_for() -> None:
    join = Join(("tracks", "image"))
    for number in range(Join.CAPACITY):
        join.put("image", header(number), number, 1)
    join.put("tracks", header(0), "t", 2)
    joined = join.take(3)
    assert joined is not None
    assert joined.messages["image"] == 0


def test_a_sequence_is_a_part_of_a_frames_name() -> None:
    join = Join(("tracks", "image"))
    join.put("image", header(0, "A"), "i", 1)
    join.put("tracks", header(0, "B"), "t", 1)
    assert join.take(2) is None


def test_samples_are_taken_as_of_the_frames_time() -> None:
    join = Join(("image",), ("twist",))
    for number, ms in enumerate((-20, -5, 5, 15)):
        join.put("twist", Header(header(0).timestamp_ns + ms * MS), number, 1)
    join.put("image", header(0), "i", 2)
    joined = join.take(3)
    assert joined is not None
    assert joined.messages["twist"] == 1


def test_a_sample_is_waited_for_while_its_topic_lives() -> None:
    join = Join(("image",), ("twist",))
    join.put("image", header(0), "i", 0)
    assert join.take(0) is not None  # nobody has ever told
    join.put("twist", header(0), "old", 0)
    join.put("image", header(1), "i", FRAME)
    assert join.take(FRAME) is None
    assert join.is_waiting
    join.put("twist", header(1), "new", FRAME + MS)
    joined = join.take(FRAME + MS)
    assert joined is not None
    assert joined.messages["twist"] == "new"
    assert not join.is_waiting


def test_a_patient_join_waits_for_a_sample_that_is_late() -> None:
    join = Join(("image",), ("twist",), patience_ns=10_000 * MS)
    join.put("twist", header(0), "old", 0)
    join.put("image", header(1), "i", FRAME)
    assert join.take(FRAME + Join.PATIENCE_NS + Join.HOLD_NS) is None
    join.put("twist", header(1), "new", FRAME + 9_000 * MS)
    joined = join.take(FRAME + 9_000 * MS)
    assert joined is not None
    assert joined.messages["twist"] == "new"


def test_a_late_frame_finds_its_sample_among_many() -> None:
    """A thousand messages a second had pushed out those of a frame that came 100 ms late: the speed was unknown."""
    join = Join(("image",), ("twist",), fast=("twist",))
    for number in range(2000):
        join.put("twist", Header(number * MS), number, number * MS)
    join.put("image", Header(1900 * MS), "image", 2000 * MS)
    joined = join.take(2000 * MS)
    assert joined is not None
    assert joined.messages == {"image": "image", "twist": 1900}


def test_nothing_is_waited_for_too_long_or_held_too_long() -> None:
    join = Join(("image",), ("twist",))
    join.put("twist", header(0), "old", 0)
    join.put("image", header(1), "i", FRAME)
    joined = join.take(FRAME + Join.PATIENCE_NS)
    assert joined is not None
    assert joined.messages["twist"] == "old"
    late = Header(header(0).timestamp_ns + Join.HOLD_NS + 1)
    join.put("image", late, "i", Join.HOLD_NS + 1)
    joined = join.take(Join.HOLD_NS + 1)  # its topic is quiet by now
    assert joined is not None
    assert "twist" not in joined.messages


@pytest.mark.parametrize(("step_ms", "late_ms"), [(100, 0), (16, 18)], ids=["rare", "late"])
def test_a_frame_that_waits_is_not_held_up_by_the_next(step_ms: int, late_ms: int) -> None:
    """Each frame of a camera above 50 Hz began to wait anew, so that next to none was ever worked on."""
    join = Join(("image",), ("twist",))
    taken_ms = []
    for now_ms in range(2000):
        stamp_ms = now_ms - late_ms
        if stamp_ms >= 0 and stamp_ms % step_ms == 0:
            join.put("twist", Header(stamp_ms * MS), stamp_ms, now_ms * MS)
        if now_ms % 16 == 0:
            join.put("image", Header(now_ms * MS), now_ms, now_ms * MS)
        joined = join.take(now_ms * MS)
        if joined is not None:
            taken_ms.append(joined.messages["image"])
            assert now_ms - taken_ms[-1] <= Join.PATIENCE_NS // MS
    assert len(taken_ms) > 110
    assert max(later - before for before, later in itertools.pairwise(taken_ms)) <= 32


class Clock:
    """ROS time, and the steady clock beside it."""

    def __init__(self) -> None:
        self.ros_ns = 1_000 * FRAME
        self.steady_ns = 5 * MS

    def pass_by(self, time_ns: int) -> None:
        self.ros_ns += time_ns
        self.steady_ns += time_ns


def sample_at(join: Join, clock: Clock) -> object:
    """What a frame that is taken now has of the topic."""
    join.put("image", Header(clock.ros_ns), "i", clock.steady_ns)
    joined = join.take(clock.steady_ns)
    assert joined is not None
    return joined.messages.get("twist")


@pytest.mark.parametrize("ahead_ns", [Join.AHEAD_NS + 1, 3_000 * MS])
def test_a_sample_that_is_stamped_ahead_is_used_neither_now_nor_later(ahead_ns: int) -> None:
    """It was believed when its time had come: light stayed on for as long after the publisher died."""
    clock = Clock()
    join = Join(("image",), ("twist",), patience_ns=0, clock_ns=lambda: clock.ros_ns)
    join.put("twist", Header(clock.ros_ns), "good", clock.steady_ns)
    join.put("twist", Header(clock.ros_ns + ahead_ns), "ahead", clock.steady_ns)
    assert join.ahead_s(clock.steady_ns) == {"twist": ahead_ns / 1e9}
    assert sample_at(join, clock) == "good"
    clock.pass_by(ahead_ns)
    assert sample_at(join, clock) != "ahead"
    assert bool(join.ahead_s(clock.steady_ns)) == (ahead_ns <= Join.HOLD_NS)


def test_a_sample_that_is_a_little_ahead_is_held_no_longer_than_others() -> None:
    clock = Clock()
    join = Join(("image",), ("twist",), patience_ns=0, clock_ns=lambda: clock.ros_ns)
    join.put("twist", Header(clock.ros_ns + Join.AHEAD_NS), "early", clock.steady_ns)
    assert not join.ahead_s(clock.steady_ns)
    clock.pass_by(Join.HOLD_NS)
    assert sample_at(join, clock) == "early"
    clock.pass_by(1)
    assert sample_at(join, clock) is None


def test_a_clock_that_is_set_back_makes_samples_ahead() -> None:
    clock = Clock()
    join = Join(("image",), ("twist",), patience_ns=0, clock_ns=lambda: clock.ros_ns)
    for before_ms in (1500, 50):
        join.put("twist", Header(clock.ros_ns - before_ms * MS), before_ms, clock.steady_ns)
    clock.ros_ns -= 1_000 * MS
    assert sample_at(join, clock) == 1500
    assert join.ahead_s(clock.steady_ns) == {"twist": 0.95}
    clock.pass_by(1_000 * MS)
    assert sample_at(join, clock) is None


@given(st.lists(st.tuples(st.sampled_from(["tracks", "image", "twist"]), st.integers(0, 12)), max_size=60))
def test_whatever_comes_nothing_grows_and_no_frame_goes_back(puts: list[tuple[str, int]]) -> None:
    join, handed = Join(("tracks", "image"), ("twist",)), []
    for now, (topic, number) in enumerate(puts):
        join.put(topic, header(number), (topic, number), now)
        joined = join.take(now + Join.PATIENCE_NS)
        if joined is not None:
            assert joined.messages["tracks"] == ("tracks", joined.messages["image"][1])
            handed.append(joined)
        assert len(join._frames) <= Join.CAPACITY
    assert sum(topic != "twist" for topic, _ in puts) >= 2 * len(handed)
