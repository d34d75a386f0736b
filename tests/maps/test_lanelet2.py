from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from foreglow.maps import RoadMap, read_road_map
from foreglow.maps.lanelet2 import _border
from tests.maps.roads import pose

# Rows of nodes to the north: at latitude 48, 0.0001 degrees of longitude are 7.46 m, of latitude 11.12 m.
LONGITUDES = {"a": 9.0, "b": 9.00005, "c": 9.0001}
WIDTH_M = 7.46 / 2


def document(*, heights: tuple[float, float, float] | None = (400.0, 400.2, 400.4), more: str = "") -> str:
    """Two lanelets, one to the north between b and c, one to the south between b and a, 50 m long."""
    nodes = ""
    for number, (name, longitude) in enumerate(LONGITUDES.items()):
        ele = f"<tag k='ele' v='{heights[number]}'/>" if heights else ""
        nodes += "".join(
            f"<node id='{name}{k}' lat='{48 + k * 0.0001:.4f}' lon='{longitude}'>{ele}</node>" for k in range(6)
        )
    ways = "".join(f"<way id='{n}'>{''.join(f'<nd ref={n + str(k)!r}/>' for k in range(6))}</way>" for n in LONGITUDES)
    return f"<osm>{nodes}{ways}{lanelet(1, 'b', 'c')}{lanelet(2, 'b', 'a')}{more}</osm>"


def lanelet(number: int, left: str, right: str, subtype: str = "road") -> str:
    return (
        f"<relation id='{number}'><member type='way' ref='{left}' role='left'/>"
        f"<member type='way' ref='{right}' role='right'/>"
        f"<tag k='type' v='lanelet'/><tag k='subtype' v='{subtype}'/></relation>"
    )


def read(tmp_path: Path, text: str) -> RoadMap:
    path = tmp_path / "town.osm"
    path.write_text(text)
    return read_road_map(path)


def test_two_directions_are_one_carriageway(tmp_path: Path) -> None:
    road_map = read(tmp_path, document())
    assert len(road_map.lines) == 1
    assert road_map.has_heights
    assert road_map.lines[0].half_width_m == pytest.approx(WIDTH_M, abs=0.01)
    road = road_map.ahead(pose(WIDTH_M * 1.5, 10.0, z=400.3, yaw_deg=90.0))
    assert road is not None
    assert road.points_m[0].tolist() == pytest.approx([0.0, WIDTH_M / 2, -0.1], abs=0.02)
    assert road.cross_slopes[3] == pytest.approx(-0.2 / WIDTH_M, abs=1e-3)  # it rises to our right
    back = road_map.ahead(pose(WIDTH_M * 0.5, 40.0, z=400.1, yaw_deg=-90.0))
    assert back is not None
    assert back.cross_slopes[3] == pytest.approx(0.2 / WIDTH_M, abs=1e-3)


def test_two_directions_of_left_hand_traffic_are_one_carriageway(tmp_path: Path) -> None:
    """They were two roads of a lane each, with a centre line in the middle of ours."""
    text = document().replace(lanelet(1, "b", "c"), lanelet(1, "c", "b"))
    road_map = read(tmp_path, text.replace(lanelet(2, "b", "a"), lanelet(2, "a", "b")))
    assert [line.half_width_m for line in road_map.lines] == pytest.approx([WIDTH_M], abs=0.01)
    road = road_map.ahead(pose(WIDTH_M * 0.5, 10.0, z=400.1, yaw_deg=90.0))
    assert road is not None
    assert road.points_m[0].tolist() == pytest.approx([0.0, -WIDTH_M / 2, 0.1], abs=0.02)


def test_lanes_of_one_direction_are_roads_of_their_own(tmp_path: Path) -> None:
    text = document().replace(lanelet(2, "b", "a"), lanelet(2, "a", "b"))
    widths_m = [2 * line.half_width_m for line in read(tmp_path, text).lines]
    assert widths_m == pytest.approx([WIDTH_M, WIDTH_M], abs=0.01)


def test_a_lanelet_of_its_own_whose_borders_run_apart(tmp_path: Path) -> None:
    text = document(heights=None).replace(lanelet(2, "b", "a"), "")
    nodes = [f"<nd ref='c{k}'/>" for k in range(6)]
    road_map = read(tmp_path, text.replace("".join(nodes), "".join(reversed(nodes))))
    assert not road_map.has_heights
    line = road_map.lines[0]
    assert line.half_width_m == pytest.approx(WIDTH_M / 2, abs=0.01)
    assert line.points_m[0].tolist() == pytest.approx([1.5 * WIDTH_M, 0.0, 0.0], abs=0.01)
    assert line.length_m == pytest.approx(55.6, abs=0.1)


