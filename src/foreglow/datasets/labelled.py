"""What every data set with labels offers to evaluation and training, whatever its format."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.source import FileSource
from foreglow.numbers import checked_whole
from foreglow.types import Frame
from foreglow.wording import shortened

if TYPE_CHECKING:
    from foreglow.datasets.pvdn.schema import BoxLabels, ImageCategory, ImageRecord, Instance, Sequence, Vehicle


PAUSE_S, PAUSE_STEPS = 1.0, 10
"""Longer steps between two images are a pause; of a tracker's memory, nothing outlasts a second."""


class LabelledSource(FileSource, ABC):
    """A `FrameSource` with labels, in the types of `foreglow.datasets.pvdn.schema`: other formats convert theirs.

    A frame's number is the id of its image, `Frame.sequence` the folder of its sequence. Methods raise ValueError for
    an unknown image.

    Attributes:
        root: Its folder.
        rate_hz: Frames a second within a sequence.
        frame_ids: Ids of the selected images, in order.
        white_level: White of the camera, by which its frames come at full scale; None for images as they are.
    """

    root: Path
    rate_hz: float
    frame_ids: tuple[int, ...]
    white_level: int | None = None

    @property
    @abstractmethod
    def name(self) -> str:
        """Short name for messages and results."""

    @property
    @abstractmethod
    def sequences(self) -> tuple[Sequence, ...]:
        """The sequences with at least one selected image."""

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """The selected frames."""

    @abstractmethod
    def read(self, image_id: int) -> Frame:
        """The frame of image `image_id`, whether it is selected or not.

        Raises:
            FileNotFoundError: If the image file is missing.
            ValueError: If there is no such id, or the image is broken or not of the size in the labels.
        """

    @abstractmethod
    def annotations(self, image_id: int) -> tuple[Vehicle, ...]:
        """The oncoming vehicles in image `image_id`; empty where there is none.

        Raises:
            FileNotFoundError: If a label file is missing.
            ValueError: If there is no such id, or the file is broken.
        """

    @abstractmethod
    def image(self, image_id: int) -> ImageRecord:
        """The labels' record of image `image_id`."""

    @abstractmethod
    def image_path(self, image_id: int) -> Path:
        """The file of image `image_id`."""

    @abstractmethod
    def sequence(self, image_id: int) -> Sequence:
        """The sequence of image `image_id`."""

    @abstractmethod
    def categories(self, image_id: int) -> tuple[ImageCategory, ...]:
        """The categories of image `image_id`; (NONE,) where it has none."""

    @abstractmethod
    def time_s(self, image_id: int) -> float:
        """Seconds from the first image of its sequence to image `image_id`."""

    def doubtful(self, image_id: int) -> tuple[Instance, ...]:  # noqa: ARG002
        """Light in image `image_id` that counts neither as an instance nor as a false alarm.

        Raises:
            FileNotFoundError: If a label file is missing.
            ValueError: If there is no such id, or the file is broken.
        """
        return ()

    def boxes(self, image_id: int) -> BoxLabels | None:  # noqa: ARG002
        """The generated boxes of image `image_id`; None where there are none for it.

        Raises:
            ValueError: If there is no such id, or the file is broken.
        """
        return None

    @property
    def notes(self) -> list[str]:
        """What is to be said of the labels, one line each, such as what a tool's file has and is not taken."""
        return []

    @property
    def num_frames(self) -> int:
        """Number of selected images."""
        return len(self.frame_ids)

    def __len__(self) -> int:
        return len(self.frame_ids)

    @property
    def directories(self) -> tuple[str, ...]:
        """Folders of the sequences with at least one selected image, in the order of the frames."""
        return tuple(dict.fromkeys(self.sequence(image_id).directory for image_id in self.frame_ids))

    @property
    def mean_rate_hz(self) -> float:
        """Frames a second by the times of the selected images: below `rate_hz` where only some are there, and above it
        where the set says less than its times tell.

        Pauses do not count, in which nobody looked: steps of more than `PAUSE_S`, and of `PAUSE_STEPS` usual ones.
        """
        times_s: dict[int, list[float]] = {}
        for image_id in self.frame_ids:
            times_s.setdefault(self.sequence(image_id).id, []).append(self.time_s(image_id))
        steps_s = np.concatenate([np.zeros(0), *(np.diff(np.sort(each)) for each in times_s.values())])
        if not steps_s.any():
            return self.rate_hz
        looked_s = steps_s[steps_s <= max(PAUSE_S, PAUSE_STEPS * float(np.median(steps_s)))]
        found = len(looked_s) / float(looked_s.sum())
        return self.rate_hz if 0.999 < found / self.rate_hz < 1.02 else found  # times may be whole milliseconds

    def only(self, directory: str) -> Self:
        """The selected images of one sequence, by its folder; the labels are shared.

        Raises:
            ValueError: If there is no such sequence.
        """
        if not isinstance(directory, str) or directory not in {each.directory for each in self.sequences}:
            raise ValueError(f"{self.name}: directory: expected that of a sequence, got {shortened(directory)}")
        return self.with_images({id_ for id_ in self.frame_ids if self.sequence(id_).directory == directory})

    def with_images(self, image_ids: Collection[int]) -> Self:
        """The selected images that are among these; the labels are shared."""
        part = copy.copy(self)
        part.frame_ids = tuple(id_ for id_ in self.frame_ids if id_ in image_ids)
        part.skipped = []
        return part

    def seen_by(self, white_level: int | None) -> Self:
        """The same images as a pipeline with this `guard.white_level` sees them: for what looks at them without one.

        Raises:
            ValueError: If it is no number that `guard.white_level` may be.
        """
        if white_level is not None:
            white_level = checked_whole("white_level", white_level, 1, 65535)
        seen = copy.copy(self)
        seen.white_level = white_level
        seen.skipped = []
        return seen

    def keypoints_px(self, image_id: int) -> NDArray[np.int32]:
        """Positions of all instances in image `image_id`, shape (K, 2), int32, columns x and y, full-frame pixels.

        Raises:
            FileNotFoundError: If a label file is missing.
            ValueError: If there is no such id, or the file is broken.
        """
        vehicles = self.annotations(image_id)
        positions = [instance.position_px for vehicle in vehicles for instance in vehicle.instances]
        return np.array(positions, np.int32).reshape(-1, 2)

    def first_with(self, sequence: Sequence, category: ImageCategory) -> int | None:
        """Id of the first image of `sequence` in `category`, or None; `CategoryConfig` names categories by meaning."""
        ids = sorted(sequence.image_ids)
        return next((image_id for image_id in ids if category in self.categories(image_id)), None)
