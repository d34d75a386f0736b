"""Messages to a CAN log and back, by our own DBC."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.datasets.vehicle_logs import read_can_log, write_can_log
from foreglow.datasets.vehicle_logs.can_log import CanDecoder, read_mapping
from foreglow.datasets.vehicle_logs.dbc import read_dbc
from foreglow.lab.simulation.scenes.scene import RoadSpec
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.street_data import StreetDataError, StreetMap
from foreglow.street import StreetMessage
from foreglow.types import EgoMotion
from tests.datasets.vehicle_logs.messages import message, segment

pytest.importorskip("can")
pytest.importorskip("cantools")

SUFFIXES = (".asc", ".blf", ".log")
MS = 1_000_000
TENTH = 100 * MS


@pytest.fixture(scope="module")
def drive() -> list[tuple[int, StreetMessage]]:
    """The messages of ten seconds on a winding, hilly road."""
    spec = RoadSpec(
        length_m=800.0,
        curvature_per_m=((0.0, 0.0), (200.0, 0.006), (500.0, -0.004)),
        elevation_m=((0.0, 0.0), (300.0, 9.0), (600.0, 0.0)),
    )
    streets = StreetMap(Road(spec), StreetDataError(longitudinal_class=2), np.random.default_rng(3))
    return [(k * TENTH, streets.message(20.0 + 1.5 * k)) for k in range(100)]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_drive_comes_back(tmp_path: Path, drive: list[tuple[int, StreetMessage]], suffix: str) -> None:
    path = tmp_path / f"drive{suffix}"
    motions = [(time_ns, EgoMotion(14.37 + 0.01 * k, -0.0421)) for k, (time_ns, _) in enumerate(drive)]
    write_can_log(path, drive, motions)
    log = read_can_log(path)
    assert log.has_street
    assert (log.first_ns, log.last_ns) == pytest.approx((0, drive[-1][0]), abs=MS)
    for (time_ns, sent), (_, motion) in zip(drive, motions, strict=True):
        assert log.street(time_ns + MS) == sent
        back = log.motion(time_ns + MS)
        assert back is not None
        assert (back.speed_mps, back.yaw_rate_radps) == pytest.approx((motion.speed_mps, motion.yaw_rate_radps))
        assert np.isnan(back.pitch_rad)


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_a_byte_order_mark_is_no_content(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"drive{suffix}"
    write_can_log(path, [(TENTH, message())])
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_can_log(path).street(TENTH) == message()


@pytest.mark.parametrize("suffix", [".blf", ".log"])
def test_times_since_1970(tmp_path: Path, suffix: str) -> None:
    path, begin_ns = tmp_path / f"drive{suffix}", 1_700_000_000_123_456_000
    write_can_log(path, [(begin_ns, message())])
    assert read_can_log(path).first_ns == pytest.approx(begin_ns, abs=MS)


@pytest.mark.parametrize("suffix", [".blf", ".log"])
@pytest.mark.parametrize("begin_s", [0.3, 10_000.0, 631_151_999.0, 631_152_000.0])
def test_times_that_are_no_dates(tmp_path: Path, suffix: str, begin_s: float) -> None:
    """Such as seconds since the car was started: a log that seems to begin at 0 belongs to other frames."""
    path, begin_ns = tmp_path / f"drive{suffix}", round(begin_s * 1e9)
    write_can_log(path, [], [(begin_ns + k * TENTH, EgoMotion(10.0 + k, 0.0)) for k in range(5)])
    log = read_can_log(path)
    assert (log.first_ns, log.last_ns) == pytest.approx((begin_ns, begin_ns + 4 * TENTH), abs=MS)


def test_a_message_grows_stale(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    write_can_log(path, [(0, message()), (TENTH, message(2))], [(0, EgoMotion(10.0, 0.1))])
    log = read_can_log(path)
    assert log.street(-MS) is None
    assert log.street(99 * MS) == message()
    assert log.street(TENTH + 1000 * MS) == message(2)
    assert log.street(TENTH + 1001 * MS) is None
    assert log.motion(500 * MS) is not None
    assert log.motion(501 * MS) is None


def test_numbers_come_round_again(tmp_path: Path) -> None:
    """Segment 3 is now another road, of which 2 is no parent."""
    path = tmp_path / "drive.log"
    again = StreetMessage(
        segments=(segment(62, parent_id=61), segment(3, parent_id=62, slope_code=5)),
        remaining_length_m=8,
        error_class=0,
    )
    write_can_log(path, [(0, message()), (TENTH, again), (2 * TENTH, message(1, 2))])
    log = read_can_log(path)
    assert [log.street(k * TENTH) for k in range(3)] == [message(), again, message(1, 2)]


_codes = st.integers(0, 255)


@st.composite
def _messages(draw: st.DrawFn) -> StreetMessage:
    numbers = draw(st.lists(st.integers(1, 62), min_size=1, max_size=8, unique=True))
    segments = tuple(
        segment(
            number,
            parent_id=parent,
            length_code=draw(st.integers(1, 127)),
            start_curvature_code=draw(_codes),
            is_start_left=draw(st.booleans()),
            end_curvature_code=draw(_codes),
            is_end_left=draw(st.booleans()),
            slope_code=draw(st.integers(-127, 127)),
        )
        for parent, number in zip([draw(st.integers(0, 62)), *numbers], numbers, strict=False)
    )
    return StreetMessage(
        segments=segments, remaining_length_m=draw(st.integers(0, 254)), error_class=draw(st.integers(0, 5))
    )


@pytest.mark.slow
@settings(derandomize=True, max_examples=40)
@given(st.lists(_messages(), min_size=1, max_size=4))
def test_any_messages_come_back(tmp_path_factory: pytest.TempPathFactory, messages: list[StreetMessage]) -> None:
    path = tmp_path_factory.mktemp("any") / "drive.log"
    write_can_log(path, [(k * TENTH, sent) for k, sent in enumerate(messages)])
    log = read_can_log(path)
    assert [log.street(k * TENTH) for k in range(len(messages))] == messages


def test_what_cannot_be_written(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with pytest.raises(ValueError, match=r"drive\.txt: expected a CAN log that ends in \.asc, \.blf, \.log"):
        write_can_log(tmp_path / "drive.txt", [(0, message())])
    with pytest.raises(ValueError, match="expected at least one message"):
        write_can_log(path, [])
    broken = StreetMessage(segments=(segment(1), segment(3)), remaining_length_m=8, error_class=0)
    with pytest.raises(ValueError, match=r"segments\.1\.parent_id: expected 1, the segment before it, got 2"):
        write_can_log(path, [(0, broken)])
    twice = StreetMessage(segments=(segment(1), segment(1, parent_id=1)), remaining_length_m=8, error_class=0)
    with pytest.raises(ValueError, match="segment_id: expected numbers of 1 to 62, each once"):
        write_can_log(path, [(0, twice)])
    with pytest.raises(ValueError, match=r"EgoMotion at 0 ns: .*Speed"):
        write_can_log(path, [], [(0, EgoMotion(500.0, 0.0))])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("suffix", "expected"),
    [
        (".asc", "expected frames of StreetSegment"),  # whose reader passes over what it does not know
        (".blf", r"expected a CAN log of the kind \.blf"),
        (".log", r"line 1: expected a frame as a CAN log of the kind \.log has it, got '.*this is no log at all'"),
    ],
)
def test_broken_logs(tmp_path: Path, suffix: str, expected: str) -> None:
    path = tmp_path / f"drive{suffix}"
    with pytest.raises(FileNotFoundError, match="drive"):
        read_can_log(path)
    path.write_bytes(b"\xffthis is no log at all\n" * 20)
    with pytest.raises(ValueError, match=rf"drive\{suffix}: {expected}"):
        read_can_log(path)


@pytest.mark.parametrize("suffix", [".asc", ".log"])
@pytest.mark.parametrize("block", [bytes(200), bytes(range(0x80, 0x100)) + b"\x01"], ids=["zero", "binary"])
def test_binary_bytes_within_text_are_damage(
    suffix: str, block: bytes, tmp_path: Path, drive: list[tuple[int, StreetMessage]]
) -> None:
    """The messages there were passed over in silence."""
    path = tmp_path / f"drive{suffix}"
    write_can_log(path, drive)
    data = bytearray(path.read_bytes())
    data[4000 : 4000 + len(block)] = block
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"drive\{suffix}: line \d+: expected text, got "):
        read_can_log(path)


def test_a_comment_may_have_any_letters(tmp_path: Path, drive: list[tuple[int, StreetMessage]]) -> None:
    path = tmp_path / "drive.asc"
    write_can_log(path, drive)
    path.write_bytes("// Größe: 5 µm\r\n".encode("cp1252") + path.read_bytes() + b"\x1a")
    assert read_can_log(path).has_street


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
def test_a_blf_that_is_cut(share: float, tmp_path: Path, drive: list[tuple[int, StreetMessage]]) -> None:
    path = tmp_path / "drive.blf"
    write_can_log(path, drive)
    data = path.read_bytes()
    num_missing = max(1, round(share * len(data)))
    path.write_bytes(data[:-num_missing])
    with pytest.raises(
        ValueError, match=rf"drive\.blf: truncated CAN log, {num_missing} bytes are missing at the end$"
    ):
        read_can_log(path)
    unstated = bytearray(data[: -max(num_missing, 8)])  # the last bytes are padding
    unstated[16:24] = bytes(8)  # of a recorder that was killed
    path.write_bytes(unstated)
    with pytest.raises(ValueError, match=r"drive\.blf: byte \d+: truncated CAN log, its last object is not whole$"):
        read_can_log(path)


@pytest.mark.parametrize(
    ("begin", "end", "expected"),
    [
        (0, 1, "expected a CAN log of the kind .blf, which begins with LOGG"),
        (144, 145, "byte 144: expected an object, which begins with LOBJ"),
        (300, 400, "byte 144: expected a container that can be unpacked, it is damaged"),
    ],
)
def test_a_damaged_blf(
    begin: int, end: int, expected: str, tmp_path: Path, drive: list[tuple[int, StreetMessage]]
) -> None:
    path = tmp_path / "drive.blf"
    write_can_log(path, drive)
    data = bytearray(path.read_bytes())
    data[begin:end] = bytes(end - begin)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"drive\.blf: {re.escape(expected)}$"):
        read_can_log(path)


@pytest.mark.parametrize(
    "line",
    [
        "(1.0) can0",
        "no frame",
        "(nan) can0 3A1#00",
        "(x) can0 3A1#00",
        "(1.0) can0 3A1#0g",
        "(1.0) can0 3A1#00112",
        "(1.0) can0 3A1##100112",
        "(1.0) can0 3A1#00.11",
        f"({'9' * 305}) vcan0 3A1#00",
    ],
)
def test_a_broken_line_is_named(line: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    write_can_log(path, [(0, message())])
    num_lines = len(path.read_text().splitlines())
    with path.open("a") as file:
        file.write(f"{line}\n")
    with pytest.raises(
        ValueError, match=rf"drive\.log: line {num_lines + 1}: expected (a|the time of a) frame"
    ) as error:
        read_can_log(path)
    assert not re.search("unpack|convert|literal|integer", str(error.value))


@pytest.mark.parametrize(
    ("suffix", "was", "becomes", "expected"),
    [
        (".asc", "timestamps absolute", "timestamps  Relative", r"line 2: expected timestamps absolute, got relative"),
        (".asc", "base hex *timestamps absolute", " base hex timestamps relative", "line 2: expected timestamps abs"),
        (".asc", "base hex *timestamps absolute", "timestamps relative\nbase hex", "line 2: expected timestamps abs"),
        (".asc", "base hex *timestamps absolute", "timestamps relative base hex", "line 2: expected timestamps abs"),
        (".log", r"\(([\d.]+)\)", r"\1", r"line 1: expected a frame as a CAN log of the kind \.log"),
        (".log", r"#(\w{16})", r"#\g<1>00", r"line 1: expected a frame as a CAN log of the kind \.log"),
        (".log", "3A", "FFFFFFF3A", r"line 1: expected a frame as a CAN log of the kind \.log"),
    ],
)
def test_logs_that_python_can_misreads(
    suffix: str, was: str, becomes: str, expected: str, tmp_path: Path, drive: list[tuple[int, StreetMessage]]
) -> None:
    """Times since the frame before, times and identifiers in another form: motion came at wrong times; nine bytes."""
    path = tmp_path / f"drive{suffix}"
    write_can_log(path, drive)
    path.write_text(re.sub(was, becomes, path.read_text()))
    with pytest.raises(ValueError, match=rf"drive\{suffix}: {expected}"):
        read_can_log(path)


def test_times_with_a_decimal_comma(tmp_path: Path, drive: list[tuple[int, StreetMessage]]) -> None:
    """As a program writes them that goes by the language of Windows; python-can passes over such lines."""
    path, same = tmp_path / "drive.asc", tmp_path / "same.asc"
    write_can_log(path, drive)
    lines = path.read_text().splitlines(keepends=True)
    same.write_text(
        "".join(re.sub(r"^(\s*\d+)\.", r"\1,", line) if number % 2 else line for number, line in enumerate(lines))
    )
    assert same.read_text() != path.read_text()
    for time_ns, _ in drive:
        assert read_can_log(same).street(time_ns) == read_can_log(path).street(time_ns)


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_logs_put_together(suffix: str, tmp_path: Path, drive: list[tuple[int, StreetMessage]]) -> None:
    """Frames were put in order, so that the messages of two drives were mixed."""
    path = tmp_path / f"drive{suffix}"
    write_can_log(path, drive)
    text = path.read_text()
    frames = "".join(line for line in text.splitlines(keepends=True) if re.search(r"3A[0-9A-F]", line))
    path.write_text(text + frames)
    number = len(text.splitlines()) + 1
    expected = (
        rf"line {number}: expected times that do not fall by more than 1 s, got 0\.0+ s after 9\.90*\d? s: a clock"
    )
    with pytest.raises(ValueError, match=rf"drive\{suffix}: {expected}"):
        read_can_log(path)


def test_a_blf_whose_clock_was_set(tmp_path: Path) -> None:
    can = pytest.importorskip("can")
    path = tmp_path / "drive.blf"
    with can.BLFWriter(path) as writer:
        for time_s in (100.0, 110.0, 105.0):
            writer.on_message_received(
                can.Message(timestamp=time_s, arbitration_id=0x3A2, data=bytes(8), is_extended_id=False)
            )
    with pytest.raises(ValueError, match=r"drive\.blf: expected times that do not .* got 5\.0+ s after 10\.0+ s"):
        read_can_log(path)


def test_messages_of_two_buses_are_put_in_order(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    write_can_log(path, [(0, message()), (8 * TENTH, message(2))])
    first, *others = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*others, first]))
    log = read_can_log(path)
    assert log.street(9 * TENTH) == message(2)


@pytest.mark.parametrize("begin_ns", [0, 1_700_000_000_000_000_000])
def test_every_kind_of_log_says_the_same_of_a_frame(begin_ns: int, tmp_path: Path) -> None:
    """Messages at the very times of frames, at 18 Hz: text rounds them to microseconds, upwards or downwards."""
    times_ns = [begin_ns + round(k * 1e9 / 18) for k in range(90)]
    motions = [(time_ns, EgoMotion(10.0 + 0.1 * k, 0.0)) for k, time_ns in enumerate(times_ns)]
    for suffix in SUFFIXES if begin_ns == 0 else (".blf", ".log"):
        path = tmp_path / f"drive{suffix}"
        write_can_log(path, [], motions)
        log = read_can_log(path)
        for time_ns, motion in motions:
            found = log.motion(time_ns)
            assert found is not None
            assert found.speed_mps == pytest.approx(motion.speed_mps), (suffix, time_ns)


@pytest.mark.parametrize(
    ("sent", "missing"), [("1A0", "Turning with a value of yaw_rate"), ("1A1", "Pace with a value of speed")]
)
def test_a_log_of_half_a_motion(tmp_path: Path, sent: str, missing: str) -> None:
    """As where a message comes with another identifier than its DBC says: the motion would never be known."""
    (tmp_path / "car.dbc").write_text(
        'BO_ 416 Pace: 2 Car\n SG_ Speed : 0|16@1+ (0.01,0) [0|0] "m/s" Car\n\n'
        'BO_ 417 Turning: 2 Car\n SG_ Rate : 0|16@1- (0.001,0) [0|0] "rad/s" Car\n'
    )
    (tmp_path / "car.toml").write_text(
        '[speed]\nmessage = "Pace"\nsignal = "Speed"\n\n[yaw_rate]\nmessage = "Turning"\nsignal = "Rate"\n'
    )
    log = tmp_path / "drive.log"
    log.write_text(f"(1.0) can0 {sent}#D007\n(1.1) can0 {sent}#D007\n")
    with pytest.raises(ValueError, match=rf"drive\.log: expected frames of {missing}, got none"):
        read_can_log(log, tmp_path / "car.dbc", tmp_path / "car.toml")


def test_a_bus_without_a_name_is_refused(tmp_path: Path) -> None:
    """No frame came from it."""
    (tmp_path / "car.toml").write_text('bus = ""\n[speed]\nmessage = "Pace"\nsignal = "Speed"\n')
    with pytest.raises(ValueError, match=r"car\.toml: bus: .*at least 1 character, got ''"):
        read_mapping(tmp_path / "car.toml")


def test_a_log_of_another_bus(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text("(1.0) can0 123#00\n(1.1) can0 123#01\n")
    with pytest.raises(
        ValueError, match="expected frames of StreetSegment, StreetPosition, EgoMotion, with values, got none"
    ):
        read_can_log(path)
    with pytest.raises(ValueError, match=r"drive\.mf4: expected a CAN log that ends in"):
        read_can_log(tmp_path / "drive.mf4")


def test_a_frame_that_is_too_short(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text("(1.5) can0 3A1#00\n")
    with pytest.raises(ValueError, match=r"drive\.log: frame at 1\.500000 s: StreetPosition: "):
        read_can_log(path)


def test_a_position_that_the_car_does_not_know(tmp_path: Path) -> None:
    """It takes the place of the message before; a segment that was never sent does so, too."""
    path = tmp_path / "drive.log"
    write_can_log(path, [(0, message())])
    known = path.read_text()
    unknown = f"{0x2 | 40 << 6 | 7 << 14 | 1 << 17:08x}"  # error class 7
    absent = f"{0x9 | 40 << 6 | 1 << 14 | 1 << 17:08x}"  # segment 9
    for code in (unknown, absent):
        data = bytes.fromhex(code)[::-1].hex()
        path.write_text(f"{known}(0.1) vcan0 3A1#{data}\n")
        log = read_can_log(path)
        assert log.street(50 * MS) == message()
        assert log.street(150 * MS) is None


@pytest.mark.parametrize("words", ["SIG_VALTYPE_ 256 Speed : 3;", "SIG_VALTYPE_ 256 Speed 12 ;"])
def test_a_type_of_a_signal_that_is_none_is_refused(tmp_path: Path, words: str) -> None:
    path = tmp_path / "car.dbc"
    signal = 'BO_ 256 Motion: 8 Car\n SG_ Speed : 0|32@1+ (1,0) [0|0] "m/s" Car\n'
    path.write_text(f"{signal}\n{words}\n")
    with pytest.raises(ValueError, match=r"car\.dbc: SIG_VALTYPE_: Speed: expected 0 .*, got (3|12)$"):
        read_dbc(path)
    path.write_text(f"{signal}\nSIG_VALTYPE_ 256 Speed : 1;\n")
    assert read_dbc(path)["Motion"].signals[0].is_float


def test_a_float_of_the_wrong_length_is_refused(tmp_path: Path) -> None:
    """cantools takes 16 bits for a float of its own, and the speed would be another one."""
    dbc, mapping = tmp_path / "car.dbc", tmp_path / "car.toml"
    signal = ' SG_ Speed : 0|16@1+ (1,0) [0|0] "m/s" Car\n SG_ Yaw : 32|16@1- (1,0) [0|0] "rad/s" Car\n'
    dbc.write_text(f"BO_ 256 Motion: 8 Car\n{signal}\nSIG_VALTYPE_ 256 Speed : 1;\n")
    parts = (
        f'[{name}]\nmessage = "Motion"\nsignal = "{own}"\n' for name, own in (("speed", "Speed"), ("yaw_rate", "Yaw"))
    )
    mapping.write_text("".join(parts))
    with pytest.raises(
        ValueError, match=r"car\.dbc: Motion: Speed: expected a float of 32 bits or a double of 64, got 16"
    ):
        CanDecoder(dbc, mapping)


def test_a_long_line_is_not_quoted_whole(tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(100_000 * "(")
    with pytest.raises(ValueError, match=r"car\.dbc: expected a DBC file: ") as caught:
        read_dbc(path)
    assert len(str(caught.value)) < 500
