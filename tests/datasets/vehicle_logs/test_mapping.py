"""A car with a DBC of its own: slopes in a multiplexed message, signs apart, km/h and degrees."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from foreglow.datasets.vehicle_logs import CanDecoder, CanLog, read_can_log
from foreglow.datasets.vehicle_logs.mapping import CanMapping, CurvatureMeaning
from foreglow.datasets.vehicle_logs.street_frames import StreetFrames
from foreglow.street import NUM_SEGMENT_IDS, curvature_code, curvature_from_code

can = pytest.importorskip("can")
cantools = pytest.importorskip("cantools")

Sent: TypeAlias = tuple[str, dict[str, float]]
"""A message's name and its values."""

DBC = """\
VERSION ""
NS_ :
BS_:
BU_: Car

BO_ 2147484160 Piece: 8 Car
 SG_ Id : 0|6@1+ (1,0) [0|63] "" Car
 SG_ Before : 8|6@1+ (1,0) [0|63] "" Car
 SG_ Metres : 16|8@1+ (2,0) [0|510] "m" Car
 SG_ BendIn : 24|8@1+ (1,0) [0|255] "" Car
 SG_ BendInRight : 32|1@1+ (1,0) [0|1] "" Car
 SG_ BendOut : 40|8@1+ (1,0) [0|255] "" Car
 SG_ BendOutRight : 48|1@1+ (1,0) [0|1] "" Car
 SG_ OnPath : 49|1@1+ (1,0) [0|1] "" Car

BO_ 513 Facts: 8 Car
 SG_ What M : 0|4@1+ (1,0) [0|15] "" Car
 SG_ FactId : 8|6@1+ (1,0) [0|63] "" Car
 SG_ Limit m0 : 16|8@1+ (1,0) [0|255] "km/h" Car
 SG_ Grade m1 : 16|8@1+ (0.5,0) [0|127] "%" Car
 SG_ GradeDown m1 : 24|1@1+ (1,0) [0|1] "" Car

BO_ 514 Here: 8 Car
 SG_ HereId : 0|6@1+ (1,0) [0|63] "" Car
 SG_ Rest : 8|8@1+ (1,0) [0|255] "m" Car
 SG_ Trust : 16|3@1+ (1,0) [0|7] "" Car

BO_ 516 Objects: 1 Car
 SG_ Vehicles : 0|4@1+ (1,0) [0|15] "" Car

BO_ 515 Dynamics: 8 Car
 SG_ Pace : 0|16@1+ (0.01,0) [0|655] "km/h" Car
 SG_ Turn : 16|14@1+ (0.01,0) [0|163] "deg/s" Car
 SG_ TurnRight : 30|1@1+ (1,0) [0|1] "" Car
"""

MAPPING = """\
[segment]
message = "Piece"
segment_id = "Id"
parent_id = "Before"
length_m = "Metres"
start_curvature = "BendIn"
is_start_left = "BendInRight"
end_curvature = "BendOut"
is_end_left = "BendOutRight"
is_probable = "OnPath"

[slope]
message = "Facts"
segment_id = "FactId"
slope_percent = "Grade"
is_downhill = "GradeDown"

[position]
message = "Here"
segment_id = "HereId"
remaining_length_m = "Rest"
error_class = "Trust"
first_error_class = 1

[curvature]
min_radius_m = 15.0
max_radius_m = 5000.0
left_when = 0

[speed]
message = "Dynamics"
signal = "Pace"
factor = 0.2777777777777778

[yaw_rate]
message = "Dynamics"
signal = "Turn"
factor = 0.017453292519943295
is_negative = "TurnRight"
"""


def piece(number: int, before: int, **others: float) -> Sent:
    usual = {"Metres": 80, "BendIn": 255, "BendInRight": 1, "BendOut": 255, "BendOutRight": 1, "OnPath": 1}
    return "Piece", {"Id": number, "Before": before} | usual | others


def here(number: int, trust: float = 2) -> Sent:
    return "Here", {"HereId": number, "Rest": 30, "Trust": trust}


