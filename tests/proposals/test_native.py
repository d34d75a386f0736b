"""What the native back end promises beside equality: threads, memory, strides, refusals."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from benchmarks.memory import resident_mib
from foreglow import _native
from foreglow.config import ProposalConfig
from foreglow.proposals import NativeProposer
from tests.proposals.frames import night_like_frame

CONFIG = ProposalConfig(reference_width_px=320)


def test_generators_in_several_threads_do_not_disturb_one_another() -> None:
    generator = np.random.default_rng(5)
    images = [night_like_frame(generator, 320, 240) for _ in range(16)]
    alone = [NativeProposer(CONFIG).propose(image).boxes_xyxy_px.tolist() for image in images]

    def all_of_them(_: int) -> list[list[list[int]]]:
        proposer = NativeProposer(CONFIG)
        return [proposer.propose(image).boxes_xyxy_px.tolist() for _ in range(10) for image in images]

    with ThreadPoolExecutor(4) as pool:
        for together in pool.map(all_of_them, range(8)):
            assert together == alone * 10


@pytest.mark.slow
def test_memory_does_not_grow() -> None:
    resident_before_mib = resident_mib()
    if resident_before_mib is None:
        pytest.skip("memory is looked up in /proc, of Linux")
    generator = np.random.default_rng(6)
    proposer = NativeProposer(CONFIG)
    frames = (night_like_frame(generator, width_px, 200) for width_px in (320, 200, 257) * 40)
    images = [image for image in frames if len(proposer.propose(image)) >= 3][:3]  # frames without boxes leak none
    num_boxes = 0

    def grown_mib(num_rounds: int) -> float:
        nonlocal num_boxes
        before_mib = resident_mib()
        for image in images * num_rounds:
            num_boxes += len(proposer.propose(image))
        after_mib = resident_mib()
        assert before_mib is not None
        assert after_mib is not None
        return after_mib - before_mib

    grown_mib(300)  # scratch memory finds its size
    assert grown_mib(16_000) < 1.0, "MiB over 48,000 frames: 22 bytes a frame, less than two boxes"
    assert num_boxes >= 3 * 3 * (300 + 16_000)


def test_result_outlives_generator_and_next_frame() -> None:
    generator = np.random.default_rng(7)
    image = night_like_frame(generator, 320, 240)
    proposer = NativeProposer(CONFIG)
    boxes = proposer.propose(image).boxes_xyxy_px
    kept = boxes.tolist()
    proposer.propose(np.zeros((64, 64), np.uint8))
    del proposer
    assert boxes.tolist() == kept


def test_dispatch_is_reported_and_refused_by_name() -> None:
    assert NativeProposer(ProposalConfig(dispatch="baseline")).dispatch == "baseline"
    assert NativeProposer(ProposalConfig()).dispatch == _native.available_dispatch()[-1]
    with pytest.raises(ValueError, match="dispatch: expected auto, baseline, avx2 or avx512, got sse9"):
        _native.ProposalGenerator(ProposalConfig().model_dump(), "sse9")


def test_core_refuses_what_the_configuration_would_not_let_through() -> None:
    for field, value in [("gap_px", 0), ("window_px", 1), ("eps", 0.0), ("reduction", 17), ("blur_width_px", 4)]:
        with pytest.raises(ValueError, match=field):
            _native.ProposalGenerator(ProposalConfig().model_dump() | {field: value}, "auto")


def test_core_refuses_other_pixels() -> None:
    proposer = _native.ProposalGenerator(ProposalConfig().model_dump(), "auto")
    with pytest.raises(TypeError, match="uint8 or uint16"):
        proposer.propose(np.zeros((64, 64), np.float32))  # type: ignore[arg-type]
