from __future__ import annotations

import json
import math

import pytest

from foreglow.files import to_json
from foreglow.lab.evaluation.label_statistics import Spread
from foreglow.lab.simulation.scenes.scene import LabelRule
from foreglow.lab.studies.simulator.metrics import FirstTimes, PeaksOfFrame, first_times, rule_effects
from tests.lab.simulation.truths import artifact

RULE = LabelRule(min_grey=2.0, min_contrast=5.0)


def drive(first_direct: int, *strengths: float) -> list[PeaksOfFrame]:
    """Images each 0.1 s whose one candidate is so many times as strong as the rule asks for."""
    return [
        PeaksOfFrame(index / 10, index >= first_direct, ((artifact(grey=2 * s, contrast=5 * s),), ()))
        for index, s in enumerate(strengths)
    ]


GROWING = drive(5, 0.3, 0.6, 1.1, 1.5, 1.5, 2.1, 3.0)


def test_first_times() -> None:
    assert first_times(GROWING, RULE) == FirstTimes(0.2, 0.5)
    assert first_times(GROWING, RULE).lead_s == pytest.approx(0.3)
    assert first_times(drive(9, 0.5, 2.0), RULE) == FirstTimes(0.1, math.inf)
    assert math.isnan(first_times(drive(9, 0.5, 2.0), RULE).lead_s)


def test_higher_thresholds_see_later() -> None:
    effects = rule_effects([GROWING], RULE)
    assert [effect.factor for effect in effects] == [0.5, 0.7, 1.0, 1.4, 2.0]
    assert [effect.shift_s.median for effect in effects] == pytest.approx([-0.1, 0, 0, 0.1, 0.3])
    assert [effect.lead_s.median for effect in effects] == pytest.approx([0.4, 0.3, 0.3, 0.2, 0.0])
    assert [effect.share_indirect_first for effect in effects] == [1, 1, 1, 1, 0]


def test_several_drives() -> None:
    sudden = drive(0, 0.1, 3.0)
    never, dark = drive(9, 0.1, 0.1), drive(9)
    (effect,) = rule_effects([GROWING, sudden, never, dark], RULE, (1.0,))
    assert (effect.num_drives, effect.num_with_indirect) == (2, 2)
    assert effect.share_indirect_first == 0.5
    assert effect.lead_s.num == 2
    assert effect.lead_s.median == pytest.approx(0.1)
    assert effect.shift_s == Spread(2, 0, 0, 0)
    assert effect.instances_per_hidden_frame == 1


def test_instances_of_hidden_images_only() -> None:
    several = tuple(artifact(x) for x in (0, 100, 200))
    images = [PeaksOfFrame(0.0, False, (several, several[:1])), PeaksOfFrame(0.1, True, (several,))]
    (effect,) = rule_effects([images], LabelRule(max_hidden_instances=2, max_instances=3), (1.0,))
    assert effect.instances_per_hidden_frame == 3


def test_no_drives() -> None:
    (effect,) = rule_effects([], RULE, (1.0,))
    fields = json.loads(json.dumps(to_json(effect), allow_nan=False))
    assert fields["share_indirect_first"] is None
    assert fields["lead_s"]["median"] is None
    assert fields["num_drives"] == 0
