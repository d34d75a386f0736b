from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.lab.simulation.camera.imager import ElectronImager, Encoder, Tone
from foreglow.lab.simulation.camera.profile import (
    CameraProfile,
    EncoderSpec,
    ExposureSpec,
    ImagerSpec,
    LensSpec,
    ToneSpec,
)
from foreglow.lab.simulation.camera.windscreen import Windscreen
from foreglow.lab.simulation.scenes.scene import SensorSpec
from tests.lab.simulation.cameras import camera

CAMERA = camera(160, 120)


def imager(**sections: Any) -> ElectronImager:
    profile = CameraProfile(name="own", lens=LensSpec(vignetting=0.0), **sections)
    return ElectronImager(profile, Windscreen(profile, SensorSpec(), CAMERA), seed=5)


def even(luminance_cd_m2: float) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.full((120, 160), luminance_cd_m2, np.float32)


def test_noise_is_that_of_electrons() -> None:
    exposure = ExposureSpec(seconds=0.01, gain=1.0)
    electrons = ImagerSpec(
        response_e=20000.0, full_well_e=1000.0, read_noise_e=5.0, fixed_pattern=0.0, column_pattern_e=0.0, bits=16
    )
    taken = imager(imager=electrons, exposure=exposure, tone=ToneSpec(gamma=1.0))
    image = taken.capture(even(2.0), frame=1).astype(np.float64)  # 400 of 1000 electrons
    assert image.mean() == pytest.approx(0.4 * 255, rel=0.01)
    expected = np.hypot(np.sqrt(400.0 + 25.0) * 255 / 1000, 12.0**-0.5)
    assert image.std() == pytest.approx(expected, rel=0.05)
    assert float(taken.noise_grey(even(2.0)).mean()) == pytest.approx(expected, rel=0.05)


