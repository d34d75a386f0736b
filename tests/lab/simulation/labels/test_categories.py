from __future__ import annotations

from typing import Any

import pytest

from foreglow.lab.simulation.labels.categories import ImageCategories, Signs, is_oncoming, signs_of
from foreglow.lab.simulation.scenes.scene import LabelRule, VehicleSpec
from tests.lab.simulation.truths import artifact, lamp, lamp_artifact, vehicle

RULE = LabelRule(hold_frames=2)

SIGNS = {
    ".": Signs(),
    "i": Signs(has_indirect=True),
    "d": Signs(has_direct=True),
    "b": Signs(has_indirect=True, has_direct=True),
    "s": Signs(has_direct=True, is_in_sight=True),
}


@pytest.mark.parametrize(
    ("shown", "production", "expected"),
    [
        ("...", "   ", "000"),
        (".iiiddss", "        ", "01223454"),
        (".iidsss..", "     pp  ", "012356600"),
        ("iidds", "    p", "12345"),
        ("iiddsss", "   pppp", "1236566"),
        ("dds", "   ", "345"),
        ("ss", "  ", "54"),
        ("bb", "  ", "34"),
        ("iidi", "    ", "1234"),
        ("i.i..i", "      ", "102002"),
        ("i...i", "     ", "10001"),
        ("ids...ids", "  p      ", "135000135"),
        ("idsss", " p   ", "13566"),
        ("idss...iids", "   p       ", "13560001235"),
        ("ii...iii", "pp      ", "16000122"),
        ("...i", "ppp ", "0001"),
    ],
)
def test_categories_of_a_drive(shown: str, production: str, expected: str) -> None:
    categories = ImageCategories([], RULE)
    steps = zip(shown, production, strict=True)
    assert "".join(str(int(categories.step(SIGNS[sign], mark == "p"))) for sign, mark in steps) == expected


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, True),
        ({"lane": "own"}, False),
        ({"lane": "branch", "is_towards": True}, True),
        ({"lane": "branch", "is_towards": False}, False),
        ({"lane": "parked_left"}, True),
        ({"lane": "parked_right", "is_towards": False}, False),
        ({"lane": "parked_right", "beam": "off"}, False),
    ],
)
def test_which_vehicles_count(fields: dict[str, Any], expected: bool) -> None:
    assert is_oncoming(VehicleSpec(**fields)) == expected


BOTH = (lamp("low_left"), lamp("low_right"), lamp("rear_left", is_rear=True, visible_share=0.0))
ONE = (lamp("low_left"), lamp("low_right", visible_share=0.1))


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, "."),
        ({"artifacts": (artifact(),)}, "i"),
        ({"artifacts": (artifact(is_doubtful=True), artifact(is_rear=True))}, "."),
        ({"artifacts": (lamp_artifact(),), "lamps": ONE, "visible_share": 0.4}, "d"),
        ({"artifacts": (lamp_artifact(), artifact()), "lamps": ONE}, "b"),
        ({"artifacts": (lamp_artifact(),), "lamps": ONE, "visible_share": 0.5}, "s"),
        ({"artifacts": (lamp_artifact(),), "lamps": BOTH}, "s"),
        ({"artifacts": (lamp_artifact(is_rear=True),), "lamps": BOTH}, "."),
        ({"lamps": BOTH, "visible_share": 1.0}, "."),
    ],
)
def test_signs_of_a_vehicle(fields: dict[str, Any], expected: str) -> None:
    assert signs_of(vehicle(**fields), RULE) == SIGNS[expected]


def test_only_oncoming_vehicles_count_and_all_of_them() -> None:
    specs = (VehicleSpec(lane="own"), VehicleSpec(), VehicleSpec())
    lit = (artifact(),)
    categories = ImageCategories(specs, RULE)
    assert categories.update([vehicle(0, artifacts=lit)], False) == 0
    assert categories.update([vehicle(0, artifacts=lit), vehicle(2, artifacts=lit)], False) == 1
    assert categories.update([vehicle(1, artifacts=(lamp_artifact(),), lamps=ONE), vehicle(2)], False) == 3
