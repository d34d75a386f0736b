"""Tracks and labelled lights as MOTChallenge files, and HOTA, IDF1 and CLEAR of them by TrackEval.

    DIR/gt/S00001/gt/gt.txt           the labelled lights: frame, id, x, y, width, height, 1, 1, 1
    DIR/gt/S00001/seqinfo.ini         name, length, rate and size of the sequence, and its images' ending, or that of
                                      most, since the format has one
    DIR/checksums.json                by which files that were changed since are known
    DIR/trackers/NAME/data/S00001.txt the plausible tracks: frame, id, x, y, width, height, confidence, -1, -1, -1

Frames, ids and places count from 1, as the format has them: the upper left pixel's edges are at 1, 1, not at 0, 0 as
elsewhere here.

Labels are points, and these measures want boxes. As in the paper's own annotations the box of a light is a proposal
that contains its key point: here the smallest one. Lights in the same box are one object, with the number of the one
that came first; a light that no proposal contains gets a square around it. Of lights with the same numbers in one image
each is an object. A track in an image whose box holds no light but a doubtful one is left out, since nobody is to be
blamed for it.
"""

from __future__ import annotations

import configparser
import contextlib
import io
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.checksums import CHECKSUMS, announce, check_unchanged, checksums_file
from foreglow.datasets import LabelledSource, Sequence
from foreglow.lab.evaluation.boxes.matching import lies_in, smallest_box
from foreglow.own_folders import check_new
from foreglow.runs.predictions import Predictions
from foreglow.types import Tracks
from foreglow.whole_files import make_folder, together, write_atomic

FIRST_PX = 1.0
"""Of the first column and row. Source: motchallenge.net, instructions: "all frame numbers, target IDs and bounding
boxes are 1-based"; readers such as py-motmetrics subtract it."""

FALLBACK_SIDE_PX = 16.0
"""Side of the square around a light that no proposal contains, full-frame pixels."""

INFO_NAME = "seqinfo.ini"
"""What tells about a sequence; the same split gives the same."""

_Boxes: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MotScores:
    """What TrackEval makes of the tracks of all sequences together.

    Attributes:
        hota: Higher order tracking accuracy, mean over the overlaps .05 to .95.
        idf1: F of identities, at an overlap of .5.
        mota: CLEAR's accuracy, at an overlap of .5.
        num_switches: How often an object's track changes.
        num_fragments: How often an object's track is interrupted.
    """

    hota: float
    det_a: float
    ass_a: float
    idf1: float
    mota: float
    num_switches: int
    num_fragments: int


def export_mot(
    dataset: LabelledSource,
    proposals: Predictions,
    tracks: Mapping[int, Tracks],
    folder: Path,
    name: str = "foreglow",
    *,
    origin: str = "tracks",
) -> None:
    """Writes the lights and the tracks of `dataset` into `folder`, as the module says.

    A sequence without light has an empty `gt.txt`: every track there is a false one. Nothing is written unless all of
    it can be used and written. `origin` names the run in messages.

    Raises:
        FileNotFoundError: If a label file is missing.
        ValueError: If a label file is broken, the run lacks an image, no sequence has a light, `name` is a path or
            unprintable, or a file is there that is not of an earlier export: of this split, or of others in the same
            folder. Or if a file that would be replaced was changed since.
        OSError: If a file cannot be written.
    """
    if not name or name != Path(name).name or name == ".." or not name.isprintable():
        raise ValueError(f"name of the tracker: expected a printable one of a folder, without slashes, got {name!r}")
    files: dict[Path, str] = {}
    num_lights = 0
    for sequence in dataset.sequences:
        image_ids = sorted(sequence.image_ids)
        for image_id in image_ids:
            if image_id not in tracks or image_id not in proposals.boxes_xyxy_px:
                raise ValueError(f"{origin}: expected all images of {dataset.root}, got a run without image {image_id}")
        lights = list(_light_rows(dataset, image_ids, proposals))
        num_lights += len(lights)
        truth = folder / "gt" / sequence.directory
        files[truth / "gt" / "gt.txt"] = "".join(lights)
        files[truth / INFO_NAME] = _sequence_info(dataset, sequence)
        rows = "".join(_track_rows(dataset, image_ids, tracks))
        files[folder / "trackers" / name / "data" / f"{sequence.directory}.txt"] = rows
    if not num_lights:
        raise ValueError(f"{dataset.root}: expected a sequence with a labelled light, found none")
    _check_own(files)
    if not any(folder.glob(f"gt/*/{INFO_NAME}")):
        check_new(str(folder), folder)
    checksums = {path.relative_to(folder).as_posix(): zlib.crc32(text.encode()) for path, text in files.items()}
    check_unchanged(folder, checksums)
    record = checksums_file(checksums, folder)
    announce(folder, checksums)
    with together():
        for path, text in files.items():  # once all is known to be sound
            make_folder(path.parent)
            write_atomic(path, text.encode())
        write_atomic(folder / CHECKSUMS, record)


def _check_own(files: Mapping[Path, str]) -> None:
    """ValueError if a file is there, and not what an earlier export has written beside it: the same `seqinfo.ini`."""
    infos = [path for path in files if path.name == INFO_NAME and path.is_file()]
    is_own = infos and all(path.read_bytes() == files[path].encode() for path in infos)
    for path in files:
        if path.exists() and not is_own:
            raise ValueError(f"{path}: expected nothing there but an earlier export of this split")


