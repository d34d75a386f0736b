"""Small files, each of which would take much memory or time to read: by name, in `BOMBS`."""

from __future__ import annotations

import os
import sqlite3
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from foreglow.datasets.bags.mcap_file import MAGIC as MCAP_MAGIC
from foreglow.datasets.bags.ros1_bag import MAGIC as BAG_MAGIC
from tests.model_bombs import (
    doubled_text,
    endless_loop,
    expanded_text,
    huge_tensor,
    many_operations,
    own_functions,
    split_nothing,
)

GIB = 1 << 30


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content)


def many(num: int, content: str, before: str = "", after: str = "") -> Callable[[Path], object]:
    """A text of which a part is there many times."""
    return lambda path: path.write_text(before + num * content + after)


def sparse(size: int, head: bytes = b"") -> Callable[[Path], object]:
    def make(path: Path) -> None:
        path.write_bytes(head)
        os.truncate(path, size)

    return make


def many_scans(num: int, side: int = 8192) -> bytes:
    """A progressive JPEG whose last scan is there many times more."""
    data = bytes(cv2.imencode(".jpg", np.zeros((side, side), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1])
    return data[:-2] + num * data[data.rindex(b"\xff\xda") : -2] + data[-2:]


def poses(path: Path) -> None:
    path.write_text("".join(f"{k} 0 0 0 0 0 0 1\n" for k in range(600_000)))


def road(length_m: str) -> str:
    return f"""<OpenDRIVE><road id="1" length="{length_m}"><planView><geometry s="0" x="0" y="0" hdg="0"
        length="{length_m}"><line/></geometry></planView></road></OpenDRIVE>"""


def lanelet(*places: tuple[float, float]) -> str:
    nodes = "".join(f'<node id="{k}" lat="{lat}" lon="{lon}"/>' for k, (lat, lon) in enumerate(places))
    ways = "".join(f'<way id="{id_}"><nd ref="{k}"/><nd ref="{k + 1}"/></way>' for id_, k in (("l", 0), ("r", 2)))
    borders = "".join(f'<member type="way" role="{side}" ref="{side[0]}"/>' for side in ("left", "right"))
    return f'<osm>{nodes}{ways}<relation id="1">{borders}<tag k="type" v="lanelet"/></relation></osm>'


def ies(vertical_deg: tuple[float, ...], horizontal_deg: tuple[float, ...], kind: int = 3) -> str:
    candela = " ".join(["1"] * len(vertical_deg) * len(horizontal_deg))
    angles = [" ".join(f"{angle:g}" for angle in angles) for angles in (vertical_deg, horizontal_deg)]
    counts = f"1 -1 1 {len(vertical_deg)} {len(horizontal_deg)} {kind} 1 0 0 0 1 1 1"
    return "\n".join(["IESNA:LM-63-2002", "TILT=NONE", counts, *angles, candela, ""])


def tiff(side: int) -> Callable[[Path], object]:
    """A white picture of one bit a pixel, deflated."""

    def make(path: Path) -> None:
        data = zlib.compress(b"\xff" * (side * side // 8), 9)
        tags = [(256, 4, side), (257, 4, side), (258, 3, 1), (259, 3, 8), (262, 3, 1), (273, 4, 8), (277, 3, 1)]
        tags += [(278, 4, side), (279, 4, len(data))]
        entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
        ifd = struct.pack("<H", len(tags)) + entries + bytes(4)
        path.write_bytes(b"II*\0" + struct.pack("<I", 8 + len(data)) + data + ifd)

    return make


def npy(*shape: int, dtype: str) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
        size = 128 + int(np.prod(shape)) * np.dtype(dtype).itemsize
        sparse(size, b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header)(path)

    return make


def blf(start: bytes, size: int) -> Callable[[Path], object]:
    """A log of a container with these bytes and then zeros."""

    def make(path: Path) -> None:
        header = struct.pack("<4sLBBBBBBBBQQLL8H8H", b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 0, 0, 0, 0, *[1] * 16)
        with path.open("wb") as file:
            file.write(header.ljust(144, b"\0"))
            packer = zlib.compressobj(1)
            begin = packer.compress(start)
            zeros = b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20))
            data = struct.pack("<H6xL4x", 2, size) + begin + zeros + packer.flush()
            file.write(struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(data), 10) + data)
            file.write(bytes((16 + len(data)) % 4))

    return make


def inner(size: int) -> bytes:
    """The beginning of an object in a container, which says to have this size."""
    return struct.pack("<4sHHLL", b"LOBJ", 32, 1, size, 1) + bytes(48)


