from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.photometry import IntensityTable, read_ies
from tests.shared_data import shared_file

HEADER = "IESNA:LM-63-2002\n[TEST] by hand\n[MANUFAC] nobody\nTILT=NONE\n"


def written(folder: Path, body: str, header: str = HEADER) -> Path:
    path = folder / "lamp.ies"
    path.write_text(header + body)
    return path


def towards(table: IntensityTable, x: float, y: float, z: float) -> float:
    return float(table.towards([x, y, z]))


def turned(right_deg: float, up_deg: float) -> tuple[float, float, float]:
    right, up = np.radians(right_deg), np.radians(up_deg)
    return float(np.cos(up) * np.cos(right)), float(-np.cos(up) * np.sin(right)), float(np.sin(up))


def test_type_a_is_azimuth_and_elevation_with_right_positive(tmp_path: Path) -> None:
    body = "1 1000 2.0 3 3 3 2 0 0 0\n0.5 1 10\n-10 0 10\n-20 0 20\n1 2 3 10 20 30 100 200 300\n"
    table = read_ies(written(tmp_path, body))
    assert towards(table, *turned(0, 0)) == pytest.approx(20)  # 20 x multiplier 2 x ballast factor 0.5
    assert towards(table, *turned(20, 0)) == pytest.approx(200, rel=1e-5)
    assert towards(table, *turned(-20, 10)) == pytest.approx(3, rel=1e-5)
    assert towards(table, *turned(10, 5)) == pytest.approx((20 + 30 + 200 + 300) / 4, rel=1e-5)
    assert towards(table, *turned(25, 0)) == 0


def test_type_a_with_one_side_is_completed(tmp_path: Path) -> None:
    table = read_ies(written(tmp_path, "1 -1 1 2 2 3 1 0 0 0\n1 1 0\n-5 5\n0 10\n8 8 4 4\n"))
    assert towards(table, *turned(-10, 0)) == pytest.approx(4, rel=1e-5)
    assert towards(table, *turned(10, 0)) == pytest.approx(4, rel=1e-5)
    assert towards(table, *turned(-5, 0)) == pytest.approx(6, rel=1e-5)


def test_type_b_turns_planes_about_the_cross_axis(tmp_path: Path) -> None:
    """Intensity is 10 + V there, at any angle to the side; in our frame V = atan2(z, x)."""
    verticals = range(-90, 91, 10)
    column = " ".join(str(100 + vertical) for vertical in verticals)
    body = f"1 -1 1 19 3 2 2 0 0 0\n1 1 0\n{' '.join(map(str, verticals))}\n-90 0 90\n{column}\n{column}\n{column}\n"
    table = read_ies(written(tmp_path, body))
    for vertical, horizontal in ((0, 0), (30, 0), (-40, 25), (60, -50)):
        v, h = np.radians(vertical), np.radians(horizontal)
        direction = np.cos(h) * np.cos(v), -np.sin(h), np.cos(h) * np.sin(v)
        assert towards(table, *direction) == pytest.approx(100 + vertical, abs=0.5)


def test_type_b_has_right_positive(tmp_path: Path) -> None:
    table = read_ies(written(tmp_path, "1 -1 1 2 3 2 2 0 0 0\n1 1 0\n-90 90\n-60 0 60\n1 1 2 2 9 9\n"))
    assert towards(table, *turned(59, 0)) > 8
    assert towards(table, *turned(-59, 0)) < 1.2


C_FULL = "1 -1 1 3 5 1 2 0 0 0\n1 1 0\n0 45 90\n0 90 180 270 360\n5 1 0 5 2 0 5 3 0 5 4 0 5 1 0\n"


def test_type_c_looks_down(tmp_path: Path) -> None:
    table = read_ies(written(tmp_path, C_FULL))
    assert towards(table, 1, 0, 0) == pytest.approx(5, abs=0.05)
    assert [towards(table, 1, y, z) for y, z in ((0, 1), (1, 0), (0, -1), (-1, 0))] == pytest.approx(
        [1, 2, 3, 4], rel=0.02
    )
    assert towards(table, -1, 0, 0.1) == 0


