"""Records a run as `ros2 bag` does: the messages of all topics, as CDR, in MCAP, which `ros2 bag play` replays."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import foxglove
from rclpy.serialization import serialize_message

from foreglow.config import PipelineConfig
from foreglow.runtime.mcap.recording_file import RecordingFile
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.results import beam_message, detections_message, proposals_message, tracks_message
from foreglow.runtime.ros2.source import FRAME_ID, Due, FramePublisher
from foreglow.runtime.ros2.standard import installed_types, standard_messages
from foreglow.runtime.run import KeepingSink, discarding
from foreglow.runtime.time_axis import TimeAxis
from foreglow.types import Frame, FrameResult

MAX_STAMP_NS = (1 << 31) * 1_000_000_000
"""The seconds of ROS's stamps have 31 bits."""

_BASIC = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
"""Names of IDL, in which rclpy describes messages, and of `.msg` files; all others are the same."""


class BagRecorder(KeepingSink):
    """Records all topics of the network for every frame, as nodes would have published them.

    The file is `.partial` until it is complete, as every recording.
    """

    def __init__(self, path: Path | str, *, config: PipelineConfig | None = None, source_name: str = "") -> None:
        """Creates the file.

        Args:
            path: The file's final name.
            config: The pipeline's configuration, kept in the recording's metadata.
            source_name: The name of the frames' source, kept likewise.

        Raises:
            OSError: If it cannot be created; the message names the path.
            ValueError: If the path does not end in `.mcap`, or another run is recording into it.
        """
        self._standard = installed_types()
        self._axis = TimeAxis()
        self._file = RecordingFile(path, config, source_name, profile="ros2")
        with discarding([self]):
            self._channels = {
                topic: _channel(topic, kind, self._file.context)
                for topic, kind in {topics.IMAGE: topics.TYPES[topics.IMAGE], **topics.TYPES, **self._standard}.items()
                if topic != topics.TIMING
            }

    @property
    def num_kept(self) -> int:
        """Frames that are on the disk."""
        return self._file.num_kept

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds a frame.

        Raises:
            OSError: If the disk is full; the message names the path.
            ValueError: If its time does not fit a stamp.
        """
        time_ns = self._axis.time_ns(frame)
        if not 0 <= time_ns < MAX_STAMP_NS:
            raise ValueError(f"{self._file.path}: time: expected one from 0 to 2^31 s, got {time_ns / 1e9:.3f} s")
        header = Header(time_ns, frame.sequence or FRAME_ID)
        num_bytes = 0
        for topic, message in (*FramePublisher.messages(Due(frame, header)), *self._results(header, frame, result)):
            data = serialize_message(message)
            self._channels[topic].log(data, log_time=time_ns)
            num_bytes += len(data)
        self._file.wrote(time_ns, num_bytes)

    def close(self) -> None:
        """Completes and renames the file; if a write failed before, it stays `.partial`.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        self._file.close(is_complete=self.is_complete)

    def discard(self) -> None:
        """Deletes what was written, unless it was completed before."""
        self._file.discard()

    def _results(self, header: Header, frame: Frame, result: FrameResult) -> Iterator[tuple[str, Any]]:
        yield topics.PROPOSALS, proposals_message(header, result.proposals)
        if result.detections is not None:
            yield topics.DETECTIONS, detections_message(header, result.detections)
            yield topics.RANGES, detections_message(header, result.detections, result.ranges)
        if result.tracks is not None:
            yield topics.TRACKS, tracks_message(header, result.tracks)
            yield from standard_messages(header, frame, result.tracks, result.beam, self._standard).items()
        if result.beam is not None:
            yield topics.BEAM, beam_message(header, result.beam)


def _channel(topic: str, kind: type[Any], context: foxglove.Context) -> foxglove.Channel:
    schema = foxglove.Schema(name=topics.type_name(kind), encoding="ros2msg", data=definition(kind).encode())
    return foxglove.Channel(f"/{topic}", schema=schema, message_encoding="cdr", context=context)


def definition(kind: type[Any]) -> str:
    """The definition of a message as in `.msg` files, without constants, followed by those of all messages in it."""
    texts: dict[str, str] = {}
    waiting = [kind]
    while waiting:
        described, lines = waiting.pop(0), []
        name = topics.type_name(described).replace("/msg", "")
        if name in texts:
            continue
        for field, declared in described.get_fields_and_field_types().items():
            basic, array = _declared(declared)
            if "/" in basic:
                package, _, inner = basic.partition("/")
                waiting.append(getattr(importlib.import_module(f"{package}.msg"), inner))
            lines.append(f"{_BASIC.get(basic, basic)}{array} {field}\n")
        texts[name] = "".join(lines)
    first, *others = texts.items()
    return first[1] + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)


def _declared(declared: str) -> tuple[str, str]:
    """The type of a field or of its items, and the brackets behind it in a `.msg` file.

    >>> _declared("sequence<double>"), _declared("double[9]"), _declared("sequence<uint8, 4>"), _declared("string")
    (('double', '[]'), ('double', '[9]'), ('uint8', '[<=4]'), ('string', ''))
    """
    if sequence := re.fullmatch(r"sequence<([^,>]+)(?:, (\d+))?>", declared):
        return sequence[1], f"[<={sequence[2]}]" if sequence[2] else "[]"
    if array := re.fullmatch(r"([^\[]+)(\[\d+\])", declared):
        return array[1], array[2]
    return declared, ""
