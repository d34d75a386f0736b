"""The report on the table of detectors: Markdown, JSON, and one HTML page with everything in it."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from foreglow.display.overlay import Measures, Picture, annotate
from foreglow.files import write_atomic, write_json_results
from foreglow.lab.reports.html import STYLE, html_table
from foreglow.lab.studies.detector.pictures import Shown
from foreglow.lab.studies.detector.plan import ROWS
from foreglow.lab.studies.detector.run import DetectorResults
from foreglow.lab.studies.detector.tables import Table, hidden_table, kind_table, main_table, markdown
from foreglow.provenance import provenance

PICTURE_WIDTH_PX = 900
JPEG_QUALITY = 82
FOUND_BGR, MISSED_BGR = (120, 235, 90), (60, 60, 250)


def write_report(results: DetectorResults, pictures: Iterable[Shown], folder: Path) -> Path:
    """Writes `results.json`, `table.md` and `report.html` to `folder`, and returns the last one's path.

    Raises:
        OSError: If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    record = {"made_with": provenance()} | results.to_json()
    write_json_results(folder / "results.json", record)
    write_atomic(folder / "table.md", ("\n".join(_markdown_lines(results)) + "\n").encode())
    report = folder / "report.html"
    write_atomic(report, "\n".join(_html_lines(results, pictures)).encode())
    return report


def draw(shown: Shown) -> Picture:
    """The brightened image with its accepted boxes, and a mark at every labelled light: green if found, red if not."""
    measures = Measures.of(shown.frame.width_px, shown.frame.height_px)
    picture = annotate(shown.frame, shown.result)[: shown.frame.height_px * measures.enlargement]  # without its caption
    for (x, y), is_found in zip(shown.lights_px.tolist(), shown.is_found.tolist(), strict=True):
        place = (round((x + 0.5) * measures.enlargement), round((y + 0.5) * measures.enlargement))
        if is_found:
            cv2.circle(picture, place, 3 * measures.bold_px, FOUND_BGR, measures.thin_px, cv2.LINE_AA)
        else:
            size_px = 9 * measures.bold_px
            cv2.drawMarker(picture, place, MISSED_BGR, cv2.MARKER_TILTED_CROSS, size_px, measures.bold_px, cv2.LINE_AA)
    return picture


def _markdown_lines(results: DetectorResults) -> Iterator[str]:
    yield f"# Detectors on {results.labels.name}"
    yield ""
    yield from _preamble(results)
    yield ""
    yield from markdown(main_table(results.rows))
    for title, remark, table in _further_tables(results):
        yield from ("", f"## {title}", "", remark, "", *markdown(table))
    yield from ("", "## Differences of F", "", *_comparison_lines(results))
    yield from ("", "## How each was made", "", *(f"- {line}" for line in _origins(results)))


def _html_lines(results: DetectorResults, pictures: Iterable[Shown]) -> Iterator[str]:
    title = html.escape(f"Detectors on {results.labels.name}")
    yield "<!doctype html>"
    yield f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
    yield f"<h1>{title}</h1>"
    yield f"<p>{html.escape(' '.join(_preamble(results)))}</p>"
    yield from html_table(main_table(results.rows))
    for heading, remark, table in _further_tables(results):
        yield f"<h2>{heading}</h2><p>{html.escape(remark)}</p>"
        yield from html_table(table)
    yield "<h2>Differences of F</h2><ul>"
    yield from (f"<li>{html.escape(line.removeprefix('- '))}</li>" for line in _comparison_lines(results))
    yield "</ul><h2>How each was made</h2><ul>"
    yield from (f"<li>{html.escape(line)}</li>" for line in _origins(results))
    yield "</ul><h2>Hits and misses</h2>"
    yield (
        "<p>Brightened. Boxes are accepted ones, with their scores; circles are labelled lights in a box, red crosses "
        "those in none. Two images that show what works, three that show what does not, each of another drive.</p>"
    )
    row = ""
    for shown in pictures:
        if shown.choice.row != row:
            yield ("" if not row else "</div>") + f"<h3>{html.escape(ROWS[shown.choice.row].title)}</h3>"
            yield '<div class="pictures">'
            row = shown.choice.row
        yield _figure(shown)
    yield ("</div>" if row else "") + "</body></html>"


def _preamble(results: DetectorResults) -> list[str]:
    num_images, num_scenes = len(results.labels.lights), len(set(results.labels.sequence_of.values()))
    return [
        f"{num_images} images of {num_scenes} drives of {results.data}. Boxes count with a score above 0.5.",
        "In parentheses: the labelled boxes themselves, which bound any classifier;",
        "for a YOLO, those that it learnt from, which bound nothing.",
        "Multiply-adds are those of one crop, or of one image of a YOLO, and of a whole frame.",
        "Run-times are for one thread and leave decoding out, mean ± standard deviation;",
        "a YOLO runs in torch, the others in ONNX Runtime.",
    ]


def _further_tables(results: DetectorResults) -> Iterator[tuple[str, str, Table]]:
    yield (
        "Recall by what a light is",
        "In brackets: the share of the lights in any box, whatever its score. Hidden: no lamp of the vehicle so far.",
        kind_table(results.rows),
    )
    yield (
        "Hidden vehicles against false boxes",
        "Recall of hidden vehicles' lights at the threshold with at most so many false boxes a frame in images without "
        "any vehicle's light. The last but one column: such false boxes a frame at 0.5. The last: the share of the "
        "vehicles whose light comes before their lamps that are found before.",
        hidden_table(results.rows),
    )


def _comparison_lines(results: DetectorResults) -> list[str]:
    return [
        f"- {ROWS[one['row']].title} less {ROWS[one['other']].title}: {one['a'] - one['b']:+.3f} "
        f"(95 % of the resamples of {one['num_scenes']} drives: {one['low']:+.3f} to {one['high']:+.3f}; "
        f"at least as good in {one['probability']:.1%})"
        for one in results.comparisons
    ] or ["- No two rows to compare."]


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


def _figure(shown: Shown) -> str:
    choice = shown.choice
    words = f"{choice.num_found} found, {choice.num_missed} missed, {choice.num_false} false"
    mark = '<span class="good">works</span>' if choice.is_best else '<span class="bad">does not</span>'
    source = base64.b64encode(_jpeg(draw(shown))).decode()
    return (
        f'<figure><img alt="image {choice.image_id}" src="data:image/jpeg;base64,{source}">'
        f"<figcaption>{mark}: {shown.frame.sequence}, image {choice.image_id}: {words}</figcaption></figure>"
    )


def _jpeg(picture: Picture) -> bytes:
    height_px, width_px = picture.shape[:2]
    if width_px > PICTURE_WIDTH_PX:
        size = (PICTURE_WIDTH_PX, round(height_px * PICTURE_WIDTH_PX / width_px))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()
