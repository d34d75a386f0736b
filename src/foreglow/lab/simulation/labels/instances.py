"""The labels of a drive: light artifacts whose instances keep their ids, with hysteresis where light is hardly seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from foreglow.datasets.simulated import Artifact, LampTruth
from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.camera.exposure import Exposure
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX
from foreglow.lab.simulation.labels.artifacts import direct_artifacts, indirect_artifacts, strength
from foreglow.lab.simulation.scenes.scene import LabelRule, Scene
from foreglow.lab.simulation.traffic.actors import Actor

GATE_PX = 30.0
"""Largest movement of a distant instance between two frames, at 1280 columns."""
NEAR_GATE_PX_M2 = 25_000.0
"""Is added to the gate at a depth of 1 m; it falls with the square of the depth.

A point 6 m beside our path, passed at 30 m/s and 18 Hz with a focal length of 1312 px, moves by 1312 * 6 * 1.7 / z^2 px
a frame; twice that for light that runs towards us at the same speed.
"""
MAX_GATE_PX = 200.0
"""Largest gate, at 1280 columns and for each frame."""
OTHER_KIND_PX = 30.0
"""A different kind of surface counts as such a distance, at 1280 columns."""


@dataclass(slots=True)
class _Instance:
    """An instance: its latest artifact, and the number of frames for which it has been missing, weak or marked."""

    latest: Artifact
    num_missed: int = 0
    num_weak: int = 0
    num_marked: int = 0


class InstanceTracker:
    """Gives artifacts their instance ids over a drive.

    Lamps keep their id by vehicle and name. Indirect artifacts, doubtful ones too, are matched to those of the latest
    frames so that the sum of distances is smallest. An instance that was marked stays marked while it is at least
    doubtful, for up to `hold_frames` frames, and is kept for as many frames while it is missing; a new instance is
    marked only if it meets the full rule. Ids count from 0 and are never used again.
    """

    def __init__(self, rule: LabelRule, width_scale: float = 1.0) -> None:
        """Starts a drive; `width_scale` is columns of the image over 1280."""
        self._rule = rule
        self._scale = width_scale
        self._num_ids = 0
        self._lamps: dict[tuple[int, bool, str], int] = {}
        self._instances: dict[int, dict[int, _Instance]] = {}

    def update(self, vehicle_id: int, artifacts: Sequence[Artifact]) -> tuple[Artifact, ...]:
        """The artifacts of a vehicle in the next frame with their ids, in their order; call it for empty ones, too."""
        known = self._instances.setdefault(vehicle_id, {})
        indirect = [(index, artifact) for index, artifact in enumerate(artifacts) if not artifact.is_direct]
        matched = self._matched(indirect, known)
        numbered: list[Artifact] = []
        for index, artifact in enumerate(artifacts):
            if artifact.is_direct:
                numbered.append(replace(artifact, instance_id=self._lamp_id(vehicle_id, artifact)))
            else:
                numbered.append(self._followed(artifact, matched.get(index), known))
        self._forget({artifact.instance_id for artifact in numbered}, known)
        return self._capped(numbered, known)

    def _lamp_id(self, vehicle_id: int, artifact: Artifact) -> int:
        key = (vehicle_id, artifact.is_rear, artifact.lamp)
        if key not in self._lamps:
            self._lamps[key] = self._new_id()
        return self._lamps[key]

    def _new_id(self) -> int:
        self._num_ids += 1
        return self._num_ids - 1

    def _matched(self, found: Sequence[tuple[int, Artifact]], known: dict[int, _Instance]) -> dict[int, int]:
        """Ids of the known instances that the `found` artifacts continue, by index of the artifact."""
        if not found or not known:
            return {}
        ids, costs = list(known), _costs([artifact for _, artifact in found], list(known.values()), self._scale)
        rows, columns = linear_sum_assignment(costs)
        return {found[row][0]: ids[column] for row, column in zip(rows, columns, strict=True) if costs[row, column] < 1}

    def _followed(self, artifact: Artifact, instance_id: int | None, known: dict[int, _Instance]) -> Artifact:
        """`artifact` with its id, marked for a while although it became weak; updates `known`."""
        if instance_id is None:
            instance_id = self._new_id()
            known[instance_id] = _Instance(artifact)
        instance = known[instance_id]
        instance.num_missed = 0
        instance.num_weak = instance.num_weak + 1 if artifact.is_doubtful else 0
        is_held = instance.num_marked > 0 and instance.num_weak <= self._rule.hold_frames
        is_marked = is_held or not artifact.is_doubtful
        instance.num_marked = instance.num_marked + 1 if is_marked else 0
        instance.latest = replace(artifact, instance_id=instance_id, is_doubtful=not is_marked)
        return instance.latest

    def _forget(self, seen: set[int], known: dict[int, _Instance]) -> None:
        """Counts the frames in which an instance is missing, and drops it after `hold_frames` of them."""
        for instance_id in known.keys() - seen:
            known[instance_id].num_missed += 1
            if known[instance_id].num_missed > self._rule.hold_frames:
                del known[instance_id]

    def _capped(self, artifacts: Sequence[Artifact], known: dict[int, _Instance]) -> tuple[Artifact, ...]:
        """As many indirect artifacts stay marked as the rule allows: earlier ones come first, then the strongest."""
        is_hidden = not any(artifact.is_direct for artifact in artifacts)
        most = self._rule.max_hidden_instances if is_hidden else self._rule.max_instances
        marked = [artifact for artifact in artifacts if not artifact.is_direct and not artifact.is_doubtful]
        ranked = sorted(marked, key=lambda each: (known[each.instance_id].num_marked == 1, -strength(each, self._rule)))
        surplus = {artifact.instance_id for artifact in ranked[most:]}
        for instance_id in surplus:
            known[instance_id].num_marked = 0
        return tuple(
            replace(artifact, is_doubtful=True) if artifact.instance_id in surplus else artifact
            for artifact in artifacts
        )


def _costs(found: Sequence[Artifact], known: Sequence[_Instance], width_scale: float) -> Floats:
    """Distance over the gate, shape (found, known): below 1 where an artifact can continue an instance, never above."""
    latest = [instance.latest for instance in known]
    found_px, known_px = (np.array([artifact.position_px for artifact in some]) for some in (found, latest))
    found_m, known_m = (
        np.nan_to_num(np.array([artifact.depth_m for artifact in some]), nan=np.inf) for some in (found, latest)
    )
    distance_px = np.linalg.norm(found_px[:, None] - known_px, axis=-1) / width_scale
    is_other_kind = np.array([[artifact.kind != other.kind for other in latest] for artifact in found])
    distance_px += OTHER_KIND_PX * is_other_kind
    gate_px = np.minimum(GATE_PX + NEAR_GATE_PX_M2 / np.minimum(found_m[:, None], known_m) ** 2, MAX_GATE_PX)
    gate_px *= np.array([1 + instance.num_missed for instance in known])
    is_other_end = np.array([[artifact.is_rear != other.is_rear for other in latest] for artifact in found])
    # A constant outside the gate, so that artifacts that cannot be matched do not influence the others.
    return np.where(is_other_end, 1.0, np.minimum(distance_px / gate_px, 1.0))


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
