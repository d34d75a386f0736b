"""Groups of options: a dataclass in a command's signature becomes options of the command."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from foreglow.cli.shared_run import open_frames
from foreglow.command_line import argument, flag, option, with_options
from foreglow.config import config_to_toml, preset
from foreglow.options import PipelineOptions, SourceOptions, VehicleOptions, WorkerOptions
from foreglow.runtime import Opening

SharedOption = Annotated[int, option("N", "A shared number.")]


@dataclass(frozen=True)
class Colours:
    """Colours of the lamp."""

    lamp: Annotated[str, argument("LAMP", "Which lamp.")]
    shade: Annotated[str, option("NAME", "Its shade.", "--colour")] = "amber"
    shared: SharedOption = 1


@dataclass(frozen=True)
class Sizes:
    """Sizes of the lamp."""

    is_large: Annotated[bool, flag("--large", "Take the large one.")] = False


def program() -> tuple[typer.Typer, list[object]]:
    app = typer.Typer(add_completion=False)
    calls: list[object] = []

    @app.command()
    @with_options
    def paint(colours: Colours, sizes: Sizes, number: SharedOption = 2) -> None:
        """Paint a lamp."""
        calls.append((colours, sizes, number))

    return app, calls


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["left"], (Colours("left"), Sizes(), 2)),
        (["left", "--colour", "red", "--shared", "3", "--large"], (Colours("left", "red", 3), Sizes(True), 2)),
        (["--number", "5", "left"], (Colours("left"), Sizes(), 5)),
    ],
)
def test_groups_arrive_as_values(arguments: list[str], expected: object) -> None:
    app, calls = program()
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert calls == [expected]


def test_what_a_group_requires_is_required() -> None:
    app, calls = program()
    assert CliRunner().invoke(app, []).exit_code == 2
    assert calls == []


def test_a_group_has_its_heading_and_leaves_single_options_alone() -> None:
    app, _ = program()
    headings = {param.name: param.rich_help_panel for param in typer.main.get_command(app).params}  # type: ignore[attr-defined]
    assert headings == {
        "lamp": None,
        "shade": "Colours of the lamp",
        "shared": "Colours of the lamp",
        "is_large": "Sizes of the lamp",
        "number": None,
    }


def test_a_model_overrides_the_file_and_the_file_the_preset(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('[classifier]\nmodel = "a.onnx"\nscore_threshold = 0.75\n')
    configuration = PipelineOptions(preset="paper", config=path, model=Path("b.onnx")).configuration()
    assert configuration.classifier.model == Path("b.onnx")
    assert configuration.classifier.score_threshold == 0.75
    assert configuration.proposals == PipelineOptions(preset="paper").configuration().proposals
    assert PipelineOptions().configuration() == PipelineOptions(preset="foreglow").configuration()


def test_a_model_judges_the_boxes_that_it_has_learnt(tmp_path: Path) -> None:
    """Those of another preset were scored as if it knew them."""
    model, file = tmp_path / "model.onnx", tmp_path / "config.toml"
    file.write_text("[proposals]\nkappa = 0.4\n[tracker]\nmin_hits = 4\n")
    PipelineOptions(model=model).configuration()  # a part of a configuration does not say which boxes
    file.write_text(config_to_toml(preset("paper").changed("classifier", model=model)))
    with pytest.raises(ValueError, match=rf"expected --config {file} with --model {model}, which knows the boxes"):
        PipelineOptions(model=model).configuration()
    with pytest.raises(ValueError, match="expected --preset foreglow with --model foreglow, which knows the boxes"):
        PipelineOptions(preset="paper", model=Path("foreglow")).configuration()
    for right in (PipelineOptions(config=file), PipelineOptions(preset="paper", model=model)):
        assert right.configuration().classifier.model == model
    assert PipelineOptions(config=file, model=model).configuration().proposals == preset("paper").proposals


def test_without_files_nothing_is_read() -> None:
    assert VehicleOptions().read() is None


@pytest.mark.parametrize(("field", "option"), [("time_offset", "--time-offset"), ("pose_error", "--pose-error")])
def test_numbers_without_their_files_are_refused(field: str, option: str) -> None:
    with pytest.raises(ValueError, match=f"{option}: expected with "):
        VehicleOptions(**{field: 3.0}).read()  # type: ignore[arg-type]


def test_work_is_parallel_with_jobs_or_a_cluster() -> None:
    assert not WorkerOptions().is_parallel
    assert WorkerOptions(jobs=2).is_parallel
    assert WorkerOptions(cluster="tcp://127.0.0.1:9").is_parallel


def test_workers_get_the_options_and_know_their_files(tmp_path: Path) -> None:
    """On a cluster, every file of a run must be there for every machine."""
    calibration = tmp_path / "camera.toml"
    calibration.touch()
    vehicle = VehicleOptions(calibration=calibration, dbc=tmp_path / "missing.dbc")
    opening = Opening(open_frames, (tmp_path, SourceOptions(limit=3), vehicle))
    assert opening.paths == (tmp_path, calibration)
    assert pickle.loads(pickle.dumps(opening)) == opening
    assert hash(opening) == hash(pickle.loads(pickle.dumps(opening)))
