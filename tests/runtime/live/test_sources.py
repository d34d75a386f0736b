"""Cameras, replays and other live sources by the name that a user gives them."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from av.error import FFmpegError

from benchmarks.faulty import live_config
from benchmarks.image_faults import CODINGS, encoded
from foreglow.beam.faults import GuardFault
from foreglow.datasets import Video, open_source, shipped_drive
from foreglow.datasets.vehicle_data import VehicleData
from foreglow.datasets.vehicle_logs import CanLog, VehicleFiles
from foreglow.pipeline import Pipeline
from foreglow.runs.frames_file import frame_to_line
from foreglow.runtime.live import ClosedLoop, LiveFault, Paced
from foreglow.runtime.live.cameras import CameraOptions, CaptureCamera, StreamCamera
from foreglow.runtime.live.opening import open_camera, open_live
from foreglow.types import BeamMode, Frame
from tests.runtime.live.stand_ins import Keeper, run_live
from tests.stand_ins import ListSource, night_frames, night_image


def test_paced_frames_come_at_their_times() -> None:
    frames = night_frames(8)
    paced = Paced(ListSource(frames), speed=2.0)
    assert paced.rate_hz == 20.0
    early_ns = [paced.now_ns() - frame.timestamp_ns for frame in paced]
    assert min(early_ns) >= 0
    assert not paced.is_lossless


def test_paced_clock_goes_as_fast() -> None:
    paced = Paced(ListSource(night_frames(1)), speed=50.0)
    next(iter(paced))
    before_ns, then_ns = paced.now_ns(), time.monotonic_ns()
    time.sleep(0.05)
    passed_ns, by_the_wall_ns = paced.now_ns() - before_ns, time.monotonic_ns() - then_ns
    assert passed_ns == pytest.approx(50 * by_the_wall_ns, rel=0.2)


def test_run_times_of_a_fast_replay_are_those_of_the_wall_clock() -> None:
    """They were added up in two clocks: waiting seemed as many times longer as the replay is faster."""
    configuration, keeper = live_config(), Keeper()

    class Slow:
        def __init__(self) -> None:
            self._pipeline = Pipeline(configuration)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._pipeline, name)

        def step(self, frame: Frame, **options: Any) -> Any:
            time.sleep(0.05)  # so that the last frame waits
            return self._pipeline.step(frame, **options)

    begun_s = time.monotonic()
    run_live(Paced(ListSource(night_frames(8)), speed=1000.0), configuration, Slow, sinks=[keeper])
    passed_ms = 1e3 * (time.monotonic() - begun_s)
    assert len(keeper.results) > 1
    assert all(0 <= sum(result.stage_ms.values()) < passed_ms for _, result in keeper.results)
    assert keeper.results[-1][1].stage_ms["queue"] > 0


def test_paced_sequences_each_have_their_time() -> None:
    frames = [*night_frames(3), *night_frames(3, "S00002")]
    paced = Paced(ListSource(frames), speed=20.0)
    ages_ns = [paced.now_ns() - frame.timestamp_ns for frame in paced]
    assert min(ages_ns) >= 0
    assert max(ages_ns) < 20 * 1e9


def test_a_time_that_is_hours_away_is_not_waited_for() -> None:
    frames = night_frames(6)
    frames[3:] = [dataclasses.replace(frame, timestamp_ns=frame.timestamp_ns + 7200 * 10**9) for frame in frames[3:]]
    paced = Paced(ListSource(frames))
    begun_s = time.monotonic()
    early_ns = [paced.now_ns() - frame.timestamp_ns for frame in paced]
    assert time.monotonic() - begun_s < 60
    assert min(early_ns) >= 0
    assert max(early_ns) < 60 * 1e9


def test_after_a_clock_was_set_back_frames_come_at_their_times() -> None:
    """The replay's clock stayed ahead: all images were too old until the frames had come to the time before."""
    frames = night_frames(6)
    frames[3:] = [dataclasses.replace(frame, timestamp_ns=frame.timestamp_ns - 60 * 10**9) for frame in frames[3:]]
    paced = Paced(ListSource(frames))
    assert max(paced.now_ns() - frame.timestamp_ns for frame in paced) < 30 * 10**9


