"""Images in files: read as grey with 8 or 16 bits, complete or with a clear error, and written as PNG."""

from __future__ import annotations

import contextlib
import tokenize
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.image_bytes import (
    JPEG_SIGNATURE,
    PNG_END,
    PNG_SIGNATURE,
    at_full_scale,
    check_jpeg,
    odd_tiff,
    png_size_px,
    size_px,
    unread_kind,
    without_asides,
)
from foreglow.files import check_file, checked_path, read_bytes
from foreglow.types import Image
from foreglow.types.arrays import check_unmasked
from foreglow.types.frame import colourless
from foreglow.wording import check_one_of

Order: TypeAlias = Literal["rgb", "bgr"]
"""Order of the channels of a colour image."""

MIN_SIDE_PX = 64
"""Smallest height and width of a frame from a file, pixels: the smallest the detector is tested with."""

MAX_SIDE_PX = 8192
"""Largest height and width of a frame from a file, pixels: twice 4k, and a bound on what a header can allocate."""

MAX_IMAGE_BYTES = 8 * MAX_SIDE_PX**2
"""Largest file: the largest image in colour with 16 bits and alpha, 512 MiB."""

# A .npy header is a Python literal, and reading a broken header raises whatever its parser does.
NPY_ERRORS = (
    *(ValueError, TypeError, SyntaxError, EOFError, OverflowError, MemoryError, RecursionError),
    tokenize.TokenError,
)
"""What NumPy raises for a broken .npy file."""


def npy_words(error: BaseException) -> str:
    """What NumPy found wrong with a file of arrays; it takes any other file for objects, and advises to run their code.

    >>> npy_words(ValueError("This file contains pickled (object) data. If you trust the file ..."))
    'it holds something else, or other objects'
    """
    words = str(error).splitlines()[0] if str(error) else type(error).__name__
    return "it holds something else, or other objects" if "pickle" in words else words


IMAGE_SUFFIXES = frozenset(
    {
        *(".jpg", ".jpeg", ".jpe", ".jif", ".jfif", ".bmp", ".dib"),
        *(".png", ".tif", ".tiff", ".pgm", ".ppm", ".pnm", ".webp", ".npy"),
    }
)
"""Endings, in lower case, by which a file in a folder is taken for an image."""

Chroma: TypeAlias = Image
"""How red what is in an image is, at half its size; see `red_chroma`."""

ROUNDING = 2
"""Chroma of grey images is off by so much at most: FFmpeg rounds both halves of it down to make video of R, G and B."""

RED_CHROMA_OF_RGB = (0.41565, -0.58435, 0.1687)
"""Weights of R, G and B: Cr + Cb / 2 of ITU-R BT.601. White light of 2,500 to 10,000 K, from halogen to LED, changes it
by less than half of what it changes Cr; red light has four fifths of its Cr."""


def read_image(path: Path | str) -> Image:
    """The grey image in the file at `path`, shape (height, width), uint8 or uint16.

    The file's bit depth is kept; values of 10 or 12 bits in a 16-bit file stay as they are, but those of a PGM or PPM
    are scaled to 8 or 16 bits, as its header says what white is; what is brighter is white. Colour becomes grey as in
    `to_grey`, alpha is dropped (a TIFF with it is refused), an EXIF orientation is applied. `.npy` has an array as
    `to_grey` takes it, colour in the order R, G, B. JPEG has no checksum: wrong bits that are the code of another
    picture go unnoticed.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is empty, not an image, truncated, damaged, smaller than `MIN_SIDE_PX` or larger than
            `MAX_SIDE_PX` on a side, or holds floats outside [0, 1].
    """
    path = checked_path(path)
    array, order = _array_in(path)
    return to_grey(array, str(path), order=order)


def read_coloured_image(path: Path | str) -> tuple[Image, Chroma | None]:
    """The grey image in the file at `path` as in `read_image`, and its `red_chroma`; the same errors."""
    path = checked_path(path)
    array, order = _array_in(path)
    return to_grey(array, str(path), order=order), red_chroma(array, order=order)


def _array_in(path: Path) -> tuple[NDArray[Any], Order]:
    """The array in the file at `path`, not checked yet if it is a .npy file, and the order of its colours."""
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such image")
    if path.suffix.lower() == ".npy":
        return _npy_array(path), "rgb"
    data = read_bytes(path, MAX_IMAGE_BYTES)
    if not data:
        raise ValueError(f"{path}: expected an image, the file is empty")
    return _decoded(data, str(path)), "bgr"


def decode_image(data: bytes, origin: str) -> Image:
    """The grey image in `data`, a whole PNG or JPEG, as `read_image` has it.

    Raises:
        ValueError: If it is neither, truncated, damaged, or of a size that is not accepted.
    """
    if not data.startswith((PNG_SIGNATURE, JPEG_SIGNATURE)):
        raise ValueError(f"{origin}: expected a PNG or a JPEG, got {data[:4].hex() or 'no data'}")
    return to_grey(_decoded(data, origin), origin, order="bgr")


