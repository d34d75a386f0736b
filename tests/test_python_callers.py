"""Public functions refuse an argument of another kind by its name; no error of Python's or NumPy's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from foreglow import BeamPolicy, Pipeline, propose
from foreglow.beam import BeamStage, make_policy, occurrence
from foreglow.beam.messages import CommandEncoder, decode_gaps, decode_levels, decode_part, encode_levels
from foreglow.beam.receiver import LampReceiver
from foreglow.classifier import OnnxClassifier
from foreglow.config import BeamConfig, GuardConfig, preset
from foreglow.datasets import Equipped, ImageFolder, PVDNWriter, Selection, open_labelled, part_of, shipped_drive
from foreglow.datasets.exchange import labels_of, read_labels_file, write_labels_file
from foreglow.datasets.simulated import read_truth
from foreglow.datasets.vehicle_logs import open_vehicle_data, read_can_log, write_can_log
from foreglow.display.overlay import annotate
from foreglow.display.video import Movie
from foreglow.distance import make_estimator
from foreglow.lab.evaluation import break_down, match_lights
from foreglow.maps import RoadMap, read_poses, read_road_map
from foreglow.parallel import Local
from foreglow.photometry import read_headlamps
from foreglow.proposals import make_proposer
from foreglow.runs.frames_file import read_tracks
from foreglow.runs.predictions import write_predictions
from foreglow.runs.recorded_run import RecordedRun
from foreglow.runtime import OutputFolder, run
from foreglow.runtime.live import LiveLoop, Paced
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.tracking import TRACKERS, make_tracker
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, Tracks
from tests.stand_ins import REFERENCE, ListSource, night_frames, night_image, result_of, tracks_of

WRONG: dict[str, Any] = {
    "none": None,
    "text": "x\0",
    "number": -1.5,
    "nan": math.nan,
    "mapping": {},
    "object": object(),
    "class": int,
    "array": np.zeros((2, 3)),
    "empty": np.zeros(0),
}

Call = Callable[[Any], object]

FRAMES = night_frames(2)
FRAME, RESULT = FRAMES[0], result_of(FRAMES[0], [[1, 2, 10, 12]], [0.7])
DETECTIONS: Any = RESULT.detections
LOW = BeamCommand.low(0, 84)
LAMPS, LIT = read_headlamps(), BeamConfig(policy="paper")
LEVELS, *_, GAPS = CommandEncoder().frames(LOW)
PIPELINE = Pipeline(REFERENCE)
SHIPPED: Any = shipped_drive()
NOTHING: Any = None
"""Beside something wrong, which is found first."""


def loop(**changed: Any) -> LiveLoop:
    config = preset("foreglow").commanding()
    known: dict[str, Any] = {
        "source": Paced(ListSource([]), math.inf),
        "make_pipeline": lambda: Pipeline(config),
        "config": config,
    }
    return LiveLoop(**(known | changed))


def recorded() -> RecordedRun:
    return RecordedRun(SHIPPED, SimpleNamespace(source="drive.mp4"), REFERENCE, {})  # type: ignore[arg-type]


CALLS: dict[str, tuple[str, Call, str]] = {
    "run": ("source", lambda wrong: run(wrong, PIPELINE, None), ""),
    "run pipeline": ("pipeline", lambda wrong: run(ListSource(FRAMES), wrong, None), ""),
    "run sinks": ("sinks", lambda wrong: run(ListSource(FRAMES), PIPELINE, None, sinks=[wrong]), ""),
    "run folder": ("folder", lambda wrong: run(ListSource(FRAMES), PIPELINE, wrong), "none"),
    "frames": ("frames", lambda wrong: list(PIPELINE.run(wrong)), "mapping"),
    "now_ns": ("now_ns", lambda wrong: PIPELINE.step(FRAME, now_ns=wrong), "none class"),
    "faults": ("faults", lambda wrong: PIPELINE.step(FRAME, faults=wrong), ""),
    "section": ("section", lambda wrong: REFERENCE.changed(wrong), ""),
    "live source": ("source", lambda wrong: loop(source=wrong), ""),
    "a source that is not replayed": ("source", lambda _: loop(source=ListSource(FRAMES)), ""),
    "live config": ("config", lambda wrong: loop(config=wrong), ""),
    "outputs": ("outputs", lambda wrong: loop(outputs=[wrong]), ""),
    "live sinks": ("sinks", lambda wrong: loop(sinks=[wrong]), ""),
    "beat": ("beat", lambda wrong: loop(beat=wrong), "class"),
    "give_up_s": ("give_up_s", lambda wrong: loop(give_up_s=wrong), "none"),
    "limit": ("limit", lambda wrong: loop().run(wrong), "none"),
    "make_pipeline": ("make_pipeline", lambda wrong: loop(make_pipeline=lambda: wrong).run(), ""),
    "replay": ("source", lambda wrong: Paced(wrong), ""),
    "speed": ("speed", lambda wrong: Paced(ListSource(FRAMES), wrong), ""),
    "camera": ("rate_hz", lambda wrong: CameraOptions(rate_hz=wrong), "none"),
    "jobs": ("jobs", lambda wrong: Local(wrong), ""),
    "frame of a result": ("FrameResult.frame", lambda wrong: FrameResult(wrong, 0, RESULT.proposals, None), ""),
    "proposals": ("FrameResult.proposals", lambda wrong: FrameResult(0, 0, wrong, None), ""),
    "image below": ("image", lambda wrong: RESULT.plot(wrong), "none array"),
    "axes": ("axes", lambda wrong: RESULT.plot(axes=wrong), "none"),
    "LEDs": ("num_leds", lambda wrong: BeamCommand.low(0, wrong), ""),
    "command": ("command", lambda wrong: CommandEncoder().frames(wrong), ""),
    "counter": ("counter", lambda wrong: encode_levels(LOW, wrong), ""),
    "CAN frames": ("frames", lambda wrong: decode_levels([wrong]), ""),
    "identifier": ("frame_id", lambda wrong: decode_gaps(wrong, GAPS.data), ""),
    "data": ("data", lambda wrong: decode_part(LEVELS.frame_id, wrong), ""),
    "receiver": ("frame_id", lambda wrong: LampReceiver().receive(0, wrong, GAPS.data), ""),
    "beam": ("config", lambda wrong: BeamStage(wrong, GuardConfig()), ""),
    "guard": ("guard", lambda wrong: BeamStage(LIT, wrong), ""),
    "policy": ("config", lambda wrong: make_policy(wrong, LAMPS), ""),
    "tracks": ("tracks", lambda wrong: make_policy(LIT, LAMPS).command(FRAME, wrong), ""),
    "road": ("road", lambda wrong: occurrence(wrong, 50.0), ""),
    "tracker": ("config", make_tracker, ""),
    "boxes": ("detections", lambda wrong: make_tracker(REFERENCE.tracker).update(FRAME, wrong, None), ""),
    "published": ("detections", lambda wrong: TRACKERS["published"](REFERENCE.tracker).update(FRAME, wrong, None), ""),
    "estimator": ("config", make_estimator, ""),
    "ranges": ("detections", lambda wrong: make_estimator(REFERENCE.distance).estimate(FRAME, wrong), ""),
    "proposer": ("config", make_proposer, ""),
    "image": ("image", lambda wrong: make_proposer(REFERENCE.proposals).propose(wrong), ""),
    "classifier": ("config", OnnxClassifier, ""),
    "picture": ("result", lambda wrong: annotate(FRAME, wrong), ""),
    "fps": ("fps", lambda wrong: Movie("movie.mp4", wrong), "none"),
    "images": ("path", ImageFolder, ""),
    "labels": ("path", read_labels_file, ""),
    "part": ("name", lambda wrong: part_of(ListSource(FRAMES), "x" if np.ndim(wrong) else wrong), ""),
    "sequence": ("directory", lambda wrong: part_of(open_labelled(SHIPPED), wrong), ""),
    "data set": ("dataset", labels_of, ""),
    "labels to write": ("labels", lambda wrong: write_labels_file("labels.json", wrong, "coco"), ""),
    "truth": ("root", read_truth, ""),
    "white": ("white_level", lambda wrong: open_labelled(SHIPPED, wrong), "none"),
    "writer": ("root", PVDNWriter, ""),
    "scenes": ("Selection.scenes", lambda wrong: Selection(scenes=wrong), "none mapping empty"),
    "equipped": ("source", lambda wrong: Equipped(wrong, NOTHING), ""),
    "car": ("data", lambda wrong: Equipped(ListSource(FRAMES), wrong), ""),
    "log": ("path", read_can_log, ""),
    "motions": ("motions", lambda wrong: write_can_log("log.asc", [], [wrong]), ""),
    "offset": ("time offset", lambda wrong: open_vehicle_data("camera.toml", time_offset_s=wrong), "number"),
    "map": ("path", read_road_map, ""),
    "roads": ("RoadMap.lines", lambda wrong: RoadMap([wrong]), ""),
    "poses": ("path", read_poses, ""),
    "folder": ("path", OutputFolder, ""),
    "tracks of a run": ("path", read_tracks, ""),
    "table": ("path", lambda wrong: recorded().write_parquet(wrong), ""),
    "COCO": ("path", lambda wrong: recorded().write_coco(wrong), ""),
    "predictions": ("predictions", lambda wrong: write_predictions("boxes.json", wrong), ""),
    "matching": ("labels", lambda wrong: match_lights(wrong, NOTHING), ""),
    "groups": ("matched", lambda wrong: break_down(wrong, 0.5), ""),
}
"""By name, the field, what is called with something wrong in it, and which of `WRONG` are right there."""


@pytest.mark.parametrize("name", CALLS)
def test_what_is_of_another_kind(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    field, call, right = CALLS[name]
    for kind, wrong in WRONG.items():
        if kind not in right.split():
            with pytest.raises((ValueError, TypeError), match=rf"^([^ ]*: )?{field}: expected "):
                call(wrong)
    assert list(tmp_path.iterdir()) == []


def test_a_single_frame_and_an_image_are_no_frames() -> None:
    for wrong in (FRAME, FRAME.image, "drive.mp4"):
        with pytest.raises(TypeError, match="frames: expected frames, such as "):
            list(PIPELINE.run(wrong))  # type: ignore[arg-type]


def test_images_are_no_frames_of_a_drive() -> None:
    images: Any = [FRAME.image, FRAME.image]
    with pytest.raises(TypeError, match=r"frames: expected each to be a Frame, .* got ndarray: `step` takes an image"):
        list(PIPELINE.run(images))
    source = ListSource(images)
    log = SimpleNamespace(camera=1, motion=1, road=1, of_one_drive=("a log",))
    for frames in (Paced(source, math.inf), Equipped(source, log)):
        with pytest.raises(ValueError, match=r"^source: expected Frame, got ndarray"):
            list(frames)
    with pytest.raises(ValueError, match=r"^source: expected Frame, got ndarray"):
        run(source, PIPELINE, None)


def test_a_clock_that_tells_no_time() -> None:
    stage = BeamStage(LIT, GuardConfig())
    for wrong in (None, "x", 1.5, math.nan, True):
        with pytest.raises(ValueError, match=r"^now_ns: expected nanoseconds as a whole number"):
            stage.command(FRAME, tracks_of([]), now_ns=lambda wrong=wrong: wrong)  # type: ignore[misc]


def test_speeds_of_own_live_sources() -> None:
    for name, wrong in (
        ("speed", 0.0),
        ("speed", None),
        ("speed", "x"),
        ("max_silence_s", -1.0),
        ("max_silence_s", "x"),
    ):
        source = Paced(ListSource(FRAMES))
        setattr(source, name, wrong)
        with pytest.raises(ValueError, match=rf"^source: {name}: expected a "):
            loop(source=source)


def test_rates_of_own_sources() -> None:
    source = ListSource(FRAMES)
    for rate_hz in (0, -1.0, math.nan, math.inf, "18"):
        source.rate_hz = rate_hz  # type: ignore[assignment]
        with pytest.raises(ValueError, match="source: rate_hz: expected a "):
            Paced(source)


def test_images_of_another_byte_order_mean_the_same() -> None:
    image = night_image(0, 480, 640, np.uint16)
    assert len(propose(image))
    assert (propose(image.astype(">u2")) == propose(image)).all()
    assert (propose((image / 65535).astype(">f4")) == propose((image / 65535).astype(np.float32))).all()


class Meddling(BeamPolicy):
    """Wants high beam, and claims that the car is fast and the camera sees."""

    def __init__(self, config: Any, headlamps: Any) -> None:
        pass

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:  # noqa: ARG002
        object.__setattr__(frame, "is_damaged", False)
        return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, 84)))


def test_the_guard_judges_the_frame_that_came() -> None:
    damaged = Frame(night_image(), timestamp_ns=0, is_damaged=True)
    passed = BeamStage(LIT, GuardConfig(), Meddling).command(damaged, tracks_of([]))
    assert "image_damaged" in passed.faults
    assert damaged.is_damaged
