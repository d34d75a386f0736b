"""From scenes to a data set on disk: PVDN's layout with the truth beside it, in a single run or several.

The split lies in `OUT/CYCLE/SPLIT`, such as `DATA/night/train`, as PVDN's own do: `foreglow run` and `evaluate` take
that folder, or `DATA` while it is the only split in there; commands that learn take `DATA`. Beside `images` and
`labels` the split's folder has `scenes.jsonl` and `simulation`; `foreglow.datasets.simulated.files` lists the files.

Each scene is driven in a temporary folder, which gets its name when it is complete: `simulation/S00001` is there as a
whole or not at all. PVDN's label files are made from the truth of all scenes at the end. So a run that was interrupted
continues where it stopped, and neither that nor the number of processes changes a byte.

Several cameras make as many data sets, `OUT/CAMERA`, from one rendering of each scene; with variants, each scene
becomes as many sequences, one after the other.
"""

from __future__ import annotations

import contextlib
import functools
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import Field

from foreglow.config import FrozenModel, validated
from foreglow.datasets.pvdn.schema import Cycle, Name
from foreglow.datasets.simulated.files import (
    MAX_FRAMES,
    InfoFile,
    sequence_folder,
    sequence_name,
    write_info,
)
from foreglow.datasets.simulated.production import ProductionConfig
from foreglow.folder_lock import FolderLock
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.lamp_files import lamp_digests
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.variants import AS_IT_IS, draw_variants
from foreglow.lab.simulation.writing.finished import kept_scenes
from foreglow.lab.simulation.writing.lidar import LidarConfig
from foreglow.lab.simulation.writing.pvdn_labels import LabelCounts, check_keypoints, write_labels
from foreglow.lab.simulation.writing.recorder import Recorder
from foreglow.lab.simulation.writing.scene_files import Making, SceneFile, read_scenes, write_scenes
from foreglow.lab.simulation.writing.street_data import StreetDataError, check_ego_on_map
from foreglow.parallel import Local, Parent, Workers
from foreglow.whole_files import is_temporary
from foreglow.wording import check_one_of

SIMULATOR_VERSION = 2
"""Raise it whenever the same scene gives other bytes: then finished scenes of an earlier version are not mixed in."""

GENERATOR = f"foreglow {version('foreglow')}, simulator {SIMULATOR_VERSION}"

DriveScene: TypeAlias = Callable[[Scene], Iterable[DriveFrame]]
"""Drives a scene; for several processes it must be a function of a module, or a `functools.partial` of such."""

ExposeScene: TypeAlias = Callable[[Scene], Iterable[tuple[DriveFrame, ...]]]
"""Drives a scene and yields, for each moment, its frames of every data set and variant; else as `DriveScene`."""

Progress: TypeAlias = Callable[[int, int, int], None]
"""Called with a scene's number, the number of its frames that are done, and the number of its frames."""


class DatasetConfig(FrozenModel):
    """How scenes become a data set.

    Attributes:
        cycle: Exposure of every image; it becomes that of the scenes' sensors.
        split: Name of the split.
        seed: The seed with which the scenes were drawn, for the record; None if they were not drawn.
        generator: Name and version of the simulator; part of it must change when the same scene gives other bytes.
        lidar: The scanner of the depth images.
        street: How wrong the street messages are.
        production: Parameters of the modelled production system, for the record.
        camera: The profile of the camera; None for the scenes' own.
        presets: Presets in whose proposals the light is told apart.
    """

    cycle: Cycle = Cycle.NIGHT
    split: Name = "train"
    seed: int | None = None
    generator: Annotated[str, Field(min_length=1)] = GENERATOR
    lidar: LidarConfig = LidarConfig()
    street: StreetDataError = StreetDataError()
    production: dict[str, Any] = Field(default_factory=dict)
    camera: CameraProfile | None = None
    presets: tuple[str, ...] = ()

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

    def exposed_for(self, camera: CameraProfile | None, presets: Sequence[str] = ()) -> DatasetConfig:
        """This configuration for a camera with its own cycle, or None, with shares for the proposals of `presets`."""
        cycle = self.cycle if camera is None else _cycle(camera.cycle)
        changed = {"camera": camera, "cycle": cycle, "presets": tuple(presets)}
        return self.model_copy(update=changed)


