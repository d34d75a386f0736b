"""A log and poses belong to one drive: those of a set whose times overlap are not given the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foreglow.datasets import PVDN, Equipped, FrameSource
from foreglow.datasets.vehicle_logs import CanLog, VehicleFiles, write_can_log
from foreglow.geometry import Camera, Pose
from foreglow.maps import PoseTrack
from foreglow.options import VehicleOptions
from foreglow.types import EgoMotion, Frame
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import IDS, edit, make_pvdn
from tests.stand_ins import ListSource

SECOND = 1_000_000_000
CAMERA = Camera(96, 72, (130.0, 130.0), (48.0, 36.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))


@pytest.fixture
def apart(tmp_path: Path) -> Path:
    """A split whose sequences begin at 1.5 and at 4.5 s."""
    return make_pvdn(tmp_path / "apart")


@pytest.fixture
def overlapping(tmp_path: Path) -> Path:
    """The same, where both begin at 1.5 s."""
    split = make_pvdn(tmp_path / "overlapping")
    edit(split / "labels/sequences.json", "sequences", 0, "start_time", value=1500)
    return split


@pytest.fixture
def can_log(tmp_path: Path) -> Path:
    pytest.importorskip("can")
    pytest.importorskip("cantools")
    path = tmp_path / "drive.log"
    write_can_log(path, [], [(k * SECOND // 10, EgoMotion(20.0, 0.0)) for k in range(60)])
    return path


def sequences(*spans_s: tuple[float, ...]) -> FrameSource:
    """Sequences A, B and so on with frames at these times."""
    image = np.zeros((72, 96), np.uint8)
    return ListSource(
        [
            Frame(image, timestamp_ns=round(time_s * SECOND), frame=k, sequence="ABC"[index])
            for index, times_s in enumerate(spans_s)
            for k, time_s in enumerate(times_s)
        ]
    )


@pytest.mark.parametrize("command", ["run", "beam", "stages", "record", "live"])
def test_a_log_of_one_drive_for_several(command: str, overlapping: Path, can_log: Path, tmp_path: Path) -> None:
    out = tmp_path / {"stages": "out.png", "record": "out.mcap"}.get(command, "out")
    frame = ("--frame", 4) if command == "stages" else ()
    line = complaint(command, overlapping, "--can-log", can_log, "--out", out, *frame)
    assert line.startswith(f"foreglow: --can-log {can_log}: expected one drive, to which such a file belongs")
    assert "that overlap in time: S00001 lasts from 1.500 to 1.556 s, S00003 begins at 1.500 s" in line
    assert line.endswith(f"; give one sequence as the source, such as {overlapping / 'images/S00001'}\n")
    assert not out.exists()


def test_one_sequence_or_sequences_apart_or_the_first_frames(overlapping: Path, apart: Path, can_log: Path) -> None:
    options = VehicleOptions(can_log=can_log)
    for split in (apart, overlapping / "images/S00003"):
        assert all(frame.motion is not None for frame in options.equip(PVDN(split)))
    options.equip(PVDN(overlapping), len(IDS["S00001"]))
    with pytest.raises(ValueError, match="--can-log"):
        options.equip(PVDN(overlapping), len(IDS["S00001"]) + 1)


def test_a_run_on_one_sequence(overlapping: Path, can_log: Path, tmp_path: Path) -> None:
    source = overlapping / "images/S00003"
    result = foreglow_command("run", source, "--can-log", can_log, "--out", tmp_path / "out", "--preset", "baseline")
    assert result.exit_code == 0, result.output


def test_a_calibration_is_of_all_drives(overlapping: Path) -> None:
    equipped = Equipped(PVDN(overlapping), VehicleFiles(camera=CAMERA))
    equipped.check()
    assert all(frame.camera is not None for frame in equipped)


def test_poses_are_named() -> None:
    poses = PoseTrack(np.array([0, SECOND]), np.zeros((2, 3)), Rotation.identity(2), has_attitude=True)
    data = VehicleFiles(poses=poses, names=("", "", "drive.csv"))
    with pytest.raises(ValueError, match=r"^--poses drive\.csv: expected one drive"):
        list(Equipped(sequences((0.0, 1.0), (0.5,)), data))


@pytest.mark.parametrize(
    ("spans_s", "is_refused"),
    [
        ([(0.0, 1.0), (1.0, 2.0)], True),
        ([(0.0, 1.0), (2.0, 3.0)], False),
        ([(2.0, 3.0), (0.0, 1.0)], False),
        ([(2.0, 3.0), (0.0, 2.5)], True),
        ([(1.0, 2.0), (0.0, 3.0)], True),
        ([(0.0,), (0.0,)], True),
        ([(0.0, 1.0), (2.0, 3.0), (0.5,)], True),
        ([(0.0, 1.0, 0.5)], False),
    ],
)
def test_sequences_of_any_source_are_told_while_they_are_read(
    spans_s: list[tuple[float, ...]], is_refused: bool
) -> None:
    log = CanLog()
    log.add_number("production", 0, 1.0)
    equipped = Equipped(sequences(*spans_s), VehicleFiles(log=log))
    if is_refused:
        with pytest.raises(ValueError, match="sequences of stand-in that overlap in time"):
            list(equipped)
    else:
        assert len(list(equipped)) == sum(map(len, spans_s))
