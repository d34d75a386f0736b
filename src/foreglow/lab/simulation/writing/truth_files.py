"""What a simulated data set knows beside its images: written while a scene is driven, read by every evaluation.

Beside PVDN's `images` and `labels`, a simulated split has

    scenes.jsonl                      every scene's specification, a line each
    simulation/info.json              who made it, how, and what the numbers mean
    simulation/S00001/scene.json      the scene of this sequence, and what it was made with
    simulation/S00001/camera.toml     calibration, as `foreglow.calibration` reads it
    simulation/S00001/road.json       the main road's centre line each metre, in the world
    simulation/S00001/frames.jsonl    a `FrameTruth` a line
    simulation/S00001/depth/000000.png  LiDAR-like depth of the first image; the number is the frame's in the drive

    truth = read_truth("DATA/night/train")
    for sequence in truth:
        for frame in sequence.frames:
            points_vehicle = sequence.road_ahead(frame.image_id)
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foreglow.calibration import calibration_to_toml, read_calibration
from foreglow.config import FrozenModel
from foreglow.datasets.images import read_image
from foreglow.datasets.json_files import parse_json, read_json
from foreglow.datasets.pvdn_schema import Id
from foreglow.datasets.pvdn_writer import png
from foreglow.files import write_atomic
from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.lidar import LidarConfig, decoded_depth_m
from foreglow.lab.simulation.writing.street_data import StreetDataError, road_ahead
from foreglow.lab.simulation.writing.truth_records import FrameRecord, FrameTruth

MAX_FRAMES = 10_000
"""Images of a sequence; image ids are the sequence's number times this, plus the frame's number in the drive."""

CONVENTIONS = {
    "world": "x east, y north, z up, metres",
    "vehicle": "x forward, y left, z up, metres; origin on the road under the middle of the rear axle",
    "camera": "x along the optical axis, y left, z up; camera.toml has its pose in the vehicle",
    "image": "x = column to the right, y = row downwards; the centre of the upper left pixel is (0.5, 0.5); pixels of "
    "the full image",
    "poses": "world_from_vehicle: position_m, and rotation by rows; its columns are forward, left and up in the world",
    "boxes": "box_xyxy_px is half-open and cut to the image; the 3-D box has size_m (length, width, height) around "
    "box_centre_m in the vehicle's own frame",
    "depth": "depth_m of an artifact and the depth images are distances along the viewing ray; the images hold metres "
    "times 256 in 16 bits, 0 for nothing",
    "candidates": "instance_id, x, y, kind, is_direct, is_rear, is_doubtful, depth_m, grey, contrast, area_px, lamp",
    "illuminance": "eye_lx in lux on a plane that faces the source, by source: ego, a vehicle's id, or fixed",
    "arc_length": "ego_s_m along the main road's centre line, from its beginning; offsets are positive to the left",
    "time": "timestamp_ns from the start of the drive",
    "missing": "null stands for NaN: no depth (haze), a lamp behind the camera",
}
"""What the numbers in the files mean, for readers in other languages; goes into `info.json`."""


class Making(FrozenModel):
    """What a scene's files depend on, beside the scene itself.

    Attributes:
        generator: Name and version of the program; part of it must change when the same scene gives other bytes.
        lidar: The scanner of the depth images.
        street: How wrong the street messages are.
    """

    generator: str
    lidar: LidarConfig = LidarConfig()
    street: StreetDataError = StreetDataError()


class SceneFile(FrozenModel):
    """`scene.json`."""

    sequence: Id
    made_with: Making
    scene: Scene


class InfoFile(FrozenModel):
    """`simulation/info.json`.

    Attributes:
        made_with: What every scene was made with.
        seed: That the scenes were drawn with; None if they were not drawn.
        cycle: Exposure cycle.
        split: Name of the split.
        rate_hz: Frames a second of every sequence.
        label_rule: When light counts as an artifact; the same for every scene.
        production: Parameters of the modelled production system.
        conventions: What the numbers mean.
    """

    made_with: Making
    seed: int | None
    cycle: str
    split: str
    rate_hz: float
    label_rule: dict[str, Any]
    production: dict[str, Any]
    conventions: dict[str, str] = CONVENTIONS


class _RoadFile(FrozenModel):
    lane_width_m: float
    s_m: tuple[float, ...]
    points_world_m: tuple[tuple[float, float, float], ...] = Field(repr=False)


class SceneWriter:
    """Writes what is known of one drive into a folder, frame by frame; `close` completes it."""

    def __init__(self, folder: Path, file: SceneFile) -> None:
        """Makes `folder/depth`; `folder` must exist."""
        self.folder = folder
        self._file = file
        self._camera_toml: str | None = None
        self._lines: list[str] = []
        (folder / "depth").mkdir(exist_ok=True)

    def add(self, frame: FrameTruth, camera: Camera, depth: NDArray[np.uint16]) -> None:
        """Adds a frame: its calibration, which must stay, and its stored depth image.

        Raises:
            ValueError: If the calibration changes, or a number that must be finite is not.
            OSError: If the depth image cannot be written.
        """
        toml = calibration_to_toml(camera)
        if toml != (self._camera_toml or toml):
            raise ValueError(f"image {frame.image_id}: camera: expected the drive's calibration to stay, it changed")
        self._camera_toml = toml
        write_atomic(self.folder / "depth" / f"{len(self._lines):06d}.png", png(depth))
        self._lines.append(FrameRecord.of(frame).model_dump_json() + "\n")

    def close(self) -> None:
        """Writes the other files, `scene.json` last.

        Raises:
            ValueError: If there was no frame.
            OSError: If a file cannot be written.
        """
        if self._camera_toml is None:
            raise ValueError(f"{self.folder}: frames: expected at least one, the drive had none")
        write_atomic(self.folder / "camera.toml", self._camera_toml.encode())
        write_atomic(self.folder / "frames.jsonl", "".join(self._lines).encode())
        write_atomic(self.folder / "road.json", _road_file(self._file.scene).model_dump_json().encode())
        write_atomic(self.folder / "scene.json", self._file.model_dump_json(indent=1).encode())


@dataclass(frozen=True)
class SequenceTruth:
    """What is known of one sequence.

    Attributes:
        root: Its folder, `SPLIT/simulation/S00001`.
        sequence_id: Its number, as in `sequences.json`.
        scene: The specification that it was driven from.
        camera: Calibration of all its images.
        frames: Its images in the order of time.
    """

    root: Path
    sequence_id: int
    scene: Scene
    camera: Camera
    frames: tuple[FrameTruth, ...]

    @property
    def directory(self) -> str:
        """Name of its folder of images, such as S00001."""
        return self.root.name

    @cached_property
    def road(self) -> Road:
        """The main road."""
        return Road(self.scene.road)

    def frame(self, image_id: int) -> FrameTruth:
        """The image `image_id`; ValueError if it is of another sequence."""
        return self.frames[self._place(image_id)]

    def depth_m(self, image_id: int) -> Floats:
        """LiDAR-like depth of image `image_id`, shape (height, width), metres along the viewing ray; NaN where none.

        Raises:
            FileNotFoundError: If the depth image is missing.
            ValueError: If there is no such image, or its depth image is broken or not of the camera's size.
        """
        path = self.root / "depth" / f"{self._place(image_id):06d}.png"
        stored = read_image(path)
        if stored.shape != (self.camera.height_px, self.camera.width_px):
            raise ValueError(
                f"{path}: image size: expected {self.camera.width_px}x{self.camera.height_px} px as in camera.toml, "
                f"got {stored.shape[1]}x{stored.shape[0]} px"
            )
        if stored.dtype != np.uint16:
            raise ValueError(f"{path}: expected an image of 16 bits, got {stored.dtype}")
        return decoded_depth_m(stored.astype(np.uint16, copy=False))

    def road_ahead(self, image_id: int, length_m: float = 400.0, left_m: float = 0.0) -> Floats:
        """The true road ahead of us in image `image_id`: shape (N, 3), each metre; see `street_data.road_ahead`."""
        frame = self.frame(image_id)
        return road_ahead(self.road, frame.ego_s_m, frame.ego_pose, length_m, left_m)

    def _place(self, image_id: int) -> int:
        place = image_id - self.sequence_id * MAX_FRAMES
        if not 0 <= place < len(self.frames):
            raise ValueError(f"{self.root}: image_id: expected an image of this sequence, got {image_id}")
        return place


class SimulatedTruth:
    """What is known of a simulated split; iterating reads its sequences one after the other.

    Attributes:
        root: The split's folder.
        info: Who made it, how, and what the numbers mean.
        sequence_ids: The finished sequences, in order.
    """

    def __init__(self, root: Path) -> None:
        """Reads `info.json` and looks which sequences are there."""
        self.root = root
        self.info: InfoFile = read_json(root / "simulation" / "info.json", InfoFile)
        self.sequence_ids: tuple[int, ...] = finished_sequences(root)

    def __len__(self) -> int:
        return len(self.sequence_ids)

    def __iter__(self) -> Iterator[SequenceTruth]:
        return (self.sequence(sequence_id) for sequence_id in self.sequence_ids)

    def sequence(self, sequence_id: int) -> SequenceTruth:
        """The sequence with this number in `sequences.json`; all but its depth images is read now.

        Raises:
            FileNotFoundError: If one of its files is missing.
            ValueError: If there is no such sequence, or a file is broken; the message names path, line and field.
        """
        if sequence_id not in self.sequence_ids:
            raise ValueError(f"{self.root}: sequence: expected one of {self.sequence_ids}, got {sequence_id}")
        folder = sequence_folder(self.root, sequence_id)
        file = read_json(folder / "scene.json", SceneFile)
        return SequenceTruth(
            root=folder,
            sequence_id=sequence_id,
            scene=file.scene,
            camera=read_calibration(folder / "camera.toml"),
            frames=tuple(_read_frames(folder / "frames.jsonl", sequence_id)),
        )

    def sequence_of(self, image_id: int) -> SequenceTruth:
        """The sequence of image `image_id`; reads all of it, so ask once."""
        return self.sequence(image_id // MAX_FRAMES)


def read_truth(root: Path | str) -> SimulatedTruth:
    """What is known of the simulated split in the folder `root`, such as `DATA/night/train`.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If its `info.json` is broken.
    """
    return SimulatedTruth(Path(root))


def sequence_name(sequence_id: int) -> str:
    """Name of a sequence's folders, such as S00001."""
    return f"S{sequence_id:05d}"


