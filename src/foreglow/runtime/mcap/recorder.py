"""A live sink that records frames and results in an MCAP file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import foxglove
from foxglove import channels as typed
from foxglove.messages import Log, LogLevel, RawImage, Timestamp

from foreglow.config import PipelineConfig
from foreglow.datasets.bags import FRAME_TOPIC, FrameMessage
from foreglow.files import fields_to_json
from foreglow.runs.frames_file import frame_to_line
from foreglow.runs.times_file import frame_to_times
from foreglow.runtime.health import Health
from foreglow.runtime.mcap.channels import (
    BOXES_TOPIC,
    CALIBRATION_TOPIC,
    CAMERA_FRAME,
    FRAME_SCHEMA,
    HEALTH_SCHEMA,
    HEALTH_TOPIC,
    IMAGE_TOPIC,
    LOG_TOPIC,
    RESULT_SCHEMA,
    RESULT_TOPIC,
    SCENE_TOPIC,
    TRANSFORM_TOPIC,
)
from foreglow.runtime.mcap.drawing import boxes_message, calibration_message, scene_message, transform_message
from foreglow.runtime.mcap.recording_file import RecordingFile
from foreglow.runtime.run import KeepingSink, discarding
from foreglow.runtime.time_axis import TimeAxis
from foreglow.types import BeamMode, Frame, FrameResult, Image

MAX_STAMP_NS = (1 << 32) * 1_000_000_000
"""The seconds of Foxglove's timestamps have 32 bits."""


class McapRecorder(KeepingSink):
    """Records every frame without loss, with its result, and the health; `docs/recordings.md` describes the topics.

    While it is written, the file is called `FILE.mcap.partial`; `close` renames it. If the process is killed, the file
    is readable up to its last chunk, at most half a second or one health message ago. The `.partial` of an earlier,
    killed run is kept under a numbered name.

    If a write fails, such as on a full disk, `close` leaves what was written before as `.partial`; `discard` deletes
    it, for runs that can be repeated.
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
        self._file = RecordingFile(path, config, source_name)
        with discarding([self]):
            self._make_channels(self._file.context)
        self._axis = TimeAxis()
        self._faults: dict[str, tuple[str, ...]] = {}

    def _make_channels(self, context: foxglove.Context) -> None:
        # The image comes first: readers take the first image topic.
        self._image = typed.RawImageChannel(IMAGE_TOPIC, context=context)
        self._calibration = typed.CameraCalibrationChannel(CALIBRATION_TOPIC, context=context)
        self._boxes = typed.ImageAnnotationsChannel(BOXES_TOPIC, context=context)
        self._transform = typed.FrameTransformChannel(TRANSFORM_TOPIC, context=context)
        self._scene = typed.SceneUpdateChannel(SCENE_TOPIC, context=context)
        self._log = typed.LogChannel(LOG_TOPIC, context=context)
        self._frame = _json_channel(FRAME_TOPIC, FRAME_SCHEMA, context)
        self._result = _json_channel(RESULT_TOPIC, RESULT_SCHEMA, context)
        self._health = _json_channel(HEALTH_TOPIC, HEALTH_SCHEMA, context)

    @property
    def num_kept(self) -> int:
        """Frames that are on the disk."""
        return self._file.num_kept

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds a frame.

        Raises:
            OSError: If the disk is full; the message names the path.
            ValueError: If its time does not fit a timestamp.
        """
        time_ns = self._axis.time_ns(frame)
        stamp = self._stamp(time_ns)
        self._frame.log(FrameMessage.of(frame).to_json(), log_time=time_ns)
        self._image.log(_image_message(frame.image, stamp), log_time=time_ns)
        if frame.camera is not None:
            self._calibration.log(calibration_message(frame.camera, stamp), log_time=time_ns)
            self._transform.log(transform_message(frame.camera, stamp), log_time=time_ns)
        self._boxes.log(boxes_message(result, stamp), log_time=time_ns)
        self._scene.log(scene_message(frame, result, stamp), log_time=time_ns)
        record = _json({**frame_to_line(frame, result), **frame_to_times(frame, result)})
        self._result.log(record, log_time=time_ns)
        if result.beam is not None:
            self._note_faults("low beam", result.beam.faults, time_ns)
        self._file.wrote(time_ns, frame.image.nbytes + len(record))

    def write_health(self, health: Health) -> None:
        """Adds a health report that has a time, and writes the chunk.

        Raises:
            OSError: If the disk is full; the message names the path.
            ValueError: If its time does not fit a timestamp.
        """
        if not health.is_timed:
            return
        time_ns = self._axis.within_sequence_ns(health.timestamp_ns)
        self._stamp(time_ns)
        record = fields_to_json(dataclasses.replace(health, beam=None))
        del record["is_timed"]
        record["beam"] = None if health.beam is None else BeamMode(health.beam.mode).name.lower()
        self._health.log(_json(record), log_time=time_ns)
        self._note_faults("fault", health.faults, time_ns)
        self._file.flush()

    def close(self) -> None:
        """Completes and renames the file; if a write failed before, it stays `.partial`.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        self._file.close(is_complete=self.is_complete)

    def discard(self) -> None:
        """Deletes what was written, unless it was completed before."""
        self._file.discard()

    def _stamp(self, time_ns: int) -> Timestamp:
        if not 0 <= time_ns < MAX_STAMP_NS:
            raise ValueError(f"{self._file.path}: time: expected one from 0 to 2^32 s, got {time_ns / 1e9:.3f} s")
        return Timestamp(sec=time_ns // 1_000_000_000, nsec=time_ns % 1_000_000_000)

    def _note_faults(self, kind: str, faults: Sequence[str], time_ns: int) -> None:
        if tuple(faults) == self._faults.get(kind, ()):
            return
        self._faults[kind] = tuple(faults)
        level = LogLevel.Warning if faults else LogLevel.Info
        message = Log(
            timestamp=self._stamp(time_ns),
            level=level,
            name="foreglow",
            message=f"{kind}: {', '.join(faults) or 'none any more'}",
        )
        self._log.log(message, log_time=time_ns)


def _json_channel(topic: str, schema: Mapping[str, Any], context: foxglove.Context) -> foxglove.Channel:
    described = foxglove.Schema(name=str(schema["title"]), encoding="jsonschema", data=json.dumps(schema).encode())
    return foxglove.Channel(topic, schema=described, message_encoding="json", context=context)


def _json(record: Mapping[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":"), allow_nan=False).encode()


def _image_message(image: Image, stamp: Timestamp) -> RawImage:
    height, width = image.shape
    depth = image.dtype.itemsize
    return RawImage(
        timestamp=stamp,
        frame_id=CAMERA_FRAME,
        width=width,
        height=height,
        encoding="mono8" if depth == 1 else "mono16",
        step=width * depth,
        data=image.astype(image.dtype.newbyteorder("<"), copy=False).tobytes(),
    )
