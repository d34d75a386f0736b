"""Images in files and arrays: what is read, and what is refused."""

from __future__ import annotations

import re
import struct
import tempfile
import warnings
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from foreglow.datasets import read_image, red_chroma, to_grey
from foreglow.datasets.images import MAX_SIDE_PX, MIN_SIDE_PX
from tests.shared_data import shared_file

GREY = np.random.default_rng(1).integers(0, 256, (70, 90), dtype=np.uint8)
GREY_16 = np.random.default_rng(2).integers(0, 65536, (70, 90), dtype=np.uint16)
COLOUR = np.random.default_rng(3).integers(0, 256, (70, 90, 3), dtype=np.uint8)
SMOOTH = cv2.GaussianBlur(GREY, (0, 0), 5)


def encoded(suffix: str, image: NDArray[Any], *options: int) -> bytes:
    _, data = cv2.imencode(suffix, image, list(options))
    return bytes(data)


def written(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".pgm"])
def test_grey_formats_without_loss(tmp_path: Path, suffix: str) -> None:
    image = read_image(written(tmp_path, f"a{suffix}", encoded(suffix, GREY)))
    assert image.dtype == np.uint8
    assert np.array_equal(image, GREY)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_sixteen_bits_stay(tmp_path: Path, suffix: str) -> None:
    image = read_image(written(tmp_path, f"a{suffix}", encoded(suffix, GREY_16)))
    assert image.dtype == np.uint16
    assert np.array_equal(image, GREY_16)


@pytest.mark.parametrize("white", [1, 100, 255, 1023, 4095, 65535])
@pytest.mark.parametrize("kind", ["P2", "P3", "P5", "P6"])
def test_white_is_what_the_header_of_a_pnm_says(tmp_path: Path, kind: str, white: int) -> None:
    values = np.random.default_rng(4).integers(0, white + 1, (70, 90))
    values[0, :2] = 0, white
    samples = np.repeat(values, 3) if kind in ("P3", "P6") else values.ravel()
    plain = (" ".join(map(str, samples)) + "\n").encode()
    body = plain if kind in ("P2", "P3") else samples.astype("u1" if white < 256 else ">u2").tobytes()
    image = read_image(written(tmp_path, "a.pnm", f"{kind}\n# night\n90 70\n{white}\n".encode() + body))
    full_scale = 255 if white < 256 else 65535
    assert image.dtype == np.dtype(f"u{1 if white < 256 else 2}")
    assert np.array_equal(image, np.rint(values * (full_scale / white)))


@pytest.mark.parametrize("kind", ["P2", "P3"])
def test_the_last_number_of_a_plain_pnm_may_end_the_file(tmp_path: Path, kind: str) -> None:
    samples = " ".join(["7"] * 90 * 70 * (3 if kind == "P3" else 1))
    assert (read_image(written(tmp_path, "a.pnm", f"{kind}\n90 70\n255\n{samples}".encode())) == 7).all()
    with pytest.raises(ValueError, match="truncated or damaged"):
        read_image(written(tmp_path, "b.pnm", f"{kind}\n90 70\n255\n{samples[:-2]}".encode()))


def test_what_is_brighter_than_the_white_of_a_pnm_is_white(tmp_path: Path) -> None:
    samples = np.full((70, 90), 300, ">u2")
    samples[0, :2] = 1023, 65535
    image = read_image(written(tmp_path, "a.pgm", b"P5\n90 70\n1023\n" + samples.tobytes()))
    assert image[0, :3].tolist() == [65535, 65535, round(300 * 65535 / 1023)]


@pytest.mark.parametrize("white", [b"0", b"65536", b"x"])
def test_a_pnm_without_a_white_is_refused(tmp_path: Path, white: bytes) -> None:
    path = written(tmp_path, "a.pgm", b"P5\n90 70\n" + white + b"\n" + GREY.tobytes())
    with pytest.raises(ValueError, match=r"a\.pgm: damaged PGM or PPM, expected a maxval of 1 to 65535, got"):
        read_image(path)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".ppm"])
def test_colour_becomes_grey_with_the_weights_of_opencv(tmp_path: Path, suffix: str) -> None:
    image = read_image(written(tmp_path, f"a{suffix}", encoded(suffix, COLOUR)))
    assert np.array_equal(image, cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY))


def test_alpha_is_dropped(tmp_path: Path) -> None:
    with_alpha = np.dstack([COLOUR, GREY])
    image = read_image(written(tmp_path, "a.png", encoded(".png", with_alpha)))
    assert np.array_equal(image, cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY))


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_formats_with_loss(tmp_path: Path, suffix: str) -> None:
    image = read_image(written(tmp_path, f"a{suffix}", encoded(suffix, SMOOTH)))
    assert np.abs(image.astype(int) - SMOOTH).max() < 16


