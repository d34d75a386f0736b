"""A run as an MCAP file: all that went in and all that came out, to replay and to look at in Foxglove."""

from foreglow.runtime.mcap.recorder import McapRecorder

__all__ = ["McapRecorder"]
