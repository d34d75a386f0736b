"""What several tests of the command line run on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from tests.cli.forked import Loaded, loaded
from tests.stand_ins import REFERENCE, night_image


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A configuration that needs no native core."""
    path = tmp_path / "reference.toml"
    width_px = REFERENCE.proposals.reference_width_px
    path.write_text(f'[proposals]\nbackend = "reference"\nreference_width_px = {width_px}\n')
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of three images."""
    path = tmp_path / "images"
    path.mkdir()
    for k in range(3):
        cv2.imwrite(str(path / f"{k:06d}.png"), night_image(k))
    return path


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loaded]:
    """A process that has loaded the program, and forks for each command."""
    with loaded(tmp_path_factory.mktemp("forked")) as process:
        yield process
