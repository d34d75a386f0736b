"""Ogg: damage, missing pages and a missing end are told; FFmpeg says nothing of any of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.datasets import Video
from foreglow.datasets.ogg import CAPTURE, checksum
from tests.datasets.test_video_damage import make_noise


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
