"""MOTChallenge files: rows worked by hand, and TrackEval's figures of tracks that are known to be right or wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from foreglow.datasets import PVDN
from foreglow.lab.evaluation.mot import export_mot, score_mot
from foreglow.types import Tracks, TrackState
from tests.datasets.tiny_pvdn import make_pvdn, write
from tests.lab.evaluation.scored_boxes import predictions_of
from tests.stand_ins import tracks_of

IMAGES = (11, 12, 13)


def light(iid: int, x: int, y: int) -> dict[str, Any]:
    return {"pos": [x, y], "iid": iid, "direct": False, "rear": False}


@pytest.fixture(name="dataset")
def fixture_dataset(tmp_path: Path) -> PVDN:
    """Sequence 3: two lights of vehicle 7, the second one from the second image on, and a doubtful one at the end."""
    root = make_pvdn(tmp_path / "set")
    for image_id in (5, 7):
        write(root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": []})
    for index, image_id in enumerate(IMAGES):
        lights = [light(4, 20 + index, 30), light(9, 60, 30)][: 1 + (index > 0)]
        vehicles = [{"pos": [50, 50], "oid": 7, "direct": False, "instances": lights}]
        document = {"image_id": image_id, "annotations": vehicles}
        if index == 2:
            document["doubtful"] = [light(-1, 90, 50)]
        write(root / f"labels/keypoints/{image_id:06d}.json", document)
    return PVDN(root)


BOXES = predictions_of(
    {
        5: [],
        7: [],
        11: [(10, 20, 30, 40, 0.9), (0, 0, 70, 50, 0.2)],
        12: [(11, 20, 31, 40, 0.9)],
        13: [(12, 20, 32, 40, 0.9), (50, 20, 70, 40, 0.1)],
    }
)


def followed(*ids: int, last: TrackState = TrackState.CONFIRMED) -> dict[int, Tracks]:
    """The first light's box in each image, under these track ids."""
    tracks = {
        image_id: tracks_of(
            [BOXES.boxes_xyxy_px[image_id][0]], [last if index == 2 else TrackState.CONFIRMED], ids=[its]
        )
        for index, (image_id, its) in enumerate(zip(IMAGES, ids, strict=True))
    }
    return tracks | {5: tracks_of([]), 7: tracks_of([])}


def test_rows(dataset: PVDN, tmp_path: Path) -> None:
    tracks = followed(0, 0, 0, last=TrackState.TENTATIVE)
    export_mot(dataset, BOXES, tracks, tmp_path / "out", "ours")
    assert (tmp_path / "out/gt/S00003/gt/gt.txt").read_text().splitlines() == [
        "1,1,11.000,21.000,20.000,20.000,1,1,1",
        "2,1,12.000,21.000,20.000,20.000,1,1,1",
        "2,2,53.000,23.000,16.000,16.000,1,1,1",  # no proposal contains it
        "3,1,13.000,21.000,20.000,20.000,1,1,1",
        "3,2,51.000,21.000,20.000,20.000,1,1,1",
    ]
    assert (tmp_path / "out/trackers/ours/data/S00003.txt").read_text().splitlines() == [
        "1,1,11.000,21.000,20.000,20.000,0.7500,-1,-1,-1",
        "2,1,12.000,21.000,20.000,20.000,0.7500,-1,-1,-1",
    ]
    assert "seqLength=3" in (tmp_path / "out/gt/S00003/seqinfo.ini").read_text()
    assert (tmp_path / "out/gt/S00001/gt/gt.txt").read_text() == ""  # no light
    assert (tmp_path / "out/trackers/ours/data/S00001.txt").read_text() == ""


