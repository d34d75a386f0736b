"""DBC files: the messages and signals of a CAN bus, and what of them could not be decoded."""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, cast

from foreglow.files import MIB, read_text
from foreglow.wording import shortened

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

MAX_DBC_BYTES = 4 * MIB
"""Largest DBC: it takes 100 times its size while it is read, and 3 s for each MiB."""

MAX_MESSAGE_BYTES = 4096
"""Longest message of a DBC: one of CAN FD has 64 bytes, one of several frames 1785."""

MAX_MULTIPLEX_VALUES = 65_536
"""Values in all ranges of multiplexed signals of a DBC: cantools lists each."""


def read_dbc(path: Path) -> dict[str, Message]:
    """The messages in the DBC file `path`, by name.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If cantools is not installed.
        ValueError: If it is no DBC, or names two messages, or two signals of a message, alike.
    """
    import cantools

    # Python prints warnings of a library for which nobody listens; what they say is checked below.
    logging.getLogger("cantools").addHandler(logging.NullHandler())
    text = read_text(path, MAX_DBC_BYTES, "latin-1")
    try:
        text = text.encode("latin-1").decode("utf-8-sig")
    except UnicodeDecodeError:  # as Vector's tools write it
        text = text.encode("latin-1").decode("cp1252", "replace")
    _check_dbc(text, str(path))
    try:
        # Not strict: public descriptions of real cars have signals that overlap.
        database = cantools.database.load_string(text, database_format="dbc", strict=False)
    except (cantools.Error, ValueError, KeyError) as error:
        raise ValueError(f"{path}: expected a DBC file: {error!s:.200}") from None
    messages = cast("Database", database).messages
    _check_names([message.name for message in messages], f"{path}: messages")
    found: dict[str, Message] = {}
    for message in messages:
        _check_names([signal.name for signal in message.signals], f"{path}: {message.name}: signals")
        found[message.name] = message
    return found


def _check_names(names: list[str], origin: str) -> None:
    """ValueError if two are the same: nobody can tell which of the two is meant."""
    twice = [name for name, num in Counter(names).items() if num > 1]
    if twice:
        raise ValueError(f"{origin}: expected each name once, {twice[0]} comes twice")


def _check_dbc(text: str, origin: str) -> None:
    """ValueError if a message of a DBC is too long, or its ranges are, or a signal is of a type that is none."""
    ends = [(int(size[:20]), "a message") for size in re.findall(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)", text)]
    ends += [
        ((int(start[:20]) + int(length[:20])) // 8, "a signal")
        for start, length in re.findall(r":\s*(\d+)\s*\|\s*(\d+)\s*@", text)
    ]
    longest = max(ends, default=(0, ""))
    if longest[0] > MAX_MESSAGE_BYTES:
        raise ValueError(f"{origin}: {longest[1]}: expected at most {MAX_MESSAGE_BYTES} bytes, got {longest[0]}")
    for name, kind in re.findall(r"\bSIG_VALTYPE_\s+\d+\s+(\w+)\s*:?\s*(\d+)\s*;", text):
        if kind not in ("0", "1", "2"):  # cantools takes others for integers
            expected = "expected 0 (integer), 1 (float) or 2 (double)"
            raise ValueError(f"{origin}: SIG_VALTYPE_: {name}: {expected}, got {shortened(int(kind[:20]))}")
    num_values = 0
    for ranges in re.findall(r"\bSG_MUL_VAL_\s([^;]*)", text):
        num_values += sum(
            abs(int(last[:20]) - int(first[:20])) for first, last in re.findall(r"(\d+)\s*-\s*(\d+)", ranges)
        )
    if num_values > MAX_MULTIPLEX_VALUES:
        raise ValueError(f"{origin}: SG_MUL_VAL_: expected ranges of at most {MAX_MULTIPLEX_VALUES}, got {num_values}")


def check_signal(signal: Signal, origin: str) -> None:
    """ValueError if a signal's scale makes every value the same, or none, or no value is within its range."""
    if not (math.isfinite(signal.scale) and math.isfinite(signal.offset) and signal.scale):
        expected = "expected a finite scale other than 0, and a finite offset"
        raise ValueError(f"{origin}: {expected}, got ({signal.scale:g},{signal.offset:g})")
    if signal.is_float and signal.length not in (32, 64):  # cantools takes any, and makes another number of it
        raise ValueError(f"{origin}: expected a float of 32 bits or a double of 64, got {signal.length} bits")
    least, most = signal.minimum, signal.maximum
    if least is not None and most is not None and not (least < most or least == most == 0):
        raise ValueError(f"{origin}: expected a range that rises, or [0|0] for none, got [{least:g}|{most:g}]")


def check_lengths(message: Message, origin: str) -> None:
    """ValueError if a signal does not fit into its message, which then could not be decoded."""
    from cantools.database.utils import start_bit

    for signal in message.signals:
        end = start_bit(signal) + signal.length
        if end > 8 * message.length:
            raise ValueError(
                f"{origin}: {message.name}: {signal.name}: expected an end within {message.length} bytes, got bit {end}"
            )


def check_decoding(message: Message, origin: str) -> None:
    """ValueError if no frame could be decoded, such as where signals lie on one another in a way that cannot be."""
    import cantools

    try:
        message.decode(bytes(message.length), decode_choices=False)
    except cantools.Error as error:
        if not message.is_multiplexed():
            raise ValueError(f"{origin}: {message.name}: expected signals that can be decoded: {error}") from None
