"""Where frames come from: images, videos, recordings, PVDN.

One Protocol, `FrameSource`, and `open_source` to choose by path.
"""

from foreglow.datasets.bags import Recording
from foreglow.datasets.cache import FrameCache
from foreglow.datasets.download import download_pvdn
from foreglow.datasets.image_folder import ImageFolder
from foreglow.datasets.images import read_image, to_grey
from foreglow.datasets.opening import open_source
from foreglow.datasets.parts import part_names, part_of
from foreglow.datasets.pvdn import PVDN, Selection
from foreglow.datasets.pvdn_schema import (
    BoxLabels,
    CategoryConfig,
    Cycle,
    EnvironmentLighting,
    ImageCategory,
    Instance,
    RoadType,
    Sequence,
    Vehicle,
    Weather,
)
from foreglow.datasets.pvdn_writer import LabelledImage, PVDNWriter, write_pvdn
from foreglow.datasets.shipped import shipped_drive
from foreglow.datasets.source import FrameSource, OnError
from foreglow.datasets.splits import SPLIT_NAMES, SplitName, split_folder, split_in
from foreglow.datasets.vehicle_data import Equipped, VehicleData
from foreglow.datasets.video import Video

__all__ = [
    "PVDN",
    "SPLIT_NAMES",
    "BoxLabels",
    "CategoryConfig",
    "Cycle",
    "EnvironmentLighting",
    "Equipped",
    "FrameCache",
    "FrameSource",
    "ImageCategory",
    "ImageFolder",
    "Instance",
    "LabelledImage",
    "OnError",
    "PVDNWriter",
    "Recording",
    "RoadType",
    "Selection",
    "Sequence",
    "SplitName",
    "Vehicle",
    "VehicleData",
    "Video",
    "Weather",
    "download_pvdn",
    "open_source",
    "part_names",
    "part_of",
    "read_image",
    "shipped_drive",
    "split_folder",
    "split_in",
    "to_grey",
    "write_pvdn",
]
