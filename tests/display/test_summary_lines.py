"""What came of a run, in lines for a terminal."""

from __future__ import annotations

from pathlib import Path

from foreglow.display.summary_lines import run_lines
from foreglow.runs.tally import Tally
from tests.stand_ins import REFERENCE


def test_control_characters_of_names_are_shown_and_not_carried_out(tmp_path: Path) -> None:
    """They may be those of somebody else's images, or of any file in the folder."""
    (tmp_path / "a\x1b[2Jb.txt").touch()
    skipped = ["c\x1b[31m.png: expected a PNG"]
    summary = Tally().summary(str(tmp_path), skipped, REFERENCE, is_complete=True, dispatch=None)
    for out, words in (
        (tmp_path, r"a\x1b[2Jb.txt"),
        (tmp_path / "run.mcap", r"the first: c\x1b[31m.png: expected a PNG"),
    ):
        lines = run_lines(summary, out)
        assert all(line.isprintable() for line in lines)
        assert words in " ".join(lines)
