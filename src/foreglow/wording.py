"""Words that messages share: a value at a sane length, an exact time, and what was expected or has no effect."""

from __future__ import annotations

import re
import reprlib
from decimal import Decimal
from typing import Any, get_args


class UnusedWarning(UserWarning):
    """Something that an input says has no effect; commands show it as a line."""


class _Short(reprlib.Repr):
    """Cuts what is long; a number of thousands of digits cannot be written at all."""

    def repr_int(self, x: int, level: int) -> str:
        return f"a whole number of {x.bit_length()} bits" if x.bit_length() > 10_000 else super().repr_int(x, level)


_SHORT = _Short()
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist, _SHORT.maxtuple = 3, 4, 6, 6
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 80


def shortened(value: object) -> str:
    """`value` as Python writes it, in one line and cut for a message, whatever its size.

    >>> shortened([1, "x" * 1000])[:6], len(shortened([1, "x" * 1000]))
    ("[1, 'x", 80)
    >>> shortened([*range(1000)]), shortened(10**5000)
    ('[0, 1, 2, 3, 4, 5, ...]', 'a whole number of 16610 bits')
    """
    is_one = type(value).__name__ == "ndarray" and getattr(value, "shape", None) == ()  # which is told from a number
    as_list = None if is_one else getattr(value, "tolist", None)  # of an array or a scalar of NumPy's
    text = re.sub(r"\s*\n\s*", " ", _SHORT.repr(as_list() if callable(as_list) else value))  # as of values with arrays
    return text if len(text) <= 80 else text[:77] + "..."


def without_password(address: str) -> str:
    """The address of a live source as it may be shown and kept: who reads results need not get into the camera.

    >>> without_password("rtsp://driver:secret@192.168.0.9:554/night")
    'rtsp://driver:***@192.168.0.9:554/night'
    >>> without_password("rtsp://192.168.0.9/user=driver&password=secret&channel=1")
    'rtsp://192.168.0.9/user=driver&password=***&channel=1'
    """
    if "://" not in address and not address.startswith("gstreamer:"):  # a path, which may be called anything
        return address
    shown = re.sub(r"(://[^\s/?#@:]*):[^\s/?#]*@", r"\1:***@", address)
    return re.sub(r"(?i)([?&;/\s](?:user-)?(?:pass\w*|pwd?|secret|token)=)[^\s&;#]*", r"\1***", shown)


def csv_words(error: Exception) -> str:
    r"""What is wrong in a file that Python's `csv` cannot read, without its advice to programmers.

    >>> csv_words(ValueError("new-line character seen in unquoted field - do you need to open the file ..."))
    'a carriage return within a line'
    """
    words = str(error)
    return "a carriage return within a line" if words.startswith("new-line character seen") else words


def exact_seconds(time_ns: int) -> str:
    """A time in seconds, with all digits, as those that differ may be the last ones of many.

    >>> exact_seconds(1_700_000_000_050_000_000), exact_seconds(0)
    ('1700000000.05', '0')
    """
    return f"{Decimal(time_ns).scaleb(-9).normalize():f}"


def check_one_of(value: object, choices: Any, field: str) -> None:
    """Passes one of some texts: Python callers may give anything, whatever the signature says.

    Args:
        value: What was given.
        choices: The texts, or the `Literal` of them.
        field: What it was given as, for the message.

    Raises:
        ValueError: If it is another one, or no text.

    >>> check_one_of("RGB", ("rgb", "bgr"), "order")
    Traceback (most recent call last):
    ValueError: order: expected one of rgb, bgr, got 'RGB'
    """
    known = get_args(choices) or tuple(choices)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{field}: expected one of {', '.join(known)}, got {shortened(value)}")
