from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.maps import CentreLine, RoadMap, read_road_map
from foreglow.street import LANE_WIDTH_M
from tests.maps.roads import pose

Lanes = tuple[tuple[str, float], ...]

LANES = """
<lanes>{offset}
 <laneSection s="0">
  <left><lane id="2" type="sidewalk"><width sOffset="0" a="9" b="0" c="0" d="0"/></lane>
        <lane id="1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></left>
  <center><lane id="0" type="none"/></center>
  <right><lane id="-1" type="driving"><width sOffset="0" a="{right}" b="0" c="0" d="0"/></lane></right>
 </laneSection>
</lanes>"""


def geometry(s: float, x: float | str, y: float, heading: float, length_m: float, shape: str) -> str:
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length_m}">{shape}</geometry>'


def road(plan: str, length_m: float | str, more: str = "") -> str:
    return f'<road id="7" length="{length_m}"><planView>{plan}</planView>{more}</road>'


def read(tmp_path: Path, *roads: str) -> RoadMap:
    path = tmp_path / "town.xodr"
    path.write_text(f"<?xml version='1.0'?><OpenDRIVE><header/>{''.join(roads)}</OpenDRIVE>")
    return read_road_map(path)


def only(road_map: RoadMap) -> CentreLine:
    assert len(road_map.lines) == 1
    return road_map.lines[0]


def test_a_line_and_an_arc(tmp_path: Path) -> None:
    plan = geometry(0, 5, 6, np.pi / 2, 50, "<line/>") + geometry(50, 5, 56, np.pi / 2, 60.5, '<arc curvature="0.01"/>')
    line = only(read(tmp_path, road(plan, 110.5)))
    assert line.half_width_m == LANE_WIDTH_M
    assert line.length_m == pytest.approx(110.5, abs=1e-3)
    np.testing.assert_allclose(line.points_m[:51], [[5, 6 + k, 0] for k in range(51)], atol=1e-9)
    turn = 0.605  # of the circle around (-95, 56)
    np.testing.assert_allclose(line.points_m[-1], [-95 + 100 * np.cos(turn), 56 + 100 * np.sin(turn), 0], atol=1e-9)


def test_a_spiral_bends_as_a_clothoid(tmp_path: Path) -> None:
    """From straight to 1/50 m over 100 m: the series x = s - s^5/(40 A^4), y = s^3/(6 A^2) - ..., A^2 = 5000."""
    line = only(read(tmp_path, road(geometry(0, 0, 0, 0, 100, '<spiral curvStart="0" curvEnd="0.02"/>'), 100)))
    s, square = 100.0, 5000.0
    x = s - s**5 / (40 * square**2) + s**9 / (3456 * square**4) - s**13 / (599040 * square**6)
    y = s**3 / (6 * square) - s**7 / (336 * square**3) + s**11 / (42240 * square**5) - s**15 / (9676800 * square**7)
    np.testing.assert_allclose(line.points_m[-1, :2], [x, y], atol=1e-3)


@pytest.mark.parametrize("axis", "UV")
@pytest.mark.parametrize("power", "abcd")
@pytest.mark.parametrize(("others", "p_range"), [(1.0, "normalized"), (0.0, "arcLength")])
def test_a_coefficient_that_is_far_too_large_is_refused(
    tmp_path: Path, axis: str, power: str, others: float, p_range: str
) -> None:
    """Without a warning of NumPy's before, which is an error in tests."""
    numbers = {f"{name}{of}": others for of in "UV" for name in "abcd"} | {f"{power}{axis}": 1e308}
    words = " ".join(f'{name}="{value}"' for name, value in numbers.items())
    shape = f'<paramPoly3 pRange="{p_range}" {words}/>'
    with pytest.raises(ValueError, match=r"\.xodr: "):
        read(tmp_path, road(geometry(0, 0, 0, 0, 20, shape), 20))


@pytest.mark.parametrize(("p_range", "scale"), [("arcLength", 1.0), ("normalized", 20.0)])
def test_a_parametric_cubic(tmp_path: Path, p_range: str, scale: float) -> None:
    """v = 0.01 u^2."""
    u = f'aU="0" bU="{scale}" cU="0" dU="0"'
    shape = f'<paramPoly3 pRange="{p_range}" {u} aV="0" bV="0" cV="{0.01 * scale**2}" dV="0"/>'
    line = only(read(tmp_path, road(geometry(0, 0, 0, 0, 20, shape), 20)))
    np.testing.assert_allclose(line.points_m[:, 1], 0.01 * line.points_m[:, 0] ** 2, atol=1e-9)
    assert line.points_m[-1, 0] == pytest.approx(20.0)