def png(image: Image) -> bytes:
    """`image` as a PNG file, without loss."""
    _, data = cv2.imencode(".png", image)
    return bytes(data)


def is_whole_png(path: Path) -> bool:
    """Whether there is a PNG with all its chunks, whose checksums are right; nothing is decoded."""
    if not path.is_file():
        return False
    try:
        data = read_bytes(path, MAX_IMAGE_BYTES)
        return data.startswith(PNG_SIGNATURE) and data.endswith(PNG_END) and bool(png_size_px(data))
    except ValueError:
        return False


def to_grey(array: NDArray[Any], origin: str = "", *, order: Order = "rgb") -> Image:
    """`array` as a grey image of shape (height, width), uint8 or uint16; uncopied if it already is such an image.

    Args:
        array: Shape (height, width) or (height, width, channels); 1 channel is grey, 2 are grey and alpha, 3 are
            colour, 4 are colour and alpha; alpha is dropped. uint8 and uint16 keep their depth; floats in [0, 1]
            become uint16 in [0, 65535].
        origin: Origin of the array, for messages.
        order: Order of the colour channels.

    Raises:
        ValueError: If the shape, the type or the order is another, the image has no pixel, or a float is NaN, infinite
            or outside [0, 1].

    Source: grey = 0.299 R + 0.587 G + 0.114 B, ITU-R BT.601, as OpenCV rounds it.

    >>> to_grey(np.array([[0.0, 1.0]])).tolist()
    [[0, 65535]]
    >>> to_grey(np.full((1, 2, 3), 7, np.uint8)).tolist()
    [[7, 7]]
    """
    check_one_of(order, Order, f"{origin}: order" if origin else "order")
    array = _checked_array(array, f"{origin}: " if origin else "")
    if array.ndim == 3:
        array = _without_colour(array, order)
    if array.dtype.kind == "f":
        return np.rint(array * np.float32(65535)).astype(np.uint16)
    image: Image = array
    return image