def dbc(size: object = 8, start_bit: object = 0, ranges: str = "0-1") -> str:
    return f"""VERSION ""\n\nBU_: Car\n\nBO_ 100 Speed: {size} Car\n SG_ mux M : {start_bit}|8@1+ (1,0) [0|0] "" Car
 SG_ speed m0 : 8|8@1+ (1,0) [0|0] "" Car\n\nSG_MUL_VAL_ 100 speed mux {ranges};\n"""


def recursive_views(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        for name, columns in (("topics", "n, '/image', 'text', 'cdr'"), ("messages", "n, 1, n, x'00'")):
            titles = "id, name, type, serialization_format" if name == "topics" else "id, topic_id, timestamp, data"
            connection.execute(
                f"CREATE VIEW {name} ({titles}) AS WITH RECURSIVE many (n) AS "
                f"(SELECT 1 UNION ALL SELECT n + 1 FROM many) SELECT {columns} FROM many"
            )
    connection.close()


def generated_texts(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        names = ", ".join(f"g{k} TEXT AS (g{k - 1} || g{k - 1})" for k in range(1, 21))
        connection.execute(
            f"CREATE TABLE topics (id INTEGER, g0 TEXT, {names}, name TEXT AS (g20), type, serialization_format)"
        )
        connection.execute("CREATE TABLE messages (id, topic_id, timestamp, data)")
        connection.executemany("INSERT INTO topics (id, g0) VALUES (?, 'xx')", [(k,) for k in range(20)])
    connection.close()


def record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def chunk(size: int, content: bytes) -> bytes:
    return record(
        6,
        struct.pack("<QQQI4sQ", 0, 0, size, 0, b"", 0)[:28]
        + struct.pack("<I", 4)
        + b"zstd"
        + struct.pack("<Q", len(content))
        + content,
    )


def mcap(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(MCAP_MAGIC + content + MCAP_MAGIC)


def long_topic(path: Path) -> None:
    import zstandard

    name = b"x" * (100 << 20)
    channel = struct.pack("<HHI", 1, 0, len(name)) + name + struct.pack("<I", 3) + b"cdr" + bytes(4)
    content = record(4, channel)
    mcap(chunk(len(content), zstandard.ZstdCompressor().compress(content)))(path)


def bag_header(path: Path) -> None:
    sparse(6 * GIB, BAG_MAGIC + struct.pack("<I", 4 * GIB - 1))(path)


def one_split(sequences: Callable[[Path], object]) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        (path / "images").mkdir(parents=True)
        (path / "labels").mkdir()
        sequences(path / "labels" / "sequences.json")

    return make


def bag_metadata(path: Path) -> None:
    path.mkdir()
    aliases = "".join(f"l{k}: &l{k} [{', '.join([f'*l{k - 1}'] * 10)}]\n" for k in range(1, 10))
    (path / "metadata.yaml").write_text(f"l0: &l0 [lol]\n{aliases}rosbag2_bagfile_information: *l9\n")


def alias_camera(path: Path) -> None:
    aliases = "".join(f"l{k}: &l{k} [{', '.join([f'*l{k - 1}'] * 10)}]\n" for k in range(1, 10))
    path.write_text(f"l0: &l0 [0]\n{aliases}image_width: *l9\n")


def archive(path: Path) -> None:
    import zipfile

    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file,
        file.open("about.npy", "w", force_zip64=True) as part,
    ):
        for _ in range(1100):
            part.write(bytes(1 << 20))


def grid_headlamps(grid: str) -> str:
    lamps = "".join(f"[{side}]\nposition_m = [2.0, {y_m}, 0.7]\n" for side, y_m in (("left", 0.6), ("right", -0.6)))
    return f"""name = "x"\n{lamps}[grid]\nnum_columns = 28\npitch_deg = 1.2\nrow_elevations_deg = [0.0, 1.0]
row_peaks_cd = [1000.0, 1000.0]\nside_sigma_deg = 10.0\neverywhere_cd = 0.0\nhalf_width_deg = 1.0
half_height_deg = 1.0\nedge_exponent = 4.0\nreach_width_deg = 2.0\nreach_height_deg = 2.0\n{grid}"""


def changed(content: str, **fields: str) -> str:
    lines = [line for line in content.splitlines() if line.partition(" =")[0] not in fields]
    return "\n".join([*lines, *(f"{name} = {value}" for name, value in fields.items()), ""])


BOMBS: dict[str, tuple[str, str, Callable[[Path], object], str]] = {
    "a road of a million kilometres": ("road map", "a.xodr", text(road("1e9")), "length: expected at most 100000 m"),
    "a thousand long roads": (
        "road map", "a.xodr", many(100, road("99999")[11:-12], "<OpenDRIVE>", "</OpenDRIVE>"), "at most 2000000 points",
    ),
    "entities of a document type": (
        "road map", "a.xodr", text('<!DOCTYPE x [<!ENTITY a "b">]>' + road("10")), "without a document type",
    ),
    "many elements": ("road map", "a.xodr", many(5_000_000, "<a/>", "<OpenDRIVE>", "</OpenDRIVE>"), "elements"),
    "a stray node": (
        "road map", "a.osm", text(lanelet((48.0, 9.0), (-48.0, 99.0), (48.0001, 9.0), (48.0001, 9.01))),
        "length: expected at most",
    ),
    "places of zeros": (
        "road map", "a.geojson", many(2_000_000, "[0,0],", '{"coordinates": [', "[0,0]]}"), "JSON of at most",
    ),
    "deep lists": ("road map", "a.json", many(1_000_000, "["), "expected JSON"),
    "a pose a nanosecond": (
        "poses", "a.tum", poses, "at most 500000 poses",
    ),
    "a line of commas": ("poses", "a.csv", many(50_000_000, ","), "line 1: expected at most"),
    "fine steps beyond the sphere": (
        "lamp", "a.ies", text(ies((-360.0, -359.95, 360.0), (-360.0, 0.0, 360.0))), "vertical angles: expected",
    ),
    "a lamp of 30 GiB": ("lamp", "a.ldt", sparse(30 * GIB), "at most 16 MiB"),
    "a fine step of LEDs": (
        "headlamps", "a.toml", text(changed(grid_headlamps(""), half_width_deg="1e-6", reach_width_deg="2e-6")),
        "grid.half_width_deg: Input should be greater",
    ),
    "more LEDs than a guard has tables for": (
        "headlamps", "a.toml",
        text(changed(grid_headlamps(""), num_columns="512", pitch_deg="0.1", half_width_deg="3.0",
                     reach_width_deg="3.0", row_elevations_deg="[0.0, 0.5, 1.0]", row_peaks_cd="[1e4, 1e4, 1e4]")),
        "expected at most 1024 LEDs in all rows, got 1536",
    ),
    "a fine step of LEDs in a wide lamp": (
        "headlamps", "a.toml",
        text(changed(grid_headlamps(""), half_width_deg="0.05", reach_width_deg="80.0", half_height_deg="0.05",
                     reach_height_deg="80.0")), "LEDs: expected",
    ),
    "a lot of LEDs": (
        "headlamps", "a.toml",
        text(changed(grid_headlamps(""), num_columns="100", pitch_deg="0.1",
                     row_elevations_deg=str([k / 10 for k in range(10)]), row_peaks_cd=str([1.0] * 10),
                     reach_width_deg="30.0", reach_height_deg="30.0")), "LEDs: ",
    ),
    "a wide TIFF": ("frames", "a.tif", tiff(30_000), "8192 px a side, got 30000x30000"),
    "a wide TIFF by another name": ("frames", "a.png", tiff(30_000), "8192 px a side, got 30000x30000"),
    "a JPEG of many scans": (
        "frames", "a.jpg", lambda path: path.write_bytes(many_scans(3000)), "JPEG of at most 100 scans",
    ),
    "a wide BMP": (
        "frames", "a.bmp",
        sparse(999, b"BM" + bytes(12) + struct.pack("<IiiHHI", 40, 40_000, 40_000, 1, 8, 1)), "got 40000x40000",
    ),
    "a wide PGM": ("frames", "a.pgm", text("P5 40000 # wide\n 20000 255\n"), "got 40000x20000"),
    "a format whose size is not asked": (
        "frames", "a.png", text("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 30000\n"), "expected an image",
    ),
    "a sparse array": ("frames", "a.npy", npy(100_000, 100_000, dtype="|u1"), "a file of at most"),
    "a long array": ("frames", "a.npy", npy(10_000_000, 2, dtype="|u1"), "got 2x10000000"),
    "a sparse array of wide values": ("frames", "a.npy", npy(8000, 8000, 4, dtype="<f8"), "a file of at most"),
    "a large file": ("frames", "a.png", sparse(30 * GIB), "at most 512 MiB"),
    "a wide video": (
        "frames", "a.y4m", text("YUV4MPEG2 W60000 H60000 F25:1 Ip A1:1 C420jpeg\nFRAME\n"), "at most 8192 px a side",
    ),
    "a pipe for a recording": ("frames", "a.mcap", os.mkfifo, "is a pipe"),
    "a pipe for an image": ("frames", "a.png", os.mkfifo, "is a pipe"),
    "a pipe for a video": ("frames", "a.mp4", os.mkfifo, "a.mp4: "),
    "a chunk that lies": ("frames", "a.mcap", mcap(chunk(1 << 40, b"x")), "chunk of at most"),
    "a topic of 100 MB": ("frames", "a.mcap", long_topic, "topic: expected at most"),
    "a header of 4 GiB": ("frames", "a.bag", bag_header, "header: expected at most"),
    "tables that are recursive views": ("frames", "a.db3", recursive_views, "a.db3: "),
    "texts that double": ("frames", "a.db3", generated_texts, "a.db3: "),
    "aliases of aliases in a bag": ("frames", "a", bag_metadata, "no aliases"),
    "aliases of aliases in a camera": ("calibration", "a.yaml", alias_camera, "no aliases"),
    "a camera of 10 GiB": ("calibration", "a.txt", sparse(10 * GIB), "at most 1 MiB"),
    "labels of zeros": ("labels", "split", one_split(many(40_000_000, "0,", "[", "0]")), "sequences.json: "),
    "labels of a billion frames": (
        "labels of a tool", "a.xml",
        text("<annotations><meta><task><size>1000000000</size></task></meta></annotations>"), "expected 1 to 200000",
    ),
    "labels of a sparse file": ("labels of a tool", "a.xml", sparse(30 * GIB, b"<annotations>"), "at most 64 MiB"),
    "labels of many elements": (
        "labels of a tool", "a.xml", many(5_000_000, "<a/>", "<annotations>", "</annotations>"), "elements and",
    ),
    "labels of many regions": (
        "labels of a tool", "a.json", many(3_000_000, "{},", '[{"annotations":[{"result":[', "{}]}]}]"), "values, got",
    ),
    "labels of a deep list": ("labels of a tool", "a.json", text("[" * 1_000_000), "a.json: "),
    "boxes of zeros": ("predictions", "a.json", many(30_000_000, "0,", "[", "0]"), "a.json: "),
    "a line of zeros": ("tracks", "a.jsonl", many(30_000_000, "0,", "[", "0]"), "line 1: expected at most"),
    "lines of 30 GiB": ("predictions", "a.jsonl", sparse(30 * GIB), "at most 512 MiB"),
    "a key of many parts": ("configuration", "a.toml", text("a." * 100_000 + "a = 1"), "at most 16 parts"),
    "a key of many parts inside": ("configuration", "a.toml", text("x = {" + "a." * 100_000 + "a = 1}"), "16 parts"),
    "a configuration without end": ("configuration", "a.toml", lambda path: path.symlink_to("/dev/zero"), "a device"),
    "a mapping of 10 GiB": ("mapping", "a.toml", sparse(10 * GIB), "at most 1 MiB"),
    "posts a micrometre apart": (
        "scene", "a.toml", text("[surroundings]\ndelineator_spacing_m = 1e-6"), "surroundings.delineator_spacing_m: ",
    ),
    "trees a micrometre apart": (
        "scene", "a.toml", text('[[surroundings.woods]]\nside = "left"\nspan_m = [0.0, 400.0]\nspacing_m = 1e-6'),
        "surroundings.woods.0.spacing_m: ",
    ),
    "a side road of a million kilometres": (
        "scene", "a.toml", text("[[road.branches]]\ns_m = 10.0\nangle_deg = 90.0\nlength_m = 1e9"), "length_m",
    ),
    "a message of 4 GB": ("DBC", "a.dbc", text(dbc(size=4_000_000_000)), "a message: expected at most"),
    "a signal far behind": ("DBC", "a.dbc", text(dbc(start_bit=4_000_000_000)), "a signal: expected at most"),
    "a range of 4 billion": ("DBC", "a.dbc", text(dbc(ranges="0-4000000000")), "SG_MUL_VAL_: "),
    "a container of 300 MB": ("CAN log", "a.blf", blf(b"", 300 << 20), "unpacked: expected"),
    "an object of 4 GB": ("CAN log", "a.blf", blf(inner(4_000_000_000), 0), "expected an object of"),
    "an object of no size": ("CAN log", "a.blf", blf(inner(0), 0), "expected an object of"),
    "a line of 3 GiB": ("CAN log", "a.asc", sparse(3 * GIB), "line 1: expected at most"),
    "a log of 30 GiB": ("CAN log", "a.log", sparse(30 * GIB), "at most 4096 MiB"),
    "a model of 30 GiB": ("model", "a.onnx", sparse(30 * GIB), "at most 512 MiB"),
    "a model of a huge tensor": ("model run", "a.onnx", huge_tensor, "can be run: "),
    "a model of a text that doubles": ("model run", "a.onnx", doubled_text, "of numbers"),
    "a model of many long texts": ("model run", "a.onnx", expanded_text, "got a tensor of texts"),
    "a model of a sequence of nothing": (
        "model run", "a.onnx", split_nothing, "got the operation 'SplitToSequence'",
    ),
    "a model of a loop without end": ("model", "a.onnx", endless_loop, "without loops, got the operation 'Loop'"),
    "a model of many operations": ("model", "a.onnx", many_operations, "at most 10000 operations"),
    "a model of functions": ("model", "a.onnx", own_functions, "without functions of its own"),
    "an archive of a GiB": ("glare drive", "a.npz", archive, "unpacked"),
}  # fmt: skip
