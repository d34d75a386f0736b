"""From scenes to a data set on disk: PVDN's layout with the truth beside it, in a single run or several.

The split lies in `OUT/CYCLE/SPLIT`, such as `DATA/night/train`, as PVDN's own do: `foreglow run` and `evaluate` take
that folder, or `DATA` while it is the only split in there; commands that learn take `DATA`. Beside `images` and
`labels` the split's folder has `scenes.jsonl` and `simulation`; `foreglow.datasets.simulated.files` lists the files.

Each scene is driven in a temporary folder, which gets its name when it is complete: `simulation/S00001` is there as a
whole or not at all. PVDN's label files are made from the truth of all scenes at the end. So a run that was interrupted
continues where it stopped, and neither that nor the number of processes changes a byte.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field

from foreglow.config import FrozenModel, validated
from foreglow.datasets.images import png
from foreglow.datasets.json_files import read_json
from foreglow.datasets.pvdn.schema import Cycle, Name
from foreglow.datasets.simulated.files import (
    MAX_FRAMES,
    InfoFile,
    TruthWriter,
    finished_sequences,
    has_truth,
    sequence_folder,
    sequence_name,
    write_info,
)
from foreglow.files import write_atomic
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.labels.production import ProductionConfig
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.lidar import LidarConfig, lidar_depth
from foreglow.lab.simulation.writing.pvdn_labels import LabelCounts, write_labels
from foreglow.lab.simulation.writing.scene_files import Making, SceneFile, road_file, write_scenes
from foreglow.lab.simulation.writing.street_data import STREET_STREAM, StreetDataError, StreetMap
from foreglow.parallel import Local, Parent, Workers

SIMULATOR_VERSION = 1
"""Raise it whenever the same scene gives other bytes: then finished scenes of an earlier version are not mixed in."""

GENERATOR = f"foreglow {version('foreglow')}, simulator {SIMULATOR_VERSION}"

LIDAR_STREAM = 902
"""Random stream of a scene's scanner, `np.random.default_rng([scene.seed, LIDAR_STREAM])`."""

MAX_JITTER_NS = 1_000_000
"""Largest difference of a frame's time from its number over the frame rate, which is the time that readers will see."""

DriveScene: TypeAlias = Callable[[Scene], Iterable[DriveFrame]]
"""Drives a scene; for several processes it must be a function of a module, or a `functools.partial` of such."""

Progress: TypeAlias = Callable[[int, int, int], None]
"""Called with a scene's number, the number of its frames that are done, and the number of its frames."""


class DatasetConfig(FrozenModel):
    """How scenes become a data set.

    Attributes:
        cycle: Exposure of every image; it becomes that of the scenes' sensors.
        split: Name of the split.
        seed: The seed with which the scenes were drawn, for the record.
        generator: Name and version of the simulator; part of it must change when the same scene gives other bytes.
        lidar: The scanner of the depth images.
        street: How wrong the street messages are.
        production: Parameters of the modelled production system, for the record.
    """

    cycle: Cycle = Cycle.NIGHT
    split: Name = "train"
    seed: int | None = None
    generator: Annotated[str, Field(min_length=1)] = GENERATOR
    lidar: LidarConfig = LidarConfig()
    street: StreetDataError = StreetDataError()
    production: dict[str, Any] = Field(default_factory=dict)

    @classmethod
    def of(cls, *, seed: int | None, split: str, cycle: str, quality: str) -> DatasetConfig:
        """The configuration for drives of our own renderer at `quality`.

        Raises:
            ValueError: If the cycle is neither `day` nor `night`, or the split no plain name.
        """
        fields = {
            "cycle": _cycle(cycle),
            "split": split,
            "seed": seed,
            "generator": f"{GENERATOR}, {quality}",
            "production": ProductionConfig().model_dump(mode="json"),
        }
        return validated(cls, fields, "simulate")


def _cycle(name: str) -> Cycle:
    if name not in set(Cycle):
        raise ValueError(f"cycle: expected one of {', '.join(Cycle)}, got {name!r}")
    return Cycle(name)