def test_a_folder_that_is_removed_meanwhile_ends_early(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for frame in night_frames(6):
        cv2.imwrite(str(folder / f"{frame.frame:06d}.png"), frame.image)
    frames = iter(open_live(str(folder), CameraOptions(), speed=math.inf))
    assert len(list(itertools.islice(frames, 2))) == 2
    shutil.rmtree(folder)
    with pytest.raises(ValueError, match=r"expected images up to the end, the last 4 cannot be read: .*000004\.png"):
        next(frames)


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e-300, math.nan])
def test_impossible_speed(speed: float) -> None:
    with pytest.raises(ValueError, match="speed: expected a positive number"):
        Paced(ListSource([]), speed)


@pytest.mark.slow
def test_live_results_are_those_of_a_run_off_line(drive: list[Frame]) -> None:
    keeper = Keeper()
    source = Paced(ListSource(drive), math.inf)
    summary, _ = run_live(source, live_config(), sinks=[keeper])
    offline = Pipeline(live_config())
    expected = [frame_to_line(frame, offline.step(frame)) for frame in drive]
    found = [frame_to_line(frame, result) for frame, result in keeper.results]
    assert found == expected
    assert summary.num_dropped == 0


@pytest.mark.parametrize("speed", [1.0, math.inf])
def test_a_recorded_replay_begins_with_its_first_frame(speed: float, drive: list[Frame], tmp_path: Path) -> None:
    """A report from before it, whose clock was at 0, made the recording of a drive of today one of decades."""
    mcap_reader = pytest.importorskip("mcap.reader")
    from foreglow.runtime.mcap import McapRecorder

    class Slow(ListSource):
        def __iter__(self) -> Iterator[Frame]:
            time.sleep(0.2)  # as opening a file takes
            yield from super().__iter__()
            time.sleep(0.2)  # and the end of the last one's work

    today_ns = 1_700_000_000_000_000_000
    frames = [dataclasses.replace(one, timestamp_ns=today_ns + one.timestamp_ns) for one in drive[:20]]
    recorder = McapRecorder(tmp_path / "drive.mcap")
    run_live(Paced(Slow(frames), speed), live_config(), sinks=[recorder])
    with (tmp_path / "drive.mcap").open("rb") as file:
        messages = list(mcap_reader.make_reader(file).iter_messages())
    assert "/health" in {channel.topic for _, channel, _ in messages}
    assert min(message.log_time for _, _, message in messages) >= frames[0].timestamp_ns


def test_overload_drops_frames_and_stays_in_time(drive: list[Frame]) -> None:
    frames = [dataclasses.replace(frame, timestamp_ns=frame.timestamp_ns) for frame in drive]
    summary, _ = run_live(Paced(ListSource(frames), speed=60.0), live_config())
    assert summary.num_dropped > 0
    assert LiveFault.CAMERA_SLOW not in summary.fault_counts  # it is we who are slow
    num_given_up = summary.fault_counts.get(LiveFault.STAGE_HANGS, 0)  # on a machine that is busy otherwise
    assert 0 <= len(frames) - summary.run.num_frames - summary.num_dropped <= num_given_up


