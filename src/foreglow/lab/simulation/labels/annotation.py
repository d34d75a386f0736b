"""What an annotator would mark in a frame: artifacts with their numbers, for every vehicle."""

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
    """Of one vehicle: the artifacts with their numbers, and the peaks under much looser thresholds."""

    artifacts: tuple[Artifact, ...]
    candidates: tuple[Artifact, ...]


class Annotator:
    """Marks frame after frame of a drive, so that instances keep their numbers."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self._rule = scene.labels
        self._scale = camera.width_px / REFERENCE_WIDTH_PX
        self._tracker = InstanceTracker(scene.labels, self._scale)

    def annotate(
        self, place: int, actor: Actor, lamps: tuple[LampTruth, ...], exposure: Exposure, camera_world_m: Floats
    ) -> Annotation:
        """The marks of the vehicle in `place` of the frame's vehicles."""
        surroundings = exposure.surroundings_of(place)
        peaks_grey = exposure.lamp_peaks_grey(place, [lamp.position_px for lamp in lamps])
        direct = direct_artifacts(lamps, peaks_grey, surroundings, camera_world_m, self._rule, self._scale)
        light = exposure.light_of(place, is_rear=actor.spec.lane == "own")
        indirect: tuple[Artifact, ...] = ()
        candidates: tuple[Artifact, ...] = ()
        if light is not None:
            indirect, candidates = indirect_artifacts(
                light, surroundings, self._rule, self._scale, has_direct=bool(direct)
            )
        return Annotation(self._tracker.update(actor.vehicle_id, (*direct, *indirect)), candidates)
