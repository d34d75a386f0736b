"""Ogg: damage, missing pages and a missing end are told; FFmpeg says nothing of any of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.containers.ogg import CAPTURE, checksum
from tests.datasets.video.test_damage import make_noise, make_stream


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return make_noise(tmp_path_factory.mktemp("ogg") / "night.ogg", "libvpx").read_bytes()


def pages_of(data: bytes) -> list[int]:
    return [index for index in range(len(data)) if data.startswith(CAPTURE, index)]


def test_a_whole_film(film: bytes, tmp_path: Path) -> None:
    path = tmp_path / "night.ogg"
    path.write_bytes(film)
    assert len(list(Video(path))) == 30


def damaged(film: bytes, kind: str) -> bytes:
    pages = pages_of(film)
    latest = len(pages) - 1
    if kind == "cut at a page":
        return film[: pages[latest]]
    if kind == "a page is missing":
        return film[: pages[latest - 1]] + film[pages[latest] :]
    if kind == "a wrong bit":
        place = pages[latest] - 20
        return film[:place] + bytes([film[place] ^ 1]) + film[place + 1 :]
    return film[: pages[latest]] + b"no page" + film[pages[latest] :]


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        ("cut at a page", "the end of the file"),
        ("a page is missing", "damage"),
        ("a wrong bit", "damage"),
        ("something between", "damage"),
    ],
)
def test_what_is_wrong_is_told(film: bytes, tmp_path: Path, kind: str, found: str) -> None:
    path = tmp_path / "night.ogg"
    path.write_bytes(damaged(film, kind))
    with pytest.raises(
        ValueError, match=rf"night\.ogg: byte \d+: expected a page of an Ogg file, found {found}; frames"
    ):
        Video(path)
    video = Video(path, on_error="skip")
    list(video)
    assert len(video.lost_parts) >= 1


@pytest.mark.parametrize("kind", ["a page is missing", "a wrong bit"])
def test_frames_behind_a_hole_are_marked(tmp_path: Path, kind: str) -> None:
    """FFmpeg goes on with the next page, whose pictures differ from others than those that are there."""
    path = tmp_path / "night.ogg"
    make_stream(path, num_frames=40, codec="libvpx")
    whole, film = [frame.image for frame in Video(path)], path.read_bytes()
    pages = pages_of(film)
    page, following = pages[20], pages[21]
    flipped = film[: page + 40] + bytes([film[page + 40] ^ 1]) + film[page + 41 :]
    path.write_bytes(flipped if kind == "a wrong bit" else film[:page] + film[following:])
    frames = list(Video(path, on_error="mark"))
    assert len(frames) < 40
    for frame in frames:
        if not frame.is_damaged:
            assert min(np.abs(frame.image.astype(int) - image).mean() for image in whole) == 0


def test_a_cut_within_a_page(film: bytes, tmp_path: Path) -> None:
    path = tmp_path / "night.ogg"
    path.write_bytes(film[:-100])
    with pytest.raises(ValueError, match="truncated video, 100 bytes are missing at the end"):
        Video(path)


def test_the_checksum_is_that_of_the_standard() -> None:
    """The polynomial 04c11db7, from 0, highest bit first, nothing inverted."""
    register = 0
    for byte in b"123456789":
        register ^= byte << 24
        for _ in range(8):
            register = (register << 1 ^ (0x04C11DB7 if register >> 31 else 0)) & 0xFFFFFFFF
    assert checksum(b"123456789") == register
