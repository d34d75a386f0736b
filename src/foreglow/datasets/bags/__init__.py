"""Frames read from recordings: ROS 1 bags, ROS 2 bags, and MCAP files; ours have all that their frames carried.

`foreglow.runtime.mcap` records such MCAP files.
"""

from foreglow.datasets.bags.frame_message import FRAME_TOPIC, FRAME_TYPE, FrameMessage
from foreglow.datasets.bags.pairs import PAUSE_NS
from foreglow.datasets.bags.pixels import grey_image
from foreglow.datasets.bags.recording import Recording, is_recording

__all__ = ["FRAME_TOPIC", "FRAME_TYPE", "PAUSE_NS", "FrameMessage", "Recording", "grey_image", "is_recording"]
