"""The numbers in a photometric file, read one field after another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from foreglow.files import MIB, number_in, read_text
from foreglow.geometry import Floats
from foreglow.wording import shortened

MAX_LAMP_BYTES = 16 * MIB
"""Largest photometric file: 3 million values, 45 by 20 degrees to either side in steps of .05 degrees have 1.4 million.
"""


MAX_CANDELA = 1e7
"""Brightest lamp: a headlamp's high beam has a twentieth of it, and the floodlights of a stadium a fifth. More is of a
wrong factor."""

_END_OF_FILE = "\x1a"
"""Some programs end a file with it, as DOS did."""


def read_lamp_text(path: Path) -> str:
    """The text of the photometric file at `path`, in whatever encoding its comments are.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no regular file, or larger than `MAX_LAMP_BYTES`.
    """
    return read_text(path, MAX_LAMP_BYTES, "latin-1").rstrip().removesuffix(_END_OF_FILE)


def scaled_candela(values: Floats, factor: float, origin: str) -> Floats:
    """The intensities of a lamp, `values` times `factor`.

    Raises:
        ValueError: If one is negative, or above `MAX_CANDELA`; the message begins with `origin`.
    """
    if not (values >= 0).all():
        raise ValueError(f"{origin}: expected at least 0, got {values.min():g}")
    brightest_cd = float(values.max()) * factor
    if not brightest_cd <= MAX_CANDELA:
        raise ValueError(f"{origin}: expected at most {MAX_CANDELA:g} cd with all factors, got {brightest_cd:g}")
    return values * factor


class NumberFields:
    """The numbers of a photometric file in order; error messages name the path, the line and the field."""

    def __init__(self, path: Path, words: Sequence[tuple[int, str]]) -> None:
        """Takes the words of the file that have to be numbers, each with the number of its line."""
        self._path = path
        self._words = words
        self._next = 0

    def seek(self, index: int) -> None:
        """Continues with the word at `index`, counted from 0."""
        self._next = index

    def take(self, num: int, field: str) -> Floats:
        """The next `num` numbers, which are the file's `field`; a comma counts as a decimal point.

        Raises:
            ValueError: If the file ends before, or a word is not a finite number.
        """
        words = self._words[self._next : self._next + num]
        if len(words) < num:
            wanted = "a number" if num == 1 else f"{num} numbers"
            raise ValueError(f"{self._path}: {field}: expected {wanted}, the file ends after {len(words)}")
        self._next += num
        values = np.empty(num)
        for index, (line, word) in enumerate(words):
            try:
                values[index] = number_in(word.replace(",", "."))
            except ValueError:
                values[index] = np.nan
            if not np.isfinite(values[index]):
                raise ValueError(f"{self._path}: line {line}: {field}: expected a number, got {word!r}")
        return values

    def whole(self, field: str, at_least: int) -> int:
        """The next number, which has to be a whole number of at least `at_least`.

        Raises:
            ValueError: If it is not.
        """
        value = float(self.take(1, field)[0])
        if value < at_least or not value.is_integer():
            line, _ = self._words[self._next - 1]
            raise ValueError(
                f"{self._path}: line {line}: {field}: expected a whole number of at least {at_least}, got {value:g}"
            )
        return int(value)

    def end(self, after: str) -> None:
        """Passes if nothing follows but blanks: what is left would be dark, or `after`, the last field, is of another.

        Raises:
            ValueError: If more follows.
        """
        for line, word in self._words[self._next :]:
            if word:
                raise ValueError(
                    f"{self._path}: line {line}: expected the end of the file after {after}, as counts and symmetry at "
                    f"its beginning say, got {shortened(word)}"
                )
