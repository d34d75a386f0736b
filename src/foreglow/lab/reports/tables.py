"""Results as text for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

if TYPE_CHECKING:
    from foreglow.lab.evaluation import BoxQuality
    from foreglow.lab.learning.annotate import Annotation
    from foreglow.lab.learning.training_run import TrainedModel
    from foreglow.lab.learning.tuning import Tuning
    from foreglow.lab.simulation import DatasetSummary
    from foreglow.runs.summary import BeamSummary
    from foreglow.runtime import RunSummary


def run_lines(summary: RunSummary, out: Path) -> list[str]:
    """What came of a run into the folder or the recording `out`, one fact a line; the last says where to look."""
    found = f"{_counted(summary.num_frames, 'frame')}, {_counted(summary.num_proposals, 'proposal')}"
    if summary.num_accepted is not None:
        found += f", {_counted(summary.num_accepted, 'light artifact')}"
    if summary.num_tracks is not None:
        found += f", {_counted(summary.num_tracks, 'track')}"
    total_ms = summary.run_time_ms["total"]
    if total_ms["median"] is not None:
        found += f"; {total_ms['median']:.2f} ms a frame (median), {total_ms['p99']:.2f} ms (p99)"
    lines = [found]
    if not summary.is_classified:
        lines.append("the proposals are not classified: no model was given (--model FILE)")
    if summary.num_ranged == 0:
        lines.append("nothing has a range: the camera's calibration is not known (--calibration FILE)")
    if summary.beam is not None:
        lines += beam_lines(summary.beam, summary.num_frames)
    if summary.num_skipped:
        listed = "listed in summary.json" if out.is_dir() else f"the first: {summary.skipped[0]}"
        lines.append(f"{_counted(summary.num_skipped, 'unreadable frame')} skipped, {listed}")
    if not summary.is_complete:
        lines.append("interrupted: the results are complete up to there")
    if not out.is_dir():
        return [*lines, f"look at {out}, such as in Foxglove"]
    names = [path.name for path in sorted(out.iterdir()) if path.is_file()]
    return [*lines, f"look in {out}: {', '.join(names)}"]


def beam_lines(beam: BeamSummary, num_frames: int) -> list[str]:
    """What the headlamps were told, and why there was low beam."""
    counts = {"full": beam.num_full, "glare-free": beam.num_glare_free, "low": beam.num_low}
    shares = ", ".join(f"{name} {count / num_frames:.1%}" for name, count in counts.items())
    gaps = "no gaps" if beam.mean_gap_deg is None else f"gaps {beam.mean_gap_deg:.1f} degrees wide in the mean"
    lines = [f"beam, of the frames: {shares}; {gaps}"]
    if beam.faults:
        faults = ", ".join(f"{name} in {_counted(count, 'frame')}" for name, count in beam.faults.items())
        lines.append(f"low beam for {faults}")
    return lines


def dataset_lines(summary: DatasetSummary) -> list[str]:
    """What is in a simulated data set, one fact a line; the last says where it is."""
    labels = summary.labels
    drives = _counted(labels.num_sequences, "drive")
    if summary.num_kept:
        drives += f" ({summary.num_kept} of them were there)"
    return [
        f"{drives}, {_counted(labels.num_images, 'image')}, {labels.num_empty_images} of them without any instance",
        f"instances: {labels.num_direct} direct, {labels.num_indirect} indirect, {labels.num_doubtful} doubtful",
        f"look in {summary.root}; foreglow run, evaluate and every later command read it as PVDN",
    ]


def annotation_table(annotations: Sequence[Annotation], parameters: str) -> Table:
    """The generated boxes, and how well the positive ones explain the key points: a column a split."""
    caption = "P, R, F, q: of the positive boxes, the most that a classifier of these boxes can reach"
    table = Table("", title=f"boxes of {parameters}", caption=caption, title_justify="left", caption_justify="left")
    for one in annotations:
        table.add_column(one.root.resolve().name, justify="right")
    table.add_row("images", *(str(one.num_images) for one in annotations))
    table.add_row("boxes", *(str(one.num_boxes) for one in annotations))
    table.add_row("boxes an image", *(_number(one.boxes_per_image) for one in annotations))
    table.add_row("positive boxes", *(str(one.num_positive) for one in annotations))
    table.add_row("left out: doubtful light only", *(str(one.num_ignored) for one in annotations), end_section=True)
    for label, name in (("P", "precision"), ("R", "recall"), ("F", "f1"), ("q", "q")):
        table.add_row(label, *(_number(getattr(one.quality, name)) for one in annotations))
    for label, name in (("q_K", "q_k"), ("q_B", "q_b")):
        pairs = ((getattr(one.quality, name), getattr(one.quality, f"{name}_std")) for one in annotations)
        table.add_row(label, *(f"{_number(mean)} ± {_number(spread)}" for mean, spread in pairs))
    return table


def tuning_lines(tuning: Tuning) -> list[str]:
    """What came of a parameter search, beside the paper's parameters."""
    chosen, paper = tuning.chosen, tuning.paper
    num_pruned = sum(one.state == "PRUNED" for one in tuning.trials)
    papers = paper.config.model_dump()
    changes = ", ".join(
        f"{name} {value}" for name, value in chosen.config.model_dump().items() if value != papers[name]
    )
    lines = [
        f"{_counted(len(tuning.trials), 'trial')} ({num_pruned} ended early), objective {tuning.settings.objective}; "
        f"the trials of this call took {tuning.seconds['trials']:.0f} s",
        f"chosen: {changes}" if changes else "chosen: the paper's parameters",
    ]
    for split in ("train", "val", "test"):
        found, beside = getattr(chosen, split), getattr(paper, split)
        if found is not None:
            names = {"q": "q", "recall": "R", "boxes_per_image": "boxes an image"}
            parts = (f"{label} {found.figures[n]:.3f} (paper {beside.figures[n]:.3f})" for n, label in names.items())
            lines.append(f"{split}: {', '.join(parts)}")
    return lines


