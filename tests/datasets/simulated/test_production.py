from __future__ import annotations

from typing import Any

import pytest

from foreglow.datasets.simulated import VehicleTruth
from foreglow.datasets.simulated.production import ProductionConfig, ProductionSystem
from tests.lab.simulation.truths import artifact, lamp, lamp_artifact, vehicle

FRAME_NS = 50_000_000
CONFIG = ProductionConfig(confirm_frames=3, rate_hz=20.0, latency_s=0.1, release_s=0.2)


def bright(vehicle_id: int = 0, **fields: Any) -> VehicleTruth:
    """Both headlamps in full sight, 300 cd each."""
    usual = {"lamps": (lamp("low_left"), lamp("low_right")), "artifacts": (lamp_artifact(),)}
    return vehicle(vehicle_id, **(usual | fields))


def reports(pattern: str, config: ProductionConfig = CONFIG) -> str:
    """Whether a vehicle that is bright (B) or not (.) is reported (R), at 20 images a second."""
    system = ProductionSystem(config)
    reported = (
        system.update(number * FRAME_NS, [bright()] if sign == "B" else [vehicle()])
        for number, sign in enumerate(pattern)
    )
    return "".join("R" if ids == {0} else "." for ids in reported)


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        # Believed with the third image, reported 0.1 s = two images later.
        ("BBBBBBB", "....RRR"),
        ("...BBBBB", ".......R"),
        # An image without the light begins the count anew.
        ("BB.BBBBB", ".......R"),
        ("BB.BB.BB.BB", "..........."),
        # What is confirmed comes even if the light has gone, and stays for 0.2 s = four images after its last sight.
        ("BBB........", "....RRR...."),
        ("BBBBBB......", "....RRRRRR.."),
        # Gone for longer: the same again.
        ("BBB.....BBBBB", "....RRR.....R"),
        ("BBB....BBB", "....RRRRRR"),
    ],
)
def test_plausibility_latency_and_release(pattern: str, expected: str) -> None:
    assert reports(pattern) == expected


def test_at_once_without_plausibility_and_latency() -> None:
    assert reports("B.B", ProductionConfig(confirm_frames=1, latency_s=0, release_s=0)) == "R.R"


@pytest.mark.parametrize(
    ("fields", "is_seen"),
    [
        ({}, True),
        ({"range_m": 400.0, "lamps": (lamp(intensity_cd=200.0), lamp(intensity_cd=200.0))}, True),
        ({"range_m": 400.0, "lamps": (lamp(intensity_cd=100.0), lamp(intensity_cd=100.0))}, False),
        ({"range_m": 400.0, "lamps": (lamp(intensity_cd=400.0, visible_share=0.7),)}, False),
        ({"range_m": 600.0}, False),
        ({"artifacts": (lamp_artifact(grey=39.0),)}, False),
        ({"artifacts": (artifact(grey=200.0),)}, False),
        ({"artifacts": (lamp_artifact(is_rear=True),)}, False),
        ({"lamps": (lamp(visible_share=0.4),)}, False),
        ({"lamps": (lamp(visible_share=0.6),)}, True),
        ({"lamps": (lamp(is_rear=True),)}, False),
        ({"lamps": ()}, False),
    ],
)
def test_what_is_bright_enough(fields: dict[str, Any], is_seen: bool) -> None:
    system = ProductionSystem(ProductionConfig(confirm_frames=1, latency_s=0))
    assert system.update(0, [bright(**fields)]) == ({0} if is_seen else set())


def test_vehicles_are_told_apart() -> None:
    system = ProductionSystem(CONFIG)
    for number in range(2):
        assert not system.update(number * FRAME_NS, [bright(3)])
    for number in range(2, 6):
        both = system.update(number * FRAME_NS, [bright(3), bright(5)])
    assert both == {3}
    assert system.update(6 * FRAME_NS, [bright(3), bright(5)]) == {3, 5}


def test_a_wrong_config_is_refused() -> None:
    with pytest.raises(ValueError, match="confirm_frames"):
        ProductionConfig(confirm_frames=0)


def test_five_frames_of_its_own_camera_whatever_the_drives_rate() -> None:
    for drive_hz, expected_ns in ((36.0, 222_222_222), (18.0, 222_222_222), (9.0, 222_222_222), (4.0, 250_000_000)):
        system = ProductionSystem(ProductionConfig(latency_s=0.0))
        times = [round(number * 1e9 / drive_hz) for number in range(40)]
        first = next(time for time in times if system.update(time, [bright()]))
        assert first == pytest.approx(expected_ns, abs=1_000)