def test_a_cubic_of_another_parameter_is_no_road_of_a_metre(tmp_path: Path) -> None:
    """Without pRange the parameter is normalised, but this one is the length."""
    shape = '<paramPoly3 aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0.001" dV="0"/>'
    with pytest.raises(ValueError, match=r"geometry at s = 0 m: expected a line of 200 m, .*, got 1 m .*pRange"):
        read(tmp_path, road(geometry(0, 0, 0, 0, 200, shape), 200))


def test_the_middle_of_the_driving_lanes(tmp_path: Path) -> None:
    plan = geometry(0, 0, 0, 0, 40, "<line/>")
    line = only(read(tmp_path, road(plan, 40, LANES.format(offset="", right=4))))
    assert line.half_width_m == 3.5
    np.testing.assert_allclose(line.points_m[:, 1], -0.5)
    offset = '<laneOffset s="10" a="1" b="0.1" c="0" d="0"/>'
    line = only(read(tmp_path, road(plan, 40, LANES.format(offset=offset, right=3))))
    np.testing.assert_allclose(line.points_m[[5, 10, 30], 1], [0.0, 1.0, 3.0])


@pytest.mark.parametrize(
    ("left", "right", "middle_m", "half_width_m"),
    [
        ((), (("none", 4), ("driving", 3.5), ("driving", 3.5)), -7.5, 3.5),
        ((), (("median", 2), ("driving", 3.5)), -3.75, 1.75),
        ((), (("driving", 3), ("bus", 3), ("slipLane", 2)), -4, 4),
        ((), (("driving", 3.5), ("biking", 2), ("driving", 3.5)), -4.5, 4.5),
        ((("driving", 3), ("shoulder", 2)), (), 1.5, 1.5),
        ((("median", 2), ("driving", 3.5)), (("median", 2), ("driving", 3.5), ("shoulder", 1)), 0.0, 5.5),
        ((("sidewalk", 5),), (("stop", 1), ("driving", 3)), -2.5, 1.5),
    ],
)
def test_what_lies_before_the_driving_lanes(
    tmp_path: Path, left: Lanes, right: Lanes, middle_m: float, half_width_m: float
) -> None:
    def lanes(side: str, sign: int, given: Lanes) -> str:
        one = '<lane id="{}" type="{}"><width sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
        numbered = [one.format(sign * number, *lane) for number, lane in enumerate(given, start=1)]
        return f"<{side}>{''.join(reversed(numbered))}</{side}>"

    section = f'<lanes><laneSection s="0">{lanes("left", 1, left)}{lanes("right", -1, right)}</laneSection></lanes>'
    line = only(read(tmp_path, road(geometry(0, 0, 0, 0, 40, "<line/>"), 40, section)))
    assert line.half_width_m == pytest.approx(half_width_m)
    np.testing.assert_allclose(line.points_m[:, 1], middle_m)


def test_heights_and_banking(tmp_path: Path) -> None:
    more = (
        '<elevationProfile><elevation s="0" a="100" b="0.05" c="0" d="0"/>'
        '<elevation s="20" a="101" b="0.05" c="0.001" d="0"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="0.04" b="0" c="0" d="0"/></lateralProfile>'
    )
    line = only(read(tmp_path, road(geometry(0, 0, 0, 0, 40, "<line/>"), 40, more + LANES.format(offset="", right=5))))
    # The middle is 1 m to the right of the reference line, which falls to the right.
    np.testing.assert_allclose(line.points_m[[0, 20, 40], 2] + np.sin(0.04), [100, 101, 102.4], atol=1e-9)
    np.testing.assert_allclose(line.cross_slopes, np.tan(0.04))


def test_roads_are_joined(tmp_path: Path) -> None:
    first = road(geometry(0, 0, 0, 0, 50, "<line/>"), 50)
    second = road(geometry(0, 100, 0, np.pi, 50, "<line/>"), 50)  # runs towards the first
    ahead = read(tmp_path, first, second).ahead(pose(10.0, 0.0))
    assert ahead is not None
    assert len(ahead) == 91


