"""The truth of a simulated data set, in files beside its images: written while it is driven, read by every evaluation.

Beside PVDN's `images` and `labels`, a simulated split has

    scenes.jsonl                      specification of every scene, a line each; the simulator reads it
    simulation/info.json              how the data set was made, and what the numbers mean
    simulation/S00001/scene.json      specification of this sequence's scene, and what it was made with
    simulation/S00001/camera.toml     calibration, as `foreglow.calibration` reads it
    simulation/S00001/road.json       the main road's centre line each metre, in the world
    simulation/S00001/frames.jsonl    a `FrameTruth` a line
    simulation/S00001/light/010000.png  how much light of which source is where, with the shares; `light_maps` reads it
    simulation/S00001/shares.parquet  whose light is in the proposals, if that was asked for; `shares` reads it
    simulation/S00001/depth/000000.png  LiDAR-like depth of the first image; the number is the frame's in the drive

    truth = read_truth("DATA/night/train")
    for drive in truth:
        for frame in drive.frames:
            ranges_m = [vehicle.range_m for vehicle in frame.vehicles]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from foreglow.calibration import calibration_to_toml, read_calibration
from foreglow.config import FrozenModel
from foreglow.datasets.images import png, read_image
from foreglow.datasets.json_files import Record, read_json, read_json_lines
from foreglow.datasets.simulated.shares import SHARES_FILE
from foreglow.datasets.simulated.truth import FrameTruth
from foreglow.files import checked_path
from foreglow.geometry import Camera, Floats
from foreglow.whole_files import write_atomic

_AGAIN = "`foreglow simulate`, as it made this split, writes it again and keeps the drives"

MAX_FRAMES = 10_000
"""Images of a sequence; an image id is the sequence's number times this, plus the frame's number in the drive."""

FRAMES_NAME = "frames.jsonl"
"""In the folder of a sequence: its images' truth."""

DEPTH_STEPS_PER_M = 256.0

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


class InfoFile(FrozenModel):
    """`simulation/info.json`.

    Attributes:
        made_with: Generator, scanner and errors of the street messages, which every scene was made with.
        seed: The seed with which the scenes were drawn; None if they were not drawn.
        cycle: Exposure cycle.
        split: Name of the split.
        rate_hz: Frames a second of every sequence.
        label_rule: When light counts as an artifact; the same for every scene.
        production: Parameters of the modelled production system.
        conventions: What the numbers mean.
    """

    made_with: dict[str, Any]
    seed: int | None
    cycle: str
    split: str
    rate_hz: float
    label_rule: dict[str, Any]
    production: dict[str, Any]
    conventions: dict[str, str] = CONVENTIONS


class RoadFile(FrozenModel):
    """`road.json`: the main road.

    Attributes:
        lane_width_m: Width of either lane.
        s_m: Arc lengths along the centre line.
        points_world_m: The centre line there.
    """

    lane_width_m: Annotated[float, Field(gt=0, le=100.0)]
    s_m: tuple[float, ...]
    points_world_m: tuple[tuple[float, float, float], ...] = Field(repr=False)


class _SceneName(Record):
    name: str


class _SceneFile(Record):
    """The part of `scene.json` that needs no simulator."""

    scene: _SceneName


class TruthWriter:
    """Writes the truth of a drive into a folder, frame by frame; `close` completes it."""

    def __init__(self, folder: Path) -> None:
        """Makes `folder/depth`; `folder` must exist."""
        self.folder = folder
        self._camera_toml: str | None = None
        self._lines: list[bytes] = []
        (folder / "depth").mkdir(exist_ok=True)

    def add(self, frame: FrameTruth, camera: Camera, depth: NDArray[np.uint16]) -> None:
        """Adds a frame: its calibration, which must not change, and its depth image as `encoded_depth` gives it.

        Raises:
            ValueError: If the calibration changes, or a number that must be finite is not.
            OSError: If the depth image cannot be written.
        """
        toml = calibration_to_toml(camera)
        if toml != (self._camera_toml or toml):
            raise ValueError(f"image {frame.image_id}: camera: expected the drive's calibration to stay, it changed")
        self._camera_toml = toml
        write_atomic(self.folder / "depth" / f"{len(self._lines):06d}.png", png(depth))
        self._lines.append(frame.to_line())

    def close(self, scene_json: str, road: RoadFile) -> None:
        """Writes the other files, `scene.json` last.

        Raises:
            ValueError: If there was no frame.
            OSError: If a file cannot be written.
        """
        if self._camera_toml is None:
            raise ValueError(f"{self.folder}: frames: expected at least one, the drive had none")
        write_atomic(self.folder / "camera.toml", self._camera_toml.encode())
        write_atomic(self.folder / FRAMES_NAME, b"".join(self._lines))
        write_atomic(self.folder / "road.json", road.model_dump_json().encode())
        write_atomic(self.folder / "scene.json", scene_json.encode())


