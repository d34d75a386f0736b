"""PVDN's labels of a simulated drive, made from its truth: keypoints, image records, and the sequence's attributes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.datasets.json_files import json_bytes, write_json
from foreglow.datasets.pvdn.schema import (
    DriverBehaviour,
    EnvironmentLighting,
    ImageAnnotation,
    ImageAnnotationsFile,
    ImageCategory,
    ImageRecord,
    Instance,
    KeypointsFile,
    RoadType,
    Sequence,
    SequencesFile,
    StreetStyle,
    Vehicle,
    View,
    Weather,
)
from foreglow.datasets.pvdn.writer import (
    CAMERA_CONFIGURATIONS,
    CATEGORIES,
    LABEL_FILES,
    image_record,
    write_label_files,
)
from foreglow.datasets.simulated import Artifact, FrameTruth, SequenceTruth, VehicleTruth, read_truth
from foreglow.datasets.simulated.files import InfoFile, read_sequence
from foreglow.files import read_plain_json
from foreglow.geometry import Camera
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.world.road import Road, interpolated
from foreglow.lab.simulation.writing.scene_files import scene_of

BEND_PER_M = 1e-3
"""A road bends if its radius is below 1 km."""

BEND_RAD = 0.1
LONG_BEND_M = 150.0
DOME_SLOPE_CHANGE = 0.03
DOME_LENGTH_M = 100.0
"""A crest takes the slope down by 3 % within 100 m."""

FOG_PER_M = 2e-3
"""Scattering from which the air is fog: a visibility (contrast of 5 %) below 1.5 km."""

DUSK_CD_M2 = 0.05
BRIGHT_CD_M2 = 10.0
"""Luminance of the sky from which it is dusk, and from which it is bright."""


@dataclass(frozen=True, slots=True)
class LabelCounts:
    """Numbers of images and labels in a split.

    Attributes:
        num_sequences: Drives.
        num_images: Images.
        num_empty_images: Images without any instance.
        num_direct: Instances that are lamps.
        num_indirect: Instances that are light of lamps on something else.
        num_doubtful: Light that counts neither as an instance nor as a false alarm.
    """

    num_sequences: int
    num_images: int
    num_empty_images: int
    num_direct: int
    num_indirect: int
    num_doubtful: int


def check_keypoints(root: Path, sequence_ids: Iterable[int]) -> None:
    """Checks that those key points of these sequences of the split `root` that are there follow from its truth.

    Raises:
        FileNotFoundError: If a file of the truth is missing.
        ValueError: If somebody has changed them since they were written; the message names the file.
    """
    for sequence_id in sequence_ids:
        truth = read_sequence(root, sequence_id)
        for frame in truth.frames:
            path = _keypoints_path(root, frame)
            if path.exists() and path.read_bytes() != json_bytes(keypoints_of(frame, truth.camera)):
                raise _changed(path)


def write_labels(root: Path, info: InfoFile, checked: Collection[int] = ()) -> LabelCounts:
    """Writes PVDN's label files of the split `root` from its truth; it is not a split while they are written.

    What somebody has corrected since stays, and is an error.

    Args:
        root: The split.
        info: How it was made.
        checked: Sequences whose key points `check_keypoints` has checked.

    Raises:
        FileNotFoundError: If a file of the truth is missing.
        ValueError: If a file of the truth is broken, or a label file was changed since it was written.
        OSError: If a label file cannot be written.
    """
    configuration = [configuration.cycle.value for configuration in CAMERA_CONFIGURATIONS].index(info.cycle)
    sequences: list[Sequence] = []
    images: list[ImageRecord] = []
    annotations: list[ImageAnnotation] = []
    num_empty, num_doubtful = 0, 0
    instances: list[Instance] = []
    for truth in read_truth(root):
        sequences.append(sequence_of(truth))
        size_px = truth.camera.width_px, truth.camera.height_px
        for frame in truth.frames:
            images.append(image_record(frame.image_id, size_px, frame.timestamp_ns, configuration))
            if frame.category is not ImageCategory.NONE:
                number = len(annotations)
                annotations.append(ImageAnnotation(id=number, category=frame.category, image_id=frame.image_id))
            keypoints = keypoints_of(frame, truth.camera)
            path = _keypoints_path(root, frame)
            if not path.exists():
                write_json(path, keypoints)
            elif truth.sequence_id not in checked and path.read_bytes() != json_bytes(keypoints):
                raise _changed(path)
            instances += [instance for vehicle in keypoints.annotations for instance in vehicle.instances]
            num_empty += not keypoints.annotations
            num_doubtful += len(keypoints.doubtful)
    images_file = ImageAnnotationsFile(
        info={
            "description": "Simulated night drives in the layout of PVDN; see simulation/info.json",
            "version": info.made_with["generator"],
            "seed": info.seed,
            "rate_hz": info.rate_hz,
            "label_rule": info.label_rule,
        },
        licences=(),
        camera_configurations=CAMERA_CONFIGURATIONS,
        categories=CATEGORIES,
        images=tuple(images),
        annotations=tuple(annotations),
    )
    _write_lists(root, images_file, SequencesFile(sequences=tuple(sequences)))
    num_direct = sum(instance.is_direct for instance in instances)
    return LabelCounts(*(len(sequences), len(images), num_empty, num_direct, len(instances) - num_direct, num_doubtful))


def _keypoints_path(root: Path, frame: FrameTruth) -> Path:
    return root / "labels" / "keypoints" / f"{frame.image_id:06d}.json"


def _changed(path: Path) -> ValueError:
    return ValueError(
        f"{path}: expected the labels that simulate wrote, got changed ones, which stay; choose another folder, or "
        "remove this file to have it made again"
    )


def _write_lists(root: Path, images_file: ImageAnnotationsFile, sequences_file: SequencesFile) -> None:
    """As `write_label_files`, where there may be those of an earlier run, perhaps with fewer sequences."""
    paths = [root / "labels" / name for name in LABEL_FILES]
    wanted = [json.loads(json_bytes(each)) for each in (images_file, sequences_file)]
    there = [_list_in(path) for path in paths]
    if there == wanted:
        return
    ends = [0, *itertools.accumulate(len(sequence["image_ids"]) for sequence in wanted[1]["sequences"])]
    for path, found, record in zip(paths, there, wanted, strict=True):
        if found is not None and not _is_begin(found, record, ends):
            raise _changed(path)
    for path in reversed(paths):  # without its sequences it is no split
        path.unlink(missing_ok=True)
    write_label_files(root, images_file, sequences_file)


def _list_in(path: Path) -> Any:
    """What the JSON file at `path` holds; None if there is no such file."""
    try:
        return read_plain_json(path) if path.exists() else None
    except ValueError:
        raise _changed(path) from None


def _is_begin(found: Any, wanted: dict[str, Any], ends: Collection[int]) -> bool:
    """Whether a file of labels is the `wanted` one, perhaps with fewer sequences, after which as many images `ends`."""
    kind = "sequences" if "sequences" in wanted else "images"
    if not isinstance(found, dict) or found.keys() != wanted.keys() or not isinstance(found[kind], list):
        return False
    if kind == "sequences":
        return bool(found[kind] == wanted[kind][: len(found[kind])])
    images = wanted[kind][: len(found[kind])]
    ids = {image["id"] for image in images}
    annotations = [each for each in wanted["annotations"] if each["image_id"] in ids]
    lists = {"images": images, "annotations": annotations, "info": found["info"]}  # the seed says nothing of labels
    return len(images) in ends and bool(found == wanted | lists)


def keypoints_of(frame: FrameTruth, camera: Camera) -> KeypointsFile:
    """The keypoints of an image: every vehicle with at least one instance, and doubtful light.

    A vehicle's position is the centre of its box, visible or not, as in PVDN, or the position of its first instance if
    that centre is outside the image. It counts as direct if a lamp of the vehicle is seen.
    """
    camera_pose = frame.ego_pose @ camera.vehicle_from_camera
    vehicles = []
    doubtful: list[Instance] = []
    for vehicle in frame.vehicles:
        sure = [artifact for artifact in vehicle.artifacts if not artifact.is_doubtful]
        doubtful += [_instance(artifact, camera) for artifact in vehicle.artifacts if artifact.is_doubtful]
        if not sure:
            continue
        middle_px = camera.project(camera_pose.to_body(vehicle.pose.to_outer(vehicle.box_centre_m)))
        is_inside = bool(((middle_px >= 0) & (middle_px < [camera.width_px, camera.height_px])).all())
        position_px = (float(middle_px[0]), float(middle_px[1])) if is_inside else sure[0].position_px
        vehicles.append(
            Vehicle(
                position_px=_whole(position_px, camera),
                oid=vehicle.vehicle_id,
                is_direct=any(artifact.is_direct for artifact in sure),
                instances=tuple(_instance(artifact, camera) for artifact in sure),
            )
        )
    if not doubtful:  # a field that is not given is not written
        return KeypointsFile(image_id=frame.image_id, annotations=tuple(vehicles))
    return KeypointsFile(image_id=frame.image_id, annotations=tuple(vehicles), doubtful=tuple(doubtful))


def sequence_of(truth: SequenceTruth) -> Sequence:
    """The entry of `sequences.json`; the attributes are what the scene's specification suggests."""
    scene = scene_of(truth)
    road, driven_m = Road(scene.road), _driven_m(scene)
    style, is_dome = street_style(road, driven_m), is_crest(road, driven_m)
    is_short = is_dome or style is not StreetStyle.STRAIGHT_STREET
    return Sequence.plain(
        truth.sequence_id,
        start_time_ms=_milliseconds(truth.frames[0].timestamp_ns),
        end_time_ms=_milliseconds(truth.frames[-1].timestamp_ns),
        num_images=len(truth.frames),
        image_ids=tuple(frame.image_id for frame in truth.frames),
        street_style=style,
        is_dome=is_dome,
        driver_behaviour=_behaviour(scene, truth.frames),
        road_type=(
            RoadType.SINGLE_LANE_NO_ROAD_MARKING
            if scene.road.centre_marking == "none"
            else RoadType.SINGLE_LANE_ROAD_MARKING
        ),
        view=View.SHORT_VIEW if is_short else View.WIDE_VIEW,
        weather=weather(scene),
        environment_lighting=lighting(scene),
    )


