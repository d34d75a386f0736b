from __future__ import annotations

import math
import os
import sys
import types
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.datasets import PVDN, FrameSource, ImageFolder, Video, download_pvdn, open_labelled, open_source
from foreglow.datasets.image_folder import natural_key
from tests.datasets.tiny_pvdn import make_pvdn
from tests.datasets.video.test_video_file import NUM_FRAMES, make_video


def _image(seed: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng(seed).integers(0, 256, (64, 70), dtype=np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """f2.png, f10.png, f1.PNG, and things that are none of its business."""
    folder = tmp_path / "drive"
    folder.mkdir()
    for number in (10, 2, 1):
        cv2.imwrite(str(folder / f"f{number}.png"), _image(number))
    (folder / "f1.png").rename(folder / "f1.PNG")
    (folder / "notes.txt").write_text("dark")
    (folder / ".hidden.png").write_text("no image")
    (folder / "more.png").mkdir()
    return folder


def test_a_folder_in_natural_order(folder: Path) -> None:
    source = ImageFolder(folder)
    frames = list(source)
    assert [Path(frame.path).name for frame in frames] == ["f1.PNG", "f2.png", "f10.png"]
    assert all(np.array_equal(f.image, _image(n)) for f, n in zip(frames, (1, 2, 10), strict=True))
    assert [frame.frame for frame in frames] == [0, 1, 2]
    assert [frame.timestamp_ns for frame in frames] == [0, 55_555_556, 111_111_111]
    assert (source.name, len(source), source.num_frames, source.rate_hz) == ("drive", 3, 3, 18.0)
    assert [frame.timestamp_ns for frame in ImageFolder(folder, rate_hz=10)] == [0, 100_000_000, 200_000_000]


@pytest.mark.parametrize("name", ["{:04}.png", "frame_{}.png"])
def test_images_that_are_missing_by_their_numbers_take_their_time(tmp_path: Path, name: str) -> None:
    for number in (8, 9, 11, 12, 13, 16, 17, 18, 19, 20, 21):
        cv2.imwrite(str(tmp_path / name.format(number)), _image(number))
    source = ImageFolder(tmp_path, rate_hz=10)
    assert [frame.timestamp_ns // 100_000_000 + 8 for frame in source] == [frame.frame for frame in source]
    rate, *others = source.notes
    assert rate.startswith(f"{tmp_path}: images have no times: taken for 10 frames a second; ")
    assert not ImageFolder(tmp_path / name.format(8)).notes
    assert others == [
        f"{tmp_path}: 3 images are missing by the numbers of the others, first between 9 and 11; times go on as if "
        "they were there"
    ]


@pytest.mark.parametrize("other", ["0003.jpg", "0003 (1).png", "frame_0003.png", "00003.png"])
def test_two_images_with_one_number_are_told(tmp_path: Path, other: str) -> None:
    """A copy made the missing image 6 unknown, and a drive that is there twice ran at half its speed."""
    for number in (0, 1, 2, 3, 4, 5, 7):
        cv2.imwrite(str(tmp_path / f"{number:04}.png"), _image(number))
    cv2.imwrite(str(tmp_path / other), _image(3))
    source = ImageFolder(tmp_path)
    assert [frame.frame for frame in source] == list(range(8))
    line = source.notes[-1]
    assert line.startswith(f"{tmp_path}: images have the same number as others, first ")
    assert "0003.png" in line
    assert other in line
    assert line.endswith("counted from 0 in the order of their names, with none missing; remove copies")


@pytest.mark.parametrize("numbers", [(0, 2, 4, 6), (3, 57, 120, 121), (0, 1, 2, 3, 10), (1, 3, 5, 6, 8)])
def test_of_images_that_were_chosen_none_are_missing(tmp_path: Path, numbers: tuple[int, ...]) -> None:
    for number in numbers:
        cv2.imwrite(str(tmp_path / f"{number}.png"), _image(number))
    source = ImageFolder(tmp_path, rate_hz=10)
    assert [frame.timestamp_ns // 100_000_000 for frame in source] == list(range(len(numbers)))
    assert len(source.notes) == 1


def test_one_bad_image_stops_or_is_skipped(folder: Path) -> None:
    (folder / "f2.png").write_bytes((folder / "f2.png").read_bytes()[:-40])
    with pytest.raises(ValueError, match=r"f2\.png: truncated PNG"):
        list(ImageFolder(folder))
    source = ImageFolder(folder, on_error="skip")
    for _ in range(2):
        assert [frame.frame for frame in source] == [0, 2]
        assert len(source.skipped) == 1
        assert source.skipped[0].startswith(f"{folder / 'f2.png'}: truncated PNG")


@pytest.mark.parametrize("target", ["f3.png", "nothing"])
def test_a_link_that_leads_nowhere_is_not_passed_over(folder: Path, target: str) -> None:
    """As in a checkout whose large files were not fetched."""
    (folder / "f3.png").symlink_to(target)
    with pytest.raises(FileNotFoundError, match=r"f3\.png: no such image"):
        list(ImageFolder(folder))
    source = ImageFolder(folder, on_error="skip")
    assert [frame.frame for frame in source] == [0, 1, 3]
    assert source.skipped == [f"{folder / 'f3.png'}: no such image"]


def test_a_folder_that_cannot_be_used(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"expected images .* found none"):
        ImageFolder(tmp_path / "empty")
    with pytest.raises(FileNotFoundError, match="no such file or folder"):
        ImageFolder(tmp_path / "absent")
    bad: Any = "ignore"
    with pytest.raises(ValueError, match="on_error: expected one of stop, skip, mark, got 'ignore'"):
        ImageFolder(folder, on_error=bad)


@pytest.mark.parametrize("rate_hz", [0, -1, None, "x", True, [], 1e-300, 1e300, 10**400, math.nan, math.inf])
def test_a_rate_that_gives_no_times(folder: Path, tmp_path: Path, rate_hz: Any) -> None:
    """All images had the time 0, or a time of thousands of years; other sources took anything."""
    video = tmp_path / "night.mp4"
    video.write_bytes(b"")
    for path in (folder, video, tmp_path / "absent"):
        with pytest.raises(ValueError, match=r"^rate_hz: expected a number from 0\.001 to 1e\+06, got ") as refused:
            open_source(path, rate_hz=rate_hz)
        assert len(str(refused.value)) < 150
    with pytest.raises(ValueError, match=r"^rate_hz: expected a number"):
        ImageFolder(folder, rate_hz=rate_hz)


def test_the_rates_at_the_ends(folder: Path) -> None:
    for rate_hz in (1e-3, 1e6):
        times_ns = [frame.timestamp_ns for frame in ImageFolder(folder, rate_hz=rate_hz)]
        assert times_ns == [0, round(1e9 / rate_hz), round(2e9 / rate_hz)]


def make_photograph(path: Path, *times: str, seed: int = 0) -> None:
    """A JPEG with these times in its Exif data, as of the last change and of the photograph."""
    assert cv2.imwrite(str(path), _image(seed))
    entries = b"".join(time.encode() + b"\0" for time in times)
    exif = b"Exif\0\0MM\0\x2a" + entries
    data = path.read_bytes()
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])


def test_photographs_of_another_time_are_no_drive(tmp_path: Path) -> None:
    make_photograph(tmp_path / "a.jpg", "2026:11:22 23:00:00", "2026:11:20 18:00:00")
    make_photograph(tmp_path / "b.jpg", "2026:11:22 23:00:00", "2026:11:20 18:00:01")
    make_photograph(tmp_path / "c.jpg", "2026:11:22 23:00:00", "2026:11:20 18:20:00")
    make_photograph(tmp_path / "d.jpg", "2026:11:22 23:00:00", "2026:11:20 18:10:00")
    make_photograph(tmp_path / "e.jpg")
    make_photograph(tmp_path / "f.jpg", "0000:00:00 00:00:00")
    assert [frame.sequence for frame in ImageFolder(tmp_path)] == ["", "", "c.jpg", "d.jpg", "e.jpg", "e.jpg"]


@pytest.mark.parametrize(
    ("rate_hz", "step_s", "words"),
    [
        (18.0, 1.0, "by their Exif data the images took 19 s, 1 a second, and not 1.06 s"),
        (18.0, 0.1, ""),  # 1 s, of whole ones
        (1.0, 1.0, ""),
        (4.0, 1.0, "by their Exif data the images took 19 s, 1 a second, and not 4.75 s"),
        (18.0, 30.0, ""),  # photographs, each a sequence of its own
    ],
)
def test_photographs_may_say_that_they_took_another_time(
    tmp_path: Path, rate_hz: float, step_s: float, words: str
) -> None:
    for number in range(20):
        taken = datetime(2026, 11, 20, 18, 0, 0) + timedelta(seconds=int(number * step_s))
        make_photograph(tmp_path / f"{number:02}.jpg", f"{taken:%Y:%m:%d %H:%M:%S}")
    _, *others = ImageFolder(tmp_path, rate_hz=rate_hz).notes
    assert others == ([f"{tmp_path}: {words}"] if words else [])


def test_images_of_another_size_are_no_drive(folder: Path) -> None:
    cv2.imwrite(str(folder / "f3.png"), _image(3)[:, :66])
    cv2.imwrite(str(folder / "f4.png"), _image(4)[:, :66].astype(np.uint16))
    assert [frame.sequence for frame in ImageFolder(folder)] == ["", "", "f3.png", "f4.png", "f10.png"]


def test_images_without_times_are_one_drive(folder: Path) -> None:
    assert {frame.sequence for frame in ImageFolder(folder)} == {""}


@given(st.lists(st.integers(0, 10**6), max_size=8, unique=True))
def test_numbers_in_names_sort_as_numbers(numbers: list[int]) -> None:
    names = [f"a{number}.png" for number in numbers]
    assert sorted(names, key=natural_key) == [f"a{number}.png" for number in sorted(numbers)]


@given(st.lists(st.text(max_size=6), max_size=6))
def test_any_names_can_be_sorted(names: list[str]) -> None:
    assert sorted(sorted(names, key=natural_key)) == sorted(names)


def test_the_path_decides_what_it_is(folder: Path, tmp_path: Path) -> None:
    split = make_pvdn(tmp_path / "PVDN", "day")
    clip = make_video(tmp_path / "clip.mp4", num_frames=3)
    expected: list[tuple[Path, type[Any], str, int]] = [
        (folder, ImageFolder, "drive", 3),
        (folder / "f2.png", ImageFolder, "f2.png", 1),
        (clip, Video, "clip.mp4", 3),
        (split, PVDN, "day/val", 5),
        (split / "images" / "S00001", PVDN, "day/val/S00001", 2),
        (split / "images" / "S00001" / "000005.png", ImageFolder, "000005.png", 1),
    ]
    for path, kind, name, num_frames in expected:
        source: FrameSource = open_source(path)
        assert type(source) is kind
        assert (source.name, source.num_frames) == (name, num_frames)
        assert len(list(source)) == num_frames
        assert list(source.skipped) == []
    assert open_source(str(folder), rate_hz=5).rate_hz == 5


def test_a_split_without_its_sequences_is_an_error_not_a_folder(tmp_path: Path) -> None:
    split = make_pvdn(tmp_path)
    (split / "labels" / "sequences.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"sequences\.json: no such file"):
        open_source(split)


def test_what_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file or folder"):
        open_source(tmp_path / "absent")
    (tmp_path / "notes.txt").write_text("dark")
    with pytest.raises(ValueError, match="expected a video"):
        open_source(tmp_path / "notes.txt")


def _fake_kagglehub(monkeypatch: pytest.MonkeyPatch, download: Any) -> types.SimpleNamespace:
    """kagglehub and requests as far as the download uses them."""
    names = ("UnauthenticatedError", "CredentialError", "NotFoundError", "DataCorruptionError", "BackendError")
    errors: Any = types.ModuleType("kagglehub.exceptions")
    for name in names:
        setattr(errors, name, type(name, (Exception,), {}))
    requests: Any = types.ModuleType("requests")
    request_error = type("RequestException", (OSError,), {})
    requests.exceptions = types.SimpleNamespace(
        RequestException=request_error, HTTPError=type("HTTPError", (request_error,), {})
    )
    hub: Any = types.ModuleType("kagglehub")
    hub.dataset_download = download
    for module in (errors, requests, hub):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return types.SimpleNamespace(errors=errors, http=requests.exceptions)


def test_download_into_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def download(handle: str, output_dir: str) -> None:
        calls.append((handle, output_dir))

    _fake_kagglehub(monkeypatch, download)
    target = tmp_path / "data" / "PVDN"
    assert download_pvdn(target) == target
    assert calls == [("saralajew/provident-vehicle-detection-at-night-pvdn", str(target))]
    assert target.is_dir()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("UnauthenticatedError", "accept the terms at https://www.kaggle.com/datasets/.* API token"),
        ("CredentialError", "API token"),
        ("NotFoundError", "there is none of this name"),
        ("DataCorruptionError", "damaged or failed, try again: first"),
        ("RequestException", "is this machine online"),
        ("HTTPError", "Kaggle refuses the download: first"),
    ],
)
def test_each_obstacle_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, message: str) -> None:
    def download(**_: str) -> None:
        raise AssertionError("replaced below")

    fake = _fake_kagglehub(monkeypatch, download)
    kind = getattr(fake.errors, name, None) or getattr(fake.http, name)

    def fail(handle: str, output_dir: str) -> None:
        error: Any = kind(f"first {handle}\nsecond {output_dir}")
        error.response = None
        raise error

    monkeypatch.setattr(sys.modules["kagglehub"], "dataset_download", fail)
    with pytest.raises(ValueError, match=message) as caught:
        download_pvdn(tmp_path)
    assert "\n" not in str(caught.value)


