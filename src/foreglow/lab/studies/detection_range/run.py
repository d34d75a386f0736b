"""Runs the detector on simulated splits, and looks for the lamps that are in sight."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from foreglow.config import PipelineConfig
from foreglow.datasets import LabelledSource, open_labelled
from foreglow.datasets.json_files import read_json
from foreglow.datasets.simulated import FrameTruth, read_truth
from foreglow.geometry import Camera, Floats
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.evaluation.boxes.split_run import run_split
from foreglow.lab.evaluation.occurrence import MIN_VISIBLE
from foreglow.lab.simulation.writing.scene_files import SceneFile
from foreglow.lab.studies.detection_range.metrics import View
from foreglow.lab.studies.progress import Progress
from foreglow.pipeline import Pipeline


def run_experiment(roots: Sequence[Path], config: PipelineConfig, progress: Progress | None = None) -> tuple[View, ...]:
    """All vehicles in sight in the images of simulated splits, and which of them the detector of `config` finds.

    Raises:
        FileNotFoundError: If an image, a label file or the simulator's truth is missing.
        ValueError: If one is broken, or there is no model.
    """
    if config.classifier.model is None:
        raise ValueError("detection range: expected a configuration with a model, or --model FILE")
    return tuple(view for root in roots for view in _views_of_split(open_labelled(root), config, progress))


def _views_of_split(dataset: LabelledSource, config: PipelineConfig, progress: Progress | None) -> Iterator[View]:
    numbers = itertools.count(1)

    def count(*_: object) -> None:
        if progress is not None:
            progress(f"images of {dataset.name}", next(numbers), len(dataset))

    found = run_split(dataset, Pipeline(config.detector_only), count).predictions
    for drive in read_truth(dataset.root):
        made = read_json(drive.root / "scene.json", SceneFile)
        weather = dataset.sequence(drive.frames[0].image_id).weather.name.lower()
        view = functools.partial(View, _camera_name(made), weather, made.scene.seed)
        for frame in drive.frames:
            if frame.image_id in found.scores:
                is_accepted = found.scores[frame.image_id] > config.classifier.score_threshold
                boxes_xyxy_px = found.boxes_xyxy_px[frame.image_id][is_accepted]
                yield from itertools.starmap(view, _seen(drive.camera, frame, boxes_xyxy_px))


def _camera_name(made: SceneFile) -> str:
    return "scene" if made.made_with.camera is None else made.made_with.camera.name


def _seen(camera: Camera, frame: FrameTruth, boxes_xyxy_px: Floats) -> Iterator[tuple[int, int, str, float, bool]]:
    """The last fields of a `View` for each vehicle in an image that shows one of its lamps."""
    camera_world_m = frame.ego_pose.to_outer(camera.vehicle_from_camera.position_m)
    for vehicle in frame.vehicles:
        for direction, is_rear in (("oncoming", False), ("ahead", True)):
            lamps = [lamp for lamp in vehicle.lamps if lamp.is_rear == is_rear and lamp.visible_share >= MIN_VISIBLE]
            if lamps:
                points_px = np.array([lamp.position_px for lamp in lamps])
                middle_world_m = np.mean([lamp.position_world_m for lamp in lamps], axis=0)
                range_m = float(np.linalg.norm(middle_world_m - camera_world_m))
                is_detected = bool(lies_in(points_px[:, None], boxes_xyxy_px).any())
                yield frame.image_id, vehicle.vehicle_id, direction, range_m, is_detected
