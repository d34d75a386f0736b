from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.photometry import IntensityTable, read_ies, read_lamp_file, read_ldt

GAMMAS = (0.0, 45.0, 90.0)


def lines_of(
    symmetry: int,
    planes: list[float],
    stored: list[list[float]],
    flux_lm: float = 1000.0,
    factor: str = "1",
    num_sets: int = 1,
) -> list[str]:
    """A whole file: intensities in cd for 1000 lm, one list for each half-plane that is stored."""
    counts = ["3", str(symmetry), str(len(planes)), "0", str(len(GAMMAS)), "45"]
    header = ["Nobody … 2024", *counts, "report", "lamp", "1", "file", "today"]
    sizes = ["1"] * 9
    lamps = ["1", "LED", f"{flux_lm}", "3000", "80", "10"] * num_sets
    values = [str(value) for plane in stored for value in plane]
    angles = [str(angle) for angle in (*planes, *GAMMAS)]
    return [*header, *sizes, "100", "100", factor, "0", str(num_sets), *lamps, *["0.5"] * 10, *angles, *values]


def written(folder: Path, lines: list[str]) -> Path:
    path = folder / "lamp.ldt"
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    return path


def towards(table: IntensityTable, x: float, y: float, z: float) -> float:
    return float(table.towards([x, y, z]))


def around(table: IntensityTable) -> list[float]:
    """Intensities at gamma 45 towards C 0, 90, 180 and 270: up, left, down and right of the axis."""
    return [towards(table, 1, y, z) for y, z in ((0, 1), (1, 0), (0, -1), (-1, 0))]


FOUR = [0.0, 90.0, 180.0, 270.0]


@pytest.mark.parametrize(
    ("symmetry", "at_45", "expected"),
    [
        (0, [1, 2, 3, 4], [1, 2, 3, 4]),
        (1, [2], [2, 2, 2, 2]),
        (2, [1, 2, 3], [1, 2, 3, 2]),
        (3, [4, 1, 2], [1, 2, 1, 4]),  # planes 270, 0 and 90
        (4, [1, 2], [1, 2, 1, 2]),
    ],
)
def test_symmetries(tmp_path: Path, symmetry: int, at_45: list[float], expected: list[float]) -> None:
    lines = lines_of(symmetry, FOUR, [[5.0, value, 0.0] for value in at_45])
    table = read_ldt(written(tmp_path, lines))
    assert towards(table, 1, 0, 0) == pytest.approx(5, abs=0.05)
    assert around(table) == pytest.approx(expected, rel=0.02)
    assert towards(table, -1, 0, 0.1) == 0


def test_the_same_lamp_as_an_ies_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    planes = np.arange(0.0, 360.0, 30.0)
    values = rng.uniform(10, 1000, (len(planes), len(GAMMAS)))
    values[:, 0] = values[0, 0]
    ldt = read_ldt(written(tmp_path, lines_of(0, planes.tolist(), values.tolist())))
    body = f"1 -1 1 3 13 1 2 0 0 0\n1 1 0\n0 45 90\n{' '.join(map(str, np.append(planes, 360)))}\n"
    body += "\n".join(" ".join(map(str, plane)) for plane in [*values, values[0]])
    (tmp_path / "lamp.ies").write_text(f"IESNA:LM-63-2002\nTILT=NONE\n{body}\n")
    np.testing.assert_allclose(ldt.intensities_cd, read_ies(tmp_path / "lamp.ies").intensities_cd, rtol=1e-5)


def test_candela_are_for_1000_lumen_of_the_first_set(tmp_path: Path) -> None:
    stored = [[5.0, 2.0, 0.0]]
    lines = lines_of(1, FOUR, stored, flux_lm=2500.0, factor="1,2", num_sets=2)
    lines[26 + 6 + 2] = "99999"
    assert towards(read_ldt(written(tmp_path, lines)), 1, 0, 0) == pytest.approx(5 * 2.5 * 1.2)


