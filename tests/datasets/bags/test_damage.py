"""Cut, flipped and random bytes: a clear error or clean frames, and no memory by what they claim of themselves."""

from __future__ import annotations

import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foreglow.datasets import Recording
from foreglow.datasets.bags.containers import decompressed
from foreglow.datasets.bags.recording import DECODERS
from foreglow.datasets.source import OnError
from tests.datasets.bags.bags import TOPIC, images, make_bag, make_mcap, raw

IMAGES = images(5)
QUICK = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


def _mcap(folder: Path) -> Path:
    return make_mcap(folder / "drive.mcap", IMAGES)


def _plain_mcap(folder: Path) -> Path:
    return make_mcap(folder / "drive.mcap", IMAGES, compression="NONE")


def _bag(folder: Path) -> Path:
    return make_bag(folder, "bag", [raw(image) for image in IMAGES])


def _lz4_bag(folder: Path) -> Path:
    return make_bag(folder, "bag", [raw(image) for image in IMAGES], compression="lz4")


def _sqlite(folder: Path) -> Path:
    return next(make_bag(folder, "sqlite3", [raw(image) for image in IMAGES]).glob("*.db3"))


MAKERS = {"mcap": _mcap, "plain mcap": _plain_mcap, "bag": _bag, "lz4 bag": _lz4_bag, "sqlite": _sqlite}


@pytest.fixture(scope="module", params=MAKERS)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    maker: Callable[[Path], Path] = MAKERS[request.param]
    return maker(tmp_path_factory.mktemp("whole"))


def check(path: Path) -> None:
    """Whatever comes out, alone or beside a line that says what is wrong, was in the recording."""
    try:
        source = Recording(path, on_error="skip")
    except ValueError as error:
        complaint = str(error)
        assert complaint.startswith(f"{path}: ")
        return
    for frame in source:
        assert frame.image.shape == IMAGES[0].shape
    assert all(line.startswith(str(path)) and "\n" not in line for line in source.skipped)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*truncated")
@QUICK
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere(whole: Path, share: float) -> None:
    data = whole.read_bytes()
    cut = whole.with_name(f"cut{whole.suffix}")
    cut.write_bytes(data[: int(share * len(data))])
    check(cut)
    try:
        frames = list(Recording(cut, on_error="skip"))
    except ValueError:
        return
    np.testing.assert_array_equal([frame.image for frame in frames], IMAGES[: len(frames)])
    if cut.stat().st_size < len(data):
        with pytest.raises(ValueError, match=r"truncated .*; --on-error skip reads what is there"):
            Recording(cut)


@pytest.mark.slow
@pytest.mark.parametrize("on_error", ["stop", "skip"])
@pytest.mark.parametrize("kind", MAKERS)
def test_a_file_cut_while_it_is_read(tmp_path: Path, kind: str, on_error: OnError) -> None:
    """Another error than a `ValueError` ended a live run without its results."""
    whole = MAKERS[kind](tmp_path)
    data = whole.read_bytes()
    for size in range(0, len(data), max(1, len(data) // 40)):
        whole.write_bytes(data)
        source = Recording(whole, on_error=on_error)
        frames = iter(source)
        read = [next(frames)]
        os.truncate(whole, size)
        complaints = source.skipped
        try:
            read += frames
        except ValueError as error:
            complaints = [str(error)]
        if kind != "sqlite":  # SQLite takes what is missing for zeros
            np.testing.assert_array_equal([frame.image for frame in read], IMAGES[: len(read)])
        assert complaints, size
        assert all(line.startswith(f"{whole}: ") for line in complaints)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*truncated")
@QUICK
@given(share=st.floats(0.0, 0.999), value=st.binary(min_size=1, max_size=8))
def test_bytes_changed_anywhere(whole: Path, share: float, value: bytes) -> None:
    data = bytearray(whole.read_bytes())
    position = int(share * (len(data) - len(value)))
    data[position : position + len(value)] = value
    damaged = whole.with_name(f"damaged{whole.suffix}")
    damaged.write_bytes(data)
    check(damaged)


@QUICK
@given(data=st.binary(max_size=200))
def test_random_bytes_behind_a_good_start(whole: Path, data: bytes) -> None:
    path = whole.with_name(f"random{whole.suffix}")
    path.write_bytes(whole.read_bytes()[:13] + data)
    check(path)


@given(data=st.binary(max_size=300))
def test_random_messages(data: bytes) -> None:
    for decode in DECODERS.values():
        for content in (data, b"\x00\x01\x00\x00" + data):
            with pytest.raises(ValueError, match=": "):  # so few bytes are no image of 64x64 px
                decode(memoryview(content)).image()


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        (("sensor_msgs/msg/Image", "cdr"), b"\0\1\0\0" + struct.pack("<iI", 7, 4_000_000_000) + bytes(40)),
        (("sensor_msgs/Image", "ros1"), struct.pack("<III", 1, 7, 4_000_000_000) + bytes(40)),
        (("foxglove.RawImage", "protobuf"), b"\x0a\x0b\x08" + b"\xff" * 9 + b"\x01"),  # -1 s
    ],
)
def test_a_time_that_cannot_be(kind: tuple[str, str], data: bytes) -> None:
    """The frame was taken to be of another time, seconds or centuries away."""
    with pytest.raises(ValueError, match=r"stamp: expected seconds below 2\^32 and less than 1e9 ns, got "):
        DECODERS[kind](memoryview(data))