def log_of(tmp_path: Path, frames: list[Sent], mapping: str = MAPPING) -> CanLog:
    """What is read of these frames, sent every 10 ms."""
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "car.toml").write_text(mapping)
    database: Any = cantools.database.load_file(tmp_path / "car.dbc")
    with can.CanutilsLogWriter(tmp_path / "car.log") as log:
        for k, (name, values) in enumerate(frames):
            message = database.get_message_by_name(name)
            log(
                can.Message(
                    timestamp=1 + k / 100,
                    arbitration_id=message.frame_id,
                    is_extended_id=message.is_extended_frame,
                    data=message.encode(values),
                )
            )
    return read_can_log(tmp_path / "car.log", tmp_path / "car.dbc", tmp_path / "car.toml")


def decoder_of(tmp_path: Path, dbc: str = DBC, mapping: str = MAPPING) -> CanDecoder:
    (tmp_path / "car.dbc").write_text(dbc, encoding="cp1252")
    (tmp_path / "car.toml").write_text(mapping)
    return CanDecoder(tmp_path / "car.dbc", tmp_path / "car.toml")


def test_the_road_of_another_car(tmp_path: Path) -> None:
    frames: list[Sent] = [
        piece(7, 6, BendIn=0, BendInRight=0, BendOut=254, BendOutRight=1),
        piece(8, 7),
        piece(9, 7, OnPath=0),  # a side road
        piece(0, 8),  # none
        piece(10, 8, Metres=0),
        ("Facts", {"What": 1, "FactId": 7, "Grade": 3.0, "GradeDown": 1}),
        ("Facts", {"What": 0, "FactId": 7, "Limit": 70}),  # another fact of the same message
        here(7),
    ]
    found = log_of(tmp_path, frames).street(1_100_000_000)
    assert found is not None
    assert [segment.segment_id for segment in found.segments] == [7, 8]
    assert (found.remaining_length_m, found.error_class) == (30, 1)
    first, second = found.segments
    assert (first.length_m, first.slope, second.slope) == (80.0, -0.03, 0.0)
    # Half a code of ours is 1.4 %.
    assert first.curvatures_per_m == pytest.approx((1 / 15, -1 / 5000), rel=0.0138)
    assert second.curvatures_per_m == (0.0, 0.0)


def test_slopes_of_a_number_that_comes_again_are_forgotten(tmp_path: Path) -> None:
    grade: Sent = ("Facts", {"What": 1, "FactId": 7, "Grade": 3.0, "GradeDown": 0})
    frames = [piece(7, 6), grade, piece(7, 6), here(7), piece(7, 5), here(7)]
    log = log_of(tmp_path, frames)
    before, after = log.street(1_035_000_000), log.street(1_055_000_000)
    assert before is not None
    assert after is not None
    assert (before.segments[0].slope, after.segments[0].slope) == (0.03, 0.0)


def test_slopes_of_numbers_that_no_segment_has_are_not_kept() -> None:
    frames = StreetFrames(CanMapping.model_validate(tomllib.loads(MAPPING)))
    for number in range(1000):
        frames.add_slope({"segment_id": number, "slope_percent": 3.0})
    assert len(frames._slope_codes) == NUM_SEGMENT_IDS


def test_motion_in_other_units(tmp_path: Path) -> None:
    frames: list[Sent] = [("Dynamics", {"Pace": 72.0, "Turn": 9.0, "TurnRight": 1})]
    motion = log_of(tmp_path, frames).motion(1_000_000_000)
    assert motion is not None
    assert (motion.speed_mps, motion.yaw_rate_radps) == pytest.approx((20.0, -0.15708), abs=1e-5)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig"])