def sequence_folder(root: Path, sequence_id: int) -> Path:
    """Where the truth of a sequence lies."""
    return root / "simulation" / sequence_name(sequence_id)


def finished_sequences(root: Path) -> tuple[int, ...]:
    """Numbers of the sequences whose truth is there, in order."""
    folders = (root / "simulation").glob("S[0-9]*")
    return tuple(sorted(int(folder.name[1:]) for folder in folders if folder.name[1:].isdigit()))


def write_info(root: Path, info: InfoFile) -> None:
    """Writes `simulation/info.json`.

    Raises:
        OSError: If that fails.
    """
    write_atomic(root / "simulation" / "info.json", info.model_dump_json(indent=1).encode())


def write_scenes(root: Path, files: list[SceneFile]) -> None:
    """Writes `scenes.jsonl`: number and specification of each scene, a line each.

    Raises:
        OSError: If that fails.
    """
    lines = [json.dumps({"sequence": one.sequence, "scene": one.scene.model_dump(mode="json")}) for one in files]
    write_atomic(root / "scenes.jsonl", ("\n".join(lines) + "\n").encode())


class _SceneLine(FrozenModel):
    """A line of `scenes.jsonl`."""

    sequence: Id
    scene: Scene


def read_scenes(path: Path) -> tuple[tuple[int, Scene], ...]:
    """Numbers and specifications of the scenes in a `scenes.jsonl`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds no scene or a line is broken; the message names path, line and field.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; expected the scenes.jsonl of a simulated split")
    lines = [
        parse_json(line, _SceneLine, f"{path}: line {place + 1}")
        for place, line in enumerate(path.read_bytes().splitlines())
    ]
    if not lines:
        raise ValueError(f"{path}: expected at least one scene, found none")
    return tuple((line.sequence, line.scene) for line in lines)


def _read_frames(path: Path, sequence_id: int) -> Iterator[FrameTruth]:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    for place, line in enumerate(path.read_bytes().splitlines()):
        origin = f"{path}: line {place + 1}"
        record = parse_json(line, FrameRecord, origin)
        if record.image_id != sequence_id * MAX_FRAMES + place:
            expected = sequence_id * MAX_FRAMES + place
            raise ValueError(f"{origin}: image_id: expected {expected}, got {record.image_id}")
        yield record.frame()


def _road_file(scene: Scene) -> _RoadFile:
    """The centre line, each metre."""
    road = Road(scene.road)
    places_m = np.arange(0.0, road.length_m + 0.5)
    return _RoadFile(
        lane_width_m=scene.road.lane_width_m,
        s_m=tuple(places_m.tolist()),
        points_world_m=tuple((x, y, z) for x, y, z in road.points(places_m).round(4).tolist()),
    )
