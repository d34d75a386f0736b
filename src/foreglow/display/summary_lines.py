"""What came of a run, in lines for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from foreglow.plugins import printable

if TYPE_CHECKING:
    from foreglow.runs.summary_file import BeamSummary, RunSummary


def run_lines(summary: RunSummary, out: Path) -> list[str]:
    """What came of a run whose results are in the folder or the recording `out`.

    The last line says where to look.
    """
    found = f"{counted(summary.num_frames, 'frame')}, {counted(summary.num_proposals, 'proposal')}"
    if summary.num_accepted is not None:
        found += f", {counted(summary.num_accepted, 'light artifact')}"
    if summary.num_tracks is not None:
        found += f", {counted(summary.num_tracks, 'track')}"
    total_ms = summary.run_time_ms["total"]
    if total_ms["median"] is not None:
        found += f"; {total_ms['median']:.2f} ms a frame (median), {total_ms['p99']:.2f} ms (p99)"
    lines = [found]
    if not summary.is_classified:
        lines.append("the proposals are not classified: no model was given (--model FILE)")
    if summary.num_ranged == 0 and summary.num_with_camera:
        if summary.num_scored and summary.calibration is not None:  # else a run without one is taken
            lines.append(
                "nothing has a range: the estimator found none; psd_3d, psd_3d_plus and psd_2d need the road ahead "
                "(--can-log, or --map with --poses)"
            )
    elif summary.num_ranged == 0:
        lines.append(
            "nothing has a range: the camera's calibration is not known (--calibration FILE; `foreglow calibrate auto "
            "VIDEO --out camera.toml` estimates one, and so does --calibration auto)"
        )
    if summary.beam is not None:
        lines += beam_lines(summary.beam, summary.num_frames)
    lines += left_out_lines(summary.skipped, summary.num_lost_parts, "listed in summary.json" if out.is_dir() else "")
    if summary.num_damaged:
        are = "is" if summary.num_damaged == 1 else "are"
        lines.append(f"{counted(summary.num_damaged, 'frame')} {are} damaged, marked by is_damaged in their lines")
    if summary.source_lack is not None:
        lines.append(summary.source_lack)
    if summary.is_interrupted:
        lines.append("interrupted: the results are complete up to there")
    if out.is_dir():
        names = [path.name for path in sorted(out.iterdir()) if path.is_file()]
        lines.append(f"look in {out}: {', '.join(names)}")
    else:
        lines.append(f"look at {out}, such as in Foxglove")
    return [printable(line) for line in lines]


def left_out_lines(skipped: Sequence[str], num_lost_parts: int, listed: str = "") -> list[str]:
    """What was left out of a source; `skipped` and `num_lost_parts` as in `RunSummary`, `listed` is where to look."""
    lines = [f"{len(skipped)} skipped as unreadable, {listed or f'the first: {skipped[0]}'}"] if skipped else []
    if num_lost_parts:
        lines.append("any number of frames may be missing: parts of the file could not be read")
    return lines


def beam_lines(beam: BeamSummary, num_frames: int) -> list[str]:
    """What the headlamps were commanded, and the reasons for low beam."""
    counts = {"full": beam.num_full, "glare-free": beam.num_glare_free, "low": beam.num_low}
    shares = ", ".join(f"{name} {count / num_frames:.1%}" for name, count in counts.items())
    gaps = "no gaps" if beam.mean_gap_deg is None else f"gaps {beam.mean_gap_deg:.1f} degrees wide in the mean"
    lines = [f"beam, of the frames: {shares}; {gaps}"]
    if beam.faults:
        faults = ", ".join(f"{name} in {counted(count, 'frame')}" for name, count in beam.faults.items())
        lines.append(f"low beam for {faults}")
    return lines


def counted(number: int, noun: str) -> str:
    """The number and its noun.

    >>> counted(1, "frame"), counted(2, "box")
    ('1 frame', '2 boxes')
    """
    plural = "es" if noun.endswith(("x", "ch")) else "s"
    return f"{number} {noun}{'' if number == 1 else plural}"
