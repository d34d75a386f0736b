"""The records of PVDN's label files, field by field; nothing is derived here.

Every record keeps keys that it does not know, and a record that was read is written with the same keys.
Source: Ohnemus et al., Provident Vehicle Detection at Night: The PVDN Dataset, arXiv 2012.15376, and the reader
published with it.
"""

from __future__ import annotations

import unicodedata
from enum import IntEnum, StrEnum
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from foreglow.datasets.json_files import Record
from foreglow.numbers import plain
from foreglow.wording import shortened

_NAMES_ON_DISK = {
    "directory": "dir",
    "driver_id": "proband_id",
    "driver_behaviour": "proband_behaviour",
    "is_dome": "dome",
    "position_px": "pos",
    "is_direct": "direct",
    "is_rear": "rear",
    "boxes_xyxy_px": "bounding_boxes",
    "start_time_ms": "start_time",
    "end_time_ms": "end_time",
    "height_px": "height",
    "width_px": "width",
}


class PVDNRecord(Record):
    """A part of a label file; some fields have clearer names in Python than on disk, and both names are accepted.

    In Python, lists and arrays, such as key points and boxes of ours, become tuples.
    """

    model_config = ConfigDict(populate_by_name=True, alias_generator=lambda name: _NAMES_ON_DISK.get(name, name))

    @classmethod
    def _plain(cls, fields: Any) -> Any:
        if not isinstance(fields, dict):
            return fields
        return {name: plain(value, as_tuples=name != "info") for name, value in fields.items()}


Id: TypeAlias = Annotated[int, Field(ge=0, le=2**53)]
"""An identifier; 2^53 is the largest that every JSON reader keeps exactly."""

Pixel: TypeAlias = Annotated[int, Field(ge=-(2**20), le=2**20)]
"""A full-frame pixel coordinate; it may lie outside the image, but not beyond any camera."""

Milliseconds: TypeAlias = Annotated[int | float, Field(ge=-(2**53), le=2**53)]


def is_plain(text: str) -> bool:
    """Whether every format keeps the text: all of it can be printed, or is a space of any sort, without backslashes."""
    return all(each != "\\" and (each.isprintable() or unicodedata.category(each) == "Zs") for each in text)


def _plain_name(name: str) -> str:
    if name in ("", ".", "..") or "/" in name or not is_plain(name):
        raise ValueError(f"expected a plain name without a path, got {shortened(name)}")
    return name


Name: TypeAlias = Annotated[str, Field(max_length=200), AfterValidator(_plain_name)]
"""Name of a file or folder, without any path."""


class Cycle(StrEnum):
    """Exposure cycle: the camera alternates between short (day) and long (night) exposure."""

    DAY = "day"
    NIGHT = "night"


class Direction(IntEnum):
    """Where the test drive was heading."""

    DIR_MOENSHEIM = 0
    DIR_IPTINGEN = 1
    DIR_EZW = 2
    ENTRANCE_MOENSHEIM = 3
    ENTRANCE_IPTINGEN = 4
    ENTRANCE_EZW = 5


class StreetStyle(IntEnum):
    """Course of the road."""

    RIGHT_TURN = 0
    LEFT_TURN = 1
    RIGHT_LEFT_TURN = 2
    LEFT_RIGHT_TURN = 3
    LONG_RIGHT_TURN = 4
    LONG_LEFT_TURN = 5
    STRAIGHT_STREET = 6


class DriverBehaviour(IntEnum):
    """How the driver dimmed the headlamps."""

    CORRECT = 0
    TOO_LATE = 1
    TOO_EARLY = 2
    INCORRECT = 3
    EXCEPTIONAL = 4


class RoadType(IntEnum):
    """Markings of the road."""

    SINGLE_LANE_ROAD_MARKING = 0
    SINGLE_LANE_NO_ROAD_MARKING = 1


class View(IntEnum):
    """How far the surroundings could be overlooked."""

    WIDE_VIEW = 0
    SHORT_VIEW = 1


class Weather(IntEnum):
    """Weather during the sequence."""

    DRY = 0
    WET = 1
    RAIN = 2
    SNOW = 3
    FOG = 4


