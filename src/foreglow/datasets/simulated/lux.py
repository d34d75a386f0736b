"""The light of our headlamps at other drivers' eyes while a drive was simulated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from foreglow.datasets.simulated.files import MAX_FRAMES, SequenceTruth, read_truth
from foreglow.types import Frame


class RecordedLux:
    """The light of ours that reached each other driver's eye, for a frame of a simulated split.

    It is the light of the beam with which the drive was simulated, whatever the beam is commanded to do now.
    """

    def __init__(self, split: Path) -> None:
        """Lists the sequences; each is read when its first frame comes.

        Raises:
            FileNotFoundError: If the split is not simulated.
            ValueError: If its `info.json` is broken.
        """
        self._truth = read_truth(split)
        self._latest: SequenceTruth | None = None

    def __call__(self, frame: Frame) -> Mapping[str, float]:
        """Lux by kind and number of the vehicle, such as `car 0`; empty where nothing is known about the sequence.

        Raises:
            ValueError: If the truth is broken; the message names path, line and field.
        """
        sequence_id = frame.frame // MAX_FRAMES
        if sequence_id not in self._truth.sequence_ids:
            return {}
        if self._latest is None or self._latest.sequence_id != sequence_id:
            self._latest = self._truth.sequence(sequence_id)
        vehicles = self._latest.frame(frame.frame).vehicles
        return {f"{vehicle.kind} {vehicle.vehicle_id}": vehicle.eye_lx.get("ego", 0.0) for vehicle in vehicles}