def _cycle(name: str) -> Cycle:
    check_one_of(name, Cycle, "cycle")
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
            differently, another process is writing there, or a drive contradicts its scene.
        OSError: If something cannot be written, such as on a full disk, or a process died; scenes that are finished
            stay.
    """
    target = Target(Path(out), config or DatasetConfig())
    expose = functools.partial(_one_each, drive)
    return simulate_datasets((target,), scenes, expose, workers=workers, progress=progress)[0]


def _one_each(drive: DriveScene, scene: Scene) -> Iterator[tuple[DriveFrame, ...]]:
    return ((known,) for known in drive(scene))


@dataclass(frozen=True, slots=True)
class Target:
    """A data set to write.

    Attributes:
        out: Its folder.
        config: Cycle, split, camera and the rest.
    """

    out: Path
    config: DatasetConfig

    def __post_init__(self) -> None:
        object.__setattr__(self, "out", Path(self.out))  # a text will do

    @property
    def root(self) -> Path:
        """The split's folder."""
        return self.out / self.config.cycle / self.config.split


def simulate_datasets(
    targets: Sequence[Target],
    scenes: Sequence[Scene],
    expose: ExposeScene,
    *,
    num_variants: int = 1,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> tuple[DatasetSummary, ...]:
    """Drives each of `scenes` once and writes it to every one of `targets`, else as `simulate_dataset`.

    Args:
        targets: The data sets, in the order of the frames that `expose` yields.
        scenes: At least one scene; all with the same frame rate and label rule.
        expose: Drives a scene and yields the frames of each moment: for each target, those of all its variants.
        num_variants: Sequences that each scene becomes.
        workers: The processes that drive, each with a renderer of its own; None drives in this process.
        progress: Called after every moment, in this process, with the number of the scene.

    Raises:
        ValueError: As `simulate_dataset`.
        OSError: As `simulate_dataset`.
    """
    for target in targets:
        _check_out(target.out)
    files = {target.root: _scene_files(scenes, target.config, num_variants) for target in targets}
    with contextlib.ExitStack() as locks:
        for root in files:
            locks.enter_context(FolderLock(root))
        for target in targets:
            _check_roads(target, scenes)
        return _simulated(targets, scenes, expose, files, num_variants, workers, progress)


def _check_out(out: Path) -> None:
    """ValueError if `out` is a split, or the folder of a data set's cycle, in which nobody looks for another set."""
    if _is_begun(out):
        root = out.parent.parent
    elif out.name in set(Cycle) and any(_is_begun(folder) for folder in out.glob("*")):
        root = out.parent
    else:
        return
    raise ValueError(f"{out}: expected the folder of the whole data set, {root}, in which CYCLE/SPLIT is made")


def _is_begun(folder: Path) -> bool:
    """Whether the folder is a split, finished or not."""
    return (folder / "scenes.jsonl").is_file() or (folder / "labels" / "keypoints").is_dir()


def _check_roads(target: Target, scenes: Sequence[Scene]) -> None:
    """ValueError if another split of the data set has the road of a scene, such as one of the user's own."""
    numbers = {scene.road.model_dump_json(): number for number, scene in enumerate(scenes, start=1)}
    for path in sorted(target.out.glob("*/*/scenes.jsonl")):
        others: list[str] = []
        if path.parent.name != target.config.split:
            with contextlib.suppress(OSError, ValueError):  # whoever reads that split will say what is wrong
                others = [scene.road.model_dump_json() for _, scene in read_scenes(path)]
        for road in numbers.keys() & set(others):
            raise ValueError(
                f"{target.root}: expected roads of its own, that of scene {numbers[road]} is also in {path.parent}"
            )


def _simulated(
    targets: Sequence[Target],
    scenes: Sequence[Scene],
    expose: ExposeScene,
    files: Mapping[Path, list[SceneFile]],
    num_variants: int,
    workers: Workers | None,
    progress: Progress | None,
) -> tuple[DatasetSummary, ...]:
    """As `simulate_datasets`, for the sequences of each split, which nobody else writes meanwhile."""
    kept = {root: kept_scenes(root, listed) for root, listed in files.items()}
    for root, there in kept.items():
        check_keypoints(root, sorted(there))  # before any work
    infos = {target.root: _info(files[target.root], target.config) for target in targets}
    for root, listed in files.items():
        for folder in ("images", "labels/keypoints", "simulation"):
            (root / folder).mkdir(parents=True, exist_ok=True)
        write_info(root, infos[root])
        write_scenes(root, [kept[root].get(file.sequence, file) for file in listed])
    report = progress or _no_progress
    missing: dict[str, _Outputs] = {}
    for number, scene in enumerate(scenes, start=1):
        outputs = tuple(
            (root, file)
            for root, listed in files.items()
            for file in listed[(number - 1) * num_variants :][:num_variants]
        )
        if all(file.sequence in kept[root] for root, file in outputs):
            report(number, scene.num_frames, scene.num_frames)
        else:
            missing[sequence_name(outputs[0][1].sequence)] = _Outputs(number, outputs)
    work = functools.partial(_make_scene, expose)
    for _ in (workers or Local()).each(work, missing, report, paths=tuple(files)):
        pass
    summaries = []
    for root, info in infos.items():
        for leftover in filter(is_temporary, root.rglob(".*.tmp")):  # of a run that was killed
            leftover.unlink(missing_ok=True)
        summaries.append(DatasetSummary(root, len(kept[root]), write_labels(root, info, kept[root])))
    return tuple(summaries)


def _no_progress(sequence: int, num_done: int, num_frames: int) -> None:
    """A progress callback that shows nothing."""


def _scene_files(scenes: Sequence[Scene], config: DatasetConfig, num_variants: int) -> list[SceneFile]:
    """The sequences with their numbers and the cycle's exposure; checks that the scenes fit together."""
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
        check_ego_on_map(scene, f"scene {number}")
    making = Making(
        generator=config.generator,
        lidar=config.lidar,
        street=config.street,
        camera=config.camera,
        presets=config.presets,
    )
    variants = [
        (_exposed(scene, config.cycle), None if variant == AS_IT_IS else variant)
        for scene in scenes
        for variant in draw_variants(scene, num_variants)
    ]
    return [
        SceneFile(sequence=number, made_with=making, scene=scene, variant=variant, lamps=lamp_digests(scene))
        for number, (scene, variant) in enumerate(variants, start=1)
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


@dataclass(frozen=True, slots=True)
class _Outputs:
    """What one drive through a scene writes: for each of its frames, the data set and the sequence."""

    number: int
    sequences: tuple[tuple[Path, SceneFile], ...]


def _make_scene(expose: ExposeScene, outputs: _Outputs, parent: Parent) -> None:
    """Drives a scene; images and truth of each of its sequences appear together or not at all."""
    partials = [root / "simulation" / f".{sequence_name(file.sequence)}.partial" for root, file in outputs.sequences]
    try:
        for partial in partials:
            shutil.rmtree(partial, ignore_errors=True)  # of a run that was killed
            (partial / "images").mkdir(parents=True)
        _drive_into(partials, outputs, expose, parent)
        for partial, (root, file) in zip(partials, outputs.sequences, strict=True):
            truth = sequence_folder(root, file.sequence)
            images = root / "images" / sequence_name(file.sequence)
            for leftover in (truth, images):  # of a run that was killed between the two lines that follow
                if leftover.exists():
                    shutil.rmtree(leftover)
            (partial / "images").rename(images)
            partial.rename(truth)
    except BaseException:
        for partial in partials:
            shutil.rmtree(partial, ignore_errors=True)
        raise


def _drive_into(folders: Sequence[Path], outputs: _Outputs, expose: ExposeScene, parent: Parent) -> None:
    scene = outputs.sequences[0][1].scene
    recorders = [Recorder(folder, file) for folder, (_, file) in zip(folders, outputs.sequences, strict=True)]
    for num_done, frames in enumerate(expose(scene), start=1):
        for recorder, known in zip(recorders, frames, strict=True):
            recorder.add(known)
        parent.report_progress(outputs.number, num_done, scene.num_frames)
        if parent.is_stopped:
            raise KeyboardInterrupt
    for recorder in recorders:
        recorder.close()