class FakeCapture:
    """OpenCV's capture of a camera that brings three frames and is then unplugged."""

    instances: list[FakeCapture] = []  # noqa: RUF012
    pixels = "MJPG"

    def __init__(self, device: int | str, backend: int) -> None:
        self.device, self.backend = device, backend
        self.properties: dict[int, float] = {}
        self.num_read, self.is_released = 0, False
        self.instances.append(self)

    def isOpened(self) -> bool:
        return self.device != 9

    def set(self, name: int, value: float) -> bool:
        self.properties[name] = value
        return True

    def get(self, name: int) -> float:
        return float(cv2.VideoWriter.fourcc(*self.pixels)) if name == cv2.CAP_PROP_FOURCC else 0.0

    def read(self) -> tuple[bool, Any]:
        self.num_read += 1
        grey = night_image(self.num_read)
        if self.pixels == "Y16 ":
            few = grey.astype(np.uint16) * np.uint16(16)
            is_whole = self.properties.get(cv2.CAP_PROP_CONVERT_RGB) == 0
            return True, few if is_whole else np.repeat((few >> 8).astype(np.uint8)[:, :, np.newaxis], 3, axis=2)
        return self.num_read <= 3, np.repeat(grey[:, :, np.newaxis], 3, axis=2)

    def release(self) -> None:
        self.is_released = True


@pytest.fixture
def capture(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FakeCapture]]:
    FakeCapture.instances = []
    monkeypatch.setattr(cv2, "VideoCapture", FakeCapture)
    yield FakeCapture.instances
    assert all(one.is_released for one in FakeCapture.instances)


def test_camera(capture: list[FakeCapture]) -> None:
    camera = open_live("camera:0", CameraOptions(size_px=(128, 96), rate_hz=18.0, delay_s=0.01))
    assert isinstance(camera, CaptureCamera)
    assert camera.is_endless
    frames: list[tuple[Frame, int]] = []
    with pytest.raises(OSError, match="camera:0: brings no more frames"):
        frames.extend((frame, camera.now_ns()) for frame in camera)
    assert len(frames) == 3
    frames.extend((frame, camera.now_ns()) for frame in itertools.islice(camera, 2))  # opened anew, numbers go on
    assert [frame.frame for frame, _ in frames] == list(range(len(frames)))
    assert all(now_ns - frame.timestamp_ns >= 10_000_000 for frame, now_ns in frames)
    assert (frames[0][0].image == night_image(1)).all()
    assert capture[0].device == 0
    assert capture[0].backend == cv2.CAP_V4L2
    assert capture[0].properties == {
        cv2.CAP_PROP_FRAME_WIDTH: 128,
        cv2.CAP_PROP_FRAME_HEIGHT: 96,
        cv2.CAP_PROP_FPS: 18.0,
        cv2.CAP_PROP_BUFFERSIZE: 1,
    }


@pytest.mark.usefixtures("capture")
def test_a_camera_that_does_not_have_the_size_that_was_asked_for() -> None:
    """OpenCV takes the nearest one that the driver has, and says nothing."""
    camera = open_live("camera:0", CameraOptions(size_px=(1280, 960)))
    with pytest.raises(OSError, match=r"camera:0: size: expected images of 1280x960, as asked for, got 128x96"):
        next(iter(camera))


@pytest.mark.usefixtures("capture")
def test_a_camera_of_16_bits_keeps_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """As OpenCV has it, one of 12 bits would have 16 grey levels."""
    monkeypatch.setattr(FakeCapture, "pixels", "Y16 ")
    (frame,) = itertools.islice(open_live("camera:0", CameraOptions()), 1)
    np.testing.assert_array_equal(frame.image, night_image(1).astype(np.uint16) * np.uint16(16))


@pytest.mark.usefixtures("capture")
def test_camera_that_is_not_there() -> None:
    with pytest.raises(OSError, match="camera:9: cannot be opened"):
        next(iter(open_live("camera:9", CameraOptions())))
    for device in ("x", "12345", "", "video0", "１"):
        with pytest.raises(ValueError, match=f"camera:{device}: expected a number, or a path"):
            open_live(f"camera:{device}", CameraOptions())
    with pytest.raises(ValueError, match="gstreamer: expected a pipeline that ends in an appsink, got none"):
        open_live("gstreamer: ", CameraOptions())


