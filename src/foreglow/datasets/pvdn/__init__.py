"""PVDN's format, read and written: splits of sequences with keypoints, categories and boxes of each image.

`schema` says what the label files hold, `labels` checks them against each other, `splits` finds them; `reader` and
`writer` are the way in and out. Simulated data sets have this format, too, with their truth beside it
(`foreglow.datasets.simulated`).
"""

from foreglow.datasets.pvdn.download import download_pvdn
from foreglow.datasets.pvdn.reader import PVDN, PVDN_RATE_HZ, Selection
from foreglow.datasets.pvdn.splits import (
    SPLIT_NAMES,
    SplitName,
    is_pvdn,
    is_split,
    shipped_drive,
    split_folder,
    split_in,
)
from foreglow.datasets.pvdn.writer import LabelledImage, PVDNWriter, write_pvdn

__all__ = [
    "PVDN",
    "PVDN_RATE_HZ",
    "SPLIT_NAMES",
    "LabelledImage",
    "PVDNWriter",
    "Selection",
    "SplitName",
    "download_pvdn",
    "is_pvdn",
    "is_split",
    "shipped_drive",
    "split_folder",
    "split_in",
    "write_pvdn",
]