def street_style(road: Road, driven_m: tuple[float, float]) -> StreetStyle:
    """The bends between two arc lengths: the first two that turn by 6 degrees or more count."""
    curvatures = road.curvature_per_m(np.arange(*driven_m, 2.0))
    signs = np.where(np.abs(curvatures) > BEND_PER_M, np.sign(curvatures), 0).astype(int).tolist()
    bends = []
    start = 0
    for sign, run in itertools.groupby(signs):
        end = start + len(list(run))
        if sign and abs(float(curvatures[start:end].sum())) * 2.0 >= BEND_RAD:
            bends.append((sign, (end - start) * 2.0))
        start = end
    if not bends:
        return StreetStyle.STRAIGHT_STREET
    first, length_m = bends[0]
    if len(bends) > 1 and bends[1][0] != first:
        return StreetStyle.LEFT_RIGHT_TURN if first > 0 else StreetStyle.RIGHT_LEFT_TURN
    if length_m >= LONG_BEND_M:
        return StreetStyle.LONG_LEFT_TURN if first > 0 else StreetStyle.LONG_RIGHT_TURN
    return StreetStyle.LEFT_TURN if first > 0 else StreetStyle.RIGHT_TURN


def is_crest(road: Road, driven_m: tuple[float, float]) -> bool:
    """Whether the road leads over a crest between two arc lengths."""
    starts = np.arange(*driven_m, 5.0)
    return bool((road.slope(starts) - road.slope(starts + DOME_LENGTH_M)).max() >= DOME_SLOPE_CHANGE)


