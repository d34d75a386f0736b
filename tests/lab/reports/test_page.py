"""A page says the same as Markdown and as HTML, and leaves what belongs beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from foreglow.lab.reports.figures import legend_above, subplots
from foreglow.lab.reports.page import Figure, Missing, Page, Table, percent

PNG = b"\x89PNG and more"


def test_nearly_all_is_not_all() -> None:
    """199 of 200 were told as 100%, and 1 of 200 as 0%."""
    shares = (0.0, 1 / 200, 3 / 500, 198 / 200, 199 / 200, 1.0, 1.0 - 1e-9)
    assert [*map(percent, shares)] == ["0%", "<1%", "1%", "99%", ">99%", "100%", "100%"]


def test_a_table() -> None:
    table = Table(["a", "b|", "<c>"], [["x", 1, 2.5], ["y", Missing("no <reason>")]])
    assert table.markdown().splitlines() == [
        "| a | b\\| | <c> |",
        "|---|---|---|",
        "| x | 1 | 2.5 |",
        "| y | *no <reason>* | – |",
    ]
    assert "<th>&lt;c&gt;</th>" in table.html()
    assert '<tr><td>y</td><td class="why" colspan="2">no &lt;reason&gt;</td></tr>' in table.html()
    assert Table(["a"], [["two\nlines"]]).markdown().splitlines()[2:] == ["| two lines |"]
    assert Table(["a", "b"], [[1, "two, three"]]).csv() == 'a,b\n1,"two, three"\n'


def test_columns() -> None:
    table = Table.of({"number": lambda value: value, "its square": lambda value: value**2}, [2, 3])
    assert (table.head, table.rows) == (["number", "its square"], [[2, 4], [3, 9]])


def page() -> Page:
    made = Page("Of <all>")
    made.text("First line.", "Second.")
    made.section("Empty")
    made.section("Full", "With words & more.")
    made.items([])
    made.items(["one", "two"])
    made.figure(Figure(PNG, "A plot", "plot.png"))
    made.media("film.mp4", "A film")
    made.listing("key = 1\n", "all of it")
    return made


def test_markdown() -> None:
    assert page().markdown() == (
        "# Of <all>\n\nFirst line.\nSecond.\n\n## Empty\n\n## Full\n\nWith words & more.\n\n- one\n- two\n\n"
        "![plot](plot.png)\n\n![A film](film.mp4)\n\n```\nkey = 1\n```\n"
    )


def test_html() -> None:
    text = page().html()
    assert "<h1>Of &lt;all&gt;</h1>\n<p>First line. Second.</p>\n<h2>Empty</h2>\n<h2>Full</h2>\n<p>" in text
    assert "<ul>\n<li>one</li>\n<li>two</li>\n</ul>" in text
    assert text.count("<ul>") == 1
    assert '<img alt="A plot" src="data:image/png;base64,' in text
    assert '<video controls style="max-width: 100%" src="film.mp4"></video>' in text
    beside = Page("Beside")
    beside.media('50 % "wet" #2?.mp4', "A film")
    assert 'src="50%20%25%20%22wet%22%20%232%3F.mp4"' in beside.html()


@pytest.mark.parametrize("name", ["report.md", "report.html"])
def test_what_lies_beside_a_page(name: str, tmp_path: Path) -> None:
    results = {"share": float("nan"), "rows": (1, 2)}
    path = page().write(tmp_path / "new" / name, results=results, made_with={"seed": 3}, files={"a.csv": "x\n"})
    assert path == tmp_path / "new" / name
    assert {file.name for file in path.parent.iterdir()} == {name, "results.json", "plot.png", "a.csv"}
    assert (path.parent / "plot.png").read_bytes() == PNG
    record = json.loads((path.parent / "results.json").read_text())
    assert record["made_with"]["seed"] == 3
    assert record["made_with"]["version"]
    assert (record["share"], record["rows"]) == (None, [1, 2])
    assert path.read_text() == (page().markdown() if name.endswith("md") else page().html())


def test_pictures_side_by_side() -> None:
    made = Page("Pictures")
    made.pictures([], "None")
    made.pictures([Figure(b"\xff\xd8", "A photograph")], "Some")
    text = made.html()
    assert "None" not in text
    assert "\n\n### Some\n\n![" in made.markdown()
    assert text.count('<h3>Some</h3><div class="pictures">\n<figure><img alt="A photograph" src="data:image/jpeg;') == 1


@pytest.mark.parametrize(("num", "options"), [(6, {}), (8, {}), (8, {"ncols": 8}), (2, {}), (1, {})])
def test_a_legend_is_no_wider_than_its_figure(num: int, options: dict[str, int]) -> None:
    """Of a figure with one panel, as where no driver goes ahead, both ends were cut off."""
    pytest.importorskip("matplotlib")
    figure, (axes,) = subplots(1, width_in=6.5, height_in=3.8)
    for number in range(num):
        axes.plot([0, 1], [0, number], label=f"a configuration {number}")
    legend_above(figure, axes, **options)
    (legend,) = figure.legends
    assert len(legend.get_texts()) == num
    assert legend.get_window_extent().width <= figure.bbox.width
