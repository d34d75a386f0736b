from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.lab.studies.glare.drive import GlareDrive, read_glare_drive, write_glare_drive
from tests.lab.studies.glare_drives import approach, empty_drive


def assert_same(one: Any, other: Any) -> None:
    """Field by field, arrays with their NaN."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        elif field.name == "eyes":
            for eye, other_eye in zip(a, b, strict=True):
                assert_same(eye, other_eye)
        elif field.name == "runs":
            assert list(a) == list(b)
            for name in a:
                assert_same(a[name], b[name])
        elif field.name == "road":
            assert_same(a, b)
        else:
            assert a == b


@pytest.mark.parametrize("drive", [approach(), empty_drive()], ids=lambda one: one.name)
def test_round_trip(drive: GlareDrive, tmp_path: Path) -> None:
    is_lit = np.arange(len(drive.times_s)) % 3 == 1
    drive = dataclasses.replace(drive, pictures={"The approach": "a.mp4"}, is_lit=is_lit, gone_s={7: 0.25})
    write_glare_drive(tmp_path / "drive.npz", drive)
    assert_same(drive, read_glare_drive(tmp_path / "drive.npz"))
    assert [path.name for path in tmp_path.iterdir()] == ["drive.npz"]


def stored(path: Path) -> dict[str, Any]:
    write_glare_drive(path, approach())
    with np.load(path) as arrays:
        return dict(arrays)


def about(arrays: dict[str, Any], **changes: Any) -> Any:
    return np.frombuffer(json.dumps(json.loads(arrays["about"].tobytes()) | changes).encode(), np.uint8)


def test_files_from_before_lit_roads_were_known(tmp_path: Path) -> None:
    arrays = stored(tmp_path / "drive.npz")
    del arrays["is_lit"]
    np.savez(tmp_path / "drive.npz", **arrays)
    assert not read_glare_drive(tmp_path / "drive.npz").is_lit.any()


def test_files_from_before_it_was_known_who_had_passed(tmp_path: Path) -> None:
    arrays = stored(tmp_path / "drive.npz")
    known = json.loads(arrays["about"].tobytes())
    del known["gone_s"]
    np.savez(tmp_path / "drive.npz", **arrays | {"about": np.frombuffer(json.dumps(known).encode(), np.uint8)})
    assert not read_glare_drive(tmp_path / "drive.npz").gone_s


@pytest.mark.parametrize("missing", ["about", "times_s", "road.leds_lx", "eyes.0.base_lx", "runs.5.levels"])
def test_a_missing_field(missing: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.npz"
    arrays = stored(path)
    del arrays[missing]
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {missing}: expected an array"):
        read_glare_drive(path)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"format": 2}, "about.format: expected 1, got 2"),
        ({"rate_hz": "fast"}, "about: rate_hz: expected a valid number"),
        ({"rate_hz": -1.0}, "GlareDrive.rate_hz: expected a positive number"),
        ({"light_s": {"one": 1.0}}, "about.light_s: expected vehicle ids, got 'one'"),
    ],
)
def test_a_wrong_field(changes: dict[str, Any], expected: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.npz"
    arrays = stored(path)
    np.savez(path, **arrays | {"about": about(arrays, **changes)})
    with pytest.raises(ValueError, match=rf"^{re.escape(f'{path}: {expected}')}"):
        read_glare_drive(path)


def test_a_wrong_array(tmp_path: Path) -> None:
    path = tmp_path / "drive.npz"
    arrays = stored(path)
    np.savez(path, **arrays | {"runs.0.levels": arrays["runs.0.levels"] + 2})
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: PolicyRun.levels: expected values in \[0, 1\]"):
        read_glare_drive(path)


def test_a_broken_file(tmp_path: Path) -> None:
    path = tmp_path / "drive.npz"
    write_glare_drive(path, approach())
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0xFF
    for data in (b"", b"\x93NUMPY", b"no archive", whole[:-100], whole[: len(whole) // 2], bytes(flipped)):
        path.write_bytes(data)
        with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: expected a whole .npz file"):
            read_glare_drive(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(ValueError, match="one array"):
        read_glare_drive(path)
    with pytest.raises(FileNotFoundError, match=r"none\.npz: no such file"):
        read_glare_drive(tmp_path / "none.npz")