@pytest.mark.parametrize(
    ("endings", "told"), [((".png",) * 3, ".png"), ((".jpg",) * 3, ".jpg"), ((".png", ".JPG", ".JPG"), ".JPG")]
)
def test_the_ending_of_the_images(dataset: PVDN, endings: tuple[str, ...], told: str, tmp_path: Path) -> None:
    path = dataset.root / "labels/image_annotations.json"
    text = path.read_text()
    for image_id, ending in zip(IMAGES, endings, strict=True):
        text = text.replace(f"{image_id:06d}.png", f"{image_id:06d}{ending}")
    path.write_text(text)
    export_mot(PVDN(dataset.root), BOXES, followed(0, 0, 0), tmp_path / "out")
    assert f"\nimExt={told}\n" in (tmp_path / "out/gt/S00003/seqinfo.ini").read_text()


def test_a_track_of_doubtful_light_is_left_out(dataset: PVDN, tmp_path: Path) -> None:
    tracks = followed(0, 0, 0)
    tracks[13] = tracks_of([[80, 40, 99, 60], [0, 40, 99, 60], [12, 20, 95, 60]])  # doubtful twice; a light, too
    export_mot(dataset, BOXES, tracks, tmp_path / "out")
    rows = (tmp_path / "out/trackers/foreglow/data/S00003.txt").read_text().splitlines()
    assert [row.split(",")[:2] for row in rows] == [["1", "1"], ["2", "1"], ["3", "3"]]


def test_lights_in_one_box_are_one_object(dataset: PVDN, tmp_path: Path) -> None:
    wide = predictions_of({5: [], 7: [], **{image_id: [(0, 0, 95, 60, 0.5)] for image_id in IMAGES}})
    export_mot(dataset, wide, followed(0, 0, 0), tmp_path / "out")
    rows = (tmp_path / "out/gt/S00003/gt/gt.txt").read_text().splitlines()
    assert [row.split(",")[:2] for row in rows] == [["1", "1"], ["2", "1"], ["3", "1"]]


def test_no_object_is_twice_in_an_image(dataset: PVDN, tmp_path: Path) -> None:
    """A point that was copied in a tool has the numbers of the first; measures refuse such files."""
    for image_id in IMAGES:
        path = dataset.root / f"labels/keypoints/{image_id:06d}.json"
        path.write_text(path.read_text().replace('"iid": 9', '"iid": 4'))
    export_mot(dataset, BOXES, followed(0, 0, 0), tmp_path / "out")
    rows = (tmp_path / "out/gt/S00003/gt/gt.txt").read_text().splitlines()
    assert [row.split(",")[:2] for row in rows] == [["1", "1"], ["2", "1"], ["2", "2"], ["3", "1"], ["3", "2"]]


@pytest.mark.parametrize("name", ["gt/S00003/gt/gt.txt", "gt/S00003/seqinfo.ini", "trackers/ours/data/S00003.txt"])
def test_files_of_another_tool_stay(dataset: PVDN, tmp_path: Path, name: str) -> None:
    write(tmp_path / "out" / name, "mine")
    with pytest.raises(ValueError, match=f"{name}: expected nothing there but an earlier export of this split"):
        export_mot(dataset, BOXES, followed(0, 0, 0), tmp_path / "out", "ours")
    assert [path.read_text() for path in (tmp_path / "out").rglob("*") if path.is_file()] == ['"mine"']


@pytest.mark.parametrize("name", ["gt/S00003/gt/gt.txt", "trackers/ours/data/S00003.txt"])
def test_files_that_were_edited_since_stay(dataset: PVDN, tmp_path: Path, name: str) -> None:
    """Another run may replace what this one exported, but nothing that somebody has changed."""
    out = tmp_path / "out"
    export_mot(dataset, BOXES, followed(0, 0, 0), out, "ours")
    export_mot(dataset, BOXES, followed(0, 0, 0), out, "theirs")
    export_mot(dataset, BOXES, followed(0, 1, 1), out, "ours")
    (out / name).write_text("99,1,1,1,1,1,1,1,1\n")
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(
        ValueError, match=f"{name}: expected the file that Foreglow wrote, got a changed one, which stays"
    ):
        export_mot(dataset, BOXES, followed(0, 0, 0), out, "ours")
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    (out / name).unlink()
    export_mot(dataset, BOXES, followed(0, 1, 1), out, "ours")
    assert "99," not in (out / name).read_text()


