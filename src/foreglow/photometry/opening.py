"""Opens a lamp's photometric file, whatever its format."""

from __future__ import annotations

from pathlib import Path

from foreglow.photometry.ies import read_ies
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.ldt import read_ldt

READERS = {".ies": read_ies, ".ldt": read_ldt}


def read_lamp_file(path: Path) -> IntensityTable:
    """The lamp in the IES (LM-63) or EULUMDAT file `path`, by its suffix, in the lamp's frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the suffix is neither `.ies` nor `.ldt`, or the file is broken; the message names the path.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a file whose name ends in {' or '.join(READERS)}")
    return reader(path)
