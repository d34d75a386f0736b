from __future__ import annotations

import errno
import functools
import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN, ImageCategory, open_source
from foreglow.datasets.pvdn.schema import Cycle
from foreglow.datasets.simulated import read_truth
from foreglow.folder_lock import FolderLock
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import LabelRule, Scene
from foreglow.lab.simulation.writing import recorder
from foreglow.lab.simulation.writing.dataset import DatasetConfig, simulate_dataset
from foreglow.parallel import Local
from foreglow.whole_files import write_atomic
from tests.lab.simulation.stub_drive import drive, scene

pytestmark = pytest.mark.slow

SCENES = [scene(1), scene(2, num_frames=2)]


def digest(folder: Path) -> dict[str, str]:
    """Every file below `folder`, hidden ones too, with a hash of its bytes."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set made in one go."""
    folder = tmp_path_factory.mktemp("whole") / "DATA"
    simulate_dataset(folder, SCENES, drive)
    return folder


def test_pvdn_reads_what_was_driven(whole: Path) -> None:
    split = PVDN(whole / "night" / "train")
    assert split.frame_ids == (10000, 10001, 10002, 20000, 20001)
    assert [sequence.directory for sequence in split.sequences] == ["S00001", "S00002"]
    assert (split.sequences[0].start_time_ms, split.sequences[1].num_images) == (500, 2)
    frames = iter(split)
    for number, given in enumerate(SCENES, start=1):
        for known in drive(given):
            frame = next(frames)
            assert np.array_equal(frame.image, known.frame.image)
            assert (frame.frame, frame.sequence) == (number * 10000 + known.frame.frame, f"S{number:05d}")
            assert frame.timestamp_ns == known.frame.timestamp_ns
            assert split.categories(frame.frame) == (known.category,)
            assert split.cycle_of(frame.frame) is split.camera_configuration(frame.frame).cycle is Cycle.NIGHT
    assert split.categories(10000) == (ImageCategory.NONE,)


def test_labels_are_the_artifacts_that_are_sure(whole: Path) -> None:
    split = PVDN(whole / "night" / "train")
    known = list(drive(SCENES[0]))[1]
    artifacts = known.vehicles[0].artifacts
    (vehicle,) = split.annotations(10001)
    assert (vehicle.oid, vehicle.is_direct) == (0, True)
    positions = [tuple(int(each) for each in artifact.position_px) for artifact in artifacts]
    assert [(instance.position_px, instance.iid, instance.is_direct) for instance in vehicle.instances] == [
        (positions[0], 0, True),
        (positions[1], 1, False),
    ]
    assert [(each.position_px, each.iid) for each in split.doubtful(10001)] == [(positions[2], -1)]
    # The first vehicle's only light is doubtful in the third frame, so PVDN would not know of it.
    assert [annotation.oid for annotation in split.annotations(10002)] == [1]
    assert len(split.doubtful(10002)) == 2
    assert split.annotations(10000) == () == split.doubtful(10000)
    assert split.labels.images_file.info["label_rule"]["min_grey"] == LabelRule().min_grey


def test_a_vehicle_is_where_its_box_is(whole: Path) -> None:
    known = list(drive(SCENES[0]))[1]
    vehicle = known.vehicles[0]
    seen_px = known.camera.project(known.camera_pose.to_body(vehicle.pose.to_outer(vehicle.box_centre_m)))
    (labelled,) = PVDN(whole / "night" / "train").annotations(10001)
    np.testing.assert_allclose(np.array(labelled.position_px) + 0.5, seen_px, atol=0.5)


def test_the_only_split_of_a_folder_is_meant(whole: Path, tmp_path: Path) -> None:
    for folder in (whole, whole / "night"):
        assert open_source(folder).num_frames == len(PVDN(folder)) == 5
    shutil.copytree(whole, tmp_path / "two")
    shutil.copytree(whole / "night" / "train", tmp_path / "two" / "day" / "train")
    with pytest.raises(ValueError, match=r"expected one split of PVDN, such as .*two/day/train"):
        open_source(tmp_path / "two")


