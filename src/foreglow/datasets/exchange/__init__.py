"""Labels of annotation tools: CVAT, COCO and Label Studio, as data sets, and to and from PVDN's format."""

from foreglow.datasets.exchange.files import LABEL_FORMATS, is_labels, read_labels_file
from foreglow.datasets.exchange.marks import Kind, LabelSet, Mark, lost_lines
from foreglow.datasets.exchange.source import LabelFile
from foreglow.datasets.exchange.transfer import (
    Guess,
    check_target,
    guesses_of,
    labels_of,
    write_labels_file,
    write_split,
)

__all__ = [
    "LABEL_FORMATS",
    "Guess",
    "Kind",
    "LabelFile",
    "LabelSet",
    "Mark",
    "check_target",
    "guesses_of",
    "is_labels",
    "labels_of",
    "lost_lines",
    "read_labels_file",
    "write_labels_file",
    "write_split",
]