def test_a_degree_sign_in_any_encoding(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text(DBC.replace('"deg/s"', '"\u00b0/s"'), encoding=encoding)
    (tmp_path / "car.toml").write_text(MAPPING.replace("factor = 0.017453292519943295\n", ""))
    decoders = [CanDecoder(tmp_path / "car.dbc", tmp_path / "car.toml"), decoder_of(tmp_path)]
    for decoder in decoders:
        decoder.take(0, next(key for key in decoder.keys if key[0] == 515), bytes(range(1, 9)), "bus")
    found, expected = (decoder.log.motion(0) for decoder in decoders)
    assert found is not None
    assert expected is not None
    assert found.yaw_rate_radps == expected.yaw_rate_radps != 0


def test_reports_of_the_production_system_count_for_half_a_second(tmp_path: Path) -> None:
    alone = '[production]\nmessage = "Objects"\nsignal = "Vehicles"\n'
    log = log_of(tmp_path, [("Objects", {"Vehicles": 0}), ("Objects", {"Vehicles": 3})], alone)
    times_ns = (990_000_000, 1_005_000_000, 1_010_000_000, 1_500_000_000, 1_520_000_000)
    assert [log.is_reported(time_ns) for time_ns in times_ns] == [None, False, True, True, None]
    assert log.motion(1_010_000_000) is None


def test_a_position_without_a_class(tmp_path: Path) -> None:
    assert log_of(tmp_path, [piece(7, 6), here(7, trust=0)]).street(1_020_000_000) is None
    assert log_of(tmp_path, [piece(7, 6), here(7, trust=7)]).street(1_020_000_000) is None


def test_old_segments_are_forgotten(tmp_path: Path) -> None:
    still: Sent = ("Dynamics", {"Pace": 0, "Turn": 0, "TurnRight": 0})
    frames = [piece(7, 6), *[still] * 1001, here(7)]
    assert log_of(tmp_path, frames).street(11_100_000_000) is None


def test_meanings_of_curvature() -> None:
    assert CurvatureMeaning(meaning="per_m").per_m(-0.01) == -0.01
    radius = CurvatureMeaning(meaning="radius_m")
    assert (radius.per_m(-50.0), radius.per_m(0.0)) == (-0.02, 0.0)
    own = CurvatureMeaning()
    for code in range(256):
        assert curvature_code(own.per_m(code)) == code
        assert own.per_m(code) == pytest.approx(curvature_from_code(code, True))
        assert own.per_m(-code) == pytest.approx(curvature_from_code(code, code == 0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"Piece"', '"Peace"', r"car\.toml: segment\.message: expected a message of .*car\.dbc, .*Dynamics, .*'Peace'"),
        (
            '"Trust"',
            '"Trusty"',
            r"car\.toml: position\.error_class: expected a signal of Here, such as HereId, Rest, Tr",
        ),
        ('segment_id = "Id"\n', "", r"car\.toml: segment\.segment_id: missing"),
        ("is_probable", "is_likely", r"car\.toml: segment\.is_likely: unknown"),
        ("max_radius_m = 5000.0", "max_radius_m = 15.0", r"max_radius_m: expected more than min_radius_m, 15"),
        ("left_when = 0", "left_when = 2", r"curvature\.left_when: .*0 or 1"),
        ("left_when = 0", "left_when = false", r"curvature\.left_when: .*valid integer, got False"),
        ("factor = 0.2777777777777778", "factor = nan", r"speed\.factor: .*finite"),
        (
            "factor = 0.2777777777777778",
            "factor = 0.0",
            r"speed\.factor: expected from 1e-09 to 100 in amount, got 0",
        ),
        ("factor = 0.2777777777777778", "factor = 1e9", r"speed\.factor: expected from 1e-09 to 100 in amount"),
        ("factor = 0.2777777777777778", "factor = -1e-300", r"speed\.factor: expected from 1e-09 to 100 in amount"),
        ("[segment]", "bus = 1\n[segment]", r"car\.toml: bus: "),
        ("[position]", "[place]", r"car\.toml: place: unknown, expected one of segment"),
        (MAPPING[MAPPING.index("[yaw_rate]") :], "", "speed, yaw_rate: expected both sections or neither"),
        (
            MAPPING[MAPPING.index("[position]") : MAPPING.index("[speed]")],
            "",
            "segment, position: expected both sections",
        ),
        (MAPPING, "", "expected the sections segment and position, speed and yaw_rate, or production"),
        ("[segment]", "[segment", r"car\.toml: expected TOML"),
    ],
)
def test_broken_mappings(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in MAPPING
    with pytest.raises(ValueError, match=message):
        log_of(tmp_path, [here(7)], MAPPING.replace(old, new, 1))


def test_numbers_that_cannot_be_computed_with(tmp_path: Path) -> None:
    decoder = decoder_of(tmp_path, DBC.replace("(0.5,0) [0|127]", "(1e307,0) [0|0]"))
    key = next(key for key in decoder.keys if key[0] == 513)  # of the message Facts
    with pytest.raises(ValueError, match="bus: Facts: expected numbers that can be computed with"):
        decoder.take(0, key, bytes([1, 7, 17, 0, 0, 0, 0, 0]), "bus")


def test_broken_descriptions(tmp_path: Path) -> None:
    log_of(tmp_path, [here(7)])
    (tmp_path / "car.dbc").write_text("BO_ this is no DBC")
    with pytest.raises(ValueError, match=r"car\.dbc: expected a DBC file: "):
        read_can_log(tmp_path / "car.log", tmp_path / "car.dbc", tmp_path / "car.toml")
    with pytest.raises(FileNotFoundError, match=r"nowhere\.dbc: no such file"):
        read_can_log(tmp_path / "car.log", tmp_path / "nowhere.dbc", tmp_path / "car.toml")
    with pytest.raises(ValueError, match=r"car\.dbc: expected a DBC and a mapping together"):
        read_can_log(tmp_path / "car.log", tmp_path / "car.dbc")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("516 Objects", "516 Dynamics", "messages: expected each name once, Dynamics comes twice"),
        ("SG_ TurnRight", "SG_ Pace", "Dynamics: signals: expected each name once, Pace comes twice"),
        ("BO_ 515", "BO_ 514", "expected an identifier of its own for each message of the mapping, Here and Dynamics"),
        ("(0.01,0) [0|655]", "(0,0) [0|655]", "Dynamics: Pace: expected a finite scale other than 0"),
        ("(0.01,0) [0|655]", "(1e400,0) [0|655]", "Dynamics: Pace: expected a finite scale other than 0"),
        ("Pace : 0|16@1+", "Pace : 56|16@1+", "Dynamics: Pace: expected an end within 8 bytes, got bit 72"),
        ("Pace : 0|16@1+", "Pace : 56|16@0+", "Dynamics: Pace: expected an end within 8 bytes, got bit 79"),
    ],
)
def test_descriptions_of_which_nobody_knows_what_is_meant(tmp_path: Path, old: str, new: str, message: str) -> None:
    """Speeds were those of another message, or of another signal, or 0, or never there."""
    assert old in DBC
    (tmp_path / "car.dbc").write_text(DBC.replace(old, new))
    (tmp_path / "car.toml").write_text(MAPPING)
    with pytest.raises(ValueError, match=rf"car\.dbc: {message}"):
        CanDecoder(tmp_path / "car.dbc", tmp_path / "car.toml")


