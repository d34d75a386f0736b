from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.datasets.simulated import Artifact
from foreglow.lab.simulation.labels.instances import InstanceTracker
from foreglow.lab.simulation.scenes.scene import LabelRule
from tests.lab.simulation.truths import artifact, lamp_artifact

RULE = LabelRule(hold_frames=3, max_instances=2, max_hidden_instances=2)


def ids(artifacts: tuple[Artifact, ...]) -> list[int]:
    return [each.instance_id for each in artifacts]


def test_lamps_keep_their_id_by_name_through_any_gap_and_jump() -> None:
    tracker = InstanceTracker(RULE)
    both = tracker.update(0, [lamp_artifact("low_left", 0), lamp_artifact("low_right", 9)])
    assert ids(both) == [0, 1]
    for _ in range(20):
        assert tracker.update(0, []) == ()
    assert ids(tracker.update(0, [lamp_artifact("low_right", 900)])) == [1]
    assert ids(tracker.update(0, [lamp_artifact("low_right", 900), lamp_artifact("low_left", 700)])) == [1, 0]


def test_other_vehicles_and_rear_lamps_have_ids_of_their_own() -> None:
    tracker = InstanceTracker(RULE)
    first = tracker.update(0, [lamp_artifact(), artifact(), lamp_artifact(is_rear=True)])
    second = tracker.update(1, [lamp_artifact(), artifact()])
    assert sorted(ids(first) + ids(second)) == [0, 1, 2, 3, 4]


def test_two_spots_keep_their_ids_while_they_move_and_swap_their_order() -> None:
    tracker = InstanceTracker(RULE)
    for step in range(10):
        left, right = artifact(100 + 8 * step, grey=20), artifact(200 + 12 * step, grey=20 + step)
        pair = [left, right] if step % 2 else [right, left]
        found = {each.position_px: each.instance_id for each in tracker.update(0, pair)}
        assert found == {left.position_px: 1, right.position_px: 0}


def test_the_sum_of_distances_counts_not_the_nearest_first() -> None:
    tracker = InstanceTracker(RULE)
    tracker.update(0, [artifact(100), artifact(120)])
    # Both move by 15; the first one's old place is now nearest to nothing, the second's to the first.
    assert ids(tracker.update(0, [artifact(115), artifact(135)])) == [0, 1]


def test_the_gate_widens_with_nearness_and_missing_frames_and_shrinks_with_the_image() -> None:
    def is_same(moved_px: float, depth_m: float, gap: int = 0, width_scale: float = 1.0) -> bool:
        tracker = InstanceTracker(RULE, width_scale)
        tracker.update(0, [artifact(100, depth_m=depth_m)])
        for _ in range(gap):
            tracker.update(0, [])
        return ids(tracker.update(0, [artifact(100 + moved_px, depth_m=depth_m)])) == [0]

    assert is_same(25, math.nan)
    assert not is_same(35, 200)
    assert is_same(35, 50)
    assert is_same(150, 12)
    assert not is_same(210, 2)
    assert is_same(35, 200, gap=1)
    assert not is_same(25, 200, width_scale=0.5)


def test_another_kind_of_surface_counts_as_farther() -> None:
    tracker = InstanceTracker(RULE)
    tracker.update(0, [artifact(100, kind="road"), artifact(118, kind="rail")])
    crossed = tracker.update(0, [artifact(112, kind="road"), artifact(106, kind="rail")])
    assert ids(crossed) == [0, 1]


def test_a_rear_light_never_continues_a_front_light() -> None:
    tracker = InstanceTracker(RULE)
    tracker.update(0, [artifact()])
    assert ids(tracker.update(0, [artifact(is_rear=True)])) == [1]


def test_kept_through_a_gap_of_hold_frames_and_not_longer() -> None:
    for gap, expected in ((3, 0), (4, 1)):
        tracker = InstanceTracker(RULE)
        tracker.update(0, [artifact()])
        for _ in range(gap):
            tracker.update(0, [])
        assert ids(tracker.update(0, [artifact()])) == [expected]


def marks(pattern: str, rule: LabelRule = RULE) -> str:
    """What becomes of a spot that meets the rule (M), the divided one (d), or is missing (.)."""
    tracker = InstanceTracker(rule)
    result = ""
    for sign in pattern:
        found = tracker.update(0, [artifact(is_doubtful=sign == "d")] if sign != "." else [])
        result += "." if not found else "d" if found[0].is_doubtful else "M"
        assert set(ids(found)) <= {0}
    return result


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("ddMdd", "ddMMM"),
        ("Mddddd", "MMMMdd"),
        ("MdMddddM", "MMMMMMdM"),
        ("M.d.d", "M.M.M"),
        ("ddddd", "ddddd"),
    ],
)
def test_a_marked_instance_does_not_blink(pattern: str, expected: str) -> None:
    assert marks(pattern) == expected


def test_without_hold_frames_nothing_is_held() -> None:
    assert marks("MdM", LabelRule(hold_frames=0)) == "MdM"


def test_never_more_than_max_instances_and_those_that_were_there_stay() -> None:
    tracker = InstanceTracker(RULE)
    tracker.update(0, [artifact(0, grey=9), artifact(200, grey=8)])
    third = artifact(400, grey=30)
    weak = artifact(200, grey=8, is_doubtful=True)
    history = [tracker.update(0, [third, artifact(0, grey=9), weak]) for _ in range(5)]
    marked = [[each.position_px[0] for each in found if not each.is_doubtful] for found in history]
    assert marked == [[0, 200]] * 3 + [[400, 0]] * 2
    assert {tuple(ids(found)) for found in history} == {(2, 0, 1)}


def test_one_while_hidden_and_more_in_sight() -> None:
    tracker = InstanceTracker(LabelRule(max_instances=2, max_hidden_instances=1))
    pair = [artifact(0, grey=9), artifact(200, grey=8)]
    assert [each.is_doubtful for each in tracker.update(0, pair)] == [False, True]
    assert [each.is_doubtful for each in tracker.update(0, [*pair, lamp_artifact()])] == [False, False, False]


@pytest.mark.slow
@given(st.lists(st.lists(st.tuples(st.floats(0, 1280), st.booleans()), max_size=6), max_size=8))
def test_ids_are_unique_and_everything_else_stays(frames: list[list[tuple[float, bool]]]) -> None:
    tracker = InstanceTracker(RULE)
    for spots in frames:
        given_artifacts = [artifact(x, is_doubtful=is_doubtful) for x, is_doubtful in spots]
        found = tracker.update(0, given_artifacts)
        assert len(set(ids(found))) == len(found)
        assert all(instance_id >= 0 for instance_id in ids(found))
        assert [each.position_px for each in found] == [each.position_px for each in given_artifacts]
        assert sum(not each.is_doubtful for each in found) <= RULE.max_instances
