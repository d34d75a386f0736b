"""The live loop: from a camera, a replay or a simulated drive to beam commands in real time; a fault is low beam."""

from foreglow.runs.summary_file import FaultEvent, LiveSummary
from foreglow.runtime.live.faults import LiveFault
from foreglow.runtime.live.loop import LiveEndedError, LiveLoop
from foreglow.runtime.live.outlet import BeamOutput
from foreglow.runtime.live.sources import ClosedLoop, LiveSource, Paced

__all__ = [
    "BeamOutput",
    "ClosedLoop",
    "FaultEvent",
    "LiveEndedError",
    "LiveFault",
    "LiveLoop",
    "LiveSource",
    "LiveSummary",
    "Paced",
]
