"""Plug-ins: found by name or given as objects, named in the configuration, and never trusted by the guard."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.beam import POLICIES, BeamPolicy, policy_class
from foreglow.beam.faults import GuardFault
from foreglow.beam.policy import HighBeam
from foreglow.config import PipelineConfig, TrackerConfig, preset, read_config
from foreglow.datasets import PVDN, shipped_drive
from foreglow.distance import RangeEstimator, make_estimator
from foreglow.photometry import NUM_LEDS
from foreglow.pipeline import MAX_TRACKS, Pipeline
from foreglow.plugins import find, make
from foreglow.runtime.live import LiveFault, Paced
from foreglow.tracking import Tracker, make_tracker
from foreglow.types import BeamCommand, BeamMode, Detections, Frame, Ranges, Tracks
from tests.cli.commands import complaint
from tests.runtime.live.stand_ins import run_live
from tests.stand_ins import ListSource
from tests.test_pipeline import identity

pytestmark = pytest.mark.slow

GROUP = "foreglow.trackers"


def shipped_frames(count: int) -> list[Frame]:
    dataset = PVDN(shipped_drive())
    return [dataset.read(image_id) for image_id in dataset.frame_ids[60 : 60 + count]]


class FarAway(RangeEstimator):
    """Everything is 80 m away."""

    def __init__(self, config: Any = None) -> None:  # noqa: ARG002
        self.num_resets = 0

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:  # noqa: ARG002
        return Ranges(detections, np.full(len(detections), 80.0), np.full(len(detections), 8.0))

    def reset(self) -> None:
        self.num_resets += 1


class NoTracks(Tracker):
    """Follows nothing."""

    def __init__(self, config: Any = None) -> None:  # noqa: ARG002
        self._tracker = make_tracker(TrackerConfig(min_score=0.999999))

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
        return self._tracker.update(frame, detections, ranges)


class AllLight(BeamPolicy):
    """Full high beam, always."""

    def __init__(self, config: Any, headlamps: Any) -> None:  # noqa: ARG002
        self._num_leds = headlamps.num_leds

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:  # noqa: ARG002
        return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, self._num_leds)))


# Names


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, which is not on Python's path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    return tmp_path


def write_module(folder: Path, name: str, text: str) -> None:
    (folder / f"{name}.py").write_text(text)
    sys.modules.pop(name, None)


def test_a_name_of_the_table_is_never_imported() -> None:
    assert find("field", "math:pi", {"math:pi": float}, GROUP) is float


def test_a_module_in_the_working_directory(folder: Path) -> None:
    write_module(folder, "my_own_trackers", "class Mine:\n    class Inner: pass\n")
    assert find("tracker.method", "my_own_trackers:Mine", {}, GROUP).__name__ == "Mine"
    assert find("tracker.method", "my_own_trackers:Mine.Inner", {}, GROUP).__name__ == "Inner"


def test_a_plug_in_that_goes_to_another_folder_takes_nobody_with_it(folder: Path) -> None:
    """When it is imported or made: a relative --out was elsewhere then."""
    away = "import os, tempfile\nos.chdir(tempfile.gettempdir())\n"
    write_module(folder, "my_leaving_trackers", f"{away}class Mine:\n    def __init__(self): os.chdir('/')\n")
    assert find("tracker.method", "my_leaving_trackers:Mine", {}, GROUP).__name__ == "Mine"
    assert Path.cwd() == folder
    make("tracker.method", "my_leaving_trackers:Mine", {}, GROUP, methods={})
    assert Path.cwd() == folder


def test_an_installed_packages_entry_point(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_module(folder, "their_package", "class Theirs: pass\n")
    about = folder / "their_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{GROUP}]\ntheirs = their_package:Theirs\n")
    monkeypatch.syspath_prepend(folder)
    assert find("tracker.method", "theirs", {}, GROUP).__name__ == "Theirs"
    with pytest.raises(ValueError, match=r"tracker\.method: expected one of ours, theirs, or module:Name, got 'best'"):
        find("tracker.method", "best", {"ours": int}, GROUP)


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("best", "expected one of alpha_beta, published, or module:Name, got 'best'"),
        ("no_such_module:Name", "no_such_module:Name cannot be imported: ModuleNotFoundError: .*no_such_module"),
        ("broken_tracker:Name", "broken_tracker:Name cannot be imported: ZeroDivisionError: division by zero"),
        ("math:Name", "math:Name cannot be imported: AttributeError: .*'Name'"),
        ("two words:Name", "two words:Name cannot be imported: ValueError: "),
        ("math:pi", "math:pi: expected a class, got float"),
    ],
)
def test_a_name_that_is_none_is_refused_with_its_field(folder: Path, name: str, complaint: str) -> None:
    write_module(folder, "broken_tracker", "1 / 0\n")
    path = folder / "car.toml"
    path.write_text(f'[tracker]\nmethod = "{name}"\n')
    config = read_config(path, preset("foreglow"))
    with pytest.raises(ValueError, match=f"^tracker.method: {complaint}"):
        Pipeline(config)


def test_every_kind_names_its_own_field() -> None:
    config = preset("foreglow")
    with pytest.raises(ValueError, match=r"^distance\.estimator: expected one of gp, .*road_surface, or module:Name"):
        make_estimator(config.changed("distance", estimator="best").distance)
    with pytest.raises(ValueError, match=r"^--policy: expected one of low, high, paper, foreglow, or module:Name"):
        policy_class("best", "--policy")


# Stages


def test_plug_ins_by_name_class_and_object_are_the_same() -> None:
    frames = shipped_frames(4)
    here = "tests.test_plugins"
    config = preset("foreglow").changed("distance", estimator=f"{here}:FarAway")
    named = config.changed("tracker", method=f"{here}:NoTracks").commanding(policy=f"{here}:AllLight")
    by_name = [identity(result) for result in Pipeline(named).run(frames)]
    classes = Pipeline(estimator=FarAway, tracker=NoTracks, policy=AllLight)
    objects = Pipeline(named, estimator=FarAway(), tracker=NoTracks())
    assert classes.config == objects.config == named
    assert [identity(result) for result in classes.run(frames)] == by_name
    assert [identity(result) for result in objects.run(frames)] == by_name
    result = classes.step(frames[0])
    assert result.ranges is not None
    assert set(result.ranges.ranges_m.tolist()) == {80.0}
    assert result.tracks is not None
    assert len(result.tracks) == 0


def test_a_given_object_is_used_and_reset() -> None:
    estimator = FarAway()
    pipeline, frame = Pipeline(estimator=estimator), shipped_frames(1)[0]
    pipeline.step(frame)
    pipeline.reset()
    pipeline.step(frame)
    assert estimator.num_resets == 2


def test_a_policy_needs_tracks() -> None:
    with pytest.raises(ValueError, match=r"beam: expected a model .* and a tracker"):
        Pipeline(PipelineConfig(), policy=AllLight)


@pytest.mark.parametrize(
    ("section", "kind", "method", "complaint"),
    [
        ("estimator", FarAway, "estimate", "distance.estimator: expected Ranges for each frame, got NoneType"),
        ("tracker", NoTracks, "update", "tracker.method: expected Tracks for each frame, got NoneType"),
        ("policy", AllLight, "command", "beam.policy: expected BeamCommand for each frame, got NoneType"),
    ],
)
def test_what_a_plug_in_returns_is_checked(section: str, kind: Any, method: str, complaint: str) -> None:
    plugin: dict[str, Any] = {section: type("Silent", (kind,), {method: lambda *_: None})}
    with pytest.raises(ValueError, match=complaint):
        Pipeline(**plugin).step(shipped_frames(1)[0])


@pytest.mark.parametrize(
    ("kind", "methods"),
    [("estimator", "estimate, reset"), ("tracker", "update, reset"), ("policy", "command, shone, reset")],
)
@pytest.mark.parametrize("made", ["None", "object()", "type('Mute', (), {})"])
def test_a_function_has_to_make_what_is_expected(folder: Path, kind: str, methods: str, made: str) -> None:
    write_module(folder, "foreign", f"def anything(*arguments):\n    return {made}\n")
    section, field = {"estimator": ("distance", kind), "tracker": (kind, "method"), "policy": ("beam", kind)}[kind]
    config = preset("foreglow").changed(section, **{field: "foreign:anything"})
    with pytest.raises(ValueError, match=rf"{section}\.{field}: foreign:anything: expected .* {methods}; .* lacks "):
        Pipeline(config)
    given: Any = {kind: lambda *_: None}
    with pytest.raises(ValueError, match=rf"^{kind}: expected a class, .* methods {methods}; function lacks"):
        Pipeline(**given)


OTHERS = {
    "estimator": ("estimate", "(self, frame)", "estimate(frame, detections), got estimate(frame)"),
    "tracker": ("update", "(self, frame, detections, ranges, more)", "update(frame, detections, ranges), got update("),
    "policy": ("shone", "(self)", "shone(command), got shone()"),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_a_method_that_is_called_otherwise(folder: Path, kind: str) -> None:
    """It was a TypeError of our own call, and as such a fault of ours."""
    method, parameters, expected = OTHERS[kind]
    base = {"estimator": "FarAway", "tracker": "NoTracks", "policy": "AllLight"}[kind]
    made = f"class Other({base}):\n    def {method}{parameters}: pass\n"
    write_module(folder, "otherwise", f"from tests.test_plugins import {base}\n{made}")
    section, field = {"estimator": ("distance", kind), "tracker": (kind, "method"), "policy": ("beam", kind)}[kind]
    config = folder / "car.toml"
    config.write_text(f'[{section}]\n{field} = "otherwise:Other"\n')
    calibration = shipped_drive() / "simulation" / "S00001" / "camera.toml"
    arguments = ("--limit", 1, "--config", config, "--calibration", calibration, "--out", folder / "out")
    line = complaint("beam", shipped_drive(), *arguments)
    assert line.startswith(f"foreglow: {config}: {section}.{field}: otherwise:Other: expected Other.{expected}")
    assert not (folder / "out").exists()
    other: Any = find("field", "otherwise:Other", {}, GROUP)
    given: Any = {kind: other}
    with pytest.raises(ValueError, match=re.escape(f"{kind}: expected Other.{expected}")):
        Pipeline(**given)


def test_a_method_may_take_more_or_anything() -> None:
    class Generous(NoTracks):
        @staticmethod
        def reset(*_: Any, **__: Any) -> None:
            pass

        def update(self, *given: Any, extra: int = 0) -> Tracks:
            return super().update(*given) if not extra else None  # type: ignore[return-value]

    for plugin in (Generous, Generous()):
        Pipeline(tracker=plugin)


def test_a_function_that_makes_a_tracker_is_one(folder: Path) -> None:
    write_module(
        folder, "maker", "def made(config):\n    from tests.test_plugins import NoTracks\n    return NoTracks()"
    )
    tracks = Pipeline(preset("foreglow").changed("tracker", method="maker:made")).step(shipped_frames(1)[0]).tracks
    assert tracks is not None
    assert len(tracks) == 0


def test_what_fails_when_it_is_made_is_no_fault_of_ours(tmp_path: Path) -> None:
    line = complaint("beam", shipped_drive(), "--policy", "json:JSONDecoder.decode", "--out", tmp_path / "out")
    assert re.search(r"json/decoder\.py, line \d+: the plug-in raised AttributeError", line)  # a module of json's
    line = complaint("beam", shipped_drive(), "--policy", "builtins:divmod", "--out", tmp_path / "out")
    assert "beam.policy: builtins:divmod cannot be made of BeamConfig, Headlamps: unsupported" in line


class ManyTracks(NoTracks):
    """Follows far more than there is."""

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:  # noqa: ARG002
        count = MAX_TRACKS + 1
        wholes, numbers = np.ones(count, np.int64), np.ones(count)
        boxes = np.tile([1.0, 1.0, 5.0, 5.0], (count, 1))
        ids = np.arange(count)
        return Tracks(ids, wholes, boxes, numbers, wholes, wholes, numbers, numbers, numbers, -wholes)


def test_too_many_tracks_are_refused() -> None:
    with pytest.raises(
        ValueError, match=rf"tracker\.method: expected at most {MAX_TRACKS} tracks of a frame, got 2001"
    ):
        Pipeline(tracker=ManyTracks).step(shipped_frames(1)[0])


class Astray(NoTracks):
    """Says that a track has a box that is not there."""

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:  # noqa: ARG002
        whole, number = np.ones(1, np.int64), np.ones(1)
        there = whole * len(detections)
        return Tracks(
            whole, whole, np.array([[1.0, 1.0, 5.0, 5.0]]), number, whole, whole, number, number, number, there
        )


def test_tracks_of_boxes_that_are_not_there_are_refused() -> None:
    with pytest.raises(ValueError, match=r"tracker\.method: expected tracks of the (\d+) boxes .*, got box \1$"):
        Pipeline(tracker=Astray).step(shipped_frames(1)[0])


def test_vehicles_in_no_state_end_a_command_where_they_are_made(folder: Path) -> None:
    """They were written as they are, which failed where nobody knew of the plug-in any more."""
    (folder / "stateless.py").write_text(
        "import numpy as np\nfrom foreglow import Tracks, Vehicles\nfrom tests.test_plugins import NoTracks\n"
        "class Stateless(NoTracks):\n"
        "    def update(self, frame, detections, ranges):\n"
        "        whole, number = np.ones(1, np.int64), np.ones(1)\n"
        "        vehicles = Vehicles(whole, 99 * whole, number, whole > 0, whole, whole - 1)\n"
        "        box = np.array([[1.0, 1.0, 5.0, 5.0]])\n"
        "        return Tracks(whole, whole, box, *[number, whole, whole, number, number, number, -whole],\n"
        "                      vehicles=vehicles)\n"
    )
    (folder / "car.toml").write_text('[tracker]\nmethod = "stateless:Stateless"\n')
    arguments = ("--limit", 1, "--config", folder / "car.toml", "--out", folder / "out")
    line = complaint("run", shipped_drive(), *arguments)
    assert "stateless.py, line 7: the plug-in raised ValueError: Vehicles.states: expected numbers from 0 to 2" in line


# The guard


def test_the_guard_sees_every_command_of_a_foreign_policy() -> None:
    frames = shipped_frames(30)
    found = [result.beam for result in Pipeline(policy=AllLight).run(frames)]
    expected = [result.beam for result in Pipeline(preset("foreglow").commanding(policy="high")).run(frames)]
    assert POLICIES["high"] is HighBeam
    for own, ours in zip(found, expected, strict=True):
        assert own is not None
        assert ours is not None
        np.testing.assert_array_equal(own.levels, ours.levels)
    assert found[-1] is not None
    assert 0.0 < found[-1].levels.min() < found[-1].levels.max() == 1.0  # dark where vehicles are


def _raises(_: Frame) -> BeamCommand:
    raise KeyError("planted")


def _nothing(_: Frame) -> Any:
    return None


def _too_many_leds(frame: Frame) -> BeamCommand:
    return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, 999)))


def _too_bright(frame: Frame) -> BeamCommand:
    return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.full((2, NUM_LEDS), math.nan))


def _of_another_frame(frame: Frame) -> BeamCommand:
    return BeamCommand(frame.timestamp_ns - 1, BeamMode.FULL, np.ones((2, NUM_LEDS)))


@pytest.mark.parametrize(
    ("command", "fault"),
    [
        (_raises, LiveFault.STAGE_FAILED),
        (_nothing, LiveFault.STAGE_FAILED),
        (_too_bright, LiveFault.STAGE_FAILED),
        (_too_many_leds, GuardFault.BAD_COMMAND),
        (_of_another_frame, GuardFault.STALE_COMMAND),
    ],
)
def test_nonsense_of_a_foreign_policy_is_low_beam_in_live(
    command: Callable[[Frame], BeamCommand], fault: LiveFault | GuardFault
) -> None:
    class Nonsense(AllLight):
        """Sensible for 25 frames, which is enough for light."""

        def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
            return super().command(frame, tracks) if frame.frame in sensible else command(frame)

    frames = shipped_frames(30)
    sensible = {frame.frame for frame in frames[:25]}
    config = preset("foreglow").commanding()
    summary, lamps = run_live(Paced(ListSource(frames), math.inf), config, lambda: Pipeline(config, policy=Nonsense))
    modes = {timestamp_ns: beam.mode for timestamp_ns, beam in lamps.of_frames().items()}
    assert modes[frames[24].timestamp_ns] != BeamMode.LOW
    assert {modes[frame.timestamp_ns] for frame in frames[25:]} == {BeamMode.LOW}
    assert fault in summary.fault_counts


def test_what_takes_other_arguments(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text('[tracker]\nmethod = "os:system"\n')
    line = complaint("run", shipped_drive(), "--limit", 1, "--config", path, "--out", tmp_path / "out")
    assert "tracker.method: os:system cannot be made of" in line


def test_a_plug_in_that_raises_in_another_process_is_named(tmp_path: Path) -> None:
    (tmp_path / "failing.py").write_text(
        "from foreglow.tracking import make_tracker\nfrom foreglow.config import TrackerConfig\n"
        "class Failing:\n"
        "    def __init__(self, config): self.reset = make_tracker(TrackerConfig()).reset\n"
        "    def reset(self): pass\n"
        "    def update(self, *given): raise IndexError('no more')\n"
    )
    (tmp_path / "config.toml").write_text('[tracker]\nmethod = "failing:Failing"\n')
    done = subprocess.run(
        [*(sys.executable, "-m", "foreglow.cli", "run", shipped_drive()), "--config", "config.toml", "--jobs", "2"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "failing.py, line 6: the plug-in raised IndexError: no more" in done.stderr
