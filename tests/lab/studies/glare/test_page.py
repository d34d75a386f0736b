from __future__ import annotations

import csv
import dataclasses
import json
import struct
from pathlib import Path

import pytest

from foreglow.files import to_json
from foreglow.lab.reports.figures import DPI
from foreglow.lab.studies.glare.drive import write_glare_drive
from foreglow.lab.studies.glare.eyes import R123
from foreglow.lab.studies.glare.figures import README_WIDTH_IN
from foreglow.lab.studies.glare.page import eye_to_show, summary_lines, write_experiment, write_report
from foreglow.lab.studies.glare.run import GlareExperiment
from foreglow.lab.studies.glare.scores import GlareResults, SensitivityPoint, score_glare
from tests.lab.studies.glare_drives import approach, empty_drive

pytestmark = pytest.mark.slow

pytest.importorskip("matplotlib")

DRIVES = (approach(0), approach(1), approach(9, is_oncoming=False), empty_drive(0))


@pytest.fixture(scope="module")
def results() -> GlareResults:
    results = score_glare("made up", DRIVES)
    points = [
        SensitivityPoint.of("detector threshold", "", value, results.policy("foreglow")) for value in (0.0, 100.0)
    ]
    return dataclasses.replace(results, sensitivity=tuple(points))


@pytest.fixture(scope="module")
def folder(results: GlareResults, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("glare") / "out"
    assert write(results, root) == root / "report.html"
    return root


def write(results: GlareResults, root: Path) -> Path:
    shown = [dataclasses.replace(DRIVES[0], pictures={"Both beams <b>": "b.mp4", "Still": "s.png"}), DRIVES[3]]
    return write_report(results, shown, root, [score_glare("made up", DRIVES, R123)])


def test_the_folder(folder: Path, results: GlareResults) -> None:
    figures = {"boxes", "bins", "sensitivity_detector_threshold", "lux_approach_00", "corridor_approach_00"}
    names = {f"{name}.png" for name in (*figures, "readme")} | {"report.html", "results.json", "drives.csv"}
    assert {path.name for path in folder.iterdir()} == names
    record = json.loads((folder / "results.json").read_text())
    assert record["made_with"]["version"]
    assert record["others"][0]["limits"] == "UN R123"
    assert {name: record[name] for name in to_json(results)} == to_json(results)
    page = (folder / "report.html").read_text()
    assert page.count("data:image/png") == len(figures)
    assert '<video controls style="max-width: 100%" src="b.mp4">' in page
    assert "Both beams &lt;b&gt;" in page
    assert 'src="s.png"' in page
    assert "statement of compliance" in page
    assert "Against other limits: UN R123" in page


def test_short_times_in_sight_have_a_decimal(results: GlareResults, tmp_path: Path) -> None:
    """ "0 s in sight" stood over glare."""
    first = results.policies[0]
    bins = tuple(
        dataclasses.replace(part, glare=dataclasses.replace(part.glare, in_sight_s=0.22))
        for part in first.oncoming.bins
    )
    short = dataclasses.replace(first, oncoming=dataclasses.replace(first.oncoming, bins=bins))
    page = write(dataclasses.replace(results, policies=(short, *results.policies[1:])), tmp_path).read_text()
    assert f"{bins[0].name} (0.2 s)" in page
    assert "(0 s)" not in page


def test_figures_of_drives_that_are_not_shown_any_more_go(results: GlareResults, tmp_path: Path) -> None:
    """With more scenes, others are the typical ones."""
    write(results, tmp_path)
    (tmp_path / "lux_mine.png").touch()
    write_report(results, [DRIVES[1]], tmp_path)
    names = {path.name for path in tmp_path.glob("lux_*")} | {path.name for path in tmp_path.glob("corridor_*")}
    assert names == {"lux_approach_01.png", "corridor_approach_01.png", "lux_mine.png"}


def test_remarks_are_at_the_beginning(results: GlareResults, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    page = write_report(results, (), folder, remarks=["Another low beam."]).read_text()
    assert page.index("Another low beam.") < page.index("<h2>")


def test_the_readme_figure_is_as_wide_as_its_column(folder: Path) -> None:
    width, _ = struct.unpack(">II", (folder / "readme.png").read_bytes()[16:24])
    assert width == round(README_WIDTH_IN * DPI) == 900


def test_a_row_for_each_policy_and_drive(folder: Path, results: GlareResults) -> None:
    with (folder / "drives.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6 * 4
    high = [row for row in rows if row["policy"] == "high"]
    dose_lxs = results.policy("high").drives[0].dose_lxs(is_oncoming=True)
    assert float(high[0]["oncoming_dose_lxs"]) == pytest.approx(dose_lxs, rel=1e-5)
    assert (high[0]["own_lane_kept"], high[0]["preceding_dose_lxs"]) == ("1", "")
    assert (high[3]["oncoming_dose_lxs"], high[3]["wrong_dimmings"]) == ("", "0")


@pytest.mark.slow
def test_the_same_results_give_the_same_files(results: GlareResults, folder: Path, tmp_path: Path) -> None:
    assert write(results, tmp_path).read_bytes() == (folder / "report.html").read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_drives_without_anybody_and_policies_without_gaps(tmp_path: Path) -> None:
    runs = {name: DRIVES[3].runs[name] for name in ("low", "high")}
    drive = dataclasses.replace(DRIVES[3], runs=runs)
    found = score_glare("empty", [drive])
    page = write_report(found, [drive], tmp_path).read_text()
    assert "<tr><td>high</td><td>–</td><td>–</td><td>–</td>" in page  # the dose of nobody was 0.00
    assert "0.00 (–)" not in page
    foreglow = dataclasses.replace(found.policy("high"), name="foreglow")
    assert summary_lines(dataclasses.replace(found, policies=(foreglow,)))[0] == (
        "glare dose of 0 oncoming drivers with foreglow: – of production's; – lx s beside that of the low beam alone"
    )
    assert "Preceding drivers" not in page
    assert page.count("data:image/png") == 2


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_film_is_in_the_page(tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    for drive in DRIVES[:2]:
        write_glare_drive(tmp_path / "drives" / f"{drive.name}.npz", drive)
    (tmp_path / "film_approach_01.mp4").write_bytes(b"")
    page = write_experiment(GlareExperiment(score_glare("made up", DRIVES[:2]), (), (), tmp_path)).read_text()
    assert page.count("<video ") == 1
    assert 'src="film_approach_01.mp4"' in page


@pytest.mark.usefixtures("undrawn")
def test_one_drive_and_one_driver_are_said_in_the_singular(tmp_path: Path) -> None:
    single = score_glare("one", [DRIVES[0]])
    assert summary_lines(single)[0].startswith("glare dose of 1 oncoming driver with foreglow: ")
    page = write_report(single, [], tmp_path).read_text()
    assert "1 drive, " in page
    assert "1 oncoming driver and " in page


@pytest.mark.usefixtures("undrawn")
def test_the_report_says_what_exact_gaps_are(results: GlareResults, tmp_path: Path) -> None:
    """The oracle was called the best that the lamps can do; ours kept more light and gave less into the gap."""
    page = write_report(results, [], tmp_path).read_text()
    assert "with 0.3 m and 0.5° more on either side, in which each LED gives no more than led_limit_lx" in page
    assert "may keep more light than the oracle" in page


def test_in_words(results: GlareResults) -> None:
    lines = summary_lines(results)
    assert lines[0].startswith("glare dose of 2 oncoming drivers with foreglow: ")  # as an error did: "foreglow: "
    assert "100% dark from the beginning" in lines[1]
    assert "(low beam 25%), after it 100%" in lines[2]


def test_in_words_beside_other_configurations(results: GlareResults) -> None:
    """What `--also` added was the policy that the words were about."""
    also = dataclasses.replace(results.policy("high"), name="ask")
    beside = dataclasses.replace(results, policies=(*results.policies, also))
    assert summary_lines(beside) == summary_lines(results)


def test_the_driver_to_look_at() -> None:
    drive = DRIVES[0]
    follows = dataclasses.replace(drive.eyes[0], vehicle_id=5, is_oncoming=False)
    later = dataclasses.replace(drive.eyes[0], vehicle_id=4)
    drive = dataclasses.replace(drive, eyes=(follows, later, *drive.eyes))
    assert eye_to_show(drive).vehicle_id == 1
    with pytest.raises(ValueError, match="there is none"):
        eye_to_show(DRIVES[3])
