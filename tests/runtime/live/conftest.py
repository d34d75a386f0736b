"""A drive in memory."""

from __future__ import annotations

import pytest

from foreglow.datasets import open_source, shipped_drive
from foreglow.types import Frame


@pytest.fixture(scope="session")
def drive() -> list[Frame]:
    """The frames of the drive that ships: its beam is never low when all is well."""
    return list(open_source(shipped_drive()))