def test_a_multiplexed_frame_that_the_description_does_not_have(tmp_path: Path) -> None:
    """Public descriptions have some of a car's numbers; the log was refused for the others."""
    log_of(tmp_path, [here(7)])
    with (tmp_path / "car.log").open("a") as file:
        file.write("(0.5) can0 201#0500000000000000\n")
    assert not read_can_log(tmp_path / "car.log", tmp_path / "car.dbc", tmp_path / "car.toml").is_empty


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_a_log_of_two_buses(tmp_path: Path, suffix: str) -> None:
    """The speed of one and something else of the other were taken in turn."""
    path = tmp_path / f"car{suffix}"
    with can.Logger(path) as log:
        for tenths in range(10):
            for bus, pace in enumerate((3600, 0)):
                data = bytes([pace % 256, pace // 256, 0, 0, 0, 0, 0, 0])
                channel = f"can{bus}" if suffix == ".log" else bus
                sent = {"timestamp": 1 + tenths / 10, "arbitration_id": 515, "is_extended_id": False, "data": data}
                log(can.Message(**sent, channel=channel))
    names = ("can0", "can1") if suffix == ".log" else ("1", "2")
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "car.toml").write_text(MAPPING)
    with pytest.raises(ValueError, match=f"frames 203 of one bus, got those of {names[0]} and {names[1]}: name one as"):
        read_can_log(path, tmp_path / "car.dbc", tmp_path / "car.toml")
    for name, speed_mps in zip(names, (10.0, 0.0), strict=True):
        (tmp_path / "car.toml").write_text(f'bus = "{name}"\n{MAPPING}')
        read = read_can_log(path, tmp_path / "car.dbc", tmp_path / "car.toml")
        motion = read.motion(read.last_ns)
        assert motion is not None
        assert motion.speed_mps == pytest.approx(speed_mps)
    (tmp_path / "car.toml").write_text(f'bus = "can7"\n{MAPPING}')
    with pytest.raises(ValueError, match=r"expected frames of .* on bus can7, with values, got none"):
        read_can_log(path, tmp_path / "car.dbc", tmp_path / "car.toml")