@dataclass(frozen=True)
class SequenceTruth:
    """What is known about one sequence.

    Attributes:
        root: Its folder, `SPLIT/simulation/S00001`.
        sequence_id: Its number, as in `sequences.json`.
        scenario: Name of its scene, such as `crest`.
        camera: Calibration of all its images.
        frames: Its images in the order of time.
    """

    root: Path
    sequence_id: int
    scenario: str
    camera: Camera
    frames: tuple[FrameTruth, ...]

    @property
    def path(self) -> Path:
        """The file with its frames."""
        return self.root / FRAMES_NAME

    @property
    def directory(self) -> str:
        """Name of its folder of images, such as S00001."""
        return self.root.name

    def frame(self, image_id: int) -> FrameTruth:
        """The image `image_id`; ValueError if it belongs to another sequence, or the truth ends before it."""
        return self.frames[self._frame_number(image_id)]

    def depth_m(self, image_id: int) -> Floats:
        """LiDAR-like depth of image `image_id`, shape (height, width), metres along the viewing ray; NaN where none.

        Raises:
            FileNotFoundError: If the depth image is missing.
            ValueError: If there is no such image, or its depth image is broken or not of the camera's size.
        """
        path = self.root / "depth" / f"{self._frame_number(image_id):06d}.png"
        stored = read_image(path)
        if stored.shape != (self.camera.height_px, self.camera.width_px):
            raise ValueError(
                f"{path}: image size: expected {self.camera.width_px}x{self.camera.height_px} px as in camera.toml, "
                f"got {stored.shape[1]}x{stored.shape[0]} px"
            )
        if stored.dtype != np.uint16:
            raise ValueError(f"{path}: expected an image of 16 bits, got {stored.dtype}")
        return decoded_depth_m(stored.astype(np.uint16, copy=False))

    def _frame_number(self, image_id: int) -> int:
        number = image_id - self.sequence_id * MAX_FRAMES
        if not 0 <= number < len(self.frames):
            found = f"{len(self.frames)} from image {self.sequence_id * MAX_FRAMES} on"
            raise ValueError(f"{self.path}: expected a line about image {image_id}, got {found}")
        return number