def test_arrays_from_numpy_files(tmp_path: Path) -> None:
    cases: list[tuple[NDArray[Any], NDArray[Any]]] = [
        (GREY, GREY),
        (GREY_16.astype(">u2"), GREY_16),
        (GREY_16 / 65535, GREY_16),
        ((GREY_16 / 65535).astype(np.float32), GREY_16),
        (np.asfortranarray(GREY), GREY),
        (COLOUR[:, :, ::-1], cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY)),
    ]
    for array, expected in cases:
        np.save(tmp_path / "a.npy", array)
        image = read_image(tmp_path / "a.npy")
        assert image.dtype == expected.dtype
        assert np.array_equal(image, expected)


def test_the_real_frame_is_read_without_change() -> None:
    path = shared_file("data/pvdn_frame_047433.png")
    expected = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert expected is not None
    assert np.array_equal(read_image(path), expected)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm", ".webp", ".npy"])
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, suffix: str) -> None:
    if suffix == ".npy":
        np.save(tmp_path / "whole.npy", GREY)
        data = (tmp_path / "whole.npy").read_bytes()
    else:
        data = encoded(suffix, GREY)
    for share in (0.02, 0.3, 0.5, 0.9, 0.99):
        path = written(tmp_path, f"cut{suffix}", data[: int(len(data) * share)])
        with pytest.raises(ValueError, match=r"truncated|expected a") as caught:
            read_image(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def test_every_cut_of_png_and_jpeg_is_refused(tmp_path: Path) -> None:
    for name, data in (("a.png", encoded(".png", SMOOTH)), ("a.jpg", encoded(".jpg", SMOOTH))):
        for length in range(1, len(data), 7):
            with pytest.raises(ValueError, match=name):
                read_image(written(tmp_path, name, data[:length]))


def test_a_flipped_bit_in_a_png_is_noticed(tmp_path: Path) -> None:
    data = bytearray(encoded(".png", GREY))
    data[len(data) // 2] ^= 4
    with pytest.raises(ValueError, match="damaged PNG, wrong checksum of chunk 'IDAT' at byte"):
        read_image(written(tmp_path, "a.png", bytes(data)))


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.png", b"", "expected an image, the file is empty"),
        ("a.npy", b"", "expected an image, the file is empty"),
        ("a.png", b"this is text\n" * 20, "expected an image .*, is none, or truncated or damaged"),
        ("a.jpg", b"\xff\xd8\xff", "truncated JPEG"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "truncated PNG"),
        ("a.npy", b"no array", "expected a complete .npy file"),
        ("a.png", encoded(".png", GREY[:63]), "header: image size: expected 64 to 8192 px a side, got 90x63 px"),
        ("a.jpg", encoded(".jpg", GREY[:, :10]), "header: image size: .*got 10x70 px"),
        ("a.bmp", encoded(".bmp", GREY[:, :10]), "image size: .*got 10x70 px"),
        ("a.png", encoded(".png", np.zeros((64, MAX_SIDE_PX + 1), np.uint8)), "got 8193x64 px"),
    ],
)
def test_what_is_no_image(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    path = written(tmp_path, name, data)
    with pytest.raises(ValueError, match=message) as caught:
        read_image(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("content", [b"no array", None])
def test_nobody_is_advised_to_run_the_code_in_a_file(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    if content is None:
        np.save(path, np.array([{}, 1], object))
    else:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.npy: expected a complete \.npy file with one array of numbers") as caught:
        read_image(path)
    assert "pickle" not in str(caught.value)


def test_a_header_that_claims_too_much_allocates_nothing(tmp_path: Path) -> None:
    data = bytearray(encoded(".png", GREY))
    data[16:24] = (2**31 - 1).to_bytes(4, "big") * 2
    with pytest.raises(ValueError, match="wrong checksum of chunk 'IHDR'"):
        read_image(written(tmp_path, "a.png", bytes(data)))
    header = np.lib.format.header_data_from_array_1_0(GREY) | {"shape": (2**40, 2**20)}
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(ValueError, match=r"expected a complete \.npy file"):
        read_image(tmp_path / "a.npy")


def test_bytes_behind_an_array_are_not_ignored(tmp_path: Path) -> None:
    for array in (GREY, np.asfortranarray(GREY)):
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(read_image(tmp_path / "a.npy"), GREY)
        with (tmp_path / "a.npy").open("ab") as file:
            file.write(b"12345")
        with pytest.raises(ValueError, match=r"a\.npy: expected .* one array, there are 5 bytes behind it"):
            read_image(tmp_path / "a.npy")


def test_a_header_without_a_kind_of_pixels_is_not_for_libpng(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = bytearray(encoded(".png", GREY))
    data[24] = 3  # bits
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    with pytest.raises(ValueError, match="expected a kind of pixels, got colour type 0, 3 bits"):
        read_image(written(tmp_path, "a.png", bytes(data)))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"P7\nWIDTH 80\n", "PAM"),
        (b"\0\0\0\x0cjP  \r\n\x87\n", "JPEG 2000"),
        (b"\xff\x4f\xff\x51", "JPEG 2000"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "JPEG XL"),
        (b"v/1\x01", "OpenEXR"),
        (b"\0\0\0\x18ftypavif", "HEIC or AVIF"),
    ],
)
def test_kinds_that_are_not_read_are_named(tmp_path: Path, start: bytes, kind: str) -> None:
    with pytest.raises(ValueError, match=rf"expected an image \(PNG, .*\), is {kind}; convert it first$"):
        read_image(written(tmp_path, "a.png", start + bytes(100)))


def with_orientation(path: Path, orientation: int) -> None:
    """Says in the Exif data of a JPEG how the camera was held."""
    data = path.read_bytes()
    exif = b"Exif\0\0MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x112, 3, 1, orientation, 0, 0)
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(exif)) + exif + data[2:])


