from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.geometry import Pose, rotation
from foreglow.photometry import (
    NUM_LEDS,
    Headlamp,
    Headlamps,
    IntensityTable,
    illuminance_lx,
    low_beam,
    matrix_beam,
    read_headlamps,
)

POSITIONS = """
[left]
position_m = [3.5, 0.6, 0.7]
{left}
[right]
position_m = [3.5, -0.6, 0.7]
{right}
"""
GRID = """
[grid]
num_columns = 4
pitch_deg = 3
row_elevations_deg = [0.0, 2.0]
row_peaks_cd = [20000.0, 10000.0]
side_sigma_deg = 8.0
everywhere_cd = 0.0
half_width_deg = 1.8
half_height_deg = 1.2
edge_exponent = 2.5
reach_width_deg = 5.0
reach_height_deg = 3.5
"""
IES = "IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 3 3 3 2 0 0 0\n1 1 0\n{up} \n{right}\n0 0 0 0 {peak} 0 0 0 0\n"


def written(folder: Path, body: str) -> Path:
    path = folder / "lamps.toml"
    path.write_text('name = "ours"\n' + body)
    return path


def grid_file(folder: Path, left: str = "turn_deg = 0.5", right: str = "yaw_deg = -2.0", grid: str = GRID) -> Path:
    return written(folder, POSITIONS.format(left=left, right=right) + grid)


def led_file(folder: Path, name: str, right_deg: float, up_deg: float, peak_cd: float = 1000.0) -> str:
    """A pyramid of light around one direction."""
    up, right = (" ".join(f"{angle + x:g}" for x in (-1, 0, 1)) for angle in (up_deg, right_deg))
    (folder / name).write_text(IES.format(up=up, right=right, peak=peak_cd))
    return name


def test_the_shipped_ones_are_the_simulated_cars() -> None:
    lamps = read_headlamps()
    assert lamps is read_headlamps()
    assert lamps.num_leds == NUM_LEDS
    assert lamps.num_columns == 28
    assert lamps.left.matrix is matrix_beam("left")
    assert lamps.left.matrix.base is low_beam()
    np.testing.assert_array_equal(lamps.left.vehicle_from_lamp.position_m, [3.65, 0.62, 0.66])
    np.testing.assert_array_equal(lamps.right.vehicle_from_lamp.position_m, [3.65, -0.62, 0.66])
    np.testing.assert_allclose(lamps.left.matrix.azimuths_deg[[0, 27]], np.array([-13.5, 13.5]) * 1.2 + 0.3)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_illuminance_is_that_of_the_whole_tables(seed: int) -> None:
    """At random levels and points: near and far, ahead and behind, inside the tables and outside."""
    rng = np.random.default_rng(seed)
    lamps, levels = read_headlamps(), rng.random((2, NUM_LEDS))
    points = rng.uniform((-20.0, -40.0, -3.0), (150.0, 40.0, 12.0), (40, 3))
    base_lx, leds_lx = lamps.illuminance_lx(points)
    assert (base_lx.shape, leds_lx.shape) == ((40,), (40, 2, NUM_LEDS))
    whole = [
        illuminance_lx(lamp.matrix.table(level), lamp.vehicle_from_lamp, points)
        for lamp, level in zip((lamps.left, lamps.right), levels, strict=True)
    ]
    np.testing.assert_allclose(base_lx + (levels * leds_lx).sum((1, 2)), np.sum(whole, axis=0), rtol=1e-5, atol=1e-9)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_intensities_are_those_of_the_turned_tables(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turned = [Pose(np.array([3.0, y, 0.7]), rotation(*rng.normal(0, 0.05, 3))) for y in (0.7, -0.7)]
    lamps = Headlamps("", Headlamp(turned[0], matrix_beam("left")), Headlamp(turned[1], matrix_beam("right")))
    directions = rng.normal((1.0, 0.0, 0.0), (0.5, 0.2, 0.05), (40, 3)) * rng.uniform(0.1, 100.0)
    levels = rng.random((2, NUM_LEDS))
    base_cd, leds_cd = lamps.intensities_cd(directions)
    for side, lamp in enumerate((lamps.left, lamps.right)):
        expected = lamp.matrix.table(levels[side]).towards(directions @ lamp.vehicle_from_lamp.rotation)
        found = base_cd[:, side] + leds_cd[:, side] @ levels[side]
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-3)


