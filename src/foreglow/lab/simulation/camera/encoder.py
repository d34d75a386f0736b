"""Compression by a real encoder: a drive becomes a stream, and every image comes back as a player would show it."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from foreglow.lab.simulation.camera.profile import EncoderSpec

LIBRARIES = {"h264": "libx264", "h265": "libx265"}
PRESETS = {"h264": "superfast", "h265": "ultrafast"}
"""The encoders of cameras are simple, and these are the quickest that predict within and between frames."""


FRAMES_PREDICTED = 4.0
"""Frames of the camera's own rate after which an image can hardly be predicted from the last one."""

MAX_MORE_BITS = 4.0
"""Up to how many times the bits of others a frame that is not predicted gets, as encoders give them."""


class Encoder:
    """A stream of one camera through a drive; the same images give the same bytes.

    There are no frames that wait for later ones, so that every image comes back at once.
    """

    def __init__(self, spec: EncoderSpec, width_px: int, height_px: int, step_s: float = 0.0) -> None:
        """A stream of images with `step_s` seconds between them; 0 for those of the camera's own rate."""
        self._size = (width_px, height_px)
        padded = (width_px + width_px % 2, height_px + height_px % 2)
        rate = Fraction(spec.rate_hz).limit_denominator(1001)
        writer: Any = av.CodecContext.create(LIBRARIES[spec.codec], "w")
        writer.width, writer.height = padded
        writer.pix_fmt = "yuv420p"
        writer.framerate, writer.time_base = rate, 1 / rate
        kbps = spec.kbps * min(MAX_MORE_BITS, max(1.0, step_s * spec.rate_hz / FRAMES_PREDICTED))
        writer.bit_rate = round(kbps * 1000)
        writer.gop_size = spec.key_every
        writer.max_b_frames = 0
        writer.thread_count = 1
        options = {"preset": PRESETS[spec.codec], "tune": "zerolatency"}
        buffer = round(kbps)  # of one second
        if spec.codec == "h264":
            options["x264-params"] = f"vbv-maxrate={buffer}:vbv-bufsize={buffer}:force-cfr=1:threads=1:sliced-threads=0"
        else:
            options["x265-params"] = (
                f"vbv-maxrate={buffer}:vbv-bufsize={buffer}:frame-threads=1:pools=1:log-level=error:info=0"
            )
        writer.options = options
        self._writer = writer
        self._reader: Any = av.CodecContext.create({"h264": "h264", "h265": "hevc"}[spec.codec], "r")
        self._reader.thread_count = 1
        self._reader.flags |= av.codec.context.Flags.low_delay
        self._num = 0

    def through(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """`image`, shape (H, W), the next of the stream, after compression.

        Raises:
            RuntimeError: If the encoder keeps it back.
        """
        width, height = self._size
        padded = np.pad(image, ((0, height % 2), (0, width % 2)), mode="edge")
        full = np.full((padded.shape[0] * 3 // 2, padded.shape[1]), 128, np.uint8)
        # Of the video range, 16 to 235.
        full[: padded.shape[0]] = LIMITED[padded]
        frame = av.VideoFrame.from_ndarray(full, format="yuv420p")
        frame.pts = self._num
        self._num += 1
        for packet in self._writer.encode(frame):
            for back in self._reader.decode(packet):
                luma = np.asarray(back.to_ndarray())[:height, :width]
                return np.asarray(FULL[luma])
        raise RuntimeError("encoder: expected an image back for every image")


LIMITED = np.rint(16 + np.arange(256) * (219 / 255)).astype(np.uint8)
FULL = np.clip(np.rint((np.arange(256) - 16) * (255 / 219)), 0, 255).astype(np.uint8)