def test_a_camera_that_was_held_upside_down(tmp_path: Path) -> None:
    path = written(tmp_path, "held.jpg", encoded(".jpg", SMOOTH))
    upright = read_image(path)
    with_orientation(path, 3)
    np.testing.assert_array_equal(read_image(path), upright[::-1, ::-1])
    with_orientation(path, 6)
    np.testing.assert_array_equal(read_image(path), np.rot90(upright, -1))


def test_several_images_in_a_file(tmp_path: Path) -> None:
    """Only the first of them would be read, and nobody would hear of the others."""
    pages = [SMOOTH, SMOOTH[::-1]]
    cv2.imwritemulti(str(tmp_path / "pages.tif"), pages)
    animation = cv2.Animation()
    animation.frames, animation.durations = [cv2.cvtColor(page, cv2.COLOR_GRAY2BGRA) for page in pages], [100, 100]
    for suffix in (".png", ".webp"):
        cv2.imwriteanimation(str(tmp_path / f"pages{suffix}"), animation)
    for suffix in (".tif", ".png", ".webp"):
        with pytest.raises(ValueError, match=rf"pages\{suffix}: expected one image, got several in one file"):
            read_image(tmp_path / f"pages{suffix}")


GIF_HEAD = b"GIF89a" + struct.pack("<HHBBB", 2, 1, 0x80, 0, 0) + bytes(3) + b"\xff\xff\xff"
GIF_IMAGE = b"\x21\xf9\x04\0\x0a\0\0\0" + b"," + struct.pack("<HHHHB", 0, 0, 2, 1, 0) + b"\x02\x02\x44\x0a\0"
GIF_OWN_COLOURS = b"," + struct.pack("<HHHHB", 0, 0, 2, 1, 0x80) + bytes(6) + b"\x02\x02\x44\x0a\0"


@pytest.mark.parametrize(
    ("images", "expected"),
    [
        (2 * GIF_IMAGE, "expected one image, got several in one file"),
        (GIF_OWN_COLOURS + GIF_IMAGE, "expected one image, got several in one file"),
        (GIF_IMAGE, r"expected an image \(PNG, .*\), is a GIF; convert it first$"),
        (GIF_IMAGE[:-4], "is a GIF; convert it first$"),
        (b"", "is a GIF; convert it first$"),
    ],
    ids=["animation", "own colours", "still", "cut", "empty"],
)
def test_a_gif_is_told(tmp_path: Path, images: bytes, expected: str) -> None:
    """An animation was called damaged."""
    for name in ("a.gif", "a.png"):
        (tmp_path / name).write_bytes(GIF_HEAD + images + b";")
        with pytest.raises(ValueError, match=rf"{name}: .*{expected}"):
            read_image(tmp_path / name)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such image"):
        read_image(tmp_path / "absent.png")
    with pytest.raises(ValueError, match="expected a file, is a folder"):
        read_image(tmp_path)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.full((64, 64), np.nan), r"expected floats in \[0, 1\], got NaN"),
        (np.full((64, 64, 3), np.inf), "got values from inf to inf"),
        (np.full((64, 64), 1.5), "got values from 1.5 to 1.5"),
        (np.full((64, 64), -0.1), "got values from -0.1 to -0.1"),
        (np.zeros((64, 64), np.int32), "expected uint8, uint16 or float .*got int32"),
        (np.zeros((64, 64), bool), "got bool"),
        (np.zeros((64, 64), complex), "got complex128"),
        (np.zeros((64, 64, 5), np.uint8), "expected shape"),
        (np.zeros(64, np.uint8), "expected shape"),
        (np.zeros((0, 64), np.uint8), "expected at least one pixel"),
        ([[1, 2]], "expected a NumPy array, got list"),
    ],
)
def test_arrays_that_are_no_image(array: Any, message: str) -> None:
    with pytest.raises(ValueError, match="here: image: ") as caught:
        to_grey(array, "here")
    with pytest.raises(ValueError, match=message):
        to_grey(array)
    assert str(caught.value).startswith("here: image: ")


