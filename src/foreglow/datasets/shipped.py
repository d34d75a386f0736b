"""The drive that ships with the package: simulated, in PVDN's layout, with labels, calibration and truth."""

from __future__ import annotations

from pathlib import Path

DEMO_DRIVE = "curve"


def shipped_drive(name: str = DEMO_DRIVE) -> Path:
    """The folder of the drive called `name`, a split that `PVDN` reads.

    Raises:
        FileNotFoundError: If no drive of this name is installed.
    """
    folder = Path(__file__).resolve().parents[1] / "shipped_drives" / name
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such drive in this installation")
    return folder
