"""Which drives of an earlier run are kept, when a data set goes on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from tests.lab.simulation.stub_drive import drive, scene

SCENES = [scene(1), scene(2, num_frames=2)]


def test_a_set_of_before_goes_on_though_it_names_a_low_beam_that_does_not_shine(tmp_path: Path) -> None:
    """Its images are the same; what it says of its drives stays, as results made of them go by it."""

    def lit(scene: Scene, **fields: object) -> Scene:
        return scene.model_copy(update={"ego": scene.ego.model_copy(update={"beam": "matrix", **fields})})

    simulate_dataset(tmp_path, [lit(SCENES[0], carpet=0.4)], drive)
    before = (tmp_path / "night/train/scenes.jsonl").read_text()
    assert simulate_dataset(tmp_path, [lit(scene) for scene in SCENES], drive).num_kept == 1
    after = (tmp_path / "night/train/scenes.jsonl").read_text()
    assert after.startswith(before)
    assert '"carpet": 1.0' in after.removeprefix(before)
    with pytest.raises(ValueError, match=r"scene\.ego\.brightness: expected 0\.5"):
        simulate_dataset(tmp_path, [lit(SCENES[0], brightness=0.5), lit(SCENES[1])], drive)


def test_lamps_that_have_changed_under_their_names_are_not_mixed_in(tmp_path: Path) -> None:
    file, out = tmp_path / "l.ies", tmp_path / "DATA"
    file.write_text("one lamp")
    cars = [SCENES[0].vehicles[0], SCENES[0].vehicles[1].model_copy(update={"low_beam_file": str(file)})]
    ego = SCENES[1].ego.model_copy(update={"low_beam_file": str(file)})
    scenes = [SCENES[0].model_copy(update={"vehicles": tuple(cars)}), SCENES[1].model_copy(update={"ego": ego})]
    simulate_dataset(out, scenes, drive)
    assert simulate_dataset(out, scenes, drive).num_kept == 2
    file.write_text("another")
    first, second = (out / f"night/train/simulation/S0000{number}/scene.json" for number in (1, 2))
    for record, field in ((first, "lamps.vehicles.1"), (second, "lamps.ego")):
        with pytest.raises(ValueError, match=rf"{record}: {field}\.low_beam_file: expected 'sha256:.* as in this run"):
            simulate_dataset(out, scenes, drive)
        of_before = json.loads(record.read_text())
        del of_before["lamps"]
        record.write_text(json.dumps(of_before))
    assert simulate_dataset(out, scenes, drive).num_kept == 2
    file.unlink()
    with pytest.raises(FileNotFoundError, match=r"l\.ies"):
        simulate_dataset(out, scenes, drive)