def test_an_export_goes_into_a_new_folder(dataset: PVDN, tmp_path: Path) -> None:
    write(tmp_path / "out" / "notes.txt", "mine")
    with pytest.raises(
        ValueError, match=r"out: expected a new folder, or one with earlier .*notes\.txt is of something"
    ):
        export_mot(dataset, BOXES, followed(0, 0, 0), tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("name", ["../other", "/other", "..", "", "a/b", "a\nb", "a\x1b[1m"])
def test_a_name_that_is_none_of_a_folder(dataset: PVDN, tmp_path: Path, name: str) -> None:
    with pytest.raises(
        ValueError, match=r"^name of the tracker: expected a printable one of a folder, without slashes, got '.*'$"
    ):
        export_mot(dataset, BOXES, followed(0, 0, 0), tmp_path / "out", name)
    assert not (tmp_path / "out").exists()


def test_an_image_that_the_run_lacks(dataset: PVDN, tmp_path: Path) -> None:
    """Not even the sequences before it are written."""
    lit = [{"pos": [50, 50], "oid": 1, "direct": False, "instances": [light(1, 20, 30)]}]
    write(dataset.root / "labels/keypoints/000005.json", {"image_id": 5, "annotations": lit})
    tracks = {image_id: its for image_id, its in followed(0, 0, 0).items() if image_id != 12}
    with pytest.raises(ValueError, match=r"tracks: expected all images of .*, got a run without image 12$"):
        export_mot(PVDN(dataset.root), BOXES, tracks, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_trackeval_of_known_tracks(dataset: PVDN, tmp_path: Path) -> None:
    """Five objects; the first light is followed in all three images."""
    pytest.importorskip("trackeval")
    export_mot(dataset, BOXES, followed(0, 0, 0), tmp_path, "whole")
    export_mot(dataset, BOXES, followed(0, 1, 1), tmp_path, "switched")
    whole, switched = score_mot(tmp_path, "whole"), score_mot(tmp_path, "switched")
    assert (whole.num_switches, switched.num_switches) == (0, 1)
    assert whole.mota == pytest.approx(3 / 5)
    assert switched.mota == pytest.approx((3 - 1) / 5)
    assert whole.idf1 == pytest.approx(2 * 3 / (5 + 3))
    assert switched.idf1 == pytest.approx(2 * 2 / (5 + 3))
    # Three of five are detected, exactly; each of them is associated in all of its light's three images.
    assert whole.det_a == pytest.approx(3 / 5)
    assert whole.ass_a == pytest.approx(1.0)
    assert whole.hota == pytest.approx((3 / 5) ** 0.5)
    assert switched.ass_a == pytest.approx((1 / 3 + 2 * 2 / 3) / 3)
    assert switched.det_a == whole.det_a


def test_false_tracks_where_no_light_is_count(dataset: PVDN, tmp_path: Path) -> None:
    """Two of them, in the sequence without light, beside three of five objects that are followed."""
    pytest.importorskip("trackeval")
    tracks = followed(0, 0, 0) | {5: tracks_of([[10, 10, 30, 30]]), 7: tracks_of([[10, 10, 30, 30]])}
    export_mot(dataset, BOXES, tracks, tmp_path)
    scores = score_mot(tmp_path)
    assert scores.mota == pytest.approx((3 - 2) / 5)
    assert scores.det_a == pytest.approx(3 / 7)
    assert scores.idf1 == pytest.approx(2 * 3 / (5 + 5))


def test_trackeval_without_files(tmp_path: Path) -> None:
    pytest.importorskip("trackeval")
    with pytest.raises(ValueError, match="expected the files of export-mot with a tracker foreglow, found none"):
        score_mot(tmp_path)