def test_roads_without_a_lane_for_cars_are_left_out(tmp_path: Path) -> None:
    plan = geometry(0, 0, 0, 0, 40, "<line/>")
    path_only = LANES.format(offset="", right=3).replace('"driving"', '"biking"')
    assert len(read(tmp_path, road(plan, 40, path_only), road(plan, 40)).lines) == 1
    with pytest.raises(
        ValueError, match=r"town\.xodr: expected at least one <road> with a driving lane, got none of 1"
    ):
        read(tmp_path, road(plan, 40, path_only))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (road("", 40), "road 7: planView: expected at least one <geometry>"),
        (
            road(
                geometry(0, 0, 0, 0, 40, "<line/>"), 40, LANES.format(offset="", right=3).replace("sidewalk", "Driving")
            ),
            "road 7: lane 2: type: expected one of bidirectional, biking, .*, got 'Driving'",
        ),
        (road(geometry(0, 0, 0, 0, 40, "<poly3/>"), 40), "road 7: geometry: expected line, arc, .*got poly3"),
        (road(geometry(0, 0, 0, 1e300, 40, "<line/>"), 40), r"road 7: geometry: hdg: .* 1000 rad, got 1e\+300"),
        (
            road(geometry(0, 0, 0, 0, 40, '<line/><arc curvature="0.1"/>'), 40),
            "road 7: geometry: expected one shape, got line, arc",
        ),
        (
            road(geometry(0, 0, 0, 0, 40, "<arc/>"), 40),
            "road 7: <arc> curvature: expected a finite number, got nothing",
        ),
        (
            road(geometry(0, "nan", 0, 0, 40, "<line/>"), 40),
            "road 7: <geometry> x: expected a finite number, got 'nan'",
        ),
        (
            road(geometry(0, 0, 0, 0, 40, "<line/>"), 40, LANES.format(offset="", right="wide")),
            "road 7: lane -1: <width> a: expected a finite number, got 'wide'",
        ),
        *(
            (
                road(geometry(0, 0, 0, 0, 40, "<line/>"), 40, LANES.format(offset="", right="3.25").replace(*change)),
                words,
            )
            for change, words in (
                (('a="3.25"', 'A="3.25"'), "road 7: lane -1: <width> a: expected a finite number, got nothing"),
                (('a="3.25"', 'a="-3.25"'), "road 7: lane -1: width: expected at least 0 m, got -3.25"),
                (
                    ('<width sOffset="0" a="3.25"', '<width sOffset="50" a="3.25"'),
                    "road 7: lane -1: expected <width> from sOffset 0 on, got the first one from 50 m on",
                ),
                (
                    ('<width sOffset="0" a="3.25" b="0" c="0" d="0"/></lane></right>', "</lane></right>"),
                    "road 7: lane -1: expected <width> from sOffset 0 on, got none",
                ),
            )
        ),
        (
            road(geometry(0, 0, 0, 0, 40, "<line/>"), 40, LANES.format(offset="", right="1e4")),
            "road 7: lanes: expected a width above 0 and up to 200 m, got 10003",
        ),
        (
            road(
                geometry(0, 0, 0, 0, 40, "<line/>"),
                40,
                '<elevationProfile><elevation s="0" a="411"/><elevation s="20" a="0"/></elevationProfile>',
            ),
            "road 7: elevation, every metre: expected heights that differ by .*, got 411 m and 0 m of points 19 and 20",
        ),
        (road(geometry(0, "1e11", 0, 0, 40, "<line/>"), 40), r"road 7: x, y: expected up to 1e\+08 m"),
        (road(geometry(0, 0, 0, 0, 40, "<line/>"), "long"), "road 7: <road> length: .* got 'long'"),
        (road(geometry(0, 0, 0, 0, 40, "<line/>"), -40), "road 7: length: expected at least 0 m, got -40"),
        (
            road(geometry(0, 0, 0, 0, 40, '<spiral curvStart="0" curvEnd="0.1"/>'), 400),
            "road 7: planView: expected geometries one after .*, got one to s = 40 m and the next from 400 m",
        ),
        (
            road(geometry(0, 0, 0, 0, 40, "<line/>") + geometry(90, 90, 0, 0, 10, "<line/>"), 100),
            "road 7: planView: expected geometries one after .*, got one to s = 40 m and the next from 90 m",
        ),
        (
            road(geometry(9, 0, 0, 0, 31, "<line/>"), 40),
            "road 7: planView: .* got one to s = 0 m and the next from 9 m",
        ),
        (
            road(geometry(0, 0, 0, 0, 20, "<line/>") + geometry(20, 90, 0, 0, 20, "<line/>"), 40),
            "road 7: planView: expected a line without gaps, got one of 71 m at s = 19 m",
        ),
        (
            road(geometry(0, 0, 0, 0, 40, '<arc curvature="1e300"/>'), 40),
            r"road 7: <arc> curvature: expected up to 1 per m, got 1e\+300",
        ),
        (
            road(
                geometry(0, 0, 0, 0, 40, "<line/>"), 40, LANES.format(offset="", right="3").replace("width", "border")
            ),
            "road 7: lane .*: expected <width>, got <border>, not read",
        ),
    ],
)
def test_errors(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=rf"town\.xodr: {message}"):
        read(tmp_path, text)


def test_broken_files(tmp_path: Path) -> None:
    path = tmp_path / "town.xodr"
    path.write_text("<OpenDRIVE><road>")
    with pytest.raises(ValueError, match=r"town\.xodr: expected XML: .*line 1"):
        read_road_map(path)
    path.write_text("<osm/>")
    with pytest.raises(ValueError, match=r"expected XML with the root <OpenDRIVE>, got <osm>"):
        read_road_map(path)
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_road_map(tmp_path / "nowhere.xodr")
