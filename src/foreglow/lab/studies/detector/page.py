"""The report on the table of detectors: Markdown, JSON, and one HTML page with everything in it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import LabelledSource
from foreglow.display.overlay import Measures, Picture, annotate
from foreglow.lab.evaluation import Predictions, SplitLabels, match_lights
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.page import DASH, Figure, Missing, Page, Table
from foreglow.lab.studies.detector.rows import ROWS, THRESHOLD
from foreglow.lab.studies.detector.run import DetectorResults, RowResult
from foreglow.types import Detections, Frame, FrameResult, Proposals

PICTURE_WIDTH_PX = 900
JPEG_QUALITY = 82
FOUND_BGR, MISSED_BGR = (120, 235, 90), (60, 60, 250)

NUM_BEST, NUM_WORST = 2, 3
HIDDEN_WEIGHT = 3.0
"""How much more a light counts whose vehicle has not shown a lamp so far: finding it is what this is about."""


class Choice(NamedTuple):
    """An image to show of a row; `is_best` if it shows what works, rather than what does not."""

    image_id: int
    is_best: bool
    num_false: int


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A chosen image of a row with what is to be drawn on it.

    Attributes:
        result: Its accepted boxes, with scores.
        lights_px: Shape (K, 2): labelled lights.
        is_found: Shape (K,): whether it lies in an accepted box.
    """

    row: str
    choice: Choice
    frame: Frame
    result: FrameResult
    lights_px: NDArray[np.float64]
    is_found: NDArray[np.bool_]


def choose(labels: SplitLabels, predictions: Predictions) -> tuple[Choice, ...]:
    """The best and the worst images of a row, best first, at most one of a scene each.

    The best have the most found lights less missed ones and false boxes, hidden vehicles' light counted three times;
    the worst the most missed lights and false boxes. Of equals, the first image.
    """
    matched = match_lights(labels, predictions)
    matches = matched.matches
    is_found = matched.best_scores > THRESHOLD
    weights = np.where(matched.is_hidden, HIDDEN_WEIGHT, 1.0)
    is_false = (matches.scores > THRESHOLD) & ~matches.has_point & ~matched.has_doubtful

    def by_image(image_of: NDArray[np.intp], values: NDArray[Any]) -> NDArray[np.float64]:
        return np.bincount(image_of, values, minlength=matches.num_images).astype(np.float64)

    found = by_image(matches.image_of_point, is_found * weights)
    missed = by_image(matches.image_of_point, ~is_found * weights)
    false = by_image(matches.image_of_box, is_false)
    good = np.where(found > 0, found - missed - false, -np.inf)

    def chosen(merits: NDArray[np.float64], num: int, is_best: bool) -> Iterator[Choice]:
        scenes: set[int] = set()
        for index in np.argsort(-merits, kind="stable"):
            image_id = matches.image_ids[index]
            scene = labels.sequence_of[image_id]
            if len(scenes) == num or not merits[index] > 0:
                return
            if scene not in scenes:
                scenes.add(scene)
                yield Choice(image_id, is_best, int(false[index]))

    return (*chosen(good, NUM_BEST, True), *chosen(missed + false, NUM_WORST, False))


def pictures(results: DetectorResults, dataset: LabelledSource) -> Iterator[Shown]:
    """The images to show of every row that was made, in the table's order.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If one is broken.
    """
    for row, predictions in results.predictions.items():
        for choice in choose(results.labels, predictions):
            frame = dataset.read(choice.image_id)
            scores = predictions.scores[choice.image_id]
            is_accepted = scores > THRESHOLD
            boxes = predictions.boxes_xyxy_px[choice.image_id][is_accepted]
            lights_px = results.labels.keypoints_px[choice.image_id]
            is_found = lies_in(lights_px[:, None], boxes).any(axis=1)
            yield Shown(row, choice, frame, _result(frame, boxes, scores[is_accepted]), lights_px, np.asarray(is_found))


def figure(shown: Shown) -> Figure:
    """The drawn image, with what is found in it, and what is not, in words."""
    choice, num_missed = shown.choice, int((~shown.is_found).sum())
    words = f"{int(shown.is_found.sum())} found, {num_missed} missed, {choice.num_false} false"
    mark = "works" if choice.is_best else "does not"
    data = jpeg(draw(shown), PICTURE_WIDTH_PX, JPEG_QUALITY)
    return Figure(data, f"{mark}: {shown.frame.sequence}, image {choice.image_id}: {words}")


def draw(shown: Shown) -> Picture:
    """The brightened image with its accepted boxes, and a mark at every labelled light: green if found, red if not."""
    measures = Measures.of(shown.frame.width_px, shown.frame.height_px)
    picture = annotate(shown.frame, shown.result)[: shown.frame.height_px * measures.enlargement]  # without its caption
    for (x, y), is_found in zip(shown.lights_px.tolist(), shown.is_found.tolist(), strict=True):
        centre = (round((x + 0.5) * measures.enlargement), round((y + 0.5) * measures.enlargement))
        if is_found:
            cv2.circle(picture, centre, 3 * measures.bold_px, FOUND_BGR, measures.thin_px, cv2.LINE_AA)
        else:
            size_px = 9 * measures.bold_px
            cv2.drawMarker(picture, centre, MISSED_BGR, cv2.MARKER_TILTED_CROSS, size_px, measures.bold_px, cv2.LINE_AA)
    return picture