def training_lines(trained: TrainedModel) -> list[str]:
    """What came of a training, one fact a line; the last says how to use it."""
    summary = trained.summary
    counts, figures, best = summary["samples"], summary["validation"], summary["best_epoch"]
    lines = [
        f"{name}: {_counted(counts[name]['positive'], 'box')} with light, {counts[name]['negative']} without, "
        f"{counts[name]['ignored']} doubtful and left out"
        for name in ("train", "val")
    ]
    lines += [
        f"{_counted(summary['num_epochs'], 'epoch')}, the best is number {best['number']}; on the validation boxes "
        f"P {best['precision']:.3f}, R {best['recall']:.3f}, F {best['f1']:.3f} at a score of 0.5",
        f"calibrated with temperature {figures['temperature']:.2f}: calibration error "
        f"{figures['calibration_error']['before']:.3f} before, {figures['calibration_error']['after']:.3f} after",
    ]
    if not (trained.folder / "curves.png").is_file():
        lines.append("no picture of the curves: it needs pip install 'foreglow[plots]'")
    return [*lines, f"look in {trained.folder}; use it with foreglow run SOURCE --config {trained.folder}/config.toml"]


def _counted(number: int, noun: str) -> str:
    plural = "es" if noun.endswith("x") else "s"
    return f"{number} {noun}{'' if number == 1 else plural}"


def box_quality_table(quality: BoxQuality, title: str) -> Table:
    """The numbers of `quality`, with a dash for those that are not defined, and the counts behind them."""
    condition = f"score > {quality.threshold:g}" if quality.is_scored else "boxes without scores, all count"
    caption = f"{_counted(quality.num_images, 'image')}, {condition}"
    if quality.num_missing:
        caption += f"\n{_counted(quality.num_missing, 'image')} without predictions, counted as without boxes"
    if quality.num_unknown:
        caption += f"\npredictions for {_counted(quality.num_unknown, 'unknown image')} ignored"
    table = Table("", "", "std", title=title, caption=caption, title_justify="left", caption_justify="left")
    table.columns[1].justify = "right"
    for name, value in (("precision", quality.precision), ("recall", quality.recall), ("F", quality.f1)):
        table.add_row(name, _number(value))
    table.add_section()
    table.add_row("q", _number(quality.q))
    table.add_row("q_K", _number(quality.q_k), f"± {_number(quality.q_k_std)}")
    table.add_row("q_B", _number(quality.q_b), f"± {_number(quality.q_b_std)}")
    table.add_section()
    table.add_row("TP (key points in a box)", str(quality.tp))
    table.add_row("FN (key points in none)", str(quality.fn))
    table.add_row("FP (boxes without key point)", str(quality.fp))
    return table


def _number(value: float) -> str:
    """`value` to four decimals; a dash for NaN."""
    return "-" if value != value else f"{value:.4f}"