class SimulatedTruth:
    """What is known about a simulated split; iterating reads a sequence at a time.

    Attributes:
        root: The split's folder.
        info: How the split was made, and what the numbers mean.
        sequence_ids: The finished sequences, in order.
    """

    def __init__(self, root: Path | str) -> None:
        """Reads `info.json` and lists the sequences."""
        root = checked_path(root, "root")
        self.root = root
        self.info = read_info(root)
        self.sequence_ids = finished_sequences(root)

    def __len__(self) -> int:
        return len(self.sequence_ids)

    def __iter__(self) -> Iterator[SequenceTruth]:
        return (self.sequence(sequence_id) for sequence_id in self.sequence_ids)

    def sequence(self, sequence_id: int) -> SequenceTruth:
        """The sequence with this number in `sequences.json`; reads all of it but the depth images.

        Raises:
            FileNotFoundError: If one of its files is missing.
            ValueError: If there is no such sequence, or a file is broken; the message names path, line and field.
        """
        if sequence_id not in self.sequence_ids:
            raise ValueError(f"{self.root}: sequence: expected one of {self.sequence_ids}, got {sequence_id}")
        return read_sequence(self.root, sequence_id)

    def scenario(self, sequence_id: int) -> str:
        """Name of the scene of this sequence, such as `crest`; reads nothing else of it.

        Raises:
            FileNotFoundError: If there is no such sequence.
            ValueError: If its `scene.json` is broken.
        """
        return _scenario(sequence_folder(self.root, sequence_id))

    def sequence_of(self, image_id: int) -> SequenceTruth:
        """The sequence of image `image_id`; it is read anew at each call."""
        return self.sequence(image_id // MAX_FRAMES)


def read_truth(root: Path | str) -> SimulatedTruth:
    """What is known about the simulated split in the folder `root`, such as `DATA/night/train`.

    Raises:
        FileNotFoundError: If the split is not simulated, or its `info.json` is gone.
        ValueError: If its `info.json` is broken.
    """
    return SimulatedTruth(root)


def read_info(root: Path) -> InfoFile:
    """How the simulated split in the folder `root` was made.

    Raises:
        FileNotFoundError: If the split is not simulated, or its `info.json` is gone.
        ValueError: If it is broken.
    """
    path = _info_path(root)
    if not has_truth(root):
        raise FileNotFoundError(f"{root}: expected a simulated split, with {path.relative_to(root)}: no such file")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file, but there are drives beside it; {_AGAIN}")
    try:
        return read_json(path, InfoFile)
    except ValueError as error:
        raise ValueError(f"{error}; {_AGAIN}") from None


def read_sequence(root: Path, sequence_id: int) -> SequenceTruth:
    """As `SimulatedTruth.sequence`, for a split whose `info.json` may not be there yet."""
    folder = sequence_folder(root, sequence_id)
    return SequenceTruth(
        root=folder,
        sequence_id=sequence_id,
        scenario=_scenario(folder),
        camera=read_calibration(folder / "camera.toml"),
        frames=tuple(_read_frames(folder / FRAMES_NAME, sequence_id)),
    )


def has_truth(root: Path | str) -> bool:
    """Whether the split in the folder `root` is simulated, also one that has lost its `info.json`."""
    root = checked_path(root, "root")
    return _info_path(root).exists() or any((root / "simulation").glob("S[0-9]*/frames.jsonl"))


def sequence_name(sequence_id: int) -> str:
    """Name of a sequence's folders, such as S00001."""
    return f"S{sequence_id:05d}"


def sequence_folder(root: Path, sequence_id: int) -> Path:
    """The folder with the truth of a sequence."""
    return root / "simulation" / sequence_name(sequence_id)


def shares_path(root: Path | str, sequence_id: int) -> Path:
    """The file that says whose light is in the proposals of a sequence; only some data sets have it."""
    root = checked_path(root, "root")
    return sequence_folder(root, sequence_id) / SHARES_FILE


def finished_sequences(root: Path) -> tuple[int, ...]:
    """Numbers of the sequences whose truth is complete, in order."""
    folders = (root / "simulation").glob("S[0-9]*")
    return tuple(sorted(int(folder.name[1:]) for folder in folders if folder.name[1:].isdigit()))


def write_info(root: Path, info: InfoFile) -> None:
    """Writes `simulation/info.json`.

    Raises:
        OSError: If that fails.
    """
    write_atomic(_info_path(root), info.model_dump_json(indent=1).encode())


def encoded_depth(depth_m: ArrayLike) -> NDArray[np.uint16]:
    """Metres as a depth image stores them, like KITTI's: times 256, uint16; 0 for values that are not finite.

    Unlike in KITTI, a depth is the distance along the viewing ray, not along the camera's axis.

    >>> encoded_depth([1.0, np.nan, 255.999]).tolist()
    [256, 0, 65535]
    """
    steps = np.rint(np.asarray(depth_m, np.float64) * DEPTH_STEPS_PER_M)
    return np.where(np.isfinite(steps), np.clip(steps, 0, 65535), 0).astype(np.uint16)


def decoded_depth_m(stored: NDArray[np.uint16]) -> Floats:
    """Metres from a depth image; NaN where there is nothing."""
    return np.where(stored > 0, stored / DEPTH_STEPS_PER_M, np.nan)


def _scenario(folder: Path) -> str:
    return read_json(folder / "scene.json", _SceneFile).scene.name


def _info_path(root: Path) -> Path:
    return root / "simulation" / "info.json"


def _read_frames(path: Path, sequence_id: int) -> Iterator[FrameTruth]:
    for expected_id, (origin, frame) in enumerate(read_json_lines(path, FrameTruth), start=sequence_id * MAX_FRAMES):
        if frame.image_id != expected_id:
            raise ValueError(f"{origin}: image_id: expected {expected_id}, got {frame.image_id}")
        yield frame