@pytest.mark.parametrize(
    ("horizontals", "columns"),
    [("0", [2]), ("0 90", [1, 3]), ("0 90 180", [1, 3, 1]), ("90 180 270", [3, 1, 3])],
)
def test_type_c_symmetries(tmp_path: Path, horizontals: str, columns: list[int]) -> None:
    values = " ".join(f"{value} {value}" for value in columns)
    num = len(columns)
    table = read_ies(written(tmp_path, f"1 -1 1 2 {num} 1 2 0 0 0\n1 1 0\n0 90\n{horizontals}\n{values}\n"))
    expected = [2.0] * 4 if num == 1 else [1.0, 3.0, 1.0, 3.0]
    found = [towards(table, 0.5, y, z) for y, z in ((0, 1), (1, 0), (0, -1), (-1, 0))]
    assert found == pytest.approx(expected, rel=0.02)


def test_type_c_integrates_to_its_flux(tmp_path: Path) -> None:
    """Lambert's law, 1000 / pi cd straight down: 1000 lm."""
    angles = np.arange(0.0, 90.1, 2.5)
    values = " ".join(f"{1000 / np.pi * np.cos(np.radians(angle)):.4f}" for angle in angles)
    body = f"1 1000 1 {len(angles)} 1 1 2 0 0 0\n1 1 0\n{' '.join(map(str, angles))}\n0\n{values}\n"
    assert read_ies(written(tmp_path, body)).luminous_flux_lm == pytest.approx(1000, rel=2e-3)


def test_a_measured_low_beam() -> None:
    table = read_ies(shared_file("data/LowBeam.ies"))
    assert table.luminous_flux_lm == pytest.approx(1768.39, rel=1e-3)  # the file's own figure
    assert table.intensities_cd.max() == pytest.approx(62_856.2)
    assert table.intensities_cd.shape == (127, 601)
    assert towards(table, *turned(4, 0)) > 10 * towards(table, *turned(-4, 0))  # right-hand traffic


def test_second_factor_by_edition(tmp_path: Path) -> None:
    body = "1 -1 1 2 2 3 2 0 0 0\n1 1.1 0\n-5 5\n-5 5\n8 8 8 8\n"
    new = read_ies(written(tmp_path, body, "IES:LM-63-2019\nTILT=NONE\n"))
    old = read_ies(written(tmp_path, body, "IESNA91\nTILT=NONE\n"))
    assert towards(new, 1, 0, 0) == pytest.approx(8)
    assert towards(old, 1, 0, 0) == pytest.approx(8.8)


