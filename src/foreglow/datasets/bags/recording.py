"""Frames from an image topic of a recording."""

from __future__ import annotations

import itertools
import statistics
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from foreglow.datasets.bags.containers import PARTIAL_SUFFIXES, Container, Message, Topic, check_num_topics, is_partial
from foreglow.datasets.bags.cursor import CdrCursor, Cursor, latest_fields, text_of
from foreglow.datasets.bags.frame_message import FRAME_TOPIC, FRAME_TYPE, FrameMessage
from foreglow.datasets.bags.mcap_file import McapFile
from foreglow.datasets.bags.pairs import TimeShift, pairs
from foreglow.datasets.bags.pixels import Pixels, grey_image
from foreglow.datasets.bags.ros1_bag import Ros1Bag
from foreglow.datasets.bags.ros2_bag import METADATA, Ros2Bag, SqliteBag
from foreglow.datasets.file_state import FileStates
from foreglow.datasets.images import decode_image
from foreglow.datasets.json_files import parse_json
from foreglow.datasets.source import FileSource, OnError, TimeOrder
from foreglow.files import check_file, checked_path
from foreglow.types import Frame, Image

NS = 1_000_000_000

MAX_SECONDS = 1 << 32
"""ROS 1 has seconds of 32 bits without a sign, ROS 2 of as many with one; the year is 2106."""


@dataclass(frozen=True, slots=True)
class ImageMessage:
    """An image message whose picture is not decoded yet.

    Attributes:
        stamp_ns: Time in its header, nanoseconds; 0 where there is none.
        content: Pixels, or the bytes of a PNG or JPEG.
    """

    stamp_ns: int
    content: Pixels | memoryview

    def image(self) -> Image:
        """The grey image.

        Raises:
            ValueError: If the picture is damaged, or its size or encoding is not accepted; the message starts with the
                field.
        """
        if isinstance(self.content, Pixels):
            return grey_image(self.content)
        return decode_image(bytes(self.content), "data")


def _ros1(data: memoryview) -> Cursor:
    cursor = Cursor(data)
    cursor.number("I", "header.seq")
    return cursor


def _image(cursor: Cursor, seconds: Literal["i", "I"]) -> ImageMessage:
    """sensor_msgs/Image, from its time stamp on."""
    stamp_ns = _ros_stamp_ns(cursor, seconds)
    height, width = cursor.number("I", "height"), cursor.number("I", "width")
    encoding, is_big_endian = cursor.text("encoding"), cursor.number("B", "is_bigendian")
    step = cursor.number("I", "step")
    return ImageMessage(stamp_ns, Pixels(height, width, encoding, bool(is_big_endian), step, cursor.block("data")))


def _compressed(cursor: Cursor, seconds: Literal["i", "I"]) -> ImageMessage:
    """sensor_msgs/CompressedImage, from its time stamp on; its format is not used."""
    stamp_ns = _ros_stamp_ns(cursor, seconds)
    cursor.text("format")
    return ImageMessage(stamp_ns, cursor.block("data"))


def _foxglove_image(data: memoryview) -> ImageMessage:
    fields = latest_fields(data)
    pixels = Pixels(
        height_px=_number(fields, 3, "height"),
        width_px=_number(fields, 2, "width"),
        encoding=text_of(_bytes(fields, 4, "encoding"), "encoding"),
        is_big_endian=False,
        step=_number(fields, 5, "step"),
        data=_bytes(fields, 6, "data"),
    )
    return ImageMessage(_foxglove_stamp_ns(fields), pixels)


def _foxglove_compressed(data: memoryview) -> ImageMessage:
    fields = latest_fields(data)
    return ImageMessage(_foxglove_stamp_ns(fields), _bytes(fields, 2, "data"))


DECODERS: Mapping[tuple[str, str], Callable[[memoryview], ImageMessage]] = MappingProxyType(
    {
        ("sensor_msgs/Image", "ros1"): lambda data: _image(_ros1(data), "I"),
        ("sensor_msgs/msg/Image", "cdr"): lambda data: _image(CdrCursor(data), "i"),
        ("sensor_msgs/CompressedImage", "ros1"): lambda data: _compressed(_ros1(data), "I"),
        ("sensor_msgs/msg/CompressedImage", "cdr"): lambda data: _compressed(CdrCursor(data), "i"),
        ("foxglove.RawImage", "protobuf"): _foxglove_image,
        ("foxglove.CompressedImage", "protobuf"): _foxglove_compressed,
    }
)
"""Decoders by the type of a message and its encoding; each raises ValueError, with the field, for a broken message."""