@pytest.mark.parametrize("frame", [0, 1])
def test_a_drive_that_is_interrupted_goes_on(whole: Path, tmp_path: Path, frame: int) -> None:
    with pytest.raises(RuntimeError, match="interrupted here"):
        simulate_dataset(tmp_path, SCENES, functools.partial(drive, fail_at=(2, frame)))
    assert not list(tmp_path.rglob("*.partial"))
    driven: list[int] = []
    summary = simulate_dataset(tmp_path, SCENES, functools.partial(_noted, driven))
    assert (summary.num_kept, driven) == (1, [2])
    assert digest(tmp_path) == digest(whole)


def _noted(driven: list[int], given: Scene) -> Iterator[DriveFrame]:
    driven.append(given.seed)
    return drive(given)


class StoppedError(Exception):
    """Stands for whatever stops a run."""


class FileMoves:
    """Counts every file and folder that gets its final name, and stops instead of move number `stop_at`."""

    def __init__(self, patch: pytest.MonkeyPatch, stop_at: int | None = None) -> None:
        self.num = 0
        self._stop_at = stop_at
        for name in ("replace", "rename"):
            patch.setattr(Path, name, self._counting(getattr(Path, name)))

    def _counting(self, move: Callable[[Path, Path], Path]) -> Callable[[Path, Path], Path]:
        def counted(source: Path, target: Path) -> Path:
            if self.num == self._stop_at:
                raise StoppedError
            self.num += 1
            return move(source, target)

        return counted


def test_a_run_that_is_interrupted_anywhere_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [scene(1, num_frames=1), scene(2, num_frames=1)]
    with monkeypatch.context() as patch:
        moves = FileMoves(patch)
        simulate_dataset(tmp_path / "whole", scenes, drive)
    expected = digest(tmp_path / "whole")
    assert moves.num >= len(expected)
    for stop_at in range(moves.num):
        folder = tmp_path / str(stop_at)
        with monkeypatch.context() as patch:
            FileMoves(patch, stop_at)
            with pytest.raises(StoppedError):
                simulate_dataset(folder, scenes, drive)
        assert not (folder / "night/train/labels/sequences.json").exists()
        simulate_dataset(folder, scenes, drive)
        assert digest(folder) == expected, stop_at


def test_leftovers_of_a_killed_run_vanish(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "DATA")
    root = tmp_path / "DATA" / "night" / "train"
    shutil.rmtree(root / "simulation" / "S00002")  # killed after the images were in place
    (root / "images" / "S00002" / "099999.png").write_bytes(b"stale")
    (root / "simulation" / ".S00002.partial").mkdir()
    (root / "simulation" / ".S00002.partial" / "frames.jsonl").write_text("{")
    (root / "labels" / ".sequences.json.1-2.tmp").write_text("{")
    simulate_dataset(tmp_path / "DATA", SCENES, drive)
    assert digest(tmp_path / "DATA") == digest(whole)


def test_hidden_files_of_the_user_stay(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "DATA")
    (tmp_path / "DATA/night/train/.notes.tmp").write_text("mine")
    simulate_dataset(tmp_path / "DATA", SCENES, drive)
    assert (tmp_path / "DATA/night/train/.notes.tmp").read_text() == "mine"


def test_two_do_not_write_one_split(tmp_path: Path) -> None:
    """Also through other folders: several cameras have theirs below that of the command."""
    with FolderLock(tmp_path / "DATA/night/train"), pytest.raises(ValueError, match="another run is writing"):
        simulate_dataset(tmp_path / "DATA", SCENES, drive)
    assert not (tmp_path / "DATA").exists()


@pytest.mark.parametrize(
    "lost",
    [
        "images/S00002/020001.png",
        "simulation/S00002/camera.toml",
        "simulation/S00002/depth",
        "simulation/S00002/depth/000001.png",
        "simulation/S00002/frames.jsonl",
        "simulation/S00002/road.json",
    ],
)
def test_a_drive_that_lost_something_is_made_again(lost: str, whole: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(whole, tmp_path / "DATA")) / "night/train"
    shutil.rmtree(root / lost) if (root / lost).is_dir() else (root / lost).unlink()
    assert simulate_dataset(tmp_path / "DATA", SCENES, drive).num_kept == 1
    assert digest(tmp_path / "DATA") == digest(whole)


