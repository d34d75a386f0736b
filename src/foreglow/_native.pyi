"""The C++ core of Foreglow; use it through foreglow.proposals, foreglow.classifier and foreglow.distance."""

from collections.abc import Sequence

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

def light_of_boxes(
    image: NDArray[np.uint8] | NDArray[np.uint16], boxes_xyxy_px: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def pair_spacings(
    centres_rad: NDArray[np.float64], sizes_rad: NDArray[np.float64], contrasts: NDArray[np.float64]
) -> NDArray[np.float64]: ...

class HypothesisWeigher:
    def __init__(self, parameters: dict[str, object]) -> None: ...
    def cells_along(
        self, road: object | None, camera_m: Sequence[float], pitch_sigma_rad: float
    ) -> NDArray[np.float64]: ...
    def quantiles(
        self,
        cells: tuple[NDArray[np.float64], ...],
        boxes: tuple[NDArray[np.float64], ...],
        shares: Sequence[float],
    ) -> NDArray[np.float64]: ...

def available_dispatch() -> list[str]: ...