def _result(frame: Frame, boxes_xyxy_px: NDArray[np.float64], scores: NDArray[np.float64]) -> FrameResult:
    """Boxes as a pipeline would have given them: whole pixels, at least one wide and high."""
    corners = np.rint(boxes_xyxy_px).astype(np.int32)
    corners[:, 2:] = np.maximum(corners[:, 2:], corners[:, :2] + 1)
    proposals = Proposals(corners)
    found = np.clip(scores, 0.0, 1.0).astype(np.float32)
    return FrameResult(frame.frame, frame.timestamp_ns, proposals, Detections(proposals, found, 0.0))


Cells: TypeAlias = list[str]

METRICS = {"precision": "P", "recall": "R", "f1": "F", "q": "q", "q_k": "q_K", "q_b": "q_B"}
ASPECTS = ("kind", "strength", "sight")


def write_report(results: DetectorResults, pictures: Iterable[Shown], folder: Path) -> Path:
    """Writes `results.json`, `table.md` and `report.html` to `folder`, and returns the last one's path.

    Raises:
        OSError: If a file cannot be written.
    """
    page = _page(results)
    files = {"table.md": page.markdown()}
    page.section(
        "Hits and misses",
        "Brightened. Boxes are accepted ones, with their scores; circles are labelled lights in a box, red crosses "
        "those in none. Two images that show what works, three that show what does not, each of another drive.",
    )
    for row, shown in itertools.groupby(pictures, key=lambda picture: picture.row):
        page.pictures(map(figure, shown), ROWS[row].title)
    return page.write(folder / "report.html", results=results, files=files)


def _page(results: DetectorResults) -> Page:
    num_images, num_scenes = len(results.labels.lights), len(set(results.labels.sequence_of.values()))
    page = Page(f"Detectors on {results.labels.name}")
    page.text(
        f"{num_images} images of {num_scenes} drives of {results.data}. Boxes count with a score above 0.5.",
        "In parentheses: the labelled boxes themselves, which bound any classifier;",
        "for a YOLO, boxes like those that it learnt from, which bound nothing.",
        "Multiply-adds are those of one crop, or of one image of a YOLO, and of a whole frame.",
        "Run-times are for one thread and leave decoding out, mean ± standard deviation;",
        "a YOLO runs in torch, the others in ONNX Runtime.",
    )
    if not any(results.labels.lights.values()):
        page.text("No key point in any image, so that only false boxes are judged: is the split labelled?")
    page.table(main_table(results.rows))
    page.section(
        "Recall by what a light is",
        "In brackets: the share of the lights in any box, whatever its score. Hidden: no lamp of the vehicle so far.",
    )
    page.table(kind_table(results.rows))
    page.section(
        "Hidden vehicles against false boxes",
        "Recall of hidden vehicles' lights at the threshold with at most so many false boxes a frame in images without "
        "any vehicle's light. The last but one column: such false boxes a frame at 0.5. The last: the share of the "
        "vehicles whose light comes before their lamps that are found before.",
    )
    page.table(hidden_table(results.rows))
    if any(_whose_light(row) for row in results.rows):
        page.section("By whose light", "A box is false if other vehicles make less than a tenth of its light.")
        page.table(whose_light_table(results.rows))
    page.section("Differences of F")
    page.items(_comparison_lines(results))
    page.section("How each was made")
    page.items(_origins(results))
    return page


def main_table(rows: Sequence[RowResult]) -> Table:
    """The paper's table: size, run-time and metrics, in parentheses those of the labelled boxes themselves."""
    head = [
        "image",
        "parameters",
        "multiply-adds",
        "a frame",
        "ms a frame",
        "median",
        "p99",
        *METRICS.values(),
        "boxes a frame",
    ]
    return _table(head, rows, _main_cells)


def kind_table(rows: Sequence[RowResult]) -> Table:
    """Recall by what a light is, with the number of lights in the head; that of all boxes in brackets."""
    groups = [_groups(row) for row in rows]
    numbers = {key: group["num"] for groups_of_row in groups for key, group in groups_of_row.items()}
    ordered = sorted(numbers, key=lambda key: ASPECTS.index(key[0]))

    def cells(row: RowResult) -> Cells:
        its_groups = _groups(row)
        return [f"{_rate(its_groups[key]['recall'])} [{_rate(its_groups[key]['ceiling'])}]" for key in ordered]

    return _table([f"{name} ({numbers[aspect, name]})" for aspect, name in ordered], rows, cells)