@pytest.mark.parametrize("address", ["rtsp://driver:a%2Fb:c@camera.local:554/x", "http://driver:secret@[::1]:8080/a@b"])
def test_a_password_is_in_no_name(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    """It would stand in messages, results and recordings."""
    asked: list[str] = []

    def no_stream(address: str, **_: object) -> None:
        asked.append(address)
        raise FFmpegError(5, "no such stream")

    monkeypatch.setattr("foreglow.runtime.live.cameras.av.open", no_stream)
    camera = open_live(address, CameraOptions())
    assert "driver:***@" in camera.name
    with pytest.raises(OSError, match=r"driver:\*\*\*@.*: cannot be opened") as error:
        next(iter(camera))
    assert "secret" not in str(error.value)
    assert asked == [address]


@pytest.mark.parametrize(
    ("address", "name"),
    [
        ("rtsp://h:554/user=admin&password=secret&channel=1", "rtsp://h:554/user=admin&password=***&channel=1"),
        ("srt://h:9?mode=caller&passphrase=secret", "srt://h:9?mode=caller&passphrase=***"),
        (
            "gstreamer:rtspsrc location=rtsp://u:secret@h user-pw=secret ! appsink",
            "gstreamer:rtspsrc location=rtsp://u:***@h user-pw=*** ! appsink",
        ),
        ("rtsp://h/compass=1?width=640", "rtsp://h/compass=1?width=640"),
    ],
)
def test_a_password_is_in_no_name_wherever_it_stands(address: str, name: str) -> None:
    assert open_live(address, CameraOptions()).name == name


def test_other_ways_to_name_a_camera(capture: list[FakeCapture]) -> None:
    next(iter(open_live("camera:/dev/video2", CameraOptions())))
    next(iter(open_live("gstreamer:videotestsrc ! appsink", CameraOptions())))
    assert [(one.device, one.backend) for one in capture] == [
        ("/dev/video2", cv2.CAP_V4L2),
        ("videotestsrc ! appsink", cv2.CAP_GSTREAMER),
    ]


@pytest.mark.slow
def test_paths_and_scenarios(tmp_path: Path) -> None:
    assert isinstance(open_live(str(shipped_drive()), CameraOptions()), Paced)
    drive = open_live("simulate:curve", CameraOptions(seed=3))
    assert isinstance(drive, ClosedLoop)
    assert drive.name == "curve/3"
    with pytest.raises(ValueError, match="scenario: expected one of"):
        open_live("simulate:nowhere", CameraOptions())
    with pytest.raises(FileNotFoundError):
        open_live(str(tmp_path / "none"), CameraOptions())


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://127.0.0.1:99999", "expected an address such as tcp://HOST:PORT: Port out of range 0-65535"),
        ("tcp://", "expected an address such as tcp://HOST:PORT, got no host"),
        ("http://[::1", "expected an address such as http://HOST:PORT: Invalid IPv6 URL"),
        ("rtsp://camera:one/x", "expected an address such as rtsp://HOST:PORT: Port could not be cast"),
        ("file:///etc/hosts", "expected an address with one of rtsp, "),
    ],
)
def test_an_address_at_which_no_stream_can_ever_be(address: str, said: str) -> None:
    """It was tried again for ever."""
    with pytest.raises(ValueError, match=f"^{re.escape(f'{address}: {said}')}"):
        open_live(address, CameraOptions())


@pytest.mark.parametrize(
    "address", ["udp://:5000", "udp://@239.0.0.1:5000", "rtsp://me:secret@camera/1?profile=2", "RTSP://[::1]:554/x"]
)
def test_an_address_at_which_a_stream_may_come_to_be(address: str) -> None:
    assert open_live(address, CameraOptions()).name == address.replace("secret", "***")


def test_only_cameras_and_streams_are_cameras() -> None:
    camera = open_camera("rtsp://127.0.0.1/night", CameraOptions())
    assert isinstance(camera, StreamCamera)
    assert camera.name == "rtsp://127.0.0.1/night"
    assert open_camera("simulate:curve", CameraOptions()) is None
    assert open_camera(str(shipped_drive()), CameraOptions()) is None