def _ros_stamp_ns(cursor: Cursor, seconds: Literal["i", "I"]) -> int:
    """The time in a header, whose frame id is skipped; ROS 2 has signed seconds."""
    stamp = cursor.number(seconds, "header.stamp.sec"), cursor.number("I", "header.stamp.nanosec")
    cursor.text("header.frame_id")
    return _stamp_ns(*stamp, "header.stamp")


def _foxglove_stamp_ns(fields: Mapping[int, int | memoryview]) -> int:
    """The google.protobuf.Timestamp in field 1."""
    stamp = latest_fields(_bytes(fields, 1, "timestamp"))
    return _stamp_ns(_number(stamp, 1, "timestamp.seconds"), _number(stamp, 2, "timestamp.nanos"), "timestamp")


def _stamp_ns(seconds: int, nanoseconds: int, field: str) -> int:
    """A time stamp in nanoseconds; a part that cannot be is of a damaged message, whose frame would be elsewhere."""
    if not (seconds < MAX_SECONDS and nanoseconds < NS):
        raise ValueError(f"{field}: expected seconds below 2^32 and less than 1e9 ns, got {seconds} and {nanoseconds}")
    return seconds * NS + nanoseconds


def _number(fields: Mapping[int, int | memoryview], number: int, field: str) -> int:
    value = fields.get(number, 0)
    if isinstance(value, memoryview):
        raise ValueError(f"{field}: expected a number, got {len(value)} bytes")
    return value


def _bytes(fields: Mapping[int, int | memoryview], number: int, field: str) -> memoryview:
    value = fields.get(number, memoryview(b""))
    if isinstance(value, int):
        raise ValueError(f"{field}: expected bytes, got the number {value}")
    return value


CONTAINERS: Mapping[str, Callable[[Path], Container]] = MappingProxyType(
    {".mcap": McapFile, ".bag": Ros1Bag, ".db3": SqliteBag}
)
"""Containers by the ending of a file; a ROS 2 bag is a folder."""

IMAGE_TYPES = tuple(sorted({name for name, _ in DECODERS}))

NUM_TIMED = 20
"""The rate is measured on so many time stamps."""