def hidden_table(rows: Sequence[RowResult]) -> Table:
    """Recall of hidden vehicles' light at limits of false boxes in images without any vehicle's light."""
    limits = sorted({point["limit"] for row in rows for point in _points(row)})
    head = ["AP", "best F", *(f"at most {limit:g}" for limit in limits), "false boxes a frame", "found ahead"]

    def cells(row: RowResult) -> Cells:
        ranking = row.examination["ranking"] or {}
        by_limit = {point["limit"]: point["recall_hidden"] for point in _points(row)}
        false = row.examination["breakdown"]["false_boxes_empty"]["per_frame"]
        hidden = [by_limit.get(limit) for limit in limits]
        ranked = [ranking.get(name) for name in ("average_precision", "best_f1")]
        return [_rate(value) for value in (*ranked, *hidden, false, row.examination["share_found_ahead"])]

    return _table(head, rows, cells)


def whose_light_table(rows: Sequence[RowResult]) -> Table:
    """The figures by whose light is in the boxes; dashes where the data set does not store that for a row's boxes."""
    limits = sorted({point["limit"] for row in rows for point in _whose_light(row).get("operating_points", ())})
    head = ["P", "AP", "false boxes a frame", "without vehicles", *(f"hidden at most {limit:g}" for limit in limits)]

    def cells(row: RowResult) -> Cells:
        found = _whose_light(row)
        by_limit = {point["limit"]: point["recall_hidden"] for point in found.get("operating_points", ())}
        false = [(found.get(name) or {}).get("per_frame") for name in ("false_boxes", "false_boxes_empty")]
        values = (found.get("precision"), found.get("average_precision"), *false, *map(by_limit.get, limits))
        return [_rate(value) for value in values]

    return _table(head, rows, cells)


def count(value: float) -> str:
    """A large number in words of three digits.

    >>> count(941761), count(195.4e6), count(28.1e9)
    ('942 k', '195 M', '28.1 G')
    """
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.3g}"


def _table(head: Cells, rows: Sequence[RowResult], cells: Callable[[RowResult], Cells]) -> Table:
    """A row for each detector; of one that could not be made, why."""
    shown = [[row.title, *(cells(row) if row.reason is None else [Missing(row.reason)])] for row in rows]
    return Table(["detector", *(head or [""])], shown)


def _main_cells(row: RowResult) -> Cells:
    quality, times = row.examination["quality"], row.run_time_ms
    rates = []
    for name in METRICS:
        spread = f" ± {_rate(quality[f'{name}_std'])}" if name in ("q_k", "q_b") and quality[name] is not None else ""
        rates.append(f"{_rate(quality[name])}{spread} ({_rate(row.ceiling.get(name))})")
    counts = (row.num_parameters, row.num_multiply_adds, row.num_multiply_adds_frame)
    times_ms = (f"{_ms(times['mean'])} ± {_ms(times['std'])}", _ms(times["median"]), _ms(times["p99"]))
    width_px, height_px = row.image_size_px
    return [f"{width_px}x{height_px}", *map(count, counts), *times_ms, *rates, f"{row.num_boxes:.2f}"]


def _groups(row: RowResult) -> dict[tuple[str, str], dict[str, Any]]:
    """The groups of lights by aspect and name; none of a row that could not be made."""
    groups = {} if row.reason else row.examination["breakdown"]["groups"]
    return {(aspect, group["name"]): group for aspect in ASPECTS for group in groups.get(aspect, ())}


def _points(row: RowResult) -> list[dict[str, Any]]:
    ranking = None if row.reason else row.examination["ranking"]
    points: list[dict[str, Any]] = [] if ranking is None else ranking["operating_points"]
    return points


def _whose_light(row: RowResult) -> dict[str, Any]:
    return row.examination.get("whose_light") or {}


def _rate(value: float | None) -> str:
    return DASH if value is None else f"{value:.3f}".removeprefix("0") if 0 <= value < 1 else f"{value:.2f}"


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _comparison_lines(results: DetectorResults) -> list[str]:
    def interval(found: dict[str, Any]) -> str:
        if found["low"] is None:
            return "no interval: a single drive"
        return (
            f"95 % of the resamples of {found['num_scenes']} drives: {found['low']:+.3f} to {found['high']:+.3f}; "
            f"at least as good in {found['probability']:.1%}"
        )

    return [
        f"{ROWS[found['row']].title} less {ROWS[found['other']].title}: {found['a'] - found['b']:+.3f} "
        f"({interval(found)})"
        for found in results.comparisons
    ] or ["No two rows with an F to compare."]


def _origins(results: DetectorResults) -> Iterator[str]:
    for row in results.rows:
        if row.reason is not None:
            yield f"{row.title}: {row.reason}"
        else:
            made = row.made_with
            yield f"{row.title}: {row.note}; measured with {_version(made)} on {made['processor']}"


def _version(made_with: dict[str, Any]) -> str:
    commit = made_with["commit"]
    changed = ", changed" if made_with["has_local_changes"] else ""
    where = f" ({commit[:10]}{changed})" if commit else ""
    return f"{made_with['version']}{where}"