def test_far_points_have_the_intensity_over_the_distance_squared() -> None:
    lamps = read_headlamps()
    directions = np.array([[1.0, 0.05, 0.01], [1.0, -0.1, 0.0]])
    base_cd, leds_cd = lamps.intensities_cd(directions)
    base_lx, leds_lx = lamps.illuminance_lx(1e6 * directions)
    squared = 1e12 * (directions**2).sum(1)
    np.testing.assert_allclose(base_lx * squared, base_cd.sum(1), rtol=1e-3)
    np.testing.assert_allclose(leds_lx * squared[:, None, None], leds_cd, rtol=1e-3, atol=1.0)


def test_no_points() -> None:
    base_lx, leds_lx = read_headlamps().illuminance_lx(np.zeros((0, 3)))
    assert (base_lx.shape, leds_lx.shape) == ((0,), (0, 2, NUM_LEDS))


def test_a_grid_of_ones_own(tmp_path: Path) -> None:
    lamps = read_headlamps(grid_file(tmp_path))
    assert (lamps.name, lamps.num_leds, lamps.num_columns) == ("ours", 8, 4)
    np.testing.assert_allclose(lamps.left.matrix.azimuths_deg[:4], [-4.0, -1.0, 2.0, 5.0])
    np.testing.assert_allclose(lamps.right.matrix.azimuths_deg[4:], [-4.5, -1.5, 1.5, 4.5])
    np.testing.assert_allclose(lamps.right.matrix.elevations_deg, [0.0] * 4 + [2.0] * 4)
    aimed = np.radians([[1.5 - 2.0, 0.0], [2.0, 2.0]])  # a column of the right lamp, which looks 2 degrees to the right
    directions = np.stack([np.cos(aimed[:, 0]), np.sin(aimed[:, 0]), np.tan(aimed[:, 1])], axis=1)
    _, leds_cd = lamps.intensities_cd(directions)
    assert leds_cd[0, 1, 2] == pytest.approx(20_000 * np.exp(-0.5 * (1.5 / 8) ** 2), rel=0.01)
    assert leds_cd[1, 0, 6] == pytest.approx(10_000 * np.exp(-0.5 * (2.0 / 8) ** 2), rel=0.01)


def test_the_examples_of_the_page(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "headlamps.md").read_text()
    grid, measured = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    for row, column in np.ndindex(2, 2):
        led_file(tmp_path, f"row{row}_column{column}.ies", 4 - 2 * column, 1.5 * row)
    path = tmp_path / "lamps.toml"
    path.write_text(measured)
    assert read_headlamps(path).num_leds == 4
    path.write_text(grid.replace('"low.ldt"', '"row0_column0.ies"'))
    assert read_headlamps(path).num_leds == 84


def test_files_lie_where_they_say(tmp_path: Path) -> None:
    (tmp_path / "leds").mkdir()
    rows = [
        [led_file(tmp_path, f"leds/{row}{column}.ies", 4 - 2 * column, 1.5 * row) for column in (0, 1)]
        for row in (0, 1)
    ]
    files = f"led_files = {rows}"
    lamps = read_headlamps(written(tmp_path, POSITIONS.format(left=files, right=files)))
    assert (lamps.num_leds, lamps.num_columns) == (4, 2)
    np.testing.assert_allclose(lamps.left.matrix.azimuths_deg, [-4, -2, -4, -2], atol=0.01)
    np.testing.assert_allclose(lamps.left.matrix.elevations_deg, [0, 0, 1.5, 1.5], atol=0.01)
    angles = np.radians([-4.0, -2.25])
    _, leds_cd = lamps.intensities_cd(np.stack([np.cos(angles), np.sin(angles), np.zeros(2)], axis=1))
    np.testing.assert_allclose(leds_cd[:, 0, :2], [[1000, 0], [0, 750]], atol=1.0)
    assert lamps.left.matrix.base is low_beam()  # whose steps are finer than the files'


@pytest.mark.parametrize(
    ("columns", "rows", "complaint"),
    [
        ((1, 0), (0, 1), "expected rows from right to left, the first LED is 2.0 degrees left of the last"),
        ((0, 1), (1, 0), "expected the lowest row first, the first row is 1.5 degrees above the last"),
    ],
)
def test_files_in_another_order(
    tmp_path: Path, columns: tuple[int, int], rows: tuple[int, int], complaint: str
) -> None:
    """The guard would have dimmed the LEDs at the other end."""
    named = [
        [led_file(tmp_path, f"{row}{column}.ies", 4 - 2 * column, 1.5 * row) for column in columns] for row in rows
    ]
    path = written(tmp_path, POSITIONS.format(left=f"led_files = {named}", right=f"led_files = {named}"))
    with pytest.raises(ValueError, match=f"{path}: left.led_files: {complaint}"):
        read_headlamps(path)