GOOD = "1 -1 1 2 2 3 2 0 0 0\n1 1 0\n-5 5\n-5 5\n8 8 8 8\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("nothing", "line TILT=NONE"),
        (HEADER.replace("NONE", "INCLUDE") + GOOD, "line 4: expected TILT=NONE, got TILT=INCLUDE"),
        (HEADER + GOOD.replace("8 8 8 8", "8 8 8"), "candela values: expected 4 numbers, the file ends after 3"),
        (HEADER + GOOD.replace("8 8 8 8", "8 8 x 8"), "line 9: candela values: expected a number, got 'x'"),
        (HEADER + GOOD.replace("8 8 8 8", "8 8 -1 8"), "candela values: expected at least 0, got -1"),
        (HEADER + GOOD.replace("2 2 3 2", "2 2 4 2"), "photometric type: expected 1"),
        (HEADER + GOOD.replace("2 2 3 2", "2.5 2 3 2"), "vertical angles: expected a whole number"),
        (HEADER + GOOD.replace("2 2 3 2", "1 2 3 2"), "vertical angles: expected at least 2, got 1"),
        (HEADER + GOOD.replace("-5 5\n-5 5", "5 -5\n-5 5"), "vertical angles: expected growing"),
        (HEADER + GOOD.replace("2 2 3 2", "2 2 1 2").replace("-5", "0"), "horizontal angles: expected a span"),
        (HEADER + GOOD.replace("2 2 3 2", "2 2 1 2"), "vertical angles: expected growing angles within 0 to 180"),
        (HEADER + GOOD.replace("-5 5\n8", "-200 200\n8"), "horizontal angles: expected growing angles within -180"),
        (HEADER + GOOD.replace("2 2 3 2", "2 2 2 2").replace("5\n8", "91\n8"), "horizontal angles: .*within -90 to 90"),
        (HEADER + GOOD.replace("-1 1 2", "-1 0 2"), "multiplier .*: expected positive numbers, got 0, 1, 1"),
        (HEADER + GOOD.replace("1 1 0\n", "1 0 0\n"), "ballast factors: expected positive numbers, got 1, 1, 0"),
        (HEADER + GOOD.replace("-1 1 2", "-1 -1 2").replace("8", "-8"), "expected positive numbers, got -1, 1, 1"),
        (HEADER + GOOD.replace("-1 1 2", "-1 1e30 2"), "candela values: expected at most 1e.07 cd .* got 8e.30"),
        (HEADER + GOOD.replace("-1 1 2", "-1 1e308 2"), "candela values: expected at most 1e.07 cd .* got inf"),
        (HEADER + GOOD + "8 8\n", "line 10: expected the end of the file after 2 x 2 candela values.* got '8'"),
        (HEADER + GOOD.replace("8 8 8 8", "8,5 8,5 8,5 8,5"), "line 9: expected the end of the file"),
        (
            HEADER + GOOD.replace("-1 1 2", "-1 1,5 2"),
            "line 5: 1,5 counts as two numbers, as a comma separates: write a",
        ),
        (HEADER + GOOD.replace("8 8 8 8", "8 8 8 8_0"), "line 9: candela values: expected a number, got '8_0'"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, complaint: str) -> None:
    path = written(tmp_path, text, "")
    with pytest.raises(ValueError, match=complaint) as caught:
        read_ies(path)
    assert str(path) in str(caught.value)


def test_the_end_of_a_file_of_dos(tmp_path: Path) -> None:
    assert towards(read_ies(written(tmp_path, GOOD + "\n\x1a\n")), 1, 0, 0) == pytest.approx(8)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_ies(tmp_path / "absent.ies")


def test_a_peak_that_the_table_would_lose_is_refused(tmp_path: Path) -> None:
    """Tables of type C have steps of a quarter of a degree at least."""
    gammas, planes = np.arange(0.0, 6.01, 0.05), np.arange(0.0, 361.0, 45.0)
    candela = np.where(np.isclose(planes[:, np.newaxis], 90.0), 3e4 * np.exp(-0.5 * ((gammas - 5.12) / 0.05) ** 2), 0.0)
    rows = [f"1 1000 1 {len(gammas)} {len(planes)} 1 1 0 0 0", "1 1 0", " ".join(f"{gamma:.2f}" for gamma in gammas)]
    rows += [" ".join(f"{plane:g}" for plane in planes), *(" ".join(f"{cd:.1f}" for cd in row) for row in candela)]
    path = tmp_path / "led.ies"
    path.write_text("IESNA:LM-63-2002\nTILT=NONE\n" + "\n".join(rows) + "\n")
    with pytest.raises(
        ValueError, match=r"led\.ies: type C: expected light that a table in steps of 0\.25 x 0\.25 deg"
    ):
        read_ies(path)


def test_two_close_angles_of_a_few_make_no_fine_table(tmp_path: Path) -> None:
    """A file of 300 bytes made a table of 8,000,000 cells; one of many values has its step."""
    close = "-90 -89.999999 0 90\n-180 -179.999999 0 180\n" + 16 * "5 "
    sparse = read_ies(written(tmp_path, f"1 -1 1.0 4 4 3 2 0 0 0\n1 1 50\n{close}"))
    assert 64_800 <= sparse.intensities_cd.size < 200_000
    angles = np.arange(-4.0, 4.01, 0.05)
    fine = " ".join(f"{angle:.2f}" for angle in angles)
    many = f"1 -1 1.0 {len(angles)} {len(angles)} 3 2 0 0 0\n1 1 50\n{fine}\n{fine}\n" + len(angles) ** 2 * "5 "
    assert read_ies(written(tmp_path, many)).intensities_cd.shape == (len(angles), len(angles))