class EnvironmentLighting(IntEnum):
    """Ambient light during the sequence."""

    BRIGHT = 0
    DUSK = 1
    DARK = 2


class ImageCategory(IntEnum):
    """What an image shows of the oncoming vehicle; `CategoryConfig` says which category marks which moment.

    The names are those of the data set's statistics; its files do not explain them further.
    """

    NONE = 0
    FIRST_VISIBLE_SIGNS = 1
    INDIRECT = 2
    FIRST_DIRECT_ARTIFACTS = 3
    DIRECT_ARTIFACTS = 4
    FIRST_DIRECT_SIGHT = 5
    FIRST_TRIGGER_LOW_BEAM = 6
    LOW_BEAM = 7


class CategoryConfig(Record):
    """Which image category marks which moment of a sequence; configuration, as the data set does not document it.

    Attributes:
        first_annotated: The first sign of the oncoming vehicle.
        first_direct_sight: The vehicle itself comes into sight.
        low_beam_trigger: The production system switches to low beam.
    """

    first_annotated: ImageCategory = ImageCategory.FIRST_VISIBLE_SIGNS
    first_direct_sight: ImageCategory = ImageCategory.FIRST_DIRECT_SIGHT
    low_beam_trigger: ImageCategory = ImageCategory.FIRST_TRIGGER_LOW_BEAM


class Sequence(PVDNRecord):
    """A scene in one exposure cycle: an entry of `sequences.json`, of which `id`, `dir` and `image_ids` must be there.

    Attributes:
        id: Number of the sequence, unique in its split.
        directory: Folder below `images`, such as S00121 (on disk: dir).
        start_time_ms: Relative time of the first image, milliseconds (on disk: start_time).
        end_time_ms: Relative time of the last image, milliseconds (on disk: end_time).
        num_images: Number of images by the data set's own count.
        image_ids: The images, in any order; in time they follow their ids.
        driver_id: Who drove (on disk: proband_id).
        sector: Section of the test route.
        is_dome: Whether the road leads over a crest (on disk: dome).
        driver_behaviour: On disk proband_behaviour.
    """

    id: Id
    directory: Name
    start_time_ms: Milliseconds = 0
    end_time_ms: Milliseconds = 0
    num_images: Id = 0
    image_ids: tuple[Id, ...]
    driver_id: int = 0
    sector: int = 0
    direction: Direction = Direction.DIR_MOENSHEIM
    street_style: StreetStyle = StreetStyle.STRAIGHT_STREET
    is_dome: bool | Literal[0, 1] = False
    driver_behaviour: DriverBehaviour = DriverBehaviour.CORRECT
    road_type: RoadType = RoadType.SINGLE_LANE_ROAD_MARKING
    view: View = View.WIDE_VIEW
    weather: Weather = Weather.DRY
    environment_lighting: EnvironmentLighting = EnvironmentLighting.DARK

    @classmethod
    def plain(cls, sequence_id: int, **fields: Any) -> Sequence:
        """A sequence with ordinary attributes (dry, dark, straight road, folder S00001 for 1), but for `fields`.

        Raises:
            ValueError: If a field has the wrong type or an unknown value.

        >>> Sequence.plain(121, weather=Weather.RAIN).directory
        'S00121'
        """
        ordinary = {name: field.default for name, field in cls.model_fields.items() if not field.is_required()}
        own = {"id": sequence_id, "directory": f"S{sequence_id:05d}", "image_ids": ()}
        return cls(**(ordinary | own | fields))


class CameraConfiguration(PVDNRecord):
    """A camera and its exposure; images refer to it by its index in the list."""

    camera: str
    cycle: Cycle


class Category(PVDNRecord):
    """A name for an image category."""

    id: int
    name: str
    supercategory: str | None = None


class EarlierImage(PVDNRecord):
    """An image without labels that was taken shortly before one with labels, in the same folder.

    Attributes:
        file_name: Name below the sequence's folder.
        age_ms: How much earlier it was taken, milliseconds.
    """

    file_name: Name
    age_ms: Annotated[float, Field(gt=0, le=10_000)]


