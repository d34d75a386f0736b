"""A simulated set without a renderer whose lights lie where geometry puts them: on a flat, straight road."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from foreglow.datasets.simulated import Artifact
from foreglow.geometry import Camera, Pose, rotation
from foreglow.lab.simulation import Scene
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import CameraSpec, RoadSpec
from foreglow.lab.simulation.writing.dataset import DatasetConfig, simulate_dataset
from foreglow.types import Image
from tests.lab.simulation import stub_drive
from tests.lab.simulation.truths import artifact, lamp_artifact, vehicle

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 320, 240, 328.0
LONELY = 3
LIGHTS_M = {0: (24.0, 2.0, 0.65), 1: (18.0, -1.0, 0.0)}
"""By instance, a lamp and light on the road, in the vehicle's frame of the first image; each image is 2 m closer."""


def scene(seed: int) -> Scene:
    camera = CameraSpec(width_px=WIDTH_PX, height_px=HEIGHT_PX, focal_px=FOCAL_PX)
    flat = RoadSpec(length_m=300.0, curvature_per_m=((0.0, 0.0),), elevation_m=((0.0, 0.0),))
    return stub_drive.scene(seed).model_copy(update={"camera": camera, "road": flat, "name": ("straight", "sag")[seed]})


def drive(scene: Scene) -> Iterator[DriveFrame]:
    mount = Pose(np.array([0.0, 0.0, 1.3]), rotation(pitch_rad=-0.02))
    focal, centre = (FOCAL_PX, FOCAL_PX), (WIDTH_PX / 2, HEIGHT_PX / 2)
    camera = Camera(WIDTH_PX, HEIGHT_PX, focal, centre, (-0.05, 0.02, 0, 0, 0), mount)
    for index, known in enumerate(stub_drive.drive(scene)):
        artifacts = tuple(_artifact(number, index, camera) for number in LIGHTS_M)
        if index == 0:
            far = dataclasses.replace(artifacts[0], instance_id=-1, is_doubtful=True)
            haze = dataclasses.replace(artifacts[0], instance_id=2, kind="haze", is_direct=False, depth_m=np.nan)
            alone = dataclasses.replace(artifacts[1], instance_id=LONELY, position_px=(5.0, 5.0))
            artifacts = (*artifacts, far, haze, alone)
        its_range_m = 30.0 - 2.0 * index
        yield dataclasses.replace(
            known,
            frame=dataclasses.replace(known.frame, image=_image(artifacts)),
            camera=camera,
            vehicles=(vehicle(artifacts=artifacts, range_m=its_range_m),),
            depth_m=np.full((HEIGHT_PX, WIDTH_PX), 20.0, np.float32),
        )


def make_split(root: Path, name: str = "test") -> Path:
    """Writes a split of two drives, three images each, to the set at `root`, and returns its folder."""
    return simulate_dataset(root, [scene(0), scene(1)], drive, DatasetConfig(split=name)).root


def known_range_m(instance: int, index: int) -> float:
    """From the camera to the light."""
    return float(np.linalg.norm(np.array(LIGHTS_M[instance]) - [2.0 * index, 0.0, 1.3]))


def _artifact(number: int, index: int, camera: Camera) -> Artifact:
    point = np.array(LIGHTS_M[number]) - [2.0 * index, 0.0, 0.0]
    x, y = camera.project(camera.vehicle_from_camera.to_body(point)).tolist()
    make = artifact if number else lamp_artifact
    return make(x=x, y=y, instance_id=number, depth_m=known_range_m(number, index))


def _image(artifacts: tuple[Artifact, ...]) -> Image:
    """A round spot at each light but the one in the corner."""
    image = np.full((HEIGHT_PX, WIDTH_PX), 6.0)
    rows, columns = np.mgrid[:HEIGHT_PX, :WIDTH_PX] + 0.5
    for x, y in {each.position_px for each in artifacts if each.instance_id != LONELY}:
        image += 200.0 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 3.0**2))
    return np.asarray(np.clip(image, 0, 255).round(), np.uint8)