class Recording(FileSource):
    """The frames of an image topic, in the order of the file, grey.

    Times are those in the headers of the messages, or the times of recording where a header has none; as in a `Video`,
    a frame that is earlier than the one before is refused, or, if by more than a second, begins another sequence.
    Frames of our own recordings carry the same as when they were recorded: number, sequence, time, camera, motion and
    road; an image without these, or with those of another time, is damage. Other recordings give neither camera nor
    motion: a CameraInfo does not say where the camera is mounted in the vehicle. A damaged message or chunk, or a
    missing end is an error, and so is a file that changes after it was opened; with `skip`, damaged parts are left out.
    A recording whose name says that it is incomplete (`PARTIAL_SUFFIXES`) is read up to its last whole chunk, and may
    grow. A warning says so, and also of a recording of ours whose run was interrupted, of a missing end with
    `skip`, and of a ROS 2 bag with fewer images than were recorded by its metadata (`lack`).

    Attributes:
        path: File or folder.
        topic: Name of the topic.
        rate_hz: Frames a second, by the first time stamps; None if these all coincide.
        num_frames: Images on the topic; None where the recording does not say.
    """

    topic: str

    def __init__(self, path: Path | str, *, topic: str | None = None, on_error: OnError = "stop") -> None:
        """Opens the recording, finds the topic and closes it again.

        Args:
            path: A .mcap, .bag or .db3 file, or the folder of a ROS 2 bag.
            topic: Name of the topic; None for the first with images.
            on_error: What damage does.

        Raises:
            FileNotFoundError: If there is no such file.
            ModuleNotFoundError: If it is compressed, and the extra `recordings` is not installed.
            ValueError: If it is not a recording, has no such topic with images, or, with `stop`, lacks its end.
        """
        super().__init__(path, on_error)
        self.path = self.origin
        self._container = _opened(self.path)
        self._states = FileStates(_files_of(self.path))
        if self._container.truncation and on_error == "stop":
            self._lose_part(self._container.truncation)
        found = self._found(topic)
        self.topic = self._topic = found.name
        self._decode = DECODERS[found.type, found.encoding]
        self.num_frames = self._container.count(self._topic)
        self.lack = self._container.lack or self._container.truncation
        if not self.lack and isinstance(self._container, Ros2Bag):
            self.lack = self._container.lack_of(self._topic, self.num_frames)
        self.rate_hz = self._rate_hz()
        self.skipped, self.lost_parts = [], []
        if self.lack:
            warnings.warn(self.lack, stacklevel=2)

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return self.path.name

    def __iter__(self) -> Iterator[Frame]:
        self.lost_parts = [self._container.truncation] if self._container.truncation else []
        self.skipped = [*self.lost_parts]
        return self._frames()

    def _frames(self) -> Iterator[Frame]:
        index, latest_ns, is_ours, shift, order = -1, -1, False, TimeShift(), TimeOrder()
        is_complete = not (self._container.truncation or is_partial(self.path))
        for image, record in pairs(self._read(), is_complete=is_complete):
            try:
                if image is not None:
                    index, latest_ns, is_ours = index + 1, image.log_time_ns, is_ours or record is not None
                    yield self._frame(image, record, index, shift if is_ours else order)
                elif record is not None and (is_ours or record.log_time_ns <= latest_ns):
                    raise ValueError(f"expected an image at the time of {FRAME_TYPE}, {record.log_time_ns} ns")
            except ValueError as error:
                self._refuse(f"{self.path}: {self.topic}: frame {index}: {error}")
        if change := self._states.change():
            self._lose(change)

    def _read(self) -> Iterator[Message]:
        """The images and what our own recordings have beside them."""
        for message in self._container.messages({self._topic, FRAME_TOPIC}, self._lose_part):
            if self.topic == message.topic.name or message.topic.type == FRAME_TYPE:
                yield message

    def _lose_part(self, message: str) -> None:
        """As `_lose`, of a part of the container; an error says how to read the rest."""
        self._lose(f"{message}; --on-error skip reads what is there" if self.on_error == "stop" else message)

    def _frame(self, image: Message, record: Message | None, index: int, times: TimeShift | TimeOrder) -> Frame:
        """The frame of an image; `times` checks its time: a `TimeOrder` where images have no record."""
        decoded = self._decode(image.data)
        path, time_ns = f"{self.path}, {self.topic}, frame {index}", _time_ns(decoded, image)
        if isinstance(times, TimeOrder):
            grey = decoded.image()
            times.take(index, time_ns)
            return Frame(grey, time_ns, frame=index, sequence=times.sequence, path=path)
        if record is None:
            raise ValueError(f"expected {FRAME_TYPE} at its time, {image.log_time_ns} ns, found none")
        message = parse_json(bytes(record.data), FrameMessage, FRAME_TYPE)
        frame = message.frame_of(decoded.image(), path)
        times.check(message, time_ns)
        return frame

    def _found(self, name: str | None) -> Topic:
        """The topic called `name`, or the first with images; without any, the error lists the topics."""
        topics: dict[str, Topic] = {}
        for message in self._container.messages(None, self._lose_part):
            topic = topics.setdefault(message.topic.name, message.topic)
            check_num_topics(topics)
            if name in (None, topic.name) and (topic.type, topic.encoding) in DECODERS:
                return topic
        known = ", ".join(
            f"{topic.name[:40]} ({(topic.type or topic.encoding)[:40]})"
            for topic in itertools.islice(topics.values(), 20)
        )
        known = known or "none"
        wanted = "a topic" if name is None else f"the topic {name}"
        raise ValueError(f"{self.path}: expected {wanted} with images ({', '.join(IMAGE_TYPES)}), found {known}")

    def _rate_hz(self) -> float | None:
        times_ns = []
        for message in itertools.islice(self._container.messages({self._topic}, self._lose_part), NUM_TIMED):
            try:
                times_ns.append(_time_ns(self._decode(message.data), message))
            except ValueError:
                continue
        steps_ns = [step for before, after in itertools.pairwise(times_ns) if (step := after - before) > 0]
        return 1e9 / statistics.median(steps_ns) if steps_ns else None


def is_recording(path: Path | str) -> bool:
    """Whether `path` is a recording by its name, or a ROS 2 bag by its metadata."""
    path = checked_path(path)
    return (path / METADATA).is_file() if path.is_dir() else _ending(path) in CONTAINERS


def _opened(path: Path) -> Container:
    if path.is_dir():
        return Ros2Bag(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such recording")
    check_file(path)
    ending = _ending(path)
    if ending not in CONTAINERS:
        raise ValueError(f"{path}: expected a recording that ends in {', '.join(CONTAINERS)}")
    return CONTAINERS[ending](path)


def _files_of(path: Path) -> list[Path]:
    """The files that hold what is read, and may not change meanwhile; none of one that is still being written."""
    files = [path] if path.is_file() else [each for each in path.iterdir() if _ending(each) in CONTAINERS]
    return [each for each in files if not is_partial(each)]


def _ending(path: Path) -> str:
    name = path.name
    for suffix in PARTIAL_SUFFIXES:
        name = name.removesuffix(suffix)
    return Path(name).suffix.lower()


def _time_ns(decoded: ImageMessage, message: Message) -> int:
    return decoded.stamp_ns or message.log_time_ns