def test_no_permission_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = _fake_kagglehub(monkeypatch, None)

    def fail(handle: str, output_dir: str) -> None:
        error = fake.http.HTTPError(f"403 Client Error {handle} {output_dir}")
        error.response = types.SimpleNamespace(status_code=403)
        raise error

    monkeypatch.setattr(sys.modules["kagglehub"], "dataset_download", fail)
    with pytest.raises(ValueError, match=r"https://www\.kaggle\.com/datasets/me/mine"):
        download_pvdn(tmp_path, "me/mine")


def test_an_old_kagglehub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _fake_kagglehub(monkeypatch, lambda handle: handle)
    with pytest.raises(ValueError, match="pip install -U kagglehub"):
        download_pvdn(tmp_path)


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kagglehub", None)
    with pytest.raises(ValueError, match=r"pip install 'foreglow\[download\]'"):
        download_pvdn(tmp_path / "data")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    "suffix", ["HEIC", "tga", "exr", "hdr", "pbm", "pfm", "pam", "pcx", "ras", "raw", "RAW", "j2k", "orf", "rw2"]
)
def test_images_of_other_formats_are_named(tmp_path: Path, suffix: str) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), _image(0))
    (tmp_path / f"b.{suffix}").touch()
    with pytest.raises(ValueError, match=rf"b\.{suffix}: expected an image that is PNG"):
        ImageFolder(tmp_path)
    source = ImageFolder(tmp_path, on_error="skip")
    assert len(list(source)) == 1
    assert f"b.{suffix}" in source.skipped[0]