def test_same_frame_same_bytes_other_frame_other_noise() -> None:
    first, again, other = (imager().capture(even(0.3), frame) for frame in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_metering_camera_holds_its_target_and_follows_with_its_lag() -> None:
    spec = ExposureSpec(metering="average", target=0.2, lag_s=1.0, min_gain=1e-3, max_gain=1e3)
    camera_ = imager(exposure=spec, tone=ToneSpec(gamma=1.0))

    def level(luminance: float, time_s: float) -> float:
        camera_.meter(even(luminance), time_s)
        return float(camera_.expected_grey(even(luminance)).mean()) / 255

    assert level(1.0, 0.0) == pytest.approx(0.2, rel=0.05)  # settled from the beginning
    assert level(2.0, 0.0) == pytest.approx(0.4, rel=0.05)  # no time to follow
    assert level(2.0, 1.0) == pytest.approx(0.4 * 0.5 ** (1 - np.exp(-1.0)), rel=0.05)
    assert level(2.0, 60.0) == pytest.approx(0.2, rel=0.05)


def test_compensation_is_in_powers_of_two() -> None:
    levels = []
    for compensation_ev in (0.0, -1.0):
        spec = ExposureSpec(metering="average", target=0.2, compensation_ev=compensation_ev)
        camera_ = imager(exposure=spec, tone=ToneSpec(gamma=1.0))
        camera_.meter(even(1.0), 0.0)
        levels.append(float(camera_.expected_grey(even(1.0)).mean()))
    assert levels[0] == pytest.approx(2 * levels[1], rel=0.05)


def test_clipped_red_is_darker_than_clipped_white_and_alike_below() -> None:
    camera_ = imager(tone=ToneSpec(gamma=1.0), exposure=ExposureSpec(gain=1.0))
    faint, strong = even(1.0), even(60.0)
    assert float(camera_.expected_grey(faint, faint).mean()) == pytest.approx(
        float(camera_.expected_grey(faint).mean()), rel=0.05
    )
    white, red = float(camera_.expected_grey(strong).mean()), float(camera_.expected_grey(strong, strong).mean())
    assert white == pytest.approx(255)
    assert red < 0.8 * white


@pytest.mark.parametrize("curve", ["gamma", "filmic", "hdr"])
def test_every_curve_grows_from_black_to_white(curve: Any) -> None:
    tone = Tone(ToneSpec(curve=curve, strength=50.0, black_level=7.0, white_level=250.0))
    grey = tone.grey(np.linspace(0.0, 1.0, 2000, dtype=np.float32)[np.newaxis])[0]
    assert (grey[0], grey[-1]) == pytest.approx((7.0, 250.0))
    assert (np.diff(grey) >= 0).all()


def test_temporal_denoising_steadies_what_stands_still_and_keeps_what_changes() -> None:
    rng = np.random.default_rng(3)
    steady = Tone(ToneSpec(denoise=0.8, noise_level=12.0))
    images = [steady.finished((100 + 2 * rng.standard_normal((60, 80))).astype(np.float32)) for _ in range(12)]
    assert images[-1].std() < 0.7 * images[0].std()
    jumped = steady.finished(np.full((60, 80), 200.0, np.float32))
    assert jumped.mean() == pytest.approx(200.0)


def test_images_far_apart_have_the_noise_that_denoising_leaves_and_nothing_of_the_last_one() -> None:
    def taken(step_s: float, denoise: float) -> ElectronImager:
        profile = CameraProfile(
            name="own",
            lens=LensSpec(vignetting=0.0),
            imager=ImagerSpec(fixed_pattern=0.0, column_pattern_e=0.0),
            exposure=ExposureSpec(gain=1.0),
            tone=ToneSpec(denoise=denoise, noise_level=40.0),
        )
        return ElectronImager(profile, Windscreen(profile, SensorSpec(), CAMERA), 5, step_s)

    plain, far_apart = (taken(0.8, denoise).capture(even(3.0), 1) for denoise in (0.0, 0.8))
    rounding = 1.0 / 12.0
    assert far_apart.std() == pytest.approx(np.sqrt((plain.var() - rounding) / 9.0 + rounding), rel=0.1)
    camera_ = taken(0.8, 0.8)
    camera_.capture(even(2.8), 1)
    assert np.array_equal(camera_.capture(even(3.0), 2), taken(0.8, 0.8).capture(even(3.0), 2))


def test_sharpening_overshoots_at_edges_only() -> None:
    step = np.full((40, 40), 80.0, np.float32)
    step[:, 20:] = 160.0
    sharp = Tone(ToneSpec(sharpen=1.0)).finished(step)
    assert sharp[20, 20] > 165
    assert sharp[20, 19] < 75
    assert (sharp[20, 2], sharp[20, 37]) == (80, 160)


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_a_stream_is_compressed_and_the_same_again(codec: Any) -> None:
    rng = np.random.default_rng(4)
    images = [rng.integers(0, 255, (72, 101), dtype=np.uint8) for _ in range(3)]
    runs = []
    for _ in range(2):
        stream = Encoder(EncoderSpec(codec=codec, kbps=400.0), 101, 72)
        runs.append([stream.through(image) for image in images])
    for image, first, again in zip(images, *runs, strict=True):
        assert first.shape == image.shape
        assert np.array_equal(first, again)
        assert not np.array_equal(first, image)


@pytest.mark.slow
def test_more_bits_lose_less() -> None:
    image = np.random.default_rng(4).integers(0, 255, (72, 96), dtype=np.uint8)
    errors = [
        np.abs(Encoder(EncoderSpec(kbps=kbps), 96, 72).through(image).astype(float) - image).mean()
        for kbps in (100.0, 20_000.0)
    ]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
def test_images_far_apart_have_more_bits_since_less_is_predicted() -> None:
    images = np.random.default_rng(4).integers(0, 255, (20, 72, 96), dtype=np.uint8)
    errors = []
    for step_s in (0.0, 0.8):
        stream = Encoder(EncoderSpec(kbps=1000.0), 96, 72, step_s)
        errors.append(np.mean([np.abs(stream.through(image).astype(float) - image).mean() for image in images]))
    assert errors[1] < 0.8 * errors[0], errors


def test_without_a_toe_black_ends_at_an_edge_and_with_one_it_fades() -> None:
    ramp = np.linspace(0.0, 1.0, 401, dtype=np.float32)[np.newaxis]
    hard, soft = (Tone(ToneSpec(gamma=1.0, crush=0.2, toe=toe)).grey(ramp)[0] for toe in (0.0, 0.1))
    assert np.allclose(hard, 255 * np.maximum(ramp[0] - 0.2, 0.0) / 0.8, atol=0.05)
    assert (np.diff(soft[4::4]) > 0).all()  # no light is lost
    assert (soft[0], soft[-1]) == pytest.approx((0.0, 255.0), abs=0.05)
    assert np.diff(hard, 2).max() > 5 * np.diff(soft, 2).max()
