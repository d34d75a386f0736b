"""Units, ranges and codes of speeds in the DBC of another car."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from foreglow.datasets.vehicle_logs import CanDecoder
from tests.datasets.vehicle_logs.test_mapping import DBC, MAPPING, decoder_of


@pytest.mark.parametrize(
    "name",
    [
        "SNA",
        "Speed_NotAvailable",
        "invalid",
        "Init",
        "Signal not valid",
        "Initialisation",
        "Err",
        "fault",
        "x",
        "> 300",
    ],
)
def test_codes_that_are_called_not_available_count_as_not_sent(tmp_path: Path, name: str) -> None:
    """All ones were a speed of 655 km/h."""
    dbc = DBC + f'\nVAL_ 515 Pace 65535 "{name}" 0 "standstill" ;\n'
    (tmp_path / "car.dbc").write_text(dbc)
    (tmp_path / "car.toml").write_text(MAPPING)
    decoder = CanDecoder(tmp_path / "car.dbc", tmp_path / "car.toml")
    key = next(key for key in decoder.keys if key[0] == 515)
    decoder.take(0, key, b"\xff\xff" + bytes(6), "bus")
    assert decoder.log.motion(0) is None
    decoder.take(10_000_000, key, bytes(8), "bus")
    motion = decoder.log.motion(10_000_000)
    assert motion is not None
    assert motion.speed_mps == 0.0


def speed_of(decoder: CanDecoder, code: int) -> float | None:
    decoder.take(0, next(key for key in decoder.keys if key[0] == 515), code.to_bytes(2, "little") + bytes(6), "bus")
    motion = decoder.log.motion(0)
    return None if motion is None else motion.speed_mps


@pytest.mark.parametrize("name", ["100 km/h", "100", " 100,0 km/h "])
def test_a_code_whose_name_is_a_number_is_a_value(tmp_path: Path, name: str) -> None:
    decoder = decoder_of(tmp_path, DBC + f'\nVAL_ 515 Pace 10000 "{name}" ;\n')
    assert speed_of(decoder, 10000) == pytest.approx(100 / 3.6)


@pytest.mark.parametrize("code", [65535, -1])
def test_a_code_of_a_signed_signal_may_be_written_without_its_sign(tmp_path: Path, code: int) -> None:
    dbc = DBC.replace("Pace : 0|16@1+ (0.01,0) [0|655]", "Pace : 0|16@1- (0.01,0) [-327|327]")
    decoder = decoder_of(tmp_path, dbc + f'\nVAL_ 515 Pace {code} "SNA" ;\n')
    assert speed_of(decoder, 10000) == pytest.approx(100 / 3.6)
    assert speed_of(decoder_of(tmp_path, dbc), 65535) == pytest.approx(-0.01 / 3.6)
    assert speed_of(decoder_of(tmp_path, dbc + f'\nVAL_ 515 Pace {code} "SNA" ;\n'), 65535) is None


def test_a_speed_beyond_the_range_of_the_dbc_counts_as_not_sent(tmp_path: Path) -> None:
    """All ones, often without a name, are 655 km/h here."""
    for pair, code, is_known in (
        ("[0|300]", 65535, False),
        ("[0|300]", 30000, True),
        ("[0|300]", 30001, False),
        ("[0|0]", 50000, True),
    ):
        assert (speed_of(decoder_of(tmp_path, with_pace(pair, "km/h")), code) is not None) == is_known, (pair, code)


@pytest.mark.parametrize("pair", ["[300|0]", "[300|300]", "[-1|-1]"])
def test_a_range_without_values_is_refused(tmp_path: Path, pair: str) -> None:
    with pytest.raises(ValueError, match=r"car\.dbc: Dynamics: Pace: expected a range that rises"):
        decoder_of(tmp_path, with_pace(pair, "km/h"))


def with_pace(pair: str, unit: str) -> str:
    """The DBC with another range and unit of the speed."""
    changed, num = re.subn(r"( SG_ Pace .*?\)) \[.*?\] \".*?\"", rf'\1 {pair} "{unit}"', DBC)
    assert num == 1
    return changed


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        *(
            ("km/h", 1 / 3.6),
            ("KPH", 1 / 3.6),
            ("km / h", 1 / 3.6),
            ("m/s", 1.0),
            ("mph", 0.44704),
            ("knots", 0.514444),
        ),
        *(("Unit_KiloMeterPerHour", 1 / 3.6), ("cm/s", 0.01)),
    ],
)
def test_without_a_factor_the_unit_of_the_dbc_counts(tmp_path: Path, unit: str, factor: float) -> None:
    mapping = MAPPING.replace("factor = 0.2777777777777778\n", "")
    decoder = decoder_of(tmp_path, with_pace("[0|300]", unit), mapping)
    assert speed_of(decoder, 10000) == pytest.approx(100 * factor, rel=1e-6)


def test_a_factor_that_contradicts_the_unit_is_refused(tmp_path: Path) -> None:
    expected = (
        r"car\.toml: speed\.factor: expected 0\.44704 or none, as .*car\.dbc: Dynamics: Pace is in mph, got 0\.27"
    )
    with pytest.raises(ValueError, match=expected):
        decoder_of(tmp_path, with_pace("[0|300]", "mph"))
    with pytest.raises(
        ValueError, match=r"yaw_rate\.factor: expected 0\.01745329 or none, as .* is in \W/s, got 0\.02"
    ):
        decoder_of(tmp_path, DBC.replace('"deg/s"', '"\u00b0/s"'), MAPPING.replace("0.017453292519943295", "0.02"))
    decoder_of(tmp_path, DBC, MAPPING.replace("0.017453292519943295", "-0.0175"))  # positive to the right


@pytest.mark.parametrize(("unit", "stated"), [("furlongs", "is in 'furlongs', none of m/s"), ("", "has no unit in")])
def test_without_a_unit_that_is_known_a_factor_is_needed(tmp_path: Path, unit: str, stated: str) -> None:
    decoder_of(tmp_path, with_pace("[0|300]", unit))
    with pytest.raises(ValueError, match=rf"speed\.factor: expected a factor to m/s, as .*car\.dbc: .* {stated}"):
        decoder_of(tmp_path, with_pace("[0|300]", unit), MAPPING.replace("factor = 0.2777777777777778\n", ""))


def test_a_number_is_not_its_own_sign(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"speed\.is_negative: expected another signal than 'Pace'"):
        decoder_of(tmp_path, DBC, MAPPING.replace('signal = "Pace"\n', 'signal = "Pace"\nis_negative = "Pace"\n'))


@pytest.mark.parametrize("factor", [0.0174533, -0.0174533])
def test_a_sign_beside_a_factor_of_either_sign(tmp_path: Path, factor: float) -> None:
    """With a negative factor, all bends were to the right."""
    decoder = decoder_of(tmp_path, DBC, MAPPING.replace("0.017453292519943295", str(factor)))
    key = next(key for key in decoder.keys if key[0] == 515)
    for number, (sign, expected) in enumerate(((0, 10.0), (1, -10.0))):
        data = (1000 | sign << 14).to_bytes(2, "little")
        decoder.take(number, key, bytes(2) + data + bytes(4), "bus")
        motion = decoder.log.motion(number)
        assert motion is not None
        assert motion.yaw_rate_radps == pytest.approx(expected * factor)


@pytest.mark.parametrize(
    ("line", "field", "signal"),
    [
        ('is_negative = "TurnRight"\n', "yaw_rate.is_negative", "Turn"),
        ('is_start_left = "BendInRight"\n', "segment.is_start_left", "BendIn"),
        ('is_end_left = "BendOutRight"\n', "segment.is_end_left", "BendOut"),
        ('is_downhill = "GradeDown"\n', "slope.is_downhill", "Grade"),
    ],
)
def test_numbers_of_either_sign_need_one(tmp_path: Path, line: str, field: str, signal: str) -> None:
    """All bends were to the left, and all roads went up."""
    mapping = MAPPING.replace(line, "")
    with pytest.raises(
        ValueError, match=rf"car\.toml: {field}: expected the signal that has the sign of {signal}, got"
    ):
        decoder_of(tmp_path, DBC, mapping)
    signed, num = re.subn(rf"( SG_ {signal} .*?@1)\+ \((.*?),0\) \[.*?\]", r"\1+ (\2,-50) [0|0]", DBC)
    assert num == 1
    decoder_of(tmp_path, signed, mapping)
    decoder_of(tmp_path, signed.replace(",-50)", ",0)").replace("@1+ (", "@1- ("), mapping)
    with pytest.raises(ValueError, match=field):
        decoder_of(tmp_path, signed.replace(",-50) [0|0]", ",-50) [0|77]"), mapping)


def test_signals_that_cannot_be_decoded_are_the_fault_of_the_dbc(tmp_path: Path) -> None:
    overlapping = re.sub(r"( SG_ Turn : )\d+\|", r"\g<1>8|", DBC)
    with pytest.raises(ValueError, match=r"car\.dbc: Dynamics: expected signals that can be decoded"):
        decoder_of(tmp_path, overlapping)