def test_a_killed_writers_file_is_read_up_to_its_last_whole_chunk(tmp_path: Path) -> None:
    data = _mcap(tmp_path).read_bytes()
    third = data.index(struct.pack("<BQ", 6, 0)[:1], len(data) // 2)
    path = tmp_path / "drive.mcap.partial"
    path.write_bytes(data[:third])
    with pytest.warns(UserWarning, match="the recording was not finished"):
        source = Recording(path)
    frames = list(source)
    assert 0 < len(frames) < len(IMAGES)
    assert source.skipped == []
    assert source.num_frames is None


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_what_lies_beyond_damage_is_read(tmp_path: Path, kind: str) -> None:
    path = _mcap(tmp_path) if kind == "mcap" else _lz4_bag(tmp_path)
    data = bytearray(path.read_bytes())
    needle = b"lz4" if kind == "bag" else b"zstd"
    positions = [position for position in range(len(data)) if data.startswith(needle, position)]
    if kind == "bag":  # all of it is one chunk, and the definitions of topics with it
        data[positions[0] + 400 : positions[0] + 420] = bytes(20)
        path.write_bytes(data)
        with pytest.raises(ValueError, match=rf"{path}: byte \d+: "):
            list(Recording(path))
        return
    data[positions[2] + 100 : positions[2] + 120] = bytes(20)
    path.write_bytes(data)
    with pytest.raises(
        ValueError,
        match=rf"{path}: byte \d+: (damaged chunk, its checksum is wrong|zstd data are damaged).*; --on-error skip ",
    ):
        list(Recording(path))
    source = Recording(path, on_error="skip")
    frames = list(source)
    assert len(frames) == len(IMAGES) - 1
    assert len(source.skipped) == 1


@pytest.mark.parametrize("piece_bytes", [1, 17, 1 << 24])
@pytest.mark.parametrize("change", ["inserted", "missing", "length"])
def test_chunks_behind_missing_and_inserted_bytes_are_read(
    tmp_path: Path, change: str, piece_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("foreglow.datasets.bags.mcap_file._PIECE_BYTES", piece_bytes)
    path = _mcap(tmp_path)
    data = bytearray(path.read_bytes())
    positions = [position for position in range(len(data)) if data.startswith(b"\x04\0\0\0zstd", position)]
    at = positions[1] + 300
    if change == "inserted":
        data[at:at] = data[at - 250 : at]
    elif change == "missing":
        del data[at : at + 250]
    else:  # that of the whole record, which is 37 bytes before its compression
        data[positions[1] - 36 : positions[1] - 28] = struct.pack("<Q", 2**40)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"^{path}: (byte \d+: |expected records up to the end)"):
        list(Recording(path))
    source = Recording(path, on_error="skip")
    np.testing.assert_array_equal([frame.image for frame in source], [IMAGES[0], *IMAGES[2:]])
    assert source.skipped == source.lost_parts
    assert source.skipped


def test_no_more_than_so_many_damaged_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foreglow.datasets.bags.mcap_file.MAX_BREAKS", 1)
    path = _mcap(tmp_path)
    data = bytearray(path.read_bytes())
    at = data.index(b"zstd", data.index(b"zstd") + 4) + 300
    del data[at : at + 250]
    path.write_bytes(data)
    source = Recording(path, on_error="skip")
    np.testing.assert_array_equal([frame.image for frame in source], [IMAGES[0]])
    assert source.skipped[-1].endswith(": expected at most 1 damaged parts, what follows is not read")


def test_damage_where_the_topic_is_defined(tmp_path: Path) -> None:
    path = _mcap(tmp_path)
    data = bytearray(path.read_bytes())
    first = data.index(b"zstd")
    data[first + 100 : first + 120] = bytes(20)
    path.write_bytes(data)
    source = Recording(path, on_error="skip")
    np.testing.assert_array_equal([frame.image for frame in source], IMAGES[1:])
    assert len(source.skipped) == 1


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_a_chunk_takes_no_more_memory_than_it_says(compression: str) -> None:
    import bz2

    lz4, zstandard = pytest.importorskip("lz4.frame"), pytest.importorskip("zstandard")
    bomb = bytes(64 << 20)
    data = {"zstd": zstandard.compress, "lz4": lz4.compress, "bz2": bz2.compress}[compression](bomb)
    tracemalloc.start()
    assert bytes(decompressed(memoryview(data), compression, 1000)) == bytes(1000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8 << 20


def test_sizes_that_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"expected a chunk of at most \d+ bytes, got 18446744073709551615"):
        decompressed(memoryview(b""), "zstd", 2**64 - 1)
    with pytest.raises(ValueError, match="expected a chunk of 5 bytes, got 4"):
        decompressed(memoryview(b"abcd"), "", 5)
    with pytest.raises(ValueError, match="expected a compression of lz4, zstd, bz2 or none, got 'brotli'"):
        decompressed(memoryview(b"abcd"), "brotli", 5)


def test_a_length_that_leads_out_of_the_file(tmp_path: Path) -> None:
    path = _mcap(tmp_path)
    data = bytearray(path.read_bytes())
    length = int.from_bytes(data[9:17], "little")
    position = 17 + length  # the record behind the header
    data[position + 1 : position + 9] = struct.pack("<Q", 2**63)
    path.write_bytes(data)
    with pytest.raises(ValueError, match="expected records up to the end, one of them is malformed"):
        list(Recording(path, topic=TOPIC))


def test_a_recording_behind_another(whole: Path) -> None:
    """As `cat` puts them together: only the first was read, and nothing said so."""
    both = whole.with_name(f"both{whole.suffix}")
    both.write_bytes(2 * whole.read_bytes())
    with pytest.raises(ValueError, match=rf"{both}: byte {whole.stat().st_size}: expected the end of the recording"):
        list(Recording(both))
    source = Recording(both, on_error="skip")
    np.testing.assert_array_equal([frame.image for frame in source], IMAGES)
    (line,) = source.skipped
    assert line.endswith("is not read: join recordings with their own tools, not with `cat`")


@pytest.mark.parametrize("tail", [bytes(3), bytes(8), bytes(4096), b"12345678", bytes(range(1, 256)) * 20])
def test_bytes_behind_a_recording(whole: Path, tail: bytes) -> None:
    """Nothing said so, or only that the end was missing; a bag of ROS 1 with zeros was not read at all."""
    longer = whole.with_name(f"longer{whole.suffix}")
    longer.write_bytes(whole.read_bytes() + tail)
    position = whole.stat().st_size
    with pytest.raises(
        ValueError, match=rf"^{longer}: byte {position}: expected the end of the recording, what follows"
    ):
        list(Recording(longer))
    source = Recording(longer, on_error="skip")
    assert source.num_frames == Recording(whole).num_frames
    np.testing.assert_array_equal([frame.image for frame in source], IMAGES)
    (line,) = source.skipped
    assert f"what follows ({len(tail)} bytes) is not read" in line
    assert source.lost_parts == [line]


def test_a_sqlite_file_whose_header_may_be_out_of_date(tmp_path: Path) -> None:
    """Programs of before 2010 do not keep the number of pages; the two counters of changes tell."""
    path = _sqlite(tmp_path)
    data = bytearray(path.read_bytes())
    data[28:32] = struct.pack(">I", 1)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"expected a ROS 2 bag in SQLite"):
        list(Recording(path))
    data[92:96] = bytes(4)
    path.write_bytes(data)
    np.testing.assert_array_equal([frame.image for frame in Recording(path)], IMAGES)


