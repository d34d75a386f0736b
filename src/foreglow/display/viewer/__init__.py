"""The Rerun viewer: a live sink that shows a run in a window, keeps it as a recording, or both (extra `view`)."""

import os

# Rerun's core writes to stderr by itself what its errors say already; it reads this once, when it is loaded.
os.environ.setdefault("RUST_LOG", "off")

from foreglow.display.viewer.outputs import RrdFile, ViewerWindow
from foreglow.display.viewer.sink import RerunSink

__all__ = ["RerunSink", "RrdFile", "ViewerWindow"]
