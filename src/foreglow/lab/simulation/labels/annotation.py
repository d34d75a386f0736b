"""The light artifacts of every vehicle in a frame, with their instance ids."""

from __future__ import annotations

from dataclasses import dataclass

from foreglow.datasets.simulated import Artifact, LampTruth
from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.camera.exposure import Exposure
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX
from foreglow.lab.simulation.labels.artifacts import direct_artifacts, indirect_artifacts
from foreglow.lab.simulation.labels.instances import InstanceTracker
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.traffic.actors import Actor


@dataclass(frozen=True, slots=True)
class Annotation:
    """The labels of a vehicle: artifacts with their ids, and the peaks under much looser thresholds."""

    artifacts: tuple[Artifact, ...]
    candidates: tuple[Artifact, ...]


class Annotator:
    """Labels a drive frame by frame, so that instances keep their ids."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self._rule = scene.labels
        self._scale = camera.width_px / REFERENCE_WIDTH_PX
        self._tracker = InstanceTracker(scene.labels, self._scale)

    def annotate(
        self, index: int, actor: Actor, lamps: tuple[LampTruth, ...], exposure: Exposure, camera_world_m: Floats
    ) -> Annotation:
        """The labels of the vehicle `index` of the frame."""
        surroundings = exposure.surroundings_of(index)
        peaks_grey = exposure.lamp_peaks_grey(index, [lamp.position_px for lamp in lamps])
        direct = direct_artifacts(lamps, peaks_grey, surroundings, camera_world_m, self._rule, self._scale)
        light = exposure.light_of(index, is_rear=actor.spec.lane == "own")
        indirect: tuple[Artifact, ...] = ()
        candidates: tuple[Artifact, ...] = ()
        if light is not None:
            indirect, candidates = indirect_artifacts(
                light, surroundings, self._rule, self._scale, has_direct=bool(direct)
            )
        return Annotation(self._tracker.update(actor.vehicle_id, (*direct, *indirect)), candidates)