def test_a_damaged_index_of_a_bag_names_one_position(tmp_path: Path) -> None:
    data = bytearray(_bag(tmp_path).read_bytes())
    position = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[position : position + 8], "little")
    path = tmp_path / "damaged.bag"
    path.write_bytes(data[:index] + bytes(len(data) - index))
    with pytest.raises(ValueError, match=rf"^{path}: truncated bag, its index is missing or cut; "):
        Recording(path)
    with pytest.warns(UserWarning, match=rf"^{path}: truncated bag, its index is missing or cut$"):
        source = Recording(path, on_error="skip")
    np.testing.assert_array_equal([frame.image for frame in source], IMAGES)
    assert [line.count(": byte ") for line in source.skipped] == [0, 1]
    path.write_bytes(data[:13] + bytes(len(data) - 13))
    with pytest.raises(ValueError, match=rf"^{path}: byte 13: header: expected a field op") as caught:
        Recording(path, on_error="skip")
    assert str(caught.value).count("byte 13") == 1


def test_what_a_killed_rosbag_left(tmp_path: Path) -> None:
    """Its header has no position of an index yet."""
    data = bytearray(_bag(tmp_path).read_bytes())
    position = data.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(data[position : position + 8], "little")
    data[position : position + 8] = bytes(8)
    path = tmp_path / "drive.bag.active"
    path.write_bytes(data[:end])
    with pytest.warns(UserWarning, match="the recording was not finished"):
        source = Recording(path)
    np.testing.assert_array_equal([frame.image for frame in source], IMAGES)
    with pytest.raises(ValueError, match=r"drive\.bag: truncated bag, its index is missing or cut"):
        Recording(path.rename(tmp_path / "drive.bag"))