def score_mot(folder: Path, name: str = "foreglow") -> MotScores:
    """The measures of the tracker `name` in the folder that `export_mot` wrote, by TrackEval.

    Raises:
        ModuleNotFoundError: If TrackEval is not installed.
        ValueError: If the folder has no such tracker.

    Source: Luiten et al., HOTA, IJCV 2021; Ristani et al., 2016; Bernardin and Stiefelhagen, 2008.
    """
    import trackeval

    lengths = {}
    for path in sorted((folder / "gt").glob("*/seqinfo.ini")):
        info = configparser.ConfigParser()
        info.read_string(path.read_text(encoding="utf-8"))
        lengths[path.parent.name] = info.getint("Sequence", "seqLength")
    if not lengths or not (folder / "trackers" / name / "data").is_dir():
        raise ValueError(f"{folder}: expected the files of export-mot with a tracker {name}, found none")
    settings = {
        "GT_FOLDER": str(folder / "gt"),
        "TRACKERS_FOLDER": str(folder / "trackers"),
        "TRACKERS_TO_EVAL": [name],
        "SEQ_INFO": lengths,
        "SKIP_SPLIT_FOL": True,
        "DO_PREPROC": False,
        "PRINT_CONFIG": False,
    }
    quiet = dict.fromkeys(
        ("PRINT_RESULTS", "PRINT_CONFIG", "TIME_PROGRESS", "OUTPUT_SUMMARY", "OUTPUT_DETAILED"), False
    )
    evaluator = trackeval.Evaluator(quiet | {"PLOT_CURVES": False, "RETURN_ON_ERROR": False, "LOG_ON_ERROR": None})
    metrics = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR({"PRINT_CONFIG": False})]
    metrics.append(trackeval.metrics.Identity({"PRINT_CONFIG": False}))
    with contextlib.redirect_stdout(io.StringIO()):
        results, _ = evaluator.evaluate([trackeval.datasets.MotChallenge2DBox(settings)], metrics)
    found = results["MotChallenge2DBox"][name]["COMBINED_SEQ"]["pedestrian"]  # the name that the format has for class 1
    return MotScores(
        hota=float(np.mean(found["HOTA"]["HOTA"])),
        det_a=float(np.mean(found["HOTA"]["DetA"])),
        ass_a=float(np.mean(found["HOTA"]["AssA"])),
        idf1=float(found["Identity"]["IDF1"]),
        mota=float(found["CLEAR"]["MOTA"]),
        num_switches=int(found["CLEAR"]["IDSW"]),
        num_fragments=int(found["CLEAR"]["Frag"]),
    )


def _light_rows(dataset: LabelledSource, image_ids: Iterable[int], proposals: Predictions) -> Iterable[str]:
    numbers: dict[tuple[int, int, int], int] = {}
    for frame, image_id in enumerate(image_ids, start=1):
        objects: dict[tuple[float, ...], int] = {}
        seen: Counter[tuple[int, int]] = Counter()
        for vehicle in dataset.annotations(image_id):
            for light in vehicle.instances:
                named = vehicle.oid, light.iid
                number = numbers.setdefault((*named, seen[named]), len(numbers) + 1)
                seen[named] += 1
                box = _box_around(np.array(light.position_px, np.float64), proposals.boxes_xyxy_px[image_id])
                objects[box] = min(number, objects.get(box, number))
        for box, number in objects.items():
            yield f"{frame},{number},{_extent(box)},1,1,1\n"


def _track_rows(dataset: LabelledSource, image_ids: Iterable[int], tracks: Mapping[int, Tracks]) -> Iterable[str]:
    for frame, image_id in enumerate(image_ids, start=1):
        found = tracks[image_id]
        boxes = found.boxes_xyxy_px
        is_doubtful = _holds(boxes, [light.position_px for light in dataset.doubtful(image_id)])
        is_doubtful &= ~_holds(boxes, dataset.keypoints_px(image_id))
        for row in np.flatnonzero(found.is_plausible & ~is_doubtful):
            yield f"{frame},{found.ids[row] + 1},{_extent(boxes[row])},{found.confidences[row]:.4f},-1,-1,-1\n"


def _box_around(point_px: _Boxes, boxes: _Boxes) -> tuple[float, ...]:
    """The smallest box that contains the point; a square around it where there is none."""
    index = smallest_box(point_px, boxes)
    if index is not None:
        return tuple(boxes[index].tolist())
    half = FALLBACK_SIDE_PX / 2
    return tuple(np.concatenate([point_px - half, point_px + half]).tolist())


def _holds(boxes: _Boxes, points_px: NDArray[np.int32] | list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Which boxes contain at least one of the points."""
    points = np.array(points_px, np.float64).reshape(1, -1, 2)
    return np.asarray(lies_in(points, boxes[:, None]).any(axis=1))


def _extent(box: Iterable[float]) -> str:
    x1, y1, x2, y2 = box
    return f"{x1 + FIRST_PX:.3f},{y1 + FIRST_PX:.3f},{x2 - x1:.3f},{y2 - y1:.3f}"


def _sequence_info(dataset: LabelledSource, sequence: Sequence) -> str:
    image = dataset.image(min(sequence.image_ids))
    endings = Counter(Path(dataset.image(image_id).file_name).suffix for image_id in sorted(sequence.image_ids))
    ending = endings.most_common(1)[0][0]  # the format has one; tools look for all images of a sequence by it
    return (
        f"[Sequence]\nname={sequence.directory}\nimDir=images\nframeRate={dataset.mean_rate_hz:g}\n"
        f"seqLength={len(sequence.image_ids)}\nimWidth={image.width_px}\nimHeight={image.height_px}\nimExt={ending}\n"
    )