def test_to_grey_keeps_a_grey_image_itself() -> None:
    assert to_grey(GREY) is GREY
    assert to_grey(GREY[::2, ::3]).strides == GREY[::2, ::3].strides
    assert np.array_equal(to_grey(GREY[:, :, None]), GREY)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_equal_channels_give_that_grey(dtype: type[Any]) -> None:
    grey = (np.arange(256).reshape(16, 16) / (255 if np.dtype(dtype).kind == "f" else 1)).astype(dtype)
    for channels in (1, 3):
        assert np.array_equal(to_grey(np.dstack([grey] * channels)), to_grey(grey))
    assert np.array_equal(to_grey(np.dstack([grey] * 3 + [grey * 0])), to_grey(grey))


def test_order_of_the_channels() -> None:
    assert np.array_equal(to_grey(COLOUR, order="bgr"), to_grey(COLOUR[:, :, ::-1], order="rgb"))
    assert to_grey(np.array([[[255, 0, 0]]], np.uint8)).tolist() == [[76]]  # 0.299 * 255 = 76.2


@settings(derandomize=True, max_examples=60)
@given(st.floats(0, 1), st.integers(0, 65535))
def test_floats_are_rounded_to_the_nearest_level(value: float, level: int) -> None:
    assert abs(int(to_grey(np.array([[value]]))[0, 0]) - value * 65535) <= 0.51
    assert to_grey(np.array([[level / 65535]]))[0, 0] == level


def _npy_bytes() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "a.npy", GREY)
        return (Path(folder) / "a.npy").read_bytes()


_SEEDS = [
    (".png", encoded(".png", SMOOTH)),
    (".png", encoded(".png", COLOUR)),
    (".jpg", encoded(".jpg", SMOOTH)),
    (".tif", encoded(".tif", SMOOTH)),
    (".bmp", encoded(".bmp", COLOUR)),
    (".pgm", encoded(".pgm", GREY)),
    (".webp", encoded(".webp", SMOOTH)),
    (".npy", _npy_bytes()),
]


def _read_or_refused(data: bytes, suffix: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder), f"fuzz{suffix}", data)
        message = str(path)
        try:
            image = read_image(path)
        except ValueError as error:
            message = str(error)
        else:
            assert image.dtype in (np.uint8, np.uint16)
            assert MIN_SIDE_PX <= min(image.shape) <= max(image.shape) <= MAX_SIDE_PX
        assert message.startswith(str(path))
        assert "\n" not in message


@pytest.mark.slow
@settings(derandomize=True, max_examples=250)
@given(st.sampled_from(_SEEDS), st.data())
def test_damaged_files_are_read_or_refused(seed: tuple[str, bytes], data: st.DataObject) -> None:
    suffix, whole = seed
    damaged = bytearray(whole)
    # Half of the damage goes to the header, where it hurts most.
    indices = st.integers(0, min(200, len(whole) - 1)) | st.integers(0, len(whole) - 1)
    for index in data.draw(st.lists(indices, min_size=1, max_size=6)):
        damaged[index] ^= data.draw(st.integers(1, 255))
    _read_or_refused(bytes(damaged[: data.draw(st.integers(len(whole) // 2, len(whole)))]), suffix)
    _read_or_refused(bytes(damaged), suffix)


@pytest.mark.slow
@settings(derandomize=True, max_examples=100)
@given(
    st.sampled_from([".png", ".jpg", ".npy"]),
    st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"II*\0", b"P5\n", b"\x93NUMPY\x01\0"]),
    st.binary(max_size=300),
)
def test_random_bytes_are_refused(suffix: str, start: bytes, rest: bytes) -> None:
    _read_or_refused(start + rest, suffix)


def test_nothing_warns() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        to_grey(np.full((2, 2, 3), 0.5))


@pytest.mark.parametrize(
    "array",
    [None, np.full((2, 2, 3), np.nan), *(np.zeros((2, 2, 3), dtype) for dtype in (np.int32, np.bool_, np.complex64))],
)
def test_what_is_no_image_has_no_colour(array: Any) -> None:
    with pytest.raises(ValueError, match=r"^image: ") as grey:
        to_grey(array)
    with pytest.raises(ValueError, match=re.escape(str(grey.value))):
        red_chroma(array)
