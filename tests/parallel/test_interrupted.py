"""A run whose sequences are run apart, and which does not come to its end."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from foreglow.config import preset
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from foreglow.parallel import Local
from foreglow.runtime import Opening, OutputFolder, RunSummary, run_apart
from tests.cli.commands import RESULTS, names
from tests.lab.simulation import stub_drive
from tests.parallel.splits import SlowSplit
from tests.parallel.test_local import wait_for

pytestmark = pytest.mark.process


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three drives of twelve frames, five seconds each."""
    scenes = [stub_drive.scene(seed, num_frames=12) for seed in (1, 2, 3)]
    return simulate_dataset(tmp_path_factory.mktemp("drives"), scenes, stub_drive.drive).root


def run_interrupted(drives: Path, out: Path, presses: int) -> RunSummary:
    """Presses Ctrl-C when the first frames are done."""

    def press(*_: object) -> None:
        for _press in range(presses if not pressed else 0):
            signal.raise_signal(signal.SIGINT)
        pressed.append(True)

    pressed: list[bool] = []
    return run_apart(Opening(SlowSplit, (drives,)), preset("foreglow"), OutputFolder(out), Local(2), progress=press)


def test_what_is_done_of_every_sequence_is_kept_in_order(drives: Path, tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    summary = run_interrupted(drives, tmp_path, presses=1)
    assert not summary.is_complete
    lines = [json.loads(line) for line in (tmp_path / "frames.jsonl").read_text().splitlines()]
    assert 0 < len(lines) == summary.num_frames < 24
    sequences = [line["sequence"] for line in lines]
    assert sequences == sorted(sequences)
    assert set(sequences) <= {"S00001", "S00002"}  # the third was not begun
    for sequence in set(sequences):
        frames = [line["frame"] for line in lines if line["sequence"] == sequence]
        assert frames == [10_000 * int(sequence[1:]) + index for index in range(len(frames))]
    assert names(tmp_path) == RESULTS
    assert signal.getsignal(signal.SIGINT) is before


def test_after_a_second_ctrl_c_nothing_is_left(drives: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_interrupted(drives, tmp_path / "out", presses=2)
    assert names(tmp_path) == set()


SCRIPT = """
import sys
from pathlib import Path
from foreglow.config import preset
from foreglow.runtime import Opening, OutputFolder, run_apart
from foreglow.parallel import Local
from tests.parallel.splits import SlowSplit

run_apart(
    Opening(SlowSplit, (Path(sys.argv[1]),)), preset("foreglow"), OutputFolder(Path(sys.argv[2])), Local(2),
    progress=lambda *_: Path(sys.argv[3]).write_text("told"),
)
"""


def test_killed_it_leaves_no_result_and_the_next_run_clears_up(drives: Path, tmp_path: Path) -> None:
    out, mark = tmp_path / "out", tmp_path / "mark"
    command = [sys.executable, "-c", SCRIPT, str(drives), str(out), str(mark)]
    parent = subprocess.Popen(command, cwd=Path(__file__).parents[2])
    wait_for(mark)
    parent.kill()
    parent.wait(20)
    left = names(out)
    assert not left & RESULTS
    assert any(name.startswith("parts-") for name in left)
    run_interrupted(drives, out, presses=1)
    assert names(out) == RESULTS
