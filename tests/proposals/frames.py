"""Generated frames and configurations that between them reach every branch of the proposal stage."""

from __future__ import annotations

import numpy as np

from foreglow.config import ProposalConfig
from foreglow.types import Image

WIDTHS_PX = (1, 2, 3, 5, 17, 63, 64, 65, 127, 128, 129, 200, 255, 256, 257, 320)


def night_like_frame(generator: np.random.Generator, width_px: int, height_px: int, is_wide: bool = False) -> Image:
    """A frame of one of the kinds below; uint16 where `is_wide`, else uint8."""
    white = 65535 if is_wide else 255
    rows, columns = np.mgrid[:height_px, :width_px]
    kind = generator.integers(7)
    level = np.zeros((height_px, width_px))
    if kind in (0, 1, 2):  # a lit road under a dark sky, lamps, noise; the ordinary case
        level += 0.12 * np.clip(rows / height_px - 0.45, 0, None) + generator.uniform(0, 0.06)
        for _ in range(generator.integers(1, 9)):
            x, y = generator.uniform(0, width_px), generator.uniform(0, height_px)
            spread = generator.uniform(0.5, 12.0, 2)
            glow = np.exp(-(((columns - x) / spread[0]) ** 2) - ((rows - y) / spread[1]) ** 2)
            level += generator.uniform(0.05, 1.3) * glow
        level += generator.normal(0, generator.choice([0.0, 0.003, 0.02]), level.shape)
    elif kind == 3:  # noise alone
        level += generator.normal(0.5, 0.2, level.shape)
    elif kind == 4:  # black with single faint pixels: means near zero
        level += (generator.random(level.shape) < 0.01) * generator.uniform(1.0 / white, 0.1)
    elif kind == 5:  # flat, or saturated in part
        level += generator.choice([0.0, 0.4, 1.0])
        if generator.random() < 0.6:
            level[: height_px // 2, width_px // 3 :] = 1.5
    else:  # a checkerboard of hard edges
        level += ((rows // generator.integers(1, 9) + columns // generator.integers(1, 14)) % 2) * generator.uniform(
            0, 1
        )
    level *= generator.choice([1.0, 1.0, 0.25, 0.04])
    level = np.clip(level * white, 0, white)
    return level.astype(np.uint16) if is_wide else level.astype(np.uint8)


def any_config(generator: np.random.Generator, width_px: int, height_px: int) -> ProposalConfig:
    """A configuration near one of the presets, or anywhere in the allowed space."""
    if generator.random() < 0.3:
        return ProposalConfig(reference_width_px=max(64, width_px))
    region = None
    if generator.random() < 0.3:
        x1, y1 = (int(generator.integers(min(40, side_px))) for side_px in (width_px, height_px))
        region = (x1, y1, x1 + int(generator.integers(1, 200)), y1 + int(generator.integers(1, 200)))
    fields: dict[str, object] = {
        "kappa": float(generator.choice([0.0, 0.25, 0.4, 0.55, 1.5])),
        "window_px": int(generator.integers(2, 60)),
        "eps": float(generator.choice([1e-3, 0.3])),
        "min_deviation": float(generator.choice([0.0, 0.005, 0.01, 0.05])),
        "gap_px": int(generator.integers(1, 14)),
        "min_area_px": float(generator.choice([0, 11])),
        "max_area_px": float(generator.choice([1999, np.inf])),
        "min_width_px": float(generator.choice([0, 6])),
        "split_saddle": float(generator.choice([0.0, 0.3, 0.7, 1.0])),
        "reduction": int(generator.choice([1, 2, 2, 3, 12])),
        "reference_width_px": int(max(64, width_px * generator.choice([0.5, 1.0, 1.0, 1.7]))),
        "normalise": bool(generator.random() < 0.8),
        "blur_width_px": int(generator.choice([1, 3, 5, 5])),
        "blur_height_px": int(generator.choice([1, 3, 3])),
        "blur_sigma_px": float(generator.choice([0.4, 2.0, 2.0, 30.0])),
        "window": str(generator.choice(["published", "published", "centred"])),
        "region_xyxy_px": region,
    }
    return ProposalConfig.model_validate(fields)
