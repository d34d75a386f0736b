"""Where frames come from: images, videos, recordings of ROS and our own, PVDN, and simulated drives.

Every source is a `FrameSource`, and `open_source` chooses it by path (`formats`). `video` reads videos, and finds what
is damaged in them; `bags` reads recordings, ROS bags and MCAP files, which `foreglow.runtime.mcap` records; `pvdn` and
`simulated` read and write data sets with labels, which `foreglow.lab.simulation.writing` fills; `vehicle_logs` reads
what a car knew beside its images.
"""

from foreglow.datasets.bags import Recording
from foreglow.datasets.formats import open_labelled, open_source
from foreglow.datasets.image_folder import ImageFolder
from foreglow.datasets.images import read_image, red_chroma, to_grey
from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.pvdn import (
    PVDN,
    SPLIT_NAMES,
    LabelledImage,
    PVDNWriter,
    Selection,
    SplitName,
    download_pvdn,
    shipped_drive,
    split_folder,
    split_in,
    write_pvdn,
)
from foreglow.datasets.pvdn.schema import (
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
from foreglow.datasets.source import FrameSource, OnError
from foreglow.datasets.vehicle_data import (
    Equipped,
    VehicleData,
    lost_parts,
    origin_of,
    part_names,
    part_of,
    topic_of,
    unread_end,
)
from foreglow.datasets.video import Video

__all__ = [
    "PVDN",
    "SPLIT_NAMES",
    "BoxLabels",
    "CategoryConfig",
    "Cycle",
    "EnvironmentLighting",
    "Equipped",
    "FrameSource",
    "ImageCategory",
    "ImageFolder",
    "Instance",
    "LabelledImage",
    "LabelledSource",
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
    "lost_parts",
    "open_labelled",
    "open_source",
    "origin_of",
    "part_names",
    "part_of",
    "read_image",
    "red_chroma",
    "shipped_drive",
    "split_folder",
    "split_in",
    "to_grey",
    "topic_of",
    "unread_end",
    "write_pvdn",
]
