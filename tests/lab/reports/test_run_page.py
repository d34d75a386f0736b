"""The page about a run: whole, by itself, and about what was in the run."""

from __future__ import annotations

import base64
import html.parser
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("matplotlib")

from foreglow.config import config_to_toml
from foreglow.datasets import shipped_drive
from foreglow.lab.reports import run_figures, run_page
from foreglow.lab.reports.run_page import key_moments, write_report
from foreglow.types import Frame
from tests.bombs import grid_headlamps
from tests.cli.commands import foreglow_command, without_digest
from tests.runs.test_recorded_run import made_up, write_run
from tests.stand_ins import REFERENCE, night_image, result_of

pytestmark = pytest.mark.slow

VOID = {"meta", "img", "br", "link"}


class Page(html.parser.HTMLParser):
    """Checks that every element is closed where it should be, and gathers texts and references."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.texts: list[str] = []
        self.feed(path.read_text())
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.references += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    @property
    def text(self) -> str:
        return "\n".join(self.texts)

    def pictures(self, kind: str) -> list[np.ndarray]:
        """All embedded ones of a kind, decoded."""
        start = f"data:image/{kind};base64,"
        found = [
            base64.b64decode(reference.removeprefix(start))
            for reference in self.references
            if reference.startswith(start)
        ]
        return [np.asarray(cv2.imdecode(np.frombuffer(each, np.uint8), cv2.IMREAD_COLOR)) for each in found]


def check_self_contained(page: Page, path: Path) -> None:
    assert all(reference.startswith("data:image/") for reference in page.references)
    plain = re.sub(r"data:image/[^\"]*", "", path.read_text())
    assert not re.search(r"url\(|@import|https?://|<script|<link", plain)


def test_a_made_up_run(tmp_path: Path) -> None:
    made = [made_up(1, "A"), made_up(2, "A", ("camera_dark",)), made_up(3, "B <b>")]
    path = write_report(write_run(tmp_path / "run", made, source="no & longer", version="1.0"))
    assert path == tmp_path / "run" / "report.html"
    page = Page(path)
    check_self_contained(page, path)
    for words in ("Run of no & longer", "Sequence A", "Sequence B <b>", "camera dark", "33.3%", "Foreglow 1.0"):
        assert words in page.text
    assert "There are no pictures: the frames are no longer at no & longer." in page.text
    assert len(page.pictures("png")) == 3
    assert page.pictures("jpeg") == []


@pytest.mark.usefixtures("undrawn")
def test_a_run_of_proposals_alone(tmp_path: Path) -> None:
    frames = [Frame(night_image(k), 50_000_000 * k, k) for k in range(3)]
    path = write_report(
        write_run(tmp_path, [(frame, result_of(frame, [(1, 2, 9, 9)])) for frame in frames]), tmp_path / "x.html"
    )
    page = Page(path)
    assert "Over time" in page.text
    assert "None were looked for: the run commanded no beam." in page.text


@pytest.mark.usefixtures("undrawn")
def test_a_live_run(tmp_path: Path) -> None:
    events = [
        {"fault": "camera_gone", "from_ns": 2_050_000_000, "until_ns": 2_550_000_000, "detail": "no frame <for> 0.2 s"},
        {"fault": "bus_failed", "from_ns": 3_050_000_000, "until_ns": None, "detail": ""},
    ]
    counts = {"num_dropped": 7, "num_late": 2, "num_unrecorded": 0, "sink_errors": []}
    live = {**counts, "fault_counts": {"camera_gone": 1, "bus_failed": 1}, "faults": events}
    page = Page(write_report(write_run(tmp_path, [made_up(1)], live=live)))
    cells = [text.strip() for text in page.texts]
    row = cells.index("camera gone")
    assert cells[row : row + 4] == ["camera gone", "2.00", "0.50", "no frame <for> 0.2 s"]
    assert cells[cells.index("bus failed") + 2] == "–"
    assert cells[cells.index("dropped for a newer frame") + 1] == "7"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.filterwarnings("ignore:.*its recording is damaged")
def test_what_a_run_lost_is_said(tmp_path: Path) -> None:
    event = {"fault": "bus_failed", "from_ns": 3_050_000_000, "until_ns": None, "detail": ""}
    live = {
        "num_dropped": 0,
        "num_late": 0,
        "num_unrecorded": 5,
        "sink_errors": ["x.mcap: full", "the disk <1>"],
        "fault_counts": {"bus_failed": 8},
        "faults": [event],
    }
    made = [made_up(1, "A"), made_up(2, "B")]
    page = Page(write_report(write_run(tmp_path, made, live=live, num_lost_parts=1, skipped=["a"], num_skipped=1)))
    cells = [text.strip() for text in page.texts]
    for words, wanted in {
        "lost parts of the source, of any number of frames": "1",
        "results that were not recorded": "5",
        "not recorded": "x.mcap: full; the disk <1>",
    }.items():
        assert cells[cells.index(words) + 1] == wanted
    assert "7 earlier ones are left out: a live run keeps the latest 1." in page.text
    assert "by the frames' clock, which may begin anew with each sequence" in page.text
    row = cells.index("bus failed")
    assert cells[row + 1] == "3.05"  # of which sequence is not known


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("lamps", "words"),
    [
        (None, "lamps.toml: no such file"),
        ("", "lamps.toml: expected lamps of 84 LEDs, as the run's, got"),
    ],
)
def test_headlamps_that_are_gone_or_others_now(tmp_path: Path, lamps: str | None, words: str) -> None:
    run, file = write_run(tmp_path / "run", [made_up(1)]), tmp_path / "lamps.toml"
    config = REFERENCE.changed("beam", headlamps=file)
    (run / "config.toml").write_text(config_to_toml(config))
    if lamps is not None:
        file.write_text(grid_headlamps(lamps))
    text = Page(write_report(run)).text
    assert "The LEDs are not drawn: " in text
    assert words in text
    assert "The LEDs, each column" not in text
    frame = Frame(night_image(), 0, 1)
    dark = write_run(tmp_path / "dark", [(frame, result_of(frame, [(1, 2, 9, 9)]))])
    (dark / "config.toml").write_text(config_to_toml(config))
    assert "The LEDs" not in Page(write_report(dark)).text


def test_a_pause_is_drawn_as_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command is known from its frame to the next one; with many gaps, they are drawn at once."""
    sheets: list[Any] = []

    def keep(figure: Any) -> bytes:
        sheets.append(figure)
        return b""

    monkeypatch.setattr(run_figures, "png", keep)
    results = [made_up(number)[1] for number in (1, 2, 3, 40, 41)]
    run_figures.sequence_figure(results, 28)
    ranges, _, beam, leds = sheets[0].axes[1:5]
    assert np.isnan(ranges.lines[0].get_xdata()).tolist() == [False, False, False, True, False, False]
    (gaps,) = [each for each in beam.collections if len(each.get_paths()) == 5 and each.get_alpha() == 0.8]
    ends_s = [path.vertices[:, 0].max() for path in gaps.get_paths()]
    np.testing.assert_allclose(ends_s, [0.05, 0.1, 0.25, 2.0, 2.05])
    shown = leds.collections[0].get_array()
    assert [bool(column.mask.all()) for column in shown.T] == [False, False, False, True, False, False]