class ImageRecord(PVDNRecord):
    """An image: an entry of `images` in `image_annotations.json`.

    Attributes:
        id: Number of the image, unique in its split; frames carry it as `Frame.frame`.
        file_name: Name below the sequence's folder.
        height_px: Rows (on disk: height).
        width_px: Columns (on disk: width).
        camera_configuration: Index in the list of camera configurations.
        date_captured: As in the file; its form is not documented.
        timestamp: Milliseconds in sets that state a rate, see `PVDN`; in PVDN's own files the unit is not documented.
        licence: Index in the list of licences.
        earlier: What the camera saw shortly before, for a classifier that wants to see it; None where unknown.
    """

    id: Id
    file_name: Name
    height_px: Annotated[int, Field(ge=1, le=2**20)]
    width_px: Annotated[int, Field(ge=1, le=2**20)]
    camera_configuration: Id = 0
    date_captured: str | int | float | None = None
    timestamp: str | int | float | None = None
    licence: int | None = None
    earlier: EarlierImage | None = None


class ImageAnnotation(PVDNRecord):
    """The category of an image: an entry of `annotations` in `image_annotations.json`."""

    id: Id
    category: ImageCategory
    image_id: Id


class Instance(PVDNRecord):
    """A light artifact of a vehicle (the paper also says blur): a lamp or the light that it throws.

    Attributes:
        position_px: Column and row in full-frame pixels (on disk: pos).
        iid: Identifies the instance over its sequence.
        is_direct: True for the lamp itself, False for its reflection or glare (on disk: direct).
        is_rear: True for a rear lamp or its light (on disk: rear).
    """

    position_px: tuple[Pixel, Pixel]
    iid: int
    is_direct: bool = False
    is_rear: bool = False


class Vehicle(PVDNRecord):
    """An oncoming vehicle in an image, and its light artifacts.

    Attributes:
        position_px: Column and row in full-frame pixels (on disk: pos).
        oid: Identifies the vehicle over its sequence.
        is_direct: True where the vehicle itself is in sight (on disk: direct).
        instances: Its light artifacts.
    """

    position_px: tuple[Pixel, Pixel]
    oid: int
    instances: tuple[Instance, ...]
    is_direct: bool = False


class BoxLabels(PVDNRecord):
    """The generated boxes of an image: `bounding_boxes/<id>.json`.

    Attributes:
        boxes_xyxy_px: x1, y1, x2, y2, half-open, full-frame pixels (on disk: bounding_boxes).
        labels: 1 where a keypoint lies in the box, else 0.
    """

    boxes_xyxy_px: tuple[tuple[Pixel, Pixel, Pixel, Pixel], ...]
    labels: tuple[float, ...]

    @model_validator(mode="after")
    def _check(self) -> BoxLabels:
        if len(self.boxes_xyxy_px) != len(self.labels):
            raise ValueError(f"labels: expected {len(self.boxes_xyxy_px)}, one for each box, got {len(self.labels)}")
        return self


class SequencesFile(PVDNRecord):
    """`labels/sequences.json`."""

    sequences: tuple[Sequence, ...]


class ImageAnnotationsFile(PVDNRecord):
    """`labels/image_annotations.json`, of which only `images` must be there."""

    info: dict[str, Any] = Field(default_factory=dict)
    licences: tuple[Any, ...] = ()
    camera_configurations: tuple[CameraConfiguration, ...] = (CameraConfiguration(camera="", cycle=Cycle.NIGHT),)
    categories: tuple[Category, ...] = ()
    images: tuple[ImageRecord, ...]
    annotations: tuple[ImageAnnotation, ...] = ()


class KeypointsFile(PVDNRecord):
    """`labels/keypoints/<id>.json`.

    Attributes:
        image_id: The image.
        annotations: The oncoming vehicles.
        doubtful: Light that counts neither as an instance nor as a false alarm; only simulated sets have any.
    """

    image_id: Id
    annotations: tuple[Vehicle, ...]
    doubtful: tuple[Instance, ...] = ()
