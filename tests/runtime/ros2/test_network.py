"""Real processes, real topics: the network makes what the pipeline makes, and outlives the death of a node."""

from __future__ import annotations

import dataclasses
import itertools
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.calibration import calibration_to_toml
from foreglow.config import PipelineConfig, preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.pipeline import Pipeline
from foreglow.types import BeamMode, EgoMotion, Frame, FrameResult

pytest.importorskip("rclpy")

from foreglow.runtime.ros2 import STAGE_NODES
from foreglow.runtime.ros2.measurement import WHOLE, Answer, Command, Network
from foreglow.runtime.ros2.node import BAD_MESSAGE, INPUT_MISSING
from foreglow.runtime.ros2.supervisor import HUNG
from tests.cli.commands import complaint
from tests.linux import needs_processes

pytestmark = [
    pytest.mark.ros,
    pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning"),  # rclpy's own
    pytest.mark.usefixtures("domain"),
]

# A busy machine is late; what is wanted here is what is computed, not when.
STEP_NS = 55_555_556
WAITING = ("--patience", "10")
PATIENT = ("--deadline", "10")


def patient_config() -> PipelineConfig:
    config = preset("foreglow").commanding()
    return config.changed("guard", max_age_s=10.0, max_gap_s=10.0).changed("live", abandon_s=100.0)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(itertools.islice(PVDN(shipped_drive()), 20, 45))


def in_process(config: PipelineConfig, frames: list[Frame]) -> list[FrameResult]:
    pipeline, results, sequence = Pipeline(config), [], None
    for frame in frames:
        if frame.sequence != sequence:
            pipeline.reset()
            sequence = frame.sequence
        results.append(pipeline.step(frame))
    return results


def same(array: object, other: object) -> None:
    np.testing.assert_array_equal(array, other)


def assert_same(answer: Answer, result: FrameResult) -> None:
    assert answer.detections is not None
    assert result.detections is not None
    for name in ("boxes_xyxy_px", "scores", "direct_probabilities"):
        same(getattr(answer.detections, name), getattr(result.detections, name))
    assert answer.ranges is not None
    assert result.ranges is not None
    same(answer.ranges.ranges_m, result.ranges.ranges_m)
    same(answer.ranges.sigmas_m, result.ranges.sigmas_m)
    assert answer.tracks is not None
    assert result.tracks is not None
    for name in {field.name for field in dataclasses.fields(result.tracks)} - {"vehicles"}:
        same(getattr(answer.tracks, name), getattr(result.tracks, name))
    assert answer.tracks.vehicles is not None
    assert result.tracks.vehicles is not None
    for field in dataclasses.fields(result.tracks.vehicles):
        same(getattr(answer.tracks.vehicles, field.name), getattr(result.tracks.vehicles, field.name))
    assert answer.beam is not None
    assert result.beam is not None
    assert (answer.beam.mode, answer.beam.faults) == (result.beam.mode, result.beam.faults)
    for name in ("levels", "gaps_rad", "gap_ranges_m"):
        same(getattr(answer.beam, name), getattr(result.beam, name))


@pytest.mark.parametrize("nodes", [STAGE_NODES, WHOLE], ids=["stages", "whole"])
def test_the_network_makes_what_the_pipeline_makes(nodes: tuple[str, ...], frames: list[Frame]) -> None:
    config = patient_config()
    again = [dataclasses.replace(frame, sequence="other", motion=None, road=None) for frame in frames[:5]]
    nose_up = EgoMotion(30.0, 0.0, 0.5)  # of no car: whoever knows the pitch takes the speed for unknown
    sent = [*frames, *again, *(dataclasses.replace(frame, sequence="up", motion=nose_up) for frame in frames[5:10])]
    options = dict.fromkeys(nodes, WAITING) | {nodes[-1]: (*WAITING, *PATIENT)}
    with Network(config, nodes, options=options) as network:
        network.warm_up(frames[0])
        answers = network.run(sent, is_in_step=True)
    results = in_process(config, sent)
    assert any(len(result.tracks or ()) for result in results)
    assert any(result.beam is not None and result.beam.mode != BeamMode.LOW for result in results)
    for answer, result in zip(answers, results, strict=True):
        assert_same(answer, result)


def test_a_killed_node_means_low_beam_and_comes_back(frames: list[Frame]) -> None:
    with Network(patient_config(), keeps_results=False) as network:
        network.warm_up(frames[0])
        for victim in STAGE_NODES:
            network.run(killing(network, frames, victim))


def endless(frames: list[Frame]) -> Iterator[Frame]:
    """Frames at full rate, over and over.

    Each has noise of its own: of 25 images over and over, of which a busy machine drops some, a guard knows the rest.
    """
    noise = np.random.default_rng(1)
    for k, frame in enumerate(itertools.cycle(frames)):
        noisy = cv2.add(frame.image, noise.integers(0, 4, frame.image.shape, np.uint8))
        image, time_ns = np.asarray(noisy, np.uint8), k * STEP_NS
        yield dataclasses.replace(frame, image=image, timestamp_ns=time_ns, sequence="long")