@pytest.mark.usefixtures("undrawn")
def test_only_so_many_sequences_have_a_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_page, "MAX_SEQUENCES", 2)
    made = [made_up(number, f"S{number}") for number in range(1, 5)]
    page = Page(write_report(write_run(tmp_path, made)))
    assert "Left out after the first 2 sequences: S3, S4." in page.text
    assert len(page.pictures("png")) == 3


def test_key_moments() -> None:
    results = [made_up(number, faults=("x",) if number < 3 else ())[1] for number in range(1, 5)]
    moments = [(key_moment.words, key_moment.result.frame, key_moment.time_s) for key_moment in key_moments(results)]
    assert moments == [
        ("first light artifact; first confirmed track; slowest frame, 0.2 ms", 1, 0.0),
        ("first dark gap", 3, 0.1),
    ]


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The end of the first second of the drive that ships, with the beam."""
    out = tmp_path_factory.mktemp("shipped") / "run"
    assert foreglow_command("beam", shipped_drive(), "--out", out, "--limit", 50).exit_code == 0
    return out


def test_the_drive_that_ships(shipped: Path) -> None:
    result = foreglow_command("report", shipped)
    assert result.exit_code == 0, result.output
    path = shipped / "report.html"
    assert result.stdout == f"look in {path}\n"
    page = Page(path)
    check_self_contained(page, path)
    shown = re.findall(r" s, frame (\d+): ", page.text)
    assert len(set(shown)) == len(shown) >= 2
    assert [picture.shape[1] for picture in page.pictures("jpeg")] == [960] * len(shown)
    assert "first dark gap" in page.text
    assert path.stat().st_size < 2e6
    again = shipped / "again.html"
    assert foreglow_command("report", shipped, "--out", again).exit_code == 0
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_frames_that_are_others_now(tmp_path: Path, shipped: Path) -> None:
    frames = shipped / "frames.jsonl"
    for name in ("summary.json", "config.toml", "times.jsonl"):
        (tmp_path / name).write_bytes((shipped / name).read_bytes())
    (tmp_path / "frames.jsonl").write_text(frames.read_text().replace('"timestamp_ns":', '"timestamp_ns":1'))
    without_digest(tmp_path)
    page = Page(write_report(tmp_path))
    assert "expected the frames of the run, there are others now." in page.text
    assert page.pictures("jpeg") == []


def test_a_report_is_called_as_a_page(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"rep\.txt: expected a report whose name ends with \.html or \.htm"):
        write_report(tmp_path, tmp_path / "rep.txt")


@pytest.mark.usefixtures("undrawn")
def test_a_report_that_cannot_be_written(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", [made_up(1)])
    result = foreglow_command("report", run, "--out", tmp_path / "nowhere" / "x.html")
    assert result.exit_code == 2
    assert "nowhere/x.html" in result.stderr
    assert "expected the folder of a run" in foreglow_command("report", tmp_path).stderr