GOOD = lines_of(2, FOUR, [[5.0, 1.0, 0.0], [5.0, 2.0, 0.0], [5.0, 3.0, 0.0]])


def changed(line: int, text: str) -> list[str]:
    return [text if number == line else old for number, old in enumerate(GOOD, 1)]


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (GOOD[:-1], "intensities: expected 9 numbers, the file ends after 8"),
        (GOOD[:44], "angles C: expected 4 numbers, the file ends after 2"),
        (GOOD[:10], "conversion factor: expected a number, the file ends after 0"),
        ([], "symmetry Isym: expected a number, the file ends after 0"),
        (changed(3, "5"), "line 3: symmetry Isym: expected 0, 1, 2, 3 or 4, got 5"),
        (changed(4, "3"), "line 4: number of C planes: expected a multiple of 2 with Isym = 2, got 3"),
        (changed(4, "2.5"), "line 4: number of C planes: expected a whole number of at least 1, got 2.5"),
        (changed(6, "1"), "line 6: number of intensities in each C plane: expected a whole number of at least 2"),
        (changed(6, "4"), "angles gamma: expected growing"),
        (changed(29, "-1000"), "total luminous flux: expected positive numbers, got 1 and -1000"),
        (changed(24, "0"), "conversion factor, .*: expected positive numbers, got 0 and 1000"),
        (changed(25, "15"), "line 25: tilt during measurement: expected 0, .*, got 15 degrees"),
        (changed(44, "0"), "angles C: expected angles that grow"),
        (changed(45, "170"), "angles C: expected .0.0, 180.0. as first and last .* got .0.0, 170.0."),
        (changed(46, "360"), "angles C: expected angles that grow from 0 to less than 360"),
        (changed(49, "181"), "angles gamma: expected growing angles within 0 to 180"),
        (changed(51, "nan"), "line 51: intensities: expected a number, got 'nan'"),
        (changed(51, ""), "line 51: intensities: expected a number, got ''"),
        (changed(51, "-1"), "intensities: expected at least 0, got -1"),
        (changed(29, "1e30"), "intensities: expected at most 1e.07 cd with all factors, got 5e.27"),
        (changed(3, "4"), "line 56: expected the end of the file after 2 x 3 intensities"),
        ([*GOOD, "", "5"], "expected the end of the file after 3 x 3 intensities.* got '5'"),
    ],
)
def test_bad_files(tmp_path: Path, lines: list[str], complaint: str) -> None:
    path = written(tmp_path, lines)
    with pytest.raises(ValueError, match=complaint) as caught:
        read_ldt(path)
    assert str(caught.value).startswith(str(path))


def test_a_tilt_that_is_not_said(tmp_path: Path) -> None:
    assert np.array_equal(
        read_ldt(written(tmp_path, changed(25, ""))).intensities_cd, read_ldt(written(tmp_path, GOOD)).intensities_cd
    )


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_ldt(tmp_path / "absent.ldt")


def test_files_are_opened_by_their_suffix(tmp_path: Path) -> None:
    written(tmp_path, GOOD).rename(tmp_path / "lamp.LDT")
    assert towards(read_lamp_file(tmp_path / "lamp.LDT"), 1, 0, 0) == pytest.approx(5, abs=0.05)
    (tmp_path / "lamp.ies").write_text("TILT=NONE\n1 -1 1 2 2 3 2 0 0 0\n1 1 0\n-5 5\n-5 5\n8 8 8 8\n")
    assert towards(read_lamp_file(tmp_path / "lamp.ies"), 1, 0, 0) == pytest.approx(8)
    assert towards(read_lamp_file(str(tmp_path / "lamp.ies")), 1, 0, 0) == pytest.approx(8)
    assert towards(read_ldt(str(tmp_path / "lamp.LDT")), 1, 0, 0) == pytest.approx(5, abs=0.05)
    with pytest.raises(ValueError, match=r"lamp.txt: expected a file whose name ends in .ies or .ldt"):
        read_lamp_file(tmp_path / "lamp.txt")
