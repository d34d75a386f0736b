"""The part of a frame that the proposal stage looks at; one meaning for all back ends."""

from __future__ import annotations

from foreglow.config import ProposalConfig


def region_inside(config: ProposalConfig, height_px: int, width_px: int) -> tuple[int, int, int, int]:
    """The configured region cut to a frame of this size, half-open x1, y1, x2, y2; the whole frame for None.

    Raises:
        ValueError: If the region lies outside the frame: looking at nothing, frame after frame, cannot be meant.

    >>> region_inside(ProposalConfig(region_xyxy_px=(100, 0, 2000, 500)), 480, 640)
    (100, 0, 640, 480)
    """
    if config.region_xyxy_px is None:
        return 0, 0, width_px, height_px
    x1, y1, x2, y2 = config.region_xyxy_px
    if x1 >= width_px or y1 >= height_px:
        raise ValueError(
            f"proposals.region_xyxy_px: expected a part of the frame, "
            f"{list(config.region_xyxy_px)} lies outside its {width_px}x{height_px} px"
        )
    return x1, y1, min(x2, width_px), min(y2, height_px)