@pytest.mark.parametrize(("suffix", "written"), [("jfif", "jpg"), ("jpe", "jpg"), ("JIF", "jpg"), ("dib", "bmp")])
def test_other_names_of_known_formats_are_read(tmp_path: Path, suffix: str, written: str) -> None:
    cv2.imwrite(str(tmp_path / f"a.{written}"), _image(0))
    expected = next(iter(open_source(tmp_path / f"a.{written}"))).image
    (tmp_path / f"a.{written}").rename(tmp_path / f"a.{suffix}")
    for path in (tmp_path, tmp_path / f"a.{suffix}"):
        np.testing.assert_array_equal([frame.image for frame in open_source(path)], [expected])


def test_a_video_without_a_name_of_its_own_is_no_image(tmp_path: Path) -> None:
    path = make_video(tmp_path / "clip.avi")
    path.rename(tmp_path / "clip.raw")
    assert len(list(open_source(tmp_path / "clip.raw"))) == NUM_FRAMES


@pytest.mark.parametrize("path", ["", None, 5, b"drive"])
def test_what_is_no_path_is_refused(path: Any) -> None:
    """An empty text stood for the working directory."""
    for opened in (open_source, open_labelled):
        with pytest.raises(ValueError, match="path: expected the path of a file or folder, got"):
            opened(path)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.HEIC", "expected an image \\(.*\\), is HEIC or AVIF; convert it first"),
        ("a.jpg", "expected an image \\(.*\\), is HEIC or AVIF; convert it first"),
    ],
)
def test_an_image_of_a_phone_is_named(tmp_path: Path, name: str, words: str) -> None:
    """A HEIC was taken for a damaged video, or, called .jpg, for a damaged image."""
    (tmp_path / name).write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(200))
    with pytest.raises(ValueError, match=f"{name}: {words}"):
        next(iter(open_source(tmp_path / name)))


@pytest.mark.parametrize("name", ["a.png", "a.mp4", "a.mcap", "a"])
def test_a_pipe_is_called_one(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(ValueError, match=f"{name}: expected a file, is a pipe"):
        next(iter(open_source(tmp_path / name)))
    with pytest.raises(ValueError, match=f"{name}: expected .*, is a pipe"):
        PVDN(tmp_path / name)


def test_a_bag_without_its_metadata_is_told(tmp_path: Path) -> None:
    (tmp_path / "night_0.db3").write_bytes(b"SQLite format 3\0")
    with pytest.raises(
        ValueError, match=r"found none, nor the metadata.yaml of a ROS 2 bag, whose file night_0.db3 can be"
    ):
        open_source(tmp_path)