def test_what_the_car_knows_is_put_beside_frames() -> None:
    class Data(VehicleData):
        def camera(self, _: Frame) -> None:
            return None

        def motion(self, _: Frame) -> Any:
            from foreglow.types import EgoMotion

            return EgoMotion(20.0, 0.0)

        def road(self, _: Frame) -> None:
            return None

    source = open_live(str(shipped_drive()), CameraOptions(data=Data()), speed=math.inf)
    first = next(iter(source))
    assert first.motion is not None
    assert first.motion.speed_mps == 20.0
    assert first.camera is not None  # what the drive itself knows stays
    assert first.road is not None


@pytest.mark.parametrize("name", ["camera:0", "rtsp://127.0.0.1:1/night"])
def test_a_recorded_drive_says_nothing_of_what_the_car_does_now(name: str) -> None:
    """Its times may be near those of the machine's clock, and the guard would believe its speed."""
    log, calibrated = CanLog(), VehicleFiles()
    log.add_number("speed", 0, 25.0)
    log.add_number("yaw_rate", 0, 0.0)
    with pytest.raises(ValueError, match=rf"{name}: expected no --can-log .* with a camera: .* --can-in"):
        open_live(name, CameraOptions(data=VehicleFiles(log=log)))
    for data in (calibrated, VehicleFiles(log=log, is_live=True)):
        assert open_live(name, CameraOptions(data=data)).is_endless


def test_an_unreadable_image_of_a_folder_is_left_out(tmp_path: Path) -> None:
    for number, frame in zip(range(1, 4), open_source(shipped_drive()), strict=False):
        cv2.imwrite(str(tmp_path / f"{number}.png"), frame.image)
    (tmp_path / "2.png").write_bytes(b"no image")
    source = open_live(str(tmp_path), CameraOptions(), speed=math.inf)
    assert [frame.frame for frame in source] == [1, 3]
    assert "2.png" in source.skipped[0]


def test_the_clock_of_a_replay_before_its_first_frame() -> None:
    """A fault may be noticed then; the machine's clock says nothing of the frames' times."""
    source = Paced(ListSource([]))
    assert 0 <= source.now_ns() < 60 * 10**9


def damaged_clip(path: Path) -> Path:
    """A stream of the drive that ships that has lost some packets after a second, and is whole again at the end."""
    coding = CODINGS["H.264, 0.36 bits a pixel"]
    assert coding is not None
    images = [frame.image[440:760, 400:880].copy() for frame in open_source(shipped_drive())]
    data = encoded(images, coding, "mpegts")
    packets = [data[start : start + 188] for start in range(0, len(data), 188)]
    begin, end = len(packets) * 3 // 10, len(packets) * 6 // 10
    path.write_bytes(b"".join(packets[:begin] + packets[begin:end:7] + packets[end:]))
    return path


@pytest.mark.slow
def test_a_damaged_file_goes_on_with_low_beam(tmp_path: Path) -> None:
    path = damaged_clip(tmp_path / "night.ts")
    keeper = Keeper()
    source = open_live(str(path), CameraOptions(), speed=math.inf)
    summary, lamps = run_live(source, live_config(), sinks=[keeper])
    frames = list(Video(path, on_error="mark"))
    assert summary.run.num_frames == len(frames) > 50
    faults = [() if result.beam is None else result.beam.faults for _, result in keeper.results]
    marked = [frame.is_damaged for frame in frames]
    first = marked.index(True)
    assert GuardFault.DAMAGED in faults[first]
    assert not any(GuardFault.DAMAGED in found for found in faults[:first])
    for found, is_damaged in zip(faults, marked, strict=True):
        assert not is_damaged or {GuardFault.DAMAGED, LiveFault.CAMERA_SLOW} & set(found)  # some frames are missing
    assert not marked[-1]
    assert all(command.mode == BeamMode.LOW for command in lamps.commands if command.faults)
