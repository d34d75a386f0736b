"""Videos: a file's frames in order (`video_file`), how packets become images, and what tells that some are damaged.

`decoding` has what FFmpeg tells, and what our own readers find beside it: in the packets (`coded_units`,
`h264_numbers`, `unshown`) and in the file around them (`containers`).
"""

from foreglow.datasets.video.video_file import Video

__all__ = ["Video"]
