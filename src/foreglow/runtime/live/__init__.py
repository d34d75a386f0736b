"""The live loop: a camera, or what stands in for one, to commands in real time; faults mean low beam and are noted."""

from foreglow.runs.summary import FaultEvent, LiveSummary
from foreglow.runtime.live.faults import LiveFault
from foreglow.runtime.live.loop import BeamOutput, LiveLoop
from foreglow.runtime.live.sources import DriveAround, LiveSource, Paced

__all__ = ["BeamOutput", "DriveAround", "FaultEvent", "LiveFault", "LiveLoop", "LiveSource", "LiveSummary", "Paced"]