def test_lanes_that_part_are_no_two_directions(tmp_path: Path) -> None:
    """Two lanelets on the same side of their common left border."""
    text = (
        document()
        .replace(lanelet(2, "b", "a"), lanelet(2, "a", "b"))
        .replace(lanelet(1, "b", "c"), lanelet(1, "a", "c"))
    )
    widths_m = sorted(2 * line.half_width_m for line in read(tmp_path, text).lines)
    assert widths_m == pytest.approx([WIDTH_M, 2 * WIDTH_M], abs=0.01)


def test_paths_are_left_out(tmp_path: Path) -> None:
    assert len(read(tmp_path, document(more=lanelet(3, "a", "c", "walkway"))).lines) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<member type='way' ref='c' role='right'/>", "", "lanelet 1: expected one right border, got 0"),
        ("<way id='c'>", "<way id='d'>", "way c: expected it with all its nodes, it is missing"),
        ("<nd ref='c3'/>", "<nd ref='c9'/>", r"way c: expected it with all its nodes, \['c9'\] is missing"),
        ("lat='48.0001'", "lat='148'", "node a1: expected a latitude of -90 to 90"),
        ("lat='48.0001'", "lat='90.00005'", r"node a1: expected a latitude .* got 90\.00005 and"),
        ("lat='48.0001'", "lat='north'", "node a1: <node> lat: expected a finite number, got 'north'"),
        ("lon='9", "lon='8", "ways . and .: (borders: expected a width above 0|length: expected at most)"),
        ("v='400.2'", "v='1e11'", "way .: height: expected up to 10000 m above or below zero, got 1e.11"),
        (
            "v='400.2'",
            "v='0'",
            "way b: ele: expected heights that differ by at most 5 m .*, got 0 m and 400.2 m of points b0",
        ),
        ("v='400.4'", "v='-9999'", "way c: ele: expected heights that differ by at most 5 m .* of points c0 and c1"),
        ("<tag k='ele' v='400.2'/>", "", "ele: expected a height at all nodes of borders, or at none"),
        ("<node id='a1'", "<node id='a0'", "node: expected an id of its own for each, got a0 twice"),
        ("<node id='a1'", "<node", "node: expected an id of its own for each, got one without"),
        ("<way id='a'>", "<way id='b'>", "way: expected an id of its own for each, got b twice"),
        (
            "<node id='a1'",
            "<node action='delete' id='a1'",
            r"way a: expected it with all its nodes, \['a1'\] is missing",
        ),
        (
            "lat='48.0005' lon='9.0001'",
            "lat='48.002' lon='9.0001'",
            "ways c and a: borders: expected a width above 0 and up to 40 m, got ",
        ),
        ("'lanelet'", "'multipolygon'", "expected at least one lanelet for cars, got none"),
    ],
)
def test_errors(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = document()
    assert old in text
    with pytest.raises(ValueError, match=rf"town\.osm: {message}"):
        read(tmp_path, text.replace(old, new) if "lanelet'" in old else text.replace(old, new, 1))


@pytest.mark.parametrize("mark", ["action='delete'", "visible='false'", "action='modify' visible='false'"])
def test_what_is_deleted_is_no_road(mark: str, tmp_path: Path) -> None:
    deleted = lanelet(3, "a", "c").replace("<relation", f"<relation {mark}")
    assert len(read(tmp_path, document(more=deleted)).lines) == 1
    assert len(read(tmp_path, document(more=lanelet(3, "a", "c"))).lines) == 2
    assert len(read(tmp_path, document(more=deleted.replace("false", "true").replace("delete", "modify"))).lines) == 2


def test_a_file_without_nodes(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"town\.osm: expected nodes, got none"):
        read(tmp_path, "<osm/>")


def test_a_way_without_nodes_is_named(tmp_path: Path) -> None:
    more = "<way id='e'/>" + lanelet(3, "e", "c")
    with pytest.raises(ValueError, match=r"town\.osm: way e: expected at least two nodes that differ"):
        read(tmp_path, document(more=more))


def test_a_border_of_many_lanelets_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each made it anew, which took minutes where borders are long."""
    made: list[str] = []

    def counting(way: str, *others: Any) -> Any:
        made.append(way)
        return _border(way, *others)

    monkeypatch.setattr("foreglow.maps.lanelet2._border", counting)
    read(tmp_path, document(more="".join(lanelet(number, "b", "c") for number in range(3, 9))))
    assert sorted(made) == ["a", "b", "c"]
