"""Frames from recordings: ROS 1 bags, ROS 2 bags, and MCAP files, our own ones with all that their frames carried."""

from foreglow.datasets.bags.frame_record import FRAME_TOPIC, FRAME_TYPE, FrameRecord
from foreglow.datasets.bags.pixels import grey_image
from foreglow.datasets.bags.recording import Recording, is_recording

__all__ = ["FRAME_TOPIC", "FRAME_TYPE", "FrameRecord", "Recording", "grey_image", "is_recording"]
