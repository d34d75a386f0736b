"""Many processes and a dask cluster give the bytes of one process, also where a worker is lost on the way."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path

import pytest

from foreglow.config import preset
from foreglow.lab.learning.tuning import TuningSettings, tune
from foreglow.lab.simulation import scene_to_toml
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from foreglow.parallel import Cluster, Local, Workers
from foreglow.runtime import Opening, OutputFolder, run_apart
from tests.cli.commands import RESULTS, complaint, foreglow_command, names
from tests.lab.learning.night_set import make_night_set
from tests.lab.simulation import stub_drive
from tests.lab.simulation.test_drive import scene
from tests.parallel.dask_cluster import DaskCluster
from tests.parallel.splits import DeadlySplit

pytestmark = pytest.mark.process

SCENES = [stub_drive.scene(seed, num_frames=3) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of four frames with lights."""
    return make_night_set(tmp_path_factory.mktemp("night"), ("val",), num_images=4) / "night" / "val"


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three simulated drives, so with camera and motion."""
    return simulate_dataset(tmp_path_factory.mktemp("drives"), SCENES, stub_drive.drive).root


@pytest.fixture
def options(cluster: DaskCluster) -> tuple[object, ...]:
    """What the command line says. Other tests have `--jobs` for the same work, whose processes start anew each time."""
    return ("--cluster", cluster.address)


@pytest.fixture
def workers(cluster: DaskCluster) -> Workers:
    """The same, made."""
    return Cluster(cluster.address)


def run(*arguments: object) -> str:
    result = foreglow_command(*arguments)
    assert result.exit_code == 0, result.output
    return result.stdout


def camera_line(told: str) -> str:
    (line,) = (line for line in told.splitlines() if line.startswith("camera: "))
    return line


def contents(folder: Path, pattern: str = "**/*") -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob(pattern) if path.is_file()}


def summary_of(folder: Path) -> dict[str, object]:
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary.pop("run_time_ms")) >= {"proposals", "total"}
    return dict(summary)


def times_of(folder: Path) -> list[tuple[int, str, int, list[str]]]:
    lines = [json.loads(line) for line in (folder / "times.jsonl").read_text().splitlines()]
    return [(each["frame"], each["sequence"], each["timestamp_ns"], list(each["stage_ms"])) for each in lines]


@pytest.mark.parametrize(("data", "kind"), [("split", "jobs"), ("drives", "cluster")])
def test_run(data: str, kind: str, tmp_path: Path, options: tuple[object, ...], request: pytest.FixtureRequest) -> None:
    options = ("--jobs", 2) if kind == "jobs" else options
    source, alone, many = request.getfixturevalue(data), tmp_path / "one", tmp_path / "many"
    told = run("run", source, "--out", alone)
    told_of_many = run("run", source, "--out", many, *options)
    assert names(many) == names(alone) == RESULTS
    assert camera_line(told_of_many) == camera_line(told)
    assert (many / "frames.jsonl").read_bytes() == (alone / "frames.jsonl").read_bytes()
    assert (many / "config.toml").read_bytes() == (alone / "config.toml").read_bytes()
    assert summary_of(many) == summary_of(alone)
    assert times_of(many) == times_of(alone)
    assert len({line[1] for line in times_of(alone)}) > 1


def test_run_of_one_piece(tmp_path: Path, drives: Path, options: tuple[object, ...]) -> None:
    source, alone, many = drives / "images" / "S00001", tmp_path / "one", tmp_path / "many"
    pictures = shutil.copytree(source, tmp_path / "pictures")
    for given in (source, pictures):
        run("run", given, "--out", alone)
        run("run", given, "--out", many, *options)
        assert (many / "frames.jsonl").read_bytes() == (alone / "frames.jsonl").read_bytes()


def test_run_skips_and_stops_at_bad_images_as_ever(tmp_path: Path, drives: Path, options: tuple[object, ...]) -> None:
    source = shutil.copytree(drives, tmp_path / "train")
    (source / "images" / "S00002" / "020001.png").write_text("no image")
    alone, many = tmp_path / "one", tmp_path / "many"
    line = complaint("run", source, "--out", many, *options)
    assert "020001.png" in line
    assert not many.exists()
    run("run", source, "--out", alone, "--on-error", "skip")
    run("run", source, "--out", many, "--on-error", "skip", *options)
    assert (many / "frames.jsonl").read_bytes() == (alone / "frames.jsonl").read_bytes()
    assert summary_of(many) == summary_of(alone)
    assert summary_of(alone)["num_skipped"] == 1


@pytest.mark.parametrize("kind", ["jobs", "cluster"])
def test_run_with_a_lost_worker(tmp_path: Path, drives: Path, kind: str, workers: Workers) -> None:
    workers = Local(2) if kind == "jobs" else workers
    source = shutil.copytree(drives, tmp_path / "train")
    config = preset("foreglow")
    out = OutputFolder(tmp_path / "out")
    told: dict[str, int] = {}

    def note(sequence: str, num_done: int) -> None:
        told[sequence] = num_done

    summary = run_apart(Opening(DeadlySplit, (source,)), config, out, workers, progress=note)
    assert told == {"S00001": 3, "S00002": 3, "S00003": 3}
    begun = Counter(path.name.partition("-")[0] for path in (source / "begun").iterdir())
    assert begun == {"S00001": 1, "S00002": 2, "S00003": 1}
    run("run", drives, "--out", tmp_path / "one")
    assert (out.path / "frames.jsonl").read_bytes() == (tmp_path / "one" / "frames.jsonl").read_bytes()
    assert summary.num_frames == 9
    assert names(out.path) == RESULTS


def test_annotate(tmp_path: Path, split: Path, options: tuple[object, ...]) -> None:
    alone, many = (shutil.copytree(split, tmp_path / name) for name in ("one", "many"))
    run("annotate", alone, "--json", tmp_path / "one.json")
    run("annotate", many, "--json", tmp_path / "many.json", *options)
    assert contents(many) == contents(alone)
    assert len(contents(alone, "labels/bounding_boxes/*.json")) == 8
    figures = [json.loads((tmp_path / f"{name}.json").read_text())[name] for name in ("one", "many")]
    assert figures[0] | {"root": ""} == figures[1] | {"root": ""}


@pytest.mark.usefixtures("undrawn")
def test_evaluate(tmp_path: Path, split: Path, options: tuple[object, ...]) -> None:
    pytest.importorskip("matplotlib")
    run("evaluate", split, "--out", tmp_path / "one", "--json", tmp_path / "one.json")
    run("evaluate", split, "--out", tmp_path / "many", "--json", tmp_path / "many.json", *options)
    assert (tmp_path / "many.json").read_bytes() == (tmp_path / "one.json").read_bytes()
    results = [json.loads((tmp_path / name / "results.json").read_text()) for name in ("one", "many")]
    assert results[0].pop("run_time_ms").keys() == results[1].pop("run_time_ms").keys()
    assert results[0] == results[1]


def test_simulate(tmp_path: Path, drives: Path, workers: Workers) -> None:
    root = simulate_dataset(tmp_path, SCENES, stub_drive.drive, workers=workers).root
    assert contents(root) == contents(drives)


@pytest.mark.renderer
def test_simulate_with_the_renderer(tmp_path: Path, options: tuple[object, ...]) -> None:
    (tmp_path / "scene.toml").write_text(scene_to_toml(scene(duration_s=2 / 18)))
    scenes = ("--scene", tmp_path / "scene.toml") * 2
    command = ("simulate", *scenes, "--size", "64x48", "--quality", "fast", "--out")
    run(*command, tmp_path / "one")
    run(*command, tmp_path / "many", *options)
    assert contents(tmp_path / "many") == contents(tmp_path / "one")
    assert len(contents(tmp_path / "one", "**/*.png")) >= 4


def test_tune_measures_the_same(tmp_path: Path, workers: Workers) -> None:
    data = make_night_set(tmp_path / "data", ("train",), num_images=3)
    settings = TuningSettings(num_trials=6, seed=3)
    alone, together = tune(data, tmp_path / "one", settings), tune(data, tmp_path / "many", settings, workers=workers)
    assert len(together.trials) == 6
    assert together.study_name == alone.study_name
    assert together.paper == alone.paper


def test_frames_in_order_only_are_refused(tmp_path: Path, drives: Path) -> None:
    for options in (("--video",), ("--limit", 2)):
        line = complaint("run", drives, "--out", tmp_path / "out", "--jobs", 2, *options)
        assert "--save and --limit without --jobs and --cluster" in line
    assert "expected --jobs or --cluster, got both" in complaint(
        "run", drives, "--out", tmp_path / "out", "--jobs", 2, "--cluster", "tcp://127.0.0.1:9"
    )
