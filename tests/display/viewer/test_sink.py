"""What the sink records, read back from its file."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("rerun")

import rerun as rr

from foreglow.datasets.bags import PAUSE_NS
from foreglow.display.overlay import KIND_BGR
from foreglow.display.viewer import RerunSink, RrdFile
from foreglow.display.viewer.blueprint import PLOTS, blueprint
from foreglow.display.viewer.entities import box_entities, led_picture, track_words, word_entity
from foreglow.display.viewer.sink import NUM_SCORES, Slots, highest
from foreglow.photometry import NUM_LEDS
from foreglow.runtime.health import Health
from foreglow.types import BeamMode, Frame, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.display.viewer.recordings import Recording, frame_at, full_result
from tests.stand_ins import night_image, result_of, tracks_of

PERIOD_NS = 50_000_000


def sink_into(path: Path, **options: object) -> RerunSink:
    return RerunSink([RrdFile(path, blueprint(has_lux=True))], **options)  # type: ignore[arg-type]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.rrd"


def test_all_of_a_frame(path: Path) -> None:
    sink = sink_into(path, lux_of=lambda _: {"car 0": 0.25})
    for number in range(3):
        frame = frame_at(number * PERIOD_NS, number)
        sink.write(frame, full_result(frame))
    assert not path.exists()
    sink.close()
    assert list(path.parent.iterdir()) == [path]
    found = Recording(path)
    assert found.entities >= {
        *("/camera/image", "/camera/proposals", "/camera/detections", "/camera/tracks", "/camera/words"),
        *("/camera/gaps", "/map/road", "/map/car", "/map/distances", "/map/tracks", "/map/tracks/places"),
        *("/map/gaps/inside", "/map/gaps/borders", "/lamps/left", "/lamps/right", "/states/beam", "/log"),
        *("/plots/scores", "/plots/ranges/0", "/plots/confidences/0", "/plots/ms/proposals", "/plots/ms/total"),
        "/plots/lux/car\\ 0",
    }
    times = [time for time, _ in found.values("/camera/image", "EncodedImage:blob")]
    assert times == [0, PERIOD_NS, 2 * PERIOD_NS]
    assert [value for _, value in found.values("/plots/lux/car\\ 0", "Scalars:scalars")] == [[0.25]] * 3
    (_, labels), *_ = found.values("/camera/words", "Points2D:labels")
    assert labels == ["#3 50+-5 m", "0.90"]
    assert len(found.values("/camera/tracks", "Boxes2D:half_sizes")[0][1]) == 2
    (_, places), *_ = found.values("/map/tracks/places", "Points3D:positions")
    assert np.hypot(*(np.array(places)[0, :2] - [1.9, 0.0])) == pytest.approx(50.0, abs=0.1)
    (_, borders), *_ = found.values("/map/gaps/borders", "LineStrips3D:strips")
    assert [len(border) for border in borders] == [8, 9]


def test_an_image_without_loss_and_one_as_jpeg(path: Path) -> None:
    frame = Frame(night_image(), 0)
    for quality in (None, 90):
        sink = sink_into(path, jpeg_quality=quality)
        sink.write(frame, result_of(frame, []))
        sink.close()
        if quality is None:
            ((_, (exact,)),) = Recording(path).values("/camera/image", "Image:buffer")
    ((_, (blob,)),) = Recording(path).values("/camera/image", "EncodedImage:blob")
    shown = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    difference = np.array(exact, np.int64).reshape(96, 128) - shown
    assert np.abs(difference).mean() < 4.0
    assert np.abs(difference).max() > 0


def test_images_of_another_depth_within_a_sequence(path: Path) -> None:
    sink = sink_into(path)
    for number, image in enumerate((night_image(), night_image().astype(np.uint16) * 257)):
        frame = Frame(image, number * PERIOD_NS, number)
        sink.write(frame, result_of(frame, []))
    sink.close()
    assert len(Recording(path).values("/camera/image", "EncodedImage:blob")) == 2


def test_a_frame_with_nothing_but_an_image(path: Path) -> None:
    frame = Frame(night_image(), 0)
    sink = sink_into(path)
    sink.write(frame, result_of(frame, [(1, 2, 30, 40)]))
    sink.close()
    found = Recording(path)
    assert "/camera/proposals" in found.entities
    assert not found.entities & {"/camera/tracks", "/lamps/left", "/plots/ranges/0", "/map/gaps/inside", "/camera/gaps"}


def test_sequences_follow_each_other_and_start_empty(path: Path) -> None:
    sink = sink_into(path)
    for sequence in ("S00001", "S00002"):
        for number in range(2):
            frame = frame_at(number * PERIOD_NS, number, sequence)
            sink.write(frame, full_result(frame))
    sink.close()
    found = Recording(path)
    second_ns = PERIOD_NS + PAUSE_NS
    times = [time for time, _ in found.values("/camera/image", "EncodedImage:blob")]
    assert times == [0, PERIOD_NS, second_ns, second_ns + PERIOD_NS]
    for entity in ("/camera", "/map", "/lamps", "/plots", "/states"):
        assert found.values(entity, "Clear:is_recursive") == [(second_ns, [True])]
    texts = [text for _, text in found.values("/log", "TextLog:text")]
    assert texts == [["sequence S00001"], ["sequence S00002"]]


def test_faults_and_modes_are_noted_when_they_change(path: Path) -> None:
    sink = sink_into(path)
    faults = [(), ("camera_dark",), ("camera_dark",), ()]
    for number, its in enumerate(faults):
        frame = frame_at(number * PERIOD_NS, number, sequence="")
        sink.write(frame, full_result(frame, its, BeamMode.LOW if its else BeamMode.GLARE_FREE))
    for number, its in enumerate([("camera_gone", "bus_failed"), ("camera_gone", "bus_failed"), ()]):
        sink.write_health(Health((10 + number) * PERIOD_NS, its, 4, 0, 0, None))
    sink.close()
    found = Recording(path)
    assert found.values("/log", "TextLog:text") == [
        (PERIOD_NS, ["low beam: camera dark"]),
        (3 * PERIOD_NS, ["low beam: no faults any more"]),
        (10 * PERIOD_NS, ["health: camera gone, bus failed"]),
        (12 * PERIOD_NS, ["health: no faults any more"]),
    ]
    modes = [(time, state[0]) for time, state in found.values("/states/beam", "StateChange:state")]
    assert modes == [(0, "glare_free"), (PERIOD_NS, "low"), (3 * PERIOD_NS, "glare_free")]


def test_a_fault_of_the_run_lasts_beyond_its_sequence(path: Path) -> None:
    sink = sink_into(path)
    for number, sequence in enumerate(("S00001", "S00002")):
        frame = frame_at(0, number, sequence)
        sink.write(frame, full_result(frame))
        sink.write_health(Health(PERIOD_NS, ("not_recorded",), 1, 0, 0, None))
    sink.close()
    states = Recording(path).values("/states/health", "StateChange:state")
    assert states == [(PERIOD_NS, ["not recorded"]), (PAUSE_NS, ["not recorded"])]


def test_dates_are_dates(path: Path) -> None:
    sink = sink_into(path)
    frame = frame_at(1_700_000_000 * 10**9)
    sink.write(frame, full_result(frame))
    sink.close()
    chunks = rr.chunk.RrdReader(path).stream()
    kinds = {
        str(chunk.to_record_batch().schema.field("time").type) for chunk in chunks if "time" in chunk.timeline_names
    }
    assert kinds == {"timestamp[ns]"}


@pytest.mark.parametrize("count", [0, 1, 16, 40])
def test_as_many_scores_in_every_frame(count: int) -> None:
    """Where their number changes, the viewer draws zeros that nobody logged."""
    scores = np.random.default_rng(count).random(count, np.float32)
    kept = highest(scores)
    assert kept.shape == (NUM_SCORES,)
    assert kept[~np.isnan(kept)].tolist() == sorted(scores.tolist(), reverse=True)[:NUM_SCORES]


def test_words_of_a_track() -> None:
    states = [TrackState.CONFIRMED, TrackState.COASTING]
    tracks = tracks_of([(0, 0, 9, 9), (20, 0, 29, 9)], states, [3, 12], [85.0, np.nan])
    assert [track_words(tracks, position) for position in (0, 1)] == ["#3 85+-8 m", "#12, coasting"]
    direct = dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.array([0.9, 0.2])))
    assert [track_words(direct, index) for index in (0, 1)] == ["#3 85+-8 m, direct", "#12, indirect, coasting"]
    told = dataclasses.replace(tracks, light_kinds=np.array([[0.1, 0.6, 0.2, 0.1], [0.1, 0.2, 0.3, 0.4]]))
    words = ["#3 85+-8 m, rear lamp", "#12, light of a rear lamp, coasting"]
    assert [track_words(told, index) for index in (0, 1)] == words


def test_boxes_have_the_colours_and_words_of_their_kinds() -> None:
    frame = frame_at(0)
    result = result_of(frame, [[3, 4, 9, 8], [20, 21, 40, 33], [50, 21, 60, 33]], [0.9, 0.8, 0.1])
    assert result.detections is not None
    kinds = np.array([[0.1, 0.6, 0.2, 0.1], [0.1, 0.2, 0.3, 0.4], [1.0, 0.0, 0.0, 0.0]], np.float32)
    detections = dataclasses.replace(result.detections, light_kinds=kinds)
    _, (_, boxes) = box_entities(result.proposals, detections)
    colours = [KIND_BGR[kind][::-1] for kind in ("rear_lamp", "rear_light")]
    assert boxes.colors.as_arrow_array().to_pylist() == [
        (red << 24) + (green << 16) + (blue << 8) + 255 for red, green, blue in colours
    ]
    _, words = word_entity(frame, detections, None)
    assert words.labels.as_arrow_array().to_pylist() == ["0.90 rear lamp", "0.80 light of a rear lamp"]


def test_lamps_as_the_driver_sees_them() -> None:
    """LED 0 is the lowest, and the furthest to the right."""
    levels = np.zeros(NUM_LEDS)
    levels[0], levels[28 + 27] = 1.0, 0.5
    picture = led_picture(levels, 28).sum(axis=2)
    assert picture.shape == (3, 28)
    assert np.unravel_index(picture.argmax(), picture.shape) == (2, 27)
    assert picture[1, 0] > picture[0, 0]


def test_slots_are_as_many_as_tracks_at_a_time() -> None:
    slots = Slots()
    for first in range(0, 300, 3):
        taken, _ = slots.assign([first, first + 1, first + 3])  # one of three stays
        assert len(set(taken)) == 3
        assert max(taken) < 4


@pytest.mark.parametrize("has_lux", [True, False])
@pytest.mark.parametrize("window_s", [None, 20.0])
def test_the_blueprint_is_recorded_with_its_views(path: Path, has_lux: bool, window_s: float | None) -> None:
    RerunSink([RrdFile(path, blueprint(has_lux=has_lux, window_s=window_s))]).close()
    reader = rr.chunk.RrdReader(path)
    (entry,) = reader.blueprints()
    assert entry.application_id == "foreglow"
    views = {
        row[0]
        for chunk in reader.stream(store=entry)
        for name, column in [(n, chunk.to_record_batch().column(n)) for n in chunk.to_record_batch().schema.names]
        if name == "ViewBlueprint:display_name"
        for row in column.to_pylist()
    }
    plots = {title for name, title in PLOTS.items() if has_lux or name != "lux"}
    assert views == plots | {"camera", "bird's-eye view", "left lamp", "right lamp", "beam and faults", "log"}
