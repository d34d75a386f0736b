"""Sound files of every kind that Foreglow reads, small, and the command that reads each."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.calibration import calibration_to_toml
from foreglow.cli import app
from foreglow.datasets import open_source, shipped_drive
from foreglow.datasets.vehicle_logs import write_can_log
from foreglow.geometry import Camera, Pose
from foreglow.types import EgoMotion
from tests.datasets.bags.bags import images as random_images
from tests.datasets.bags.bags import make_bag, raw
from tests.datasets.tiny_pvdn import make_pvdn
from tests.datasets.vehicle_logs.messages import message

NUM_IMAGES, WIDTH_PX, HEIGHT_PX = 8, 320, 240
CAMERA = Camera(1280, 960, (1300.0, 1300.0), (640.0, 480.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))


@dataclasses.dataclass(frozen=True)
class Material:
    """A file, and the command that reads it.

    Attributes:
        file: Its path below the folder of all materials.
        command: Words of the command line; `@NAME` is the file or folder NAME of the materials.
        is_text: Whether it is meant to be read by people, too.
    """

    file: str
    command: tuple[str, ...]
    is_text: bool = False


def run(file: str, *more: str) -> tuple[str, ...]:
    return ("run", f"@{file}", "--out", "out", "--limit", "5", *more)


def beam(*more: str) -> tuple[str, ...]:
    return ("beam", "@results", "--out", "out", "--calibration", "@camera.toml", "--can-log", "@drive.log", *more)


ON_VIDEO = run("night.mp4")
EVALUATE = ("evaluate", "@night/val", "--predictions", "@predictions.jsonl", "--json", "out.json")

MATERIALS: dict[str, Material] = {
    **{f"image .{suffix}": Material(f"night.{suffix}", run(f"night.{suffix}"))
       for suffix in ("png", "jpg", "tif", "bmp", "pgm", "npy", "webp")},
    "image of a folder": Material("images/000002.png", run("images")),
    "video .mp4": Material("night.mp4", run("night.mp4")),
    "video .ts, live": Material("night.ts", ("live", "@night.ts", "--speed", "0", "--out", "out")),
    "video .avi": Material("night.avi", run("night.avi", "--on-error", "mark")),
    "recording .mcap": Material("night.mcap", run("night.mcap")),
    "recording .mcap, live": Material("night.mcap", ("live", "@night.mcap", "--speed", "0", "--out", "out")),
    "bag of ROS 1": Material("drive.bag", run("drive.bag")),
    "bag of ROS 2": Material("drive_sqlite3/drive_sqlite3.db3", run("drive_sqlite3")),
    "metadata of a bag": Material("drive_sqlite3/metadata.yaml", run("drive_sqlite3"), True),
    "sequences of a split": Material("night/val/labels/sequences.json", run("night/val"), True),
    "annotations of a split": Material("night/val/labels/image_annotations.json", run("night/val"), True),
    "predictions": Material("predictions.jsonl", EVALUATE, True),
    "frames of a run": Material("results/frames.jsonl", beam(), True),
    "times of a run": Material("results/times.jsonl", ("report", "@results", "--out", "out.html"), True),
    "summary of a run": Material("results/summary.json", ("report", "@results", "--out", "out.html"), True),
    "configuration": Material("results/config.toml", (*ON_VIDEO, "--config", "@results/config.toml"), True),
    "calibration": Material("camera.toml", (*ON_VIDEO, "--calibration", "@camera.toml"), True),
    "calibration of ROS": Material(
        "camera.yaml",
        ("calibrate", "convert", "@camera.yaml", "--out", "o.toml", "--mount-forward", "1.9", "--mount-height", "1.3"),
        True,
    ),
    "model": Material("model.onnx", (*ON_VIDEO, "--model", "@model.onnx")),
    "headlamps": Material("lamps.toml", beam("--lamps", "@lamps.toml"), True),
    "CAN log .asc": Material("drive.asc", (*ON_VIDEO, "--can-log", "@drive.asc"), True),
    "CAN log .log": Material("drive.log", (*ON_VIDEO, "--can-log", "@drive.log"), True),
    "CAN log .blf": Material("drive.blf", (*ON_VIDEO, "--can-log", "@drive.blf")),
    "DBC": Material("street.dbc", (*ON_VIDEO, "--can-log", "@drive.log", "--dbc", "@street.dbc",
                                   "--mapping", "@street.toml"), True),
    "mapping": Material("street.toml", (*ON_VIDEO, "--can-log", "@drive.log", "--dbc", "@street.dbc",
                                        "--mapping", "@street.toml"), True),
    "map of GeoJSON": Material("town.geojson", (*ON_VIDEO, "--map", "@town.geojson", "--poses", "@drive.csv"), True),
    "map of OpenDRIVE": Material("town.xodr", (*ON_VIDEO, "--map", "@town.xodr", "--poses", "@local.tum"), True),
    "map of Lanelet2": Material("town.osm", (*ON_VIDEO, "--map", "@town.osm", "--poses", "@drive.csv"), True),
    "poses .csv": Material("drive.csv", (*ON_VIDEO, "--map", "@town.geojson", "--poses", "@drive.csv"), True),
    "poses .tum": Material("local.tum", (*ON_VIDEO, "--map", "@town.xodr", "--poses", "@local.tum"), True),
}  # fmt: skip


def make_materials(folder: Path) -> None:
    """Writes every file of `MATERIALS` into an empty folder."""
    source = open_source(shipped_drive())
    images = [
        cv2.resize(frame.image, (WIDTH_PX, HEIGHT_PX)) for frame, _ in zip(source, range(NUM_IMAGES), strict=False)
    ]
    (folder / "images").mkdir()
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / "images" / f"{number:06d}.png"), image)
    for suffix in ("png", "jpg", "tif", "bmp", "pgm", "webp"):
        cv2.imwrite(str(folder / f"night.{suffix}"), images[0])
    np.save(folder / "night.npy", images[0])
    for name, codec in (("night.mp4", "libx264"), ("night.ts", "libx264"), ("night.avi", "mjpeg")):
        write_video(folder / name, codec, images)
    make_bag(folder, "bag", [raw(image) for image in random_images(NUM_IMAGES)])
    make_bag(folder, "sqlite3", [raw(image) for image in random_images(NUM_IMAGES)])
    split = make_pvdn(folder)
    photometry = resources.files("foreglow.photometry")
    models = resources.files("foreglow.models")
    logs = resources.files("foreglow.datasets.vehicle_logs")
    for source_file, name in (
        (photometry / "headlamps.toml", "lamps.toml"),
        (models / "foreglow.onnx", "model.onnx"),
        (logs / "street.dbc", "street.dbc"),
        (logs / "street.toml", "street.toml"),
    ):
        (folder / name).write_bytes(source_file.read_bytes())
    write_texts(folder)
    command("run", folder / "images", "--out", folder / "results", "--calibration", folder / "camera.toml")
    command("record", folder / "images", "--out", folder / "night.mcap")
    command("run", split, "--out", folder / "of_split")
    shutil.copy(folder / "of_split" / "frames.jsonl", folder / "predictions.jsonl")


def command(*words: object) -> None:
    """A command of the program, in this process."""
    app([str(word) for word in words], standalone_mode=False)


def write_video(path: Path, codec: str, images: Sequence[NDArray[Any]]) -> None:
    with av.open(str(path), "w") as output:
        stream: Any = output.add_stream(codec, rate=18)
        stream.width, stream.height = WIDTH_PX, HEIGHT_PX
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for image in images:
            output.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray").reformat(format=stream.pix_fmt)))
        output.mux(stream.encode(None))


def write_texts(folder: Path) -> None:
    second = 1_000_000_000
    times_ns = range(0, 2 * second, second // 10)
    for suffix in ("asc", "log", "blf"):
        motions = [(time_ns, EgoMotion(12.0, 0.1)) for time_ns in times_ns]
        write_can_log(folder / f"drive.{suffix}", [(time_ns, message()) for time_ns in times_ns], motions)
    (folder / "camera.toml").write_text(calibration_to_toml(CAMERA))
    matrix = {"rows": 3, "cols": 3, "data": [1300.0, 0.0, 640.0, 0.0, 1300.0, 480.0, 0.0, 0.0, 1.0]}
    ros = {
        "image_width": 1280,
        "image_height": 960,
        "camera_name": "front",
        "camera_matrix": matrix,
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": [1300.0, 0, 640.0, 0, 0, 1300.0, 480.0, 0, 0, 0, 1.0, 0]},
    }
    (folder / "camera.yaml").write_text("".join(f"{key}: {json.dumps(value)}\n" for key, value in ros.items()))
    (folder / "town.geojson").write_text(
        json.dumps({"type": "LineString", "coordinates": [[9.0, 48.0], [9.005, 48.0], [9.01, 48.0001]]})
    )
    rows = [f"{k / 10},{47.999985},{9 + k * 1e-5},90" for k in range(11)]
    (folder / "drive.csv").write_text("\n".join(["timestamp_s,lat_deg,lon_deg,heading_deg", *rows, ""]))
    shape = '<geometry s="0" x="0" y="0" hdg="0" length="200"><arc curvature="0.002"/></geometry>'
    lane = '<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
    middle = '<center><lane id="0" type="none"/></center>'
    lanes = f'<lanes><laneSection s="0">{middle}<right>{lane}</right></laneSection></lanes>'
    road = f'<road id="7" length="200"><planView>{shape}</planView>{lanes}</road>'
    (folder / "town.xodr").write_text(f"<?xml version='1.0'?>\n<OpenDRIVE><header/>\n{road}\n</OpenDRIVE>")
    (folder / "local.tum").write_text("".join(f"{k / 10} {k} -1.7 0 0 0 0 1\n" for k in range(11)))
    step_deg = 1e-4 / math.cos(math.radians(48.0))
    nodes = [(f"{side}{k}", 48.0 + 1.5e-5 * (side == "l"), 9.0 + step_deg * k) for side in "lr" for k in range(11)]
    ways = "".join(
        f'<way id="{side}">' + "".join(f'<nd ref="{side}{k}"/>' for k in range(11)) + "</way>" for side in "lr"
    )
    sides = "".join(f'<member type="way" role="{side}" ref="{side[0]}"/>' for side in ("left", "right"))
    lanelet = f'<relation id="1">{sides}<tag k="type" v="lanelet"/><tag k="subtype" v="road"/></relation>'
    listed = "\n".join(f'<node id="{name}" lat="{lat:.7f}" lon="{lon:.7f}"/>' for name, lat, lon in nodes)
    (folder / "town.osm").write_text(f"<osm>\n{listed}\n{ways}\n{lanelet}\n</osm>")