@dataclass(frozen=True, slots=True)
class DatasetSummary:
    """What a data set contains.

    Attributes:
        root: The split's folder.
        num_kept: Sequences that an earlier run had finished.
        labels: Numbers of images and labels.
    """

    root: Path
    num_kept: int
    labels: LabelCounts


def simulate_dataset(
    out: Path | str,
    scenes: Sequence[Scene],
    drive: DriveScene,
    config: DatasetConfig | None = None,
    *,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> DatasetSummary:
    """Drives `scenes` and writes them as the split `out/CYCLE/SPLIT`; scenes that are there already are kept.

    The first scene becomes sequence 1 (S00001) with the images 10000, 10001, ...; more scenes may be added later.

    Args:
        out: Folder of the data set; made if need be.
        scenes: At least one scene; all with the same frame rate and label rule.
        drive: Drives a scene and yields its frames; called once for each scene, in any order.
        config: Cycle, split and the rest.
        workers: The processes that drive, each with a renderer of its own; None drives in this process.
        progress: Called after every frame, in this process.

    Raises:
        ValueError: If the scenes do not fit together, the folder holds something else or scenes that were made
            differently, or a drive contradicts its scene.
        OSError: If something cannot be written, such as on a full disk, or a process died; scenes that are finished
            stay.
    """
    config = config or DatasetConfig()
    files = _scene_files(scenes, config)
    root = Path(out) / config.cycle / config.split
    kept = _kept(root, files)
    for folder in ("images", "labels/keypoints", "simulation"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    info = _info(files, config)
    write_info(root, info)
    write_scenes(root, files)
    report = progress or _no_progress
    for file in files:
        if file.sequence in kept:
            report(file.sequence, file.scene.num_frames, file.scene.num_frames)
    missing = {sequence_name(file.sequence): file for file in files if file.sequence not in kept}
    work = functools.partial(_make_scene, root, drive)
    for _ in (workers or Local()).each(work, missing, report, paths=(root,)):
        pass
    for leftover in root.rglob(".*.tmp"):  # of a run that was killed
        leftover.unlink(missing_ok=True)
    return DatasetSummary(root, len(kept), write_labels(root, info))


def _no_progress(sequence: int, num_done: int, num_frames: int) -> None:
    """A progress callback that shows nothing."""


def _scene_files(scenes: Sequence[Scene], config: DatasetConfig) -> list[SceneFile]:
    """The scenes with their numbers and the cycle's exposure; checks that they fit together."""
    if not scenes:
        raise ValueError("scenes: expected at least one, got none")
    first = scenes[0]
    for number, scene in enumerate(scenes, start=1):
        for field in ("rate_hz", "labels"):
            if getattr(scene, field) != getattr(first, field):
                raise ValueError(
                    f"scenes: {field}: expected one for the whole data set, scene {number} differs from the first"
                )
        if scene.num_frames > MAX_FRAMES:
            raise ValueError(f"scenes: expected up to {MAX_FRAMES} frames each, scene {number} has {scene.num_frames}")
    making = Making(generator=config.generator, lidar=config.lidar, street=config.street)
    return [
        SceneFile(sequence=number, made_with=making, scene=_exposed(scene, config.cycle))
        for number, scene in enumerate(scenes, start=1)
    ]


def _exposed(scene: Scene, cycle: Cycle) -> Scene:
    exposure = "night" if cycle is Cycle.NIGHT else "day"
    return scene.model_copy(update={"sensor": scene.sensor.model_copy(update={"exposure": exposure})})


def _info(files: list[SceneFile], config: DatasetConfig) -> InfoFile:
    return InfoFile(
        made_with=files[0].made_with.model_dump(mode="json"),
        seed=config.seed,
        cycle=config.cycle.value,
        split=config.split,
        rate_hz=files[0].scene.rate_hz,
        label_rule=files[0].scene.labels.model_dump(mode="json"),
        production=config.production,
    )


def _kept(root: Path, files: list[SceneFile]) -> frozenset[int]:
    """Numbers of the finished scenes; checks that the folder may be written to at all."""
    if not has_truth(root):
        for name in ("images", "labels"):
            if any(found.is_file() for found in (root / name).rglob("*")):
                raise ValueError(f"{root}: expected a new folder or a simulated split, this is another data set")
    finished = finished_sequences(root)
    for sequence_id in finished:
        folder = sequence_folder(root, sequence_id)
        if sequence_id > len(files):
            raise ValueError(f"{folder}: expected at most the {len(files)} scenes of this run; choose another folder")
        wanted, there = files[sequence_id - 1], read_json(folder / "scene.json", SceneFile)
        field = _difference(wanted.model_dump(mode="json"), there.model_dump(mode="json"))
        if field is not None:
            raise ValueError(
                f"{folder / 'scene.json'}: {field}; choose another folder, or remove {folder} to make it anew"
            )
    return frozenset(number for number in finished if (root / "images" / sequence_name(number)).is_dir())


def _difference(wanted: Any, there: Any, field: str = "") -> str | None:
    """The first field in which two JSON values differ, as `field: expected ..., found ...`."""
    if wanted == there:
        return None
    if isinstance(wanted, dict) and isinstance(there, dict) and wanted.keys() == there.keys():
        deeper = (_difference(wanted[key], there[key], f"{field}.{key}".lstrip(".")) for key in wanted)
        return next(found for found in deeper if found is not None)
    return f"{field}: expected {_short(wanted)} as in this run, found {_short(there)}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _make_scene(root: Path, drive: DriveScene, file: SceneFile, parent: Parent) -> None:
    """Drives a scene; its images and its truth appear together or not at all."""
    name = sequence_name(file.sequence)
    partial = root / "simulation" / f".{name}.partial"
    images, truth = root / "images" / name, sequence_folder(root, file.sequence)
    shutil.rmtree(partial, ignore_errors=True)  # of a run that was killed
    try:
        (partial / "images").mkdir(parents=True)
        _drive_into(partial, file, drive, parent)
        for leftover in (truth, images):  # of a run that was killed between the two lines that follow
            if leftover.exists():
                shutil.rmtree(leftover)
        (partial / "images").rename(images)
        partial.rename(truth)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def _drive_into(folder: Path, file: SceneFile, drive: DriveScene, parent: Parent) -> None:
    scene, name = file.scene, sequence_name(file.sequence)
    street = StreetMap(Road(scene.road), file.made_with.street, np.random.default_rng([scene.seed, STREET_STREAM]))
    lidar_rng = np.random.default_rng([scene.seed, LIDAR_STREAM])
    writer = TruthWriter(folder)
    start_ns, num_done = 0, 0
    for known in drive(scene):
        if num_done == 0:
            start_ns = known.timestamp_ns
        _check_frame(known, num_done, scene, start_ns, name)
        image_id = file.sequence * MAX_FRAMES + num_done
        write_atomic(folder / "images" / f"{image_id:06d}.png", png(known.frame.image))
        depth = lidar_depth(known.depth_m, known.camera, lidar_rng, file.made_with.lidar)
        numbered = replace(known, image_id=image_id, street=street.message(known.ego_s_m))
        writer.add(numbered, known.camera, depth)
        num_done += 1
        parent.report_progress(file.sequence, num_done, scene.num_frames)
        if parent.is_stopped:
            raise KeyboardInterrupt
    if num_done != scene.num_frames:
        raise ValueError(f"{name}: drive: expected {scene.num_frames} frames, got {num_done}")
    writer.close(file.model_dump_json(indent=1), road_file(scene))


def _check_frame(known: DriveFrame, number: int, scene: Scene, start_ns: int, name: str) -> None:
    """Refuses a frame that would make the files contradict each other."""
    where = f"{name}: drive: frame {number}"
    if number >= scene.num_frames:
        raise ValueError(f"{where}: expected {scene.num_frames} frames, got more")
    expected_ns = start_ns + round(number * 1e9 / scene.rate_hz)
    if abs(known.timestamp_ns - expected_ns) > MAX_JITTER_NS:
        raise ValueError(f"{where}: timestamp_ns: expected about {expected_ns}, got {known.timestamp_ns}")
    size_px, image_px = (known.camera.width_px, known.camera.height_px), (known.frame.width_px, known.frame.height_px)
    if image_px != size_px:
        raise ValueError(f"{where}: image: expected the camera's {size_px} px, got {image_px} px")