@pytest.mark.parametrize(
    ("damaged", "num_left"),
    [
        ("images/S00002/020001.png", 4),
        ("images/S00002/020000.png", -1),
        ("simulation/S00002/depth/000001.png", 0),
        ("simulation/S00002/camera.toml", 10),
        ("simulation/S00002/frames.jsonl", 3),
        ("simulation/S00002/frames.jsonl", 0),
        ("simulation/S00002/road.json", -1),
    ],
)
def test_a_drive_of_which_a_file_is_damaged_is_made_again(
    damaged: str, num_left: int, whole: Path, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(whole, tmp_path / "DATA")) / "night/train"
    (root / damaged).write_bytes((root / damaged).read_bytes()[:num_left])
    assert simulate_dataset(tmp_path / "DATA", SCENES, drive).num_kept == 1
    assert digest(tmp_path / "DATA") == digest(whole)


@pytest.mark.parametrize("damaged", ["images/S00002/020001.png", "simulation/S00002/depth/000001.png"])
def test_a_drive_with_an_image_of_which_a_bit_is_flipped_is_made_again(
    damaged: str, whole: Path, tmp_path: Path
) -> None:
    """In the middle of the file, between a whole begin and a whole end."""
    path = Path(shutil.copytree(whole, tmp_path / "DATA")) / "night/train" / damaged
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert simulate_dataset(tmp_path / "DATA", SCENES, drive).num_kept == 1
    assert digest(tmp_path / "DATA") == digest(whole)


def test_a_refusal_leaves_the_labels(whole: Path, tmp_path: Path) -> None:
    """A damaged scene is not made again, since nothing else says what was driven; the rest stays readable."""
    root = Path(shutil.copytree(whole, tmp_path / "DATA")) / "night/train"
    (root / "simulation/S00002/scene.json").write_text('{"a')
    with pytest.raises(ValueError, match=r"S00002/scene.json: expected JSON.*remove .*/S00002 to make it anew"):
        simulate_dataset(tmp_path / "DATA", SCENES, drive)
    assert len(PVDN(root)) == 5


@pytest.mark.parametrize("lost", ["shares.parquet", "light", "light/010001.png"])
def test_lost_shares_are_made_again(lost: str, tmp_path: Path) -> None:
    config = DatasetConfig(presets=("foreglow",))
    simulate_dataset(tmp_path, SCENES[:1], _lit, config)
    before, path = digest(tmp_path), tmp_path / "night/train/simulation/S00001" / lost
    assert simulate_dataset(tmp_path, SCENES[:1], _lit, config).num_kept == 1
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert simulate_dataset(tmp_path, SCENES[:1], _lit, config).num_kept == 0
    assert digest(tmp_path) == before
    if path.is_file():
        path.write_bytes(path.read_bytes()[:-1])
        assert simulate_dataset(tmp_path, SCENES[:1], _lit, config).num_kept == 0
        assert digest(tmp_path) == before


def _lit(of: Scene) -> Iterator[DriveFrame]:
    """The drive with the light of each source."""
    light = np.ones((6, 16, 16), np.float32)
    return (replace(known, light_cd_m2=light) for known in drive(of))


