"""Numbers in tables: NaN, and what is not there, is a dash."""

from __future__ import annotations

import math

DASH = "–"


def number(value: float | None, digits: int = 2, missing: str = DASH) -> str:
    """`value` with `digits` decimals.

    >>> number(0.125, 2), number(None), number(math.nan, missing="")
    ('0.12', '–', '')
    """
    return missing if value is None or math.isnan(value) else f"{value:.{digits}f}"


def signed(value: float, digits: int = 2) -> str:
    """`value` with its sign and `digits` decimals.

    >>> signed(0.5)
    '+0.50'
    """
    return DASH if math.isnan(value) else f"{value:+.{digits}f}"


def percent(value: float) -> str:
    """A share as whole per cent.

    >>> percent(0.256)
    '26%'
    """
    return DASH if math.isnan(value) else f"{value:.0%}"
