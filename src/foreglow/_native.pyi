"""The C++ core of Foreglow; use it through foreglow.proposals and foreglow.classifier."""

import numpy as np
from numpy.typing import NDArray

def extract_crops(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    boxes_xyxy_px: NDArray[np.int32],
    support: int,
    size_px: int,
    earlier: NDArray[np.uint8] | NDArray[np.uint16] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...

class ProposalGenerator:
    def __init__(self, parameters: dict[str, object], dispatch: str) -> None: ...
    def propose(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.int32]: ...
    @property
    def dispatch(self) -> str: ...
    @property
    def num_doubtful(self) -> int: ...

def available_dispatch() -> list[str]: ...