def _checked_array(array: object, prefix: str) -> NDArray[Any]:
    """`array` as uint8, uint16 or float32 in this machine's byte order, uncopied if it is already.

    Raises:
        ValueError: As `to_grey`.
    """
    if not isinstance(array, np.ndarray):
        remedy = "; foreglow.read_image(path) reads one" if isinstance(array, str | PathLike) else ""
        raise ValueError(f"{prefix}image: expected a NumPy array, got {type(array).__name__}{remedy}")
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (1, 2, 3, 4)):
        raise ValueError(f"{prefix}image: expected shape (height, width) or (height, width, 1..4), got {array.shape}")
    if array.size == 0:
        raise ValueError(f"{prefix}image: expected at least one pixel, got shape {array.shape}")
    check_unmasked(f"{prefix}image", array)
    if array.dtype.kind == "f":
        return _checked_floats(array, prefix)
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        raise ValueError(f"{prefix}image: expected uint8, uint16 or float in [0, 1], got {array.dtype}")
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def red_chroma(array: NDArray[Any], *, order: Order = "rgb") -> Chroma | None:
    """How red what is in a colour image is, shape (ceil(height / 2), ceil(width / 2)), 128 for white; None for grey.

    Rear lamps are red and headlamps are not, be they yellowish or bluish. An image in colours that are all grey is
    grey. Images of 16 bits and floats give 16 bits, and 32768 for white.

    Args:
        array: An image that `to_grey` takes.
        order: Order of its colour channels.

    Raises:
        ValueError: As `to_grey`.

    >>> red, white = np.zeros((2, 2, 3), np.uint8), np.full((2, 2, 3), 200, np.uint8)
    >>> red[..., 0] = 200
    >>> red_chroma(np.hstack([white, red])).tolist()
    [[128, 211]]
    """
    check_one_of(order, Order, "order")
    array = _checked_array(array, "")
    if array.ndim != 3 or array.shape[2] < 3:
        return None
    weights = RED_CHROMA_OF_RGB if order == "rgb" else RED_CHROMA_OF_RGB[::-1]
    dtype = array.dtype if array.dtype.kind == "u" else np.dtype(np.uint16)
    top = int(np.iinfo(dtype).max)
    size = (-(-array.shape[1] // 2), -(-array.shape[0] // 2))
    colours = np.ascontiguousarray(array[:, :, :3])
    half = cv2.resize(colours, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    red = cv2.transform(half, (1.0 if dtype == array.dtype else top) * np.array([weights]))
    return if_coloured(np.rint(np.clip(red + colourless(np.empty(0, dtype)), 0, top)).astype(dtype))


def if_coloured(chroma: Chroma) -> Chroma | None:
    """`chroma`; None if there is no colour in it, but for rounding."""
    low, high, _, _ = cv2.minMaxLoc(chroma)
    return chroma if low < colourless(chroma) - ROUNDING or high > colourless(chroma) + ROUNDING else None


def _without_colour(array: NDArray[Any], order: Order) -> NDArray[Any]:
    """`array` (height, width, 1..4) as a single channel of the same type."""
    if array.shape[2] <= 2:
        return array[:, :, 0]
    code = cv2.COLOR_BGR2GRAY if order == "bgr" else cv2.COLOR_RGB2GRAY
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(array[:, :, :3]), code))


def _checked_floats(array: NDArray[Any], prefix: str) -> NDArray[Any]:
    """`array` as float32, all in [0, 1]; its 24 bits of mantissa are enough for the 16 that are kept."""
    colour = array[:, :, :3] if array.ndim == 3 else array
    low, high = float(colour.min()), float(colour.max())
    if not (low >= 0.0 and high <= 1.0):
        what = "NaN" if np.isnan(low) or np.isnan(high) else f"values from {low:g} to {high:g}"
        raise ValueError(f"{prefix}image: expected floats in [0, 1], got {what}")
    return array.astype(np.float32)


def check_size(height: int, width: int, origin: str) -> None:
    """Checks that the readers accept a frame size.

    Raises:
        ValueError: If a side is shorter than `MIN_SIDE_PX` or longer than `MAX_SIDE_PX`.
    """
    if not (MIN_SIDE_PX <= height <= MAX_SIDE_PX and MIN_SIDE_PX <= width <= MAX_SIDE_PX):
        raise ValueError(
            f"{origin}: image size: expected {MIN_SIDE_PX} to {MAX_SIDE_PX} px a side, got {width}x{height} px"
        )


def _decoded(data: bytes, origin: str) -> NDArray[Any]:
    """The complete image in `data`, decoded by OpenCV: grey or B, G, R, any depth; its size is checked before."""
    none = f"{origin}: expected an image ({known_formats()}), is none, or truncated or damaged"
    try:
        size = size_px(data)
        if size is not None:
            check_size(*size, "header")
        if data.startswith(JPEG_SIGNATURE):
            check_jpeg(data)
        if data.startswith(PNG_SIGNATURE):
            data = without_asides(data)
        data, white = at_full_scale(data)
    except ValueError as error:
        raise ValueError(f"{origin}: {error}") from None
    if kind := unread_kind(data):
        raise ValueError(f"{origin}: expected an image ({known_formats()}), is {kind}; convert it first")
    if size is None:
        raise ValueError(none)
    try:
        with quiet_opencv():
            array = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        raise ValueError(f"{origin}: expected an image, cannot be decoded: {error.err or error.code}") from None
    if array is None:
        if odd := odd_tiff(data):
            none = f"{origin}: expected an image ({known_formats()}), is {odd}, cannot be decoded; convert it first"
        raise ValueError(none)
    check_size(array.shape[0], array.shape[1], origin)
    return np.asarray(array) if white is None else _to_full_scale(np.asarray(array), white)


def _to_full_scale(array: NDArray[Any], white: int) -> NDArray[Any]:
    """`array` of uint8 or uint16 with the greatest value of its type where it has `white` or more."""
    full_scale = np.iinfo(array.dtype).max
    if white == full_scale:
        return array
    scaled = np.minimum(array, white).astype(np.float64) * (full_scale / white)
    return np.asarray(np.rint(scaled).astype(array.dtype))


@contextlib.contextmanager
def quiet_opencv() -> Iterator[None]:
    """Keeps OpenCV from writing to standard error, as our own message says what is wrong."""
    logging = cv2.utils.logging
    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def known_formats() -> str:
    """The readable formats, for messages."""
    return "PNG, JPEG, TIFF, BMP, PGM/PPM, WebP or .npy"


def _npy_array(path: Path) -> NDArray[Any]:
    """The array in the file at `path`; mapped first, so that an exaggerated size in the header allocates nothing."""
    check_file(path, MAX_IMAGE_BYTES + 4096)  # and a header; the array is no longer than its file
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: expected an image, the file is empty")
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
    except NPY_ERRORS as error:
        raise ValueError(
            f"{path}: expected a complete .npy file with one array of numbers: {npy_words(error)}"
        ) from error
    if not isinstance(mapped, np.ndarray):
        raise ValueError(f"{path}: expected a .npy file with one array, is an archive of arrays")
    if mapped.ndim >= 2:
        check_size(mapped.shape[0], mapped.shape[1], str(path))
    num_behind = path.stat().st_size - getattr(mapped, "offset", 0) - mapped.nbytes
    if isinstance(mapped, np.memmap) and num_behind:
        raise ValueError(f"{path}: expected a .npy file with one array, there are {num_behind} bytes behind it")
    return np.array(mapped)
