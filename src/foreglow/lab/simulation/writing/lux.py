"""The light of our headlamps at other drivers' eyes as a simulated drive was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from foreglow.lab.simulation.writing.truth_files import MAX_FRAMES, SequenceTruth, read_truth
from foreglow.types import Frame


class RecordedLux:
    """Says for a frame of a simulated split how much of our light was at each other driver's eye.

    That is the light that shone while the drive was simulated, not what a beam that is commanded now would give.
    """

    def __init__(self, split: Path) -> None:
        """Looks which sequences are there; each is read when its first frame comes.

        Raises:
            FileNotFoundError: If the split is not simulated.
            ValueError: If its `info.json` is broken.
        """
        self._truth = read_truth(split)
        self._latest: SequenceTruth | None = None

    def __call__(self, frame: Frame) -> Mapping[str, float]:
        """Lux by kind and number of the vehicle, such as `car 0`; empty where nothing is known of the sequence.

        Raises:
            ValueError: If the truth is broken; the message names path, line and field.
        """
        sequence_id = frame.frame // MAX_FRAMES
        if sequence_id not in self._truth.sequence_ids:
            return {}
        if self._latest is None or self._latest.sequence_id != sequence_id:
            self._latest = self._truth.sequence(sequence_id)
        vehicles = self._latest.frame(frame.frame).vehicles
        return {f"{one.kind} {one.vehicle_id}": one.eye_lx.get("ego", 0.0) for one in vehicles}
