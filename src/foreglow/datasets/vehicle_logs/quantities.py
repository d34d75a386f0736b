"""What a DBC says of a signal that is a number with a unit: its unit, its range, and the codes that are no value."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

FACTORS = MappingProxyType(
    {
        "speed": {
            "m/s": 1.0,
            "km/h": 1 / 3.6,
            "mph": 0.44704,
            "kn": 1852 / 3600,
            "cm/s": 0.01,
            "mm/s": 0.001,
            "m/min": 1 / 60,
            "m/h": 1 / 3600,
            "ft/s": 0.3048,
        },
        "yaw_rate": {
            "rad/s": 1.0,
            "mrad/s": 0.001,
            "deg/s": math.pi / 180,
            "deg/min": math.pi / 10800,
            "rpm": math.pi / 30,
        },
    }
)
"""From a unit to ours, by quantity."""

_ALIKE = {
    **dict.fromkeys(("mps", "ms-1", "m*s-1", "meter/s", "metre/s", "meterpersecond", "meterprosekunde"), "m/s"),
    **dict.fromkeys(("kmh", "kph", "kmph", "km/hr", "km/std", "kilometerperhour", "unit_kilometerperhour"), "km/h"),
    **dict.fromkeys(("mi/h", "miles/h", "mileperhour", "milesperhour", "unit_mileperhour"), "mph"),
    **dict.fromkeys(("knot", "knots", "kt", "kts"), "kn"),
    **dict.fromkeys(("radps", "rads", "rad/sec", "1/s", "radpersecond", "unit_radpersecond"), "rad/s"),
    **dict.fromkeys(("degps", "degs", "deg/sec", "degree/s", "degrees/s", "grad/s"), "deg/s"),
    **dict.fromkeys(
        ("\u00b0/s", "\u00b0/sec", "degreepersecond", "unit_degreepersecond", "unit_degrepersecon"), "deg/s"
    ),
}
"""Other ways to write a unit, in lower case and without blanks."""

_TOLERANCE = 0.01
"""A factor in a mapping is rounded by less than this share."""

_UNKNOWN = re.compile(
    r"(?i)\bSNA\b|^n/?a$|not[ _]?(avail|valid|def|known)|unavail|invalid|unknown|undef|ungueltig|ung\u00fcltig"
    r"|\bno[ _]?(signal|data|value)\b|missing|out[ _]?of[ _]?range"
    r"|^(init\w*|fehler|err(or)?|fault|failure|defect|failed)$"
)
"""Names in a value table for codes that are no value, such as all ones where a sensor has failed."""

_NUMBER = re.compile(r"\s*[-+]?\d+([.,]\d+)?\s*[^\s\d]{0,12}\s*")
"""Names of codes that are values themselves, such as `0 km/h`."""


def factor_of(quantity: str, signal: Signal, given: float | None, names: tuple[str, str]) -> float:
    """From the signal's unit to ours: by the DBC, or where that says no unit that is known, by the mapping.

    Args:
        quantity: One of `FACTORS`.
        signal: The signal.
        given: The mapping's factor; None if it gives none. Its sign is kept: a yaw rate may be positive to the right.
        names: What the factor, and the signal, are called in messages.

    Raises:
        ValueError: If the mapping and the DBC contradict each other, or the unit is not known and no factor is given.
    """
    written = (signal.unit or "").strip()
    unit = written.lower().replace(" ", "")
    known = FACTORS[quantity].get(_ALIKE.get(unit, unit))
    if known is None and given is not None:
        return given
    if known is None:
        stated = f"is in {written[:40]!r}, none of {', '.join(FACTORS[quantity])}" if written else "has no unit"
        ours = next(iter(FACTORS[quantity]))
        raise ValueError(f"{names[0]}: expected a factor to {ours}, as {names[1]} {stated} in the DBC, got none")
    if given is not None and abs(abs(given) - known) > _TOLERANCE * known:
        raise ValueError(
            f"{names[0]}: expected {known:.7g} or none, as {names[1]} is in {written[:40]}, got {given:g}; if the "
            "unit is wrong, correct it in the DBC"
        )
    return known if given is None else given


def is_in_range(signal: Signal, value: float) -> bool:
    """Whether a scaled value is one that the DBC allows, to half a step; a DBC without a range allows all."""
    least, most = signal.minimum, signal.maximum
    if least is None or most is None or least == most:
        return True
    slack = abs(float(signal.scale)) / 2
    return float(least) - slack <= value <= float(most) + slack


def has_both_signs(signal: Signal) -> bool:
    """Whether a signal may be below 0 as well as above, by its bits and by the DBC's range."""
    if signal.is_float:
        least, most = -math.inf, math.inf
    else:
        first = -(2 ** (signal.length - 1)) if signal.is_signed else 0
        codes = first, first + 2**signal.length - 1
        least, most = sorted(code * float(signal.scale) + float(signal.offset) for code in codes)
    if signal.minimum is not None and signal.maximum is not None and signal.minimum != signal.maximum:
        least, most = max(least, float(signal.minimum)), min(most, float(signal.maximum))
    return least < 0 < most


@lru_cache(maxsize=1024)  # by the object: a bus brings the same few messages again and again
def unknown_codes(message: Message, quantities: Collection[str] = ()) -> dict[str, set[int]]:
    """By signal, the codes to which the DBC's value table gives a name that says that the value is not known.

    Of `quantities`, signals that are numbers with a unit, those are all codes that have a name, unless it is a number
    too, or that of 0, such as `standstill`.
    """
    codes = {
        signal.name: {
            code
            for code, name in _named_codes(signal)
            if _UNKNOWN.search(name) or (signal.name in quantities and not _is_value(signal, code, name))
        }
        for signal in message.signals
    }
    return {name: found for name, found in codes.items() if found}


def _named_codes(signal: Signal) -> Iterator[tuple[int, str]]:
    """The codes of the value table, as raw values, and their names: tools write those of signed signals either way."""
    for code, name in (signal.choices or {}).items():
        is_negative = signal.is_signed and 2 ** (signal.length - 1) <= code < 2**signal.length
        yield code - 2**signal.length if is_negative else code, str(name)


def _is_value(signal: Signal, code: int, name: str) -> bool:
    return _NUMBER.fullmatch(name) is not None or code * float(signal.scale) + float(signal.offset) == 0


def known_values(
    message: Message, values: dict[str, Any], raw: dict[str, Any], quantities: frozenset[str]
) -> dict[str, Any]:
    """The values of a frame that are known: not by the value table, nor, of `quantities`, out of the DBC's range."""
    unknown = unknown_codes(message, quantities)
    ranges = {signal.name: signal for signal in message.signals if signal.name in quantities}
    return {
        name: value
        for name, value in values.items()
        if raw[name] not in unknown.get(name, ()) and (name not in ranges or is_in_range(ranges[name], value))
    }
