"""Records a run as an MCAP file, with all inputs and results, to replay it and to view it in Foxglove."""

from foreglow.runtime.mcap.recorder import McapRecorder

__all__ = ["McapRecorder"]
