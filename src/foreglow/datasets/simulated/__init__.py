"""Simulated drives: PVDN's format with the truth beside it, read and written; nothing here needs the simulator.

`truth` has the types of the truth, `files` writes and reads them (its docstring lists the files), `vehicle` is the part
of it that a car knows, too, `lux` the light of our headlamps at other drivers' eyes, and `production` when the modelled
production system reports a vehicle.
"""

from foreglow.datasets.simulated.files import SequenceTruth, SimulatedTruth, has_truth, read_truth, shares_path
from foreglow.datasets.simulated.shares import NUM_VEHICLE_SOURCES, SOURCES, BoxShares, read_shares
from foreglow.datasets.simulated.truth import KINDS, Artifact, FrameTruth, Kind, LampTruth, VehicleTruth

__all__ = [
    "KINDS",
    "NUM_VEHICLE_SOURCES",
    "SOURCES",
    "Artifact",
    "BoxShares",
    "FrameTruth",
    "Kind",
    "LampTruth",
    "SequenceTruth",
    "SimulatedTruth",
    "VehicleTruth",
    "has_truth",
    "read_shares",
    "read_truth",
    "shares_path",
]