def weather(scene: Scene) -> Weather:
    """The weather, in PVDN's words: what falls comes first, then fog, then what lies on the road."""
    if scene.weather.snow_mm_h > 0:
        return Weather.SNOW
    if scene.weather.rain_mm_h > 0:
        return Weather.RAIN
    if scene.weather.scattering_per_m >= FOG_PER_M:
        return Weather.FOG
    if scene.road.snow > 0.1:
        return Weather.SNOW
    return Weather.WET if scene.road.wetness > 0.2 else Weather.DRY


def lighting(scene: Scene) -> EnvironmentLighting:
    """The ambient light, by the sky's luminance."""
    if scene.weather.sky_cd_m2 >= BRIGHT_CD_M2:
        return EnvironmentLighting.BRIGHT
    return EnvironmentLighting.DUSK if scene.weather.sky_cd_m2 >= DUSK_CD_M2 else EnvironmentLighting.DARK


def _behaviour(scene: Scene, frames: tuple[FrameTruth, ...]) -> DriverBehaviour:
    """High beam all the way is wrong as soon as another vehicle is in sight."""
    is_anyone_in_sight = any(_is_in_sight(vehicle) for frame in frames for vehicle in frame.vehicles)
    return DriverBehaviour.INCORRECT if scene.ego.beam == "high" and is_anyone_in_sight else DriverBehaviour.CORRECT


def _is_in_sight(vehicle: VehicleTruth) -> bool:
    return any(artifact.is_direct and not artifact.is_doubtful for artifact in vehicle.artifacts)


def _driven_m(scene: Scene) -> tuple[float, float]:
    """Arc lengths from the start of our drive to 100 m beyond its end."""
    ends_m, _ = interpolated(scene.ego.timetable, [0.0, scene.duration_s])
    return float(ends_m.min()), float(ends_m.max()) + 100.0


def _milliseconds(timestamp_ns: int) -> int | float:
    return timestamp_ns // 1_000_000 if timestamp_ns % 1_000_000 == 0 else timestamp_ns / 1e6


def _instance(artifact: Artifact, camera: Camera) -> Instance:
    return Instance(
        position_px=_whole(artifact.position_px, camera),
        iid=artifact.instance_id,
        is_direct=artifact.is_direct,
        is_rear=artifact.is_rear,
    )


def _whole(position_px: tuple[float, float], camera: Camera) -> tuple[int, int]:
    """The pixel of a position; of a position beyond the border, the nearest pixel."""
    x, y = position_px
    return (
        min(max(int(np.floor(x)), 0), camera.width_px - 1),
        min(max(int(np.floor(y)), 0), camera.height_px - 1),
    )
