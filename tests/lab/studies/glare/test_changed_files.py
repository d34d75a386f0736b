"""Files of a car that change between two calls of the experiment on glare, or while it drives."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Never

import pytest

from foreglow.config import preset
from foreglow.lab.studies.glare import simulate as driving
from foreglow.lab.studies.glare.run import GlarePlan, run_experiment
from foreglow.models import BUNDLED, model_path
from foreglow.parallel import Local
from foreglow.photometry.headlamps_file import SHIPPED
from tests.lab.studies.detector_data import make_model
from tests.lab.studies.glare_scenes import scene, write_scenes_of

pytestmark = [pytest.mark.renderer, pytest.mark.slow]


@pytest.mark.parametrize("name", ["model.onnx", "lamps.toml", "paper.onnx"])
def test_a_file_that_changes_while_scenes_are_driven_is_noticed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each scene's drive opens them anew: later ones were of another model than the plan says."""
    monkeypatch.setattr(driving, "RUN_IN_S", 0.1)
    path = tmp_path / name
    if name == "model.onnx":
        path.write_bytes(model_path(Path(BUNDLED)).read_bytes())
        car = preset("foreglow").changed("classifier", model=path)
    else:
        car = preset("foreglow")
    if name == "lamps.toml":
        car = car.commanding(headlamps=Path(shutil.copy(SHIPPED, path)))
    paper = make_model(path) if name == "paper.onnx" else None

    def meanwhile(number: int, num_done: int, num_all: int) -> None:  # noqa: ARG001
        if num_done == 1:
            content = path.read_bytes()  # the name of the program that wrote it, or a comment
            path.write_bytes(
                content + b"\n" if path.suffix == ".toml" else content.replace(b"foreglow", b"foreglov", 1)
            )
            assert path.read_bytes() != content

    scenes, plan = write_scenes_of(tmp_path, scene(0.1 + 3 / 18)), GlarePlan(quality="fast", paper_model=paper)
    with pytest.raises(ValueError, match=r"plan\.json: .* while scenes were driven"):
        run_experiment(scenes, car, plan, tmp_path / "out", progress=meanwhile)
    assert not list(tmp_path.glob("out/drives/*"))


POLICY = """
from helping_beam import LEVEL

class Mine:
    def __init__(self, config, headlamps): ...
    def command(self, frame, tracks): ...
    def shone(self, command): ...
    def reset(self): ...
"""


@pytest.mark.parametrize("name", ["my_beam", "helping_beam"])
def test_drives_of_a_policy_as_it_was_are_not_taken_for_those_of_it_now(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who works on a policy repeats the command after each change, and read the figures of the first one."""

    class Stopped(Local):
        def each(self, *_: object, **__: object) -> Never:
            raise KeyboardInterrupt

    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_beam.py").write_text(POLICY)
    (tmp_path / "helping_beam.py").write_text("LEVEL = 1\n")
    scenes, car = write_scenes_of(tmp_path / "scenes", scene()), preset("foreglow").commanding(policy="my_beam:Mine")

    def begin() -> None:
        for module in ("my_beam", "helping_beam"):  # as in a process of its own
            monkeypatch.delitem(sys.modules, module, raising=False)
        run_experiment(
            scenes, car, GlarePlan(quality="fast"), tmp_path / "out", workers=Stopped(), progress=lambda *_: None
        )

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            begin()
    path = tmp_path / f"{name}.py"
    path.write_text(path.read_text() + "# changed\n")
    with pytest.raises((ValueError, KeyboardInterrupt), match=rf"models: expected module {name} as it was here before"):
        begin()
