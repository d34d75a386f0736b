"""Stage 1: where in the frame something stands out against its surroundings.

Two back ends with one meaning: `reference` is the readable specification, `native` the C++ core. They return the same
boxes, in the same order, for every image.
"""

from __future__ import annotations

from typing import Protocol

from foreglow.config import ProposalConfig
from foreglow.proposals.native import NativeProposer
from foreglow.proposals.reference import ReferenceProposer
from foreglow.proposals.resizing import ResizingProposer
from foreglow.proposals.standing import StandingLight
from foreglow.types import Image, Proposals
from foreglow.types.arrays import check_kind

__all__ = [
    "BACKENDS",
    "NativeProposer",
    "Proposer",
    "ReferenceProposer",
    "ResizingProposer",
    "StandingLight",
    "make_proposer",
]


class Proposer(Protocol):
    """Finds boxes that may hold a light artifact."""

    def propose(self, image: Image) -> Proposals:
        """The proposals of `image` (height, width), uint8 or uint16, any strides; sorted by y1, x1, y2, x2.

        Raises:
            ValueError: If the configured region lies outside the image.
        """
        ...


BACKENDS: dict[str, type[NativeProposer] | type[ReferenceProposer]] = {
    "native": NativeProposer,
    "reference": ReferenceProposer,
}


def make_proposer(config: ProposalConfig) -> Proposer:
    """The back end that `config.backend` names, ready to use; on resized frames where `config` asks for a size.

    Raises:
        ValueError: If the configuration is none.
    """
    check_kind("config", config, ProposalConfig)
    back_end = BACKENDS[config.backend]
    return back_end(config) if config.working_size_px is None else ResizingProposer(config, back_end)
