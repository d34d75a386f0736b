"""Damage: what becomes of the bytes, the fields and the kind of a file. The same generator gives the same damage."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np

Generator = np.random.Generator


def cut(data: bytes, rng: Generator) -> bytes:
    return data[: int(rng.integers(0, max(1, len(data))))]


def flip(data: bytes, rng: Generator) -> bytes:
    """Some bytes are others."""
    changed = bytearray(data)
    for index in rng.integers(0, max(1, len(data)), int(rng.integers(1, 20))):
        if changed:
            changed[int(index) % len(changed)] ^= int(rng.integers(1, 256))
    return bytes(changed)


def blank(data: bytes, rng: Generator) -> bytes:
    """A span is zeros, as on a bad disk."""
    begin, end = sorted(int(k) for k in rng.integers(0, len(data) + 1, 2))
    return data[:begin] + bytes(end - begin) + data[end:]


def shuffle(data: bytes, rng: Generator) -> bytes:
    """A part is left out, comes twice, or is elsewhere."""
    a, b, c = sorted(int(k) for k in rng.integers(0, len(data) + 1, 3))
    return (data[:a] + data[b:], data[:b] + data[a:], data[:a] + data[b:c] + data[a:b] + data[c:])[int(rng.integers(3))]


def pad(data: bytes, rng: Generator) -> bytes:
    """Something follows, or precedes."""
    more = rng.bytes(int(rng.integers(1, 5000)))
    return data + more if rng.random() < 0.5 else more + data


def no_bytes(data: bytes, rng: Generator) -> bytes:  # noqa: ARG001
    return b""


DAMAGE: dict[str, Callable[[bytes, Generator], bytes]] = {
    "cut": cut, "flipped": flip, "blank span": blank, "parts moved": shuffle, "more bytes": pad, "empty": no_bytes,
}  # fmt: skip

VALUES = (
    "nan", "inf", "-inf", "1e400", "-1", "0", "1e-300", "9" * 400, "1e308", "2147483648", "18446744073709551616",
    "null", "true", '""', '"x"', '"' + "x" * 100_000 + '"', "[]", "{}", "[" * 3000, "..", "0x10", "1_0", "١",
)  # fmt: skip
"""What stands in place of a number or text."""

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def other_number(data: bytes, rng: Generator) -> bytes:
    """A number is another value."""
    found = list(NUMBER.finditer(data))
    if not found:
        return data + b"nan"
    number = found[int(rng.integers(len(found)))]
    return data[: number.start()] + str(rng.choice(VALUES)).encode() + data[number.end() :]


def other_word(data: bytes, rng: Generator) -> bytes:
    """A word, such as the name of a field, is another, everywhere."""
    words = sorted(set(re.findall(rb"[A-Za-z_]\w+", data)))
    if not words:
        return data + b"word"
    word = words[int(rng.integers(len(words)))]
    return data.replace(
        word, str(rng.choice(["", "x", "__class__", "../../x", "a b", "\x00", "ſ", word.decode()[::-1]])).encode()
    )


def other_lines(data: bytes, rng: Generator) -> bytes:
    """A line is left out, comes many times, or the order is another."""
    lines = data.split(b"\n")
    index = int(rng.integers(len(lines)))
    kind = int(rng.integers(3))
    if kind == 0:
        del lines[index]
    elif kind == 1:
        lines[index:index] = [lines[index]] * int(rng.integers(1, 200))
    else:
        lines = [lines[int(k)] for k in rng.permutation(len(lines))]
    return b"\n".join(lines)


def other_encoding(data: bytes, rng: Generator) -> bytes:
    """The same text in another encoding, or with characters that do not belong into a text."""
    text = data.decode(errors="replace")
    return (
        text.encode("utf-16"), text.encode("utf-32"), b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"),
        data.replace(b"\n", b"\r"), data.replace(b" ", b"\x00"), data.replace(b"a", b"\xff"), b"\x00" * 3 + data,
    )[int(rng.integers(8))]  # fmt: skip


TEXT_DAMAGE: dict[str, Callable[[bytes, Generator], bytes]] = {
    "another number": other_number, "another word": other_word, "other lines": other_lines,
    "another encoding": other_encoding,
}  # fmt: skip


def folder(path: Path) -> None:
    path.mkdir()


def sound_socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # the path of a socket is at most 107 bytes long
    try:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    finally:
        os.chdir(here)


def loop(path: Path) -> None:
    path.symlink_to(path.name)


def nowhere(path: Path) -> None:
    path.symlink_to("nothing")


def zeros_for_ever(path: Path) -> None:
    path.symlink_to("/dev/zero")


def sparse(path: Path) -> None:
    path.write_bytes(b"")
    os.truncate(path, 40 << 30)


def left_out(path: Path) -> None:  # noqa: ARG001
    return


def own_memory(path: Path) -> None:
    path.symlink_to("/proc/self/mem")


NO_FILES: dict[str, Callable[[Path], None]] = {
    "a folder": folder, "a pipe": os.mkfifo, "a socket": sound_socket, "a link to itself": loop,
    "a link to nothing": nowhere, "/dev/zero": zeros_for_ever, "40 GiB of nothing": sparse, "missing": left_out,
    "a process's memory": own_memory,
}  # fmt: skip
