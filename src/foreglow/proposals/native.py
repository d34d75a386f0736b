"""The proposal stage on the C++ core."""

from __future__ import annotations

import foreglow._native as _native
from foreglow.config import ProposalConfig
from foreglow.types import Image, Proposals
from foreglow.types.arrays import check_image, check_kind, with_adjacent_columns


class NativeProposer:
    """The proposal stage in C++; returns exactly the boxes of `ReferenceProposer`.

    Scratch memory is kept between frames, so use one object per thread; the GIL is released during the computation.
    """

    def __init__(self, config: ProposalConfig) -> None:
        check_kind("config", config, ProposalConfig)
        self.config = config
        parameters = config.model_dump(exclude={"backend", "dispatch", "working_size_px"})
        self._generator = _native.ProposalGenerator(parameters, config.dispatch)

    @property
    def dispatch(self) -> str:
        """The instruction set in use: `baseline`, `avx2` or `avx512`."""
        return self._generator.dispatch

    @property
    def num_doubtful(self) -> int:
        """Number of pixels of the last frame that were too close to the threshold for single precision."""
        return self._generator.num_doubtful

    def propose(self, image: Image) -> Proposals:
        """The proposals of `image`: shape (height, width), uint8 or uint16, any strides.

        Raises:
            ValueError: If there is no such image, or the configured region lies outside it.
        """
        check_image("image", image)
        return Proposals(self._generator.propose(with_adjacent_columns(image)))