def test_a_drive_whose_scene_was_lost_is_not_overwritten(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "DATA")
    (tmp_path / "DATA/night/train/simulation/S00002/scene.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"S00002/scene.json: no such file, .* remove .*/S00002 to make it"):
        simulate_dataset(tmp_path / "DATA", SCENES, drive)


def test_processes_change_nothing_and_an_error_in_one_keeps_the_others_scene(whole: Path, tmp_path: Path) -> None:
    reported: list[tuple[int, int, int]] = []
    failing = functools.partial(drive, fail_at=(1, 1))
    with pytest.raises(RuntimeError, match="interrupted here"):
        simulate_dataset(tmp_path, SCENES, failing, workers=Local(2), progress=lambda *call: reported.append(call))
    assert [call for call in reported if call[0] == 2] == [(2, 1, 2), (2, 2, 2)]
    assert read_truth(tmp_path / "night/train").sequence_ids == (2,)
    assert simulate_dataset(tmp_path, SCENES, drive).num_kept == 1
    assert digest(tmp_path) == digest(whole)


def test_summary_and_progress(tmp_path: Path) -> None:
    reported: list[tuple[int, int, int]] = []
    summary = simulate_dataset(tmp_path, SCENES, drive, progress=lambda *call: reported.append(call))
    assert reported == [(1, 1, 3), (1, 2, 3), (1, 3, 3), (2, 1, 2), (2, 2, 2)]
    labels = summary.labels
    assert (labels.num_empty_images, labels.num_direct, labels.num_indirect, labels.num_doubtful) == (2, 3, 3, 4)
    reported.clear()
    assert simulate_dataset(tmp_path, SCENES, drive, progress=lambda *call: reported.append(call)).num_kept == 2
    assert reported == [(1, 3, 3), (2, 2, 2)]


def test_the_field_that_differs_is_named(tmp_path: Path) -> None:
    """Also one that is written only where it is given, and lists that differ behind their beginning."""
    simulate_dataset(tmp_path, SCENES, drive)
    long = tuple(f"preset-{number:02d}" for number in range(20))
    for presets, there, said in (
        (("foreglow",), None, "made_with.presets: expected ['foreglow'] as in this run, found nothing"),
        ((), ["foreglow"], "made_with.presets: expected nothing as in this run, found ['foreglow']"),
        ((*long, "a"), [*long, "b"], "made_with.presets.20: expected 'a' as in this run, found 'b'"),
    ):
        path = tmp_path / "night/train/simulation/S00001/scene.json"
        record = json.loads(path.read_text())
        record["made_with"].pop("presets", None)
        record["made_with"].update({} if there is None else {"presets": there})
        path.write_text(json.dumps(record))
        with pytest.raises(ValueError, match=re.escape(said)):
            simulate_dataset(tmp_path, SCENES, drive, DatasetConfig(presets=presets))
    record["made_with"] |= {"presets": (), "generator": f"{'a' * 70}, one thing"}
    path.write_text(json.dumps(record))
    with pytest.raises(
        ValueError, match=r"made_with\.generator: expected .*a, another' as in this run, found .*a, one thing'; choose"
    ):
        simulate_dataset(tmp_path, SCENES, drive, DatasetConfig(generator=f"{'a' * 70}, another"))


def test_more_scenes_join_and_fewer_do_not(whole: Path, tmp_path: Path) -> None:
    simulate_dataset(tmp_path, SCENES[:1], drive)
    assert simulate_dataset(tmp_path, SCENES, drive).num_kept == 1
    assert digest(tmp_path) == digest(whole)
    with pytest.raises(ValueError, match=r"S00002: expected at most the 1 scenes of this run; choose another folder"):
        simulate_dataset(tmp_path, SCENES[:1], drive)


def test_other_scenes_are_not_mixed_in(whole: Path) -> None:
    other = SCENES[1].model_copy(update={"seed": 9})
    with pytest.raises(ValueError, match=r"S00002/scene\.json: scene\.seed: expected 9 as in this run, found 2; cho"):
        simulate_dataset(whole, [SCENES[0], other], drive)
    with pytest.raises(ValueError, match=r"S00001/scene\.json: made_with\.generator: expected 'else'.*, found 'foreg"):
        simulate_dataset(whole, SCENES, drive, DatasetConfig(generator="else"))


def test_no_road_is_in_two_splits(tmp_path: Path) -> None:
    """As `simulate --scene` had it twice; the help says otherwise."""
    simulate_dataset(tmp_path, SCENES[:1], drive)
    for cycle in Cycle:
        with pytest.raises(ValueError, match=r"val: expected roads of its own, that of scene 1 is also in .*train"):
            simulate_dataset(tmp_path, SCENES[:1], drive, DatasetConfig(split="val", cycle=cycle))
        simulate_dataset(tmp_path, SCENES[:1], drive, DatasetConfig(cycle=cycle))
    assert {path.name for path in (tmp_path / "night").iterdir()} == {"train"}


def test_cycle_split_and_rate(tmp_path: Path) -> None:
    exposures: list[str] = []

    def noting(given: Scene) -> Iterator[DriveFrame]:
        exposures.append(given.sensor.exposure)
        return drive(given)

    for cycle in Cycle:
        config = DatasetConfig(cycle=cycle, split="val", seed=7, production={"latency_s": 0.5})
        root = simulate_dataset(tmp_path, [scene(1, rate_hz=25.0)], noting, config).root
        assert root == tmp_path / cycle / "val"
        split = PVDN(root)
        assert (split.rate_hz, split.cycle, split.cycle_of(10000)) == (25.0, cycle, cycle)
        assert [frame.timestamp_ns for frame in split] == [500_000_000, 540_000_000, 580_000_000]
        info = json.loads((root / "simulation" / "info.json").read_text())
        assert (info["seed"], info["cycle"], info["production"]) == (7, cycle, {"latency_s": 0.5})
        assert info["label_rule"]["max_instances"] == LabelRule().max_instances
    assert exposures == ["day", "night"]


@pytest.mark.parametrize(
    ("scenes", "message"),
    [
        ([], "scenes: expected at least one"),
        ([scene(1), scene(1, rate_hz=20.0)], "scenes: rate_hz: expected one .* scene 2 differs"),
        ([scene(1), scene(1).model_copy(update={"labels": LabelRule(min_grey=3.0)})], "scenes: labels: .* scene 2"),
        ([scene(1).model_copy(update={"duration_s": 600.0})], "expected up to 10000 frames each, scene 1 has 10800"),
    ],
)
def test_scenes_that_do_not_fit(tmp_path: Path, scenes: list[Scene], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulate_dataset(tmp_path / "out", scenes, drive)
    assert not (tmp_path / "out").exists()


def test_drives_that_contradict_their_scene(tmp_path: Path) -> None:
    def short(given: Scene) -> Iterator[DriveFrame]:
        return iter(list(drive(given))[:-1])

    def long(given: Scene) -> Iterator[DriveFrame]:
        return iter([*drive(given), *drive(given)])

    for wrong, message in (
        (short, "S00001: drive: expected 3 frames, got 2"),
        (long, "S00001: drive: frame 3: expected 3 frames, got more"),
        (functools.partial(drive, lag_ns=700_000), "frame 2: timestamp_ns: expected about 611111111, got 612511111"),
    ):
        with pytest.raises(ValueError, match=message):
            simulate_dataset(tmp_path, SCENES, wrong)
    assert read_truth(tmp_path / "night/train").sequence_ids == ()
    assert not list(tmp_path.rglob("*.png"))


def test_another_data_set_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "night/train/images/S1").mkdir(parents=True)
    (tmp_path / "night/train/images/S1/000001.png").write_bytes(b"real")
    with pytest.raises(ValueError, match=r"train: expected a new folder or a simulated split, this is another data"):
        simulate_dataset(tmp_path, SCENES, drive)
    assert list(digest(tmp_path)) == ["night/train/images/S1/000001.png"]


def test_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OSError, match="out"):
        simulate_dataset(tmp_path / "out", SCENES, drive)


def test_a_full_disk_is_one_error_and_finished_scenes_stay(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, data: bytes) -> None:
        if path.name == "020001.png":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        write_atomic(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(recorder, "write_atomic", full)
        with pytest.raises(OSError, match=r"No space left on device: '.*020001\.png'"):
            simulate_dataset(tmp_path, SCENES, drive)
    assert not list(tmp_path.rglob(".S00002*"))
    assert simulate_dataset(tmp_path, SCENES, drive).num_kept == 1
    assert digest(tmp_path) == digest(whole)
