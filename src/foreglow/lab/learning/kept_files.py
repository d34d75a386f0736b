"""What is kept on disk to be used again: whether it is whole, and still of the images it was made of."""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from foreglow.checksums import checksum
from foreglow.files import MIB, check_file
from foreglow.plugins import first_line_of

END_BYTES = 64 << 10
"""Of the end of a PNG, which is where the checksum of all its pixels is."""


class UnreadableError(ValueError):
    """A file that torch cannot read as plain values; its cause is what torch raised."""


_PNG = b"\x89PNG\r\n\x1a\n"
_ZIP = b"PK\x03\x04"


def image_state(path: Path) -> bytes:
    """16 bytes that tell an image from any other that was in its place: of its time of change, size and contents.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is no regular file.
    """
    check_file(path)
    changed_ns = path.stat().st_mtime_ns
    return hashlib.blake2b(b"%d " % changed_ns + image_contents(path), digest_size=16).digest()


def image_contents(path: Path) -> bytes:
    """16 bytes of an image's size and contents: of a PNG, the last `END_BYTES` are read, of any other image all.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is no regular file.
    """
    check_file(path)
    digest = hashlib.blake2b(digest_size=16)
    with path.open("rb") as file:
        state = os.fstat(file.fileno())
        start = file.read(len(_PNG))
        digest.update(b"%d " % state.st_size + start)
        if start == _PNG:
            file.seek(max(file.tell(), state.st_size - END_BYTES))
        while piece := file.read(MIB):
            digest.update(piece)
    return digest.digest()


def state_of(paths: Iterable[Path], state: Callable[[Path], bytes] = image_state) -> str:
    """What tells these files, in this order, from any others in their places: their `state` and which are there.

    A time of change alone does not: what was restored from a backup is older than what was made of its successor.

    Raises:
        OSError: If one cannot be read.
        ValueError: If one is no regular file.
    """
    digest = hashlib.blake2b(digest_size=16)
    for path in paths:
        digest.update(state(path) if path.exists() else b"-")
    return digest.hexdigest()


def file_checksum(path: Path) -> int:
    """CRC-32 of a regular file.

    Raises:
        OSError: If there is no such file, or it cannot be read.
        ValueError: If it is no regular file.
    """
    check_file(path)
    return checksum(path)


def checksum_of(value: Any) -> int:
    """CRC-32 of a value of JSON."""
    return zlib.crc32(json.dumps(value).encode())


def check_torch_file(path: Path) -> None:
    """Checks what `torch.save` wrote at `path` against its own checksums, at which torch does not look.

    They are those of a zip file, as torch has written since version 1.6. Another file passes: it has none.

    Raises:
        ValueError: If a part of it is not what was written, or it is no regular file.
        OSError: If there is no such file, or it cannot be read.
    """
    check_file(path)
    with path.open("rb") as file:
        if file.read(len(_ZIP)) != _ZIP:  # as torch tells the two apart
            return
        try:
            with zipfile.ZipFile(file) as archive:
                # Torch packs nothing, so that what is read is no larger than the file.
                is_packed = any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist())
                is_whole = not is_packed and archive.testzip() is None
        except (zipfile.BadZipFile, struct.error, EOFError, RuntimeError, ValueError, LookupError, OverflowError):
            is_whole = False
    if not is_whole:
        raise ValueError(f"{path}: expected a whole checkpoint, found it damaged")


def read_torch_file(path: Path) -> Any:
    """What `torch.save` wrote at `path`, on the CPU; code in the file is never executed.

    Raises:
        UnreadableError: If torch cannot read it, whatever it raises: in its format before version 1.6, which has no
            checksum, every flipped bit reaches its code.
        ValueError: If a part of it is not what was written, or it is no regular file.
        OSError: If there is no such file, or it cannot be read.
    """
    import torch

    check_torch_file(path)
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception as error:
        reason = first_line_of(error) or type(error).__name__
        raise UnreadableError(f"{path}: expected a file of torch that is whole ({reason})") from error
