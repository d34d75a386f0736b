"""The native back end returns the reference's boxes exactly, at every dispatch level, whatever the frame."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow import _native
from foreglow.config import ProposalConfig, preset
from foreglow.proposals import NativeProposer, ReferenceProposer
from foreglow.types import Image
from tests.proposals.frames import WIDTHS_PX, any_config, night_like_frame

pytestmark = pytest.mark.slow

LEVELS = _native.available_dispatch()


def equal_boxes(image: Image, config: ProposalConfig, where: str) -> list[list[int]]:
    """The reference's boxes, once every dispatch level has been found to have the same."""
    wanted: list[list[int]] = ReferenceProposer(config).propose(image).boxes_xyxy_px.tolist()
    for level in LEVELS:
        proposer = NativeProposer(config.model_copy(update={"dispatch": level}))
        found = proposer.propose(image).boxes_xyxy_px.tolist()
        assert found == wanted, f"{where}: {level}, {image.shape} {image.dtype}, {config}"
    return wanted


@pytest.mark.parametrize("batch", range(8))
def test_small_frames_with_any_configuration(batch: int) -> None:
    generator = np.random.default_rng(batch)
    num_boxes = 0
    for number in range(75):
        width_px = int(generator.choice(WIDTHS_PX))
        height_px = int(generator.integers(1, 160))
        image = night_like_frame(generator, width_px, height_px, is_wide=bool(generator.random() < 0.3))
        config = any_config(generator, width_px, height_px)
        num_boxes += len(equal_boxes(image, config, f"batch {batch}, frame {number}"))
    assert num_boxes > 75, "frames without boxes compare nothing"


def test_camera_frames_with_the_presets() -> None:
    generator = np.random.default_rng(16)
    num_boxes = dict.fromkeys(("paper", "baseline"), 0)
    for width_px, height_px in [(1280, 960)] * 3 + [(1281, 961), (640, 360), (1920, 1080), (2872, 1622), (333, 777)]:
        image = night_like_frame(generator, width_px, height_px)
        for name in num_boxes:
            num_boxes[name] += len(equal_boxes(image, preset(name).proposals, name))
    assert min(num_boxes.values()) > 10


def test_wide_camera_frames() -> None:
    generator = np.random.default_rng(12)
    for width_px, height_px in [(1280, 960), (1279, 480), (2600, 500)]:
        equal_boxes(night_like_frame(generator, width_px, height_px, is_wide=True), ProposalConfig(), "16 bit")


@pytest.mark.parametrize("sigma_px", [0.1, 0.3, 0.36, 0.42, 0.5, 0.6])
def test_narrow_blurs(sigma_px: float) -> None:
    """Taps that are far below any whole number; double precision had to decide every pixel, which took seconds."""
    generator = np.random.default_rng(5)
    config = preset("paper").proposals.model_copy(update={"blur_sigma_px": sigma_px})
    equal_boxes(night_like_frame(generator, 640, 360), config, "night")
    bright = generator.integers(60, 200, (360, 640)).astype(np.uint8)
    equal_boxes(bright, config, "noise")
    for level in LEVELS:
        proposer = NativeProposer(config.model_copy(update={"dispatch": level}))
        proposer.propose(bright)
        assert proposer.num_doubtful < 0.01 * bright.size


@pytest.mark.parametrize("window", ["published", "centred"])
def test_pixels_at_the_threshold_are_decided_in_double_precision(window: str) -> None:
    """Puts kappa just below and above the value at which a pixel at a blob's edge is set: far closer than single
    precision can tell, and the blob's box depends on it."""
    generator = np.random.default_rng(3)
    num_edges = num_doubtful = 0
    for number in range(12):
        image = night_like_frame(generator, 320, 200, is_wide=number % 3 == 0)
        fields = {"min_deviation": 0.0, "min_area_px": 0.0, "min_width_px": 0.0, "reference_width_px": 320}
        config = ProposalConfig.model_validate({**fields, "window": window, "max_area_px": np.inf})
        stages = ReferenceProposer(config).stages(image)
        assert stages is not None
        difference = stages.blurred - stages.mean
        with np.errstate(divide="ignore", invalid="ignore"):
            critical = (stages.blurred / stages.mean - 1) / (1 - difference / (1 - difference + config.eps))
        candidates = critical[(critical > 0.2) & (critical < 1.0) & (stages.mean > 0.01)]
        for kappa in generator.permutation(candidates)[:10]:
            sides = [config.model_copy(update={"kappa": float(kappa * factor)}) for factor in (1 - 1e-8, 1 + 1e-8)]
            below, above = (equal_boxes(image, side, f"frame {number}, kappa {side.kappa!r}") for side in sides)
            num_edges += below != above
            proposer = NativeProposer(sides[0])
            proposer.propose(image)
            num_doubtful += proposer.num_doubtful
    assert num_edges > 10, "the chosen pixels decide no box, so nothing was tested"
    assert num_doubtful >= num_edges