def killing(network: Network, frames: list[Frame], victim: str) -> Iterator[Frame]:
    """Frames at full rate; once there is light a node is killed, until there is light again."""
    turns = endless(frames)
    commands = network.commands

    def until(is_meant: Callable[[Command], bool]) -> Iterator[Frame]:
        """A minute at most."""
        since = len(commands)
        for frame in itertools.islice(turns, 18 * 60):
            if any(map(is_meant, commands[since:])):
                return
            yield frame
        counted = Counter((one.beam.mode.name, one.beam.faults) for one in commands[since:])
        raise AssertionError((victim, is_meant.__name__, counted, network.processes[victim].popen.poll()))

    def is_lit(one: Command) -> bool:
        return one.beam.mode != BeamMode.LOW

    def lacks_input(one: Command) -> bool:  # a busy machine may drop so many images that other faults come first
        return INPUT_MISSING in one.beam.faults

    yield from until(is_lit)
    process = network.processes[victim].popen
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    killed, killed_ns = len(commands), time.time_ns()
    if victim != "beam":  # there it is the lamps' own timeout that ends the light
        yield from until(lacks_input)
        index = next(index for index in range(killed, len(commands)) if lacks_input(commands[index]))
        low, before = commands[index], commands[index - 1]
        assert low.beam.mode == BeamMode.LOW
        # After the last image that was on its way, late on a busy machine. How soon is the benchmark's to say.
        assert low.received_ns - max(before.received_ns, killed_ns) < 1e9
    yield from itertools.islice(turns, 9)  # what was on its way when the process died
    yield from until(is_lit)
    assert network.processes[victim].popen.pid != process.pid


HANGS_ONCE = """
import pathlib, time
from foreglow.distance import GroundPlane

class HangsOnce(GroundPlane):
    def estimate(self, frame, detections):
        here = pathlib.Path(__file__).with_name("hung")
        if frame.sequence == "long" and not here.exists():
            here.touch()
            time.sleep(600)
        return super().estimate(frame, detections)
"""


@pytest.mark.parametrize(("nodes", "name"), [(STAGE_NODES, "distance"), (WHOLE, "pipeline")], ids=["stages", "whole"])
def test_a_node_that_hangs_ends_and_comes_back(
    nodes: tuple[str, ...],
    name: str,
    frames: list[Frame],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """It hung for good, and no other node could help it."""
    (tmp_path / "hanging.py").write_text(HANGS_ONCE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    config = preset("foreglow").commanding().changed("distance", estimator="hanging:HangsOnce")
    with Network(config, nodes, keeps_results=False) as network:
        network.warm_up(frames[0])
        hanging = network.processes[name].popen
        turns = endless(frames)

        def until(is_done: Callable[[], bool]) -> Iterator[Frame]:
            """A minute at most."""
            yield from itertools.takewhile(lambda _: not is_done(), itertools.islice(turns, 18 * 60))
            assert is_done(), [one.beam.faults for one in network.commands[-5:]]

        network.run(until(lambda: network.processes[name].popen is not hanging))
        assert hanging.returncode == HUNG
        assert f"foreglow: stage_hangs: {name}: distance; start again" in capfd.readouterr().err
        since = len(network.commands)
        network.run(until(lambda: any(not one.beam.faults for one in network.commands[since:])))


def foreglow(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "foreglow.cli", "ros2", *arguments]


def test_one_command_runs_a_drive_to_its_end() -> None:
    done = subprocess.run(
        foreglow("all", str(shipped_drive()), "--limit", "5"), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_one_command_scales_the_calibration(tmp_path: Path, frames: list[Frame]) -> None:
    camera = frames[0].camera
    assert camera is not None
    twice, other = tmp_path / "twice.toml", tmp_path / "other.toml"
    twice.write_text(calibration_to_toml(camera.scaled(2 * camera.width_px, 2 * camera.height_px)))
    other.write_text(calibration_to_toml(dataclasses.replace(camera, height_px=camera.height_px - 60)))
    line = ("all", str(shipped_drive()), "--limit", "5", "--calibration")
    done = subprocess.run(foreglow(*line, str(twice)), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert BAD_MESSAGE not in done.stderr
    assert f"{other}: image: expected the frames' size or its multiple" in complaint("ros2", *line, other)


def test_what_cannot_be_played_is_said_at_once(tmp_path: Path) -> None:
    assert "no such file" in complaint("ros2", "all", tmp_path / "no")


def test_what_a_source_leaves_out_is_said(tmp_path: Path, frames: list[Frame]) -> None:
    """It was played as if that were all, and a source without any readable image as if it had none."""
    line = foreglow("source", str(tmp_path), "--on-error", "skip")
    (tmp_path / "1.png").write_bytes(b"no image")
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"{tmp_path}: expected a readable frame; {tmp_path / '1.png'}: " in done.stderr
    cv2.imwrite(str(tmp_path / "0.png"), frames[0].image)
    done = subprocess.run(line, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"1 skipped as unreadable, the first: {tmp_path / '1.png'}: ")


@needs_processes
def test_no_node_outlives_the_command() -> None:
    with subprocess.Popen(foreglow("all", str(shipped_drive()), "--loop"), stderr=subprocess.DEVNULL) as command:
        children: list[str] = []
        wait_until(lambda: len(children_of(command.pid)) == len(STAGE_NODES) + 1)
        children = children_of(command.pid)
        command.kill()
        command.wait()
    wait_until(lambda: not any(is_alive(child) for child in children))


def children_of(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()


def is_alive(pid: str) -> bool:
    try:
        return b"foreglow.cli" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def wait_until(is_done: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 60
    while not is_done():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def test_the_detector_has_become_two_nodes() -> None:
    line = complaint("ros2", "detector", "--preset", "paper")
    assert "foreglow ros2 proposals and foreglow ros2 classifier" in line


def test_other_options_are_refused(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from foreglow.cli import app

    result = CliRunner().invoke(app, ["ros2", "distance", "--nothing", str(tmp_path)])
    assert result.exit_code == 2
    assert "--nothing: no such option" in result.output