def test_a_coarse_small_base_is_refined_for_the_leds(tmp_path: Path) -> None:
    base = led_file(tmp_path, "base.ies", 0.0, -2.0, 5000.0)
    lamps = read_headlamps(grid_file(tmp_path, f'base = "{base}"'))
    table = lamps.left.matrix.base
    assert np.diff(table.azimuths_deg).max() <= 0.6
    assert table.elevations_deg[0] <= -3.0
    assert table.elevations_deg[-1] >= 3.5
    down = np.radians(-2.5)
    base_cd, leds_cd = lamps.intensities_cd([[np.cos(down), 0.0, np.sin(down)], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(base_cd[:, 0], [2500.0, 0.0], atol=5)
    np.testing.assert_allclose(leds_cd[1, 0, 1], 20_000 * np.exp(-0.5 * (1.5 / 8) ** 2 - (1.5 / 1.8) ** 2.5), rtol=0.01)


@pytest.mark.parametrize("peaks_cd", [(12_000, 9.0, 8_000, 7_000), (12, 9_000, 8, 7), (9.0, 12_000, 8_000)])
def test_a_file_in_another_unit_than_the_others(tmp_path: Path, peaks_cd: tuple[float, ...]) -> None:
    """The guard would have thought the LED all but dark, and let it shine."""
    files = [led_file(tmp_path, f"{k}.ies", -2.0 * k, 0.0, peak_cd) for k, peak_cd in enumerate(peaks_cd)]
    path = written(tmp_path, POSITIONS.format(left=f"led_files = [{files}]", right=f"led_files = [{files}]"))
    number = int(np.argmin(peaks_cd) if np.median(peaks_cd) > 100 else np.argmax(peaks_cd))
    with pytest.raises(ValueError, match=f"left.led_files: LED {number}: .* got {peaks_cd[number]:g}; is its file in"):
        read_headlamps(path)


@pytest.mark.parametrize(
    ("left", "grid", "complaint"),
    [
        ("yaw_deg = 'x'", GRID, "left.yaw_deg: .*number.* got 'x'"),
        ("colour = 1", GRID, "left.colour: unknown"),
        ("base = 'absent.txt'", GRID, r"left.base: .*absent.txt: expected a file whose name ends in .ies or .ldt"),
        ("base = 'broken.ies'", GRID, "left.base: .*broken.ies: expected an IES file"),
        ("led_files = [['one.ies'], []]", "", "left.led_files.1: "),
        ("led_files = [['one.ies'], ['one.ies', 'one.ies']]", "", r"left.led_files: expected rows of one length"),
        ("led_files = [['one.ies']]\nturn_deg = 1.0", "", "left.turn_deg: expected only with"),
        ("led_files = [['dark.ies']]", "", "left.led_files: LED 0: expected light"),
        ("base = 'dark.ies'\nled_files = [['one.ies']]", "", "left.base: expected at least 1000 cd .*, got 0 cd"),
        ("led_files = [['one.ies', 'dim.ies']]", "", "left.led_files: LED 1: expected at least 1 cd .*, got 0.5"),
        (
            "led_files = [['half.ies']]",
            "",
            "left.led_files: all LEDs together: expected at least 1000 cd .*, got 500 cd",
        ),
        ("led_files = [['one.ies']]", GRID, "left.led_files: expected either these or .grid., got both"),
        ("", "", "left.led_files: missing, and there is no .grid. either"),
        ("", GRID.replace("pitch_deg = 3", "pitch_deg = 0"), "grid.pitch_deg: .*greater than 0"),
        ("", GRID.replace("side_sigma_deg = 8.0", "side_sigma_deg = 1e-300"), "grid.side_sigma_deg: .*equal to 0.001"),
        ("", GRID.replace("[0.0, 2.0]", "[2.0, 0.0]"), "grid.row_elevations_deg: expected growing"),
        (
            "",
            GRID.replace("[0.0, 2.0]", "[0.002, 0.026]"),
            r"grid.row_elevations_deg: expected rows at least 0.1 degrees apart, got \[0.002, 0.026\]; are these",
        ),
        ("pitch_deg = 2.0", GRID, "left.pitch_deg: expected a low beam that is brightest .*, elevation 1.5$"),
        ("", GRID.replace("[20000.0, 10000.0]", "[1.0]"), "grid.row_peaks_cd: expected one for each of 2 rows, got 1"),
        ("", GRID.replace("[20000.0, 10000.0]", "[0.0, 10000.0]"), "grid: LED 0: expected at least 1 cd .*, got 0"),
        ("", GRID.replace("[20000.0, 10000.0]", "[20.0, 10.0]"), "grid: all LEDs together: expected at least 1000 cd"),
        ("", GRID.replace("half_width_deg = 1.8", "half_width_deg = 1e-308"), "grid.half_width_deg: .*equal to 0.05"),
        ("", GRID.replace("edge_exponent = 2.5", ""), "grid.edge_exponent: missing"),
        ("", GRID.replace("pitch_deg = 3", "pitch_deg = 80"), "grid: num_columns: expected columns within 45 degrees"),
        (
            "turn_deg = -4.5",
            GRID.replace("pitch_deg = 3", "pitch_deg = 28"),
            "grid: num_columns: expected columns within 45 degrees of the axis, .* got one at -46",
        ),
        ("", GRID.replace("5.0", "1.0"), "grid.reach_width_deg: expected at least half_width_deg, 1.8, got 1"),
    ],
)
def test_faults_are_named(tmp_path: Path, left: str, grid: str, complaint: str) -> None:
    led_file(tmp_path, "one.ies", 0.0, 0.0)
    led_file(tmp_path, "dark.ies", 0.0, 0.0, 0.0)
    led_file(tmp_path, "dim.ies", 0.0, 0.0, 0.5)
    led_file(tmp_path, "half.ies", 0.0, 0.0, 500.0)
    (tmp_path / "broken.ies").write_text("nothing")
    path = grid_file(tmp_path, left, "led_files = [['one.ies']]" if "led_files" in left and not grid else "", grid)
    with pytest.raises(ValueError, match=complaint) as caught:
        read_headlamps(path)
    assert str(caught.value).startswith(f"{path}: ")


def bodies(old: str, new: str) -> str:
    body = POSITIONS.format(left="", right="") + GRID
    assert old in body
    return body.replace(old, new)


MISPLACED = {
    "sides swapped": (
        " 0.6, 0.7]",
        " -0.6, 0.7]",
        r"left.position_m.1: expected at least 0.1 m, on the left .* got -0.6",
    ),
    "both on the left": (
        "-0.6, 0.7]",
        "0.6, 0.7]",
        r"right.position_m.1: expected at most -0.1 m, on the right .* 0.6",
    ),
    "both in the middle": (" 0.6, 0.7]", " 0.0, 0.7]", r"left.position_m.1: expected at least 0.1 m, .* got 0$"),
    "far aside": (" 0.6, 0.7]", " 2.1, 0.7]", r"left.position_m.1: .* less than or equal to 2, got 2.1"),
    "behind the rear axle": ("[3.5,", "[-3.5,", r"left.position_m.0: .* greater than or equal to 0.5, got -3.5"),
    "far ahead": ("[3.5,", "[13.0,", r"left.position_m.0: .* less than or equal to 12, got 13"),
    "below the road": ("0.7]", "-5.0]", r"left.position_m.2: .* greater than or equal to 0.2, got -5"),
    "on a mast": ("0.7]", "3.1]", r"left.position_m.2: .* less than or equal to 3, got 3.1"),
    "aimed aside": ("[right]", "yaw_deg = 90.0\n[right]", r"left.yaw_deg: .* less than or equal to 5, got 90"),
    "aimed to the right": ("[right]", "yaw_deg = -30.0\n[right]", r"left.yaw_deg: .* equal to -5, got -30"),
    "aimed up": ("[grid]", "pitch_deg = 20.0\n[grid]", r"right.pitch_deg: .* less than or equal to 2, got 20"),
    "aimed down": ("[grid]", "pitch_deg = -90.0\n[grid]", r"right.pitch_deg: .* equal to -2, got -90"),
    "turned": ("[grid]", "turn_deg = 45.0\n[grid]", r"right.turn_deg: .* less than or equal to 5, got 45"),
    "high rows": ("[0.0, 2.0]", "[60.0, 65.0]", r"grid.row_elevations_deg.0: .* less than or equal to 10, got 60"),
    "low rows": ("[0.0, 2.0]", "[-30.0, -25.0]", r"grid.row_elevations_deg.0: .* equal to -5, got -30"),
    "rows above all vehicles": (
        "[0.0, 2.0]",
        "[5.0, 7.0]",
        r"grid, as left aims it: all LEDs together: expected at least 0.25 of their peak, .* within 5 degrees of "
        r"straight ahead at elevation 0, got 0 cd: the peak is at azimuth -?\d\.\d, elevation 5\.\d$",
    ),
    "columns beyond the guard's directions": (
        GRID,
        GRID.replace("pitch_deg = 3", "pitch_deg = 28").replace("everywhere_cd = 0.0", "everywhere_cd = 100.0"),
        r"grid, as left aims it: LED 0: expected light within 45 degrees to the sides and -10 to 15 degrees high, got "
        r"some at azimuth -4\d\.\d, elevation ",
    ),
}


@pytest.mark.parametrize("fault", MISPLACED)
def test_lamps_are_where_headlamps_are_and_shine_ahead(tmp_path: Path, fault: str) -> None:
    """The guard took vehicles to be in the dark, and dimmed nothing."""
    old, new, complaint = MISPLACED[fault]
    path = written(tmp_path, bodies(old, new))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_headlamps(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("right_deg", "up_deg", "complaint"),
    [
        (0.0, 60.0, "LED 0: expected light within 45 degrees .* got some at azimuth -?0.\\d, elevation 6[01].\\d"),
        (90.0, 0.0, "LED 0: expected light within 45 degrees .* got some at azimuth -9[01].\\d, elevation -?0.\\d"),
        (20.0, 0.0, r"all LEDs together: .* got 0 cd: the peak is at azimuth -20.0, elevation 0.0"),
        (0.0, -4.0, r"all LEDs together: .* got 0 cd: the peak is at azimuth 0.0, elevation -4.0"),
    ],
)
def test_measured_leds_shine_ahead(tmp_path: Path, right_deg: float, up_deg: float, complaint: str) -> None:
    files = f"led_files = [['{led_file(tmp_path, 'led.ies', right_deg, up_deg, 5000.0)}']]"
    path = written(tmp_path, POSITIONS.format(left=files, right=files))
    with pytest.raises(ValueError, match=f"left.led_files: {complaint}") as caught:
        read_headlamps(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(("right_deg", "up_deg"), [(90.0, 0.0), (-30.0, -1.0), (0.0, 8.0), (0.0, -40.0)])
def test_a_low_beam_shines_on_the_road(tmp_path: Path, right_deg: float, up_deg: float) -> None:
    base = led_file(tmp_path, "base.ies", right_deg, up_deg, 5000.0)
    path = grid_file(tmp_path, f'base = "{base}"')
    complaint = rf"left.base: expected a low beam .* got azimuth {0 - right_deg:.1f}, elevation {up_deg:.1f}$"
    with pytest.raises(ValueError, match=complaint) as caught:
        read_headlamps(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_lamps_with_different_numbers_of_leds(tmp_path: Path) -> None:
    led_file(tmp_path, "one.ies", 0.0, 0.0)
    single, pair = "led_files = [['one.ies']]", "led_files = [['one.ies', 'one.ies']]"
    with pytest.raises(ValueError, match="expected as many LEDs and columns left as right"):
        read_headlamps(written(tmp_path, POSITIONS.format(left=single, right=pair)))


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_headlamps(tmp_path / "lamps.toml")
    path = grid_file(tmp_path, "base = 'absent.ies'")
    with pytest.raises(FileNotFoundError, match=r"left.base: .*absent.ies: no such file") as caught:
        read_headlamps(path)
    assert str(path) in str(caught.value)


def test_tables_reach_beyond_the_borders_only_with_darkness() -> None:
    """Half a cell outside the LEDs' part of the table their light fades; a whole cell outside there is none."""
    azimuths, elevations = np.linspace(-10, 10, 21), np.linspace(-5, 5, 11)
    flat = IntensityTable(azimuths, elevations, np.zeros((11, 21), np.float32))
    lamp = matrix_beam("left")
    edged = type(lamp)(
        flat, slice(5, 8), slice(4, 6), np.full((1, 2, 3), 100.0, np.float32), np.zeros(1), np.zeros(1), 1
    )
    mount = Pose(np.zeros(3), np.eye(3))
    lamps = Headlamps("", Headlamp(mount, edged), Headlamp(mount, edged))
    turned = np.radians([-5.0, -5.5, -6.0, -3.0, -2.5, -2.0])
    up = np.radians(-0.5)
    directions = np.stack([np.cos(turned) * np.cos(up), np.sin(turned) * np.cos(up), np.full(6, np.sin(up))], axis=1)
    _, leds_cd = lamps.intensities_cd(directions)
    np.testing.assert_allclose(leds_cd[:, 0, 0], [100, 50, 0, 100, 50, 0], atol=1e-6)
