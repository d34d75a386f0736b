"""What is finished of the scenes of a split that is written, and not to be made again."""

from __future__ import annotations

import collections
import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from foreglow.datasets.images import is_whole_png
from foreglow.datasets.json_files import read_json
from foreglow.datasets.simulated.files import (
    MAX_FRAMES,
    RoadFile,
    finished_sequences,
    has_truth,
    read_sequence,
    sequence_folder,
    shares_path,
)
from foreglow.datasets.simulated.light_maps import light_map_path
from foreglow.datasets.simulated.shares import read_shares
from foreglow.lab.simulation.writing.scene_files import SceneFile


def kept_scenes(root: Path, files: list[SceneFile]) -> dict[int, SceneFile]:
    """The finished scenes of which nothing was lost, by number, as they are recorded there.

    Checks that the folder may be written to at all.
    """
    if not has_truth(root):
        for name in ("images", "labels"):
            if any(found.is_file() for found in (root / name).rglob("*")):
                raise ValueError(f"{root}: expected a new folder or a simulated split, this is another data set")
    finished: dict[int, SceneFile] = {}
    for sequence_id in finished_sequences(root):
        folder = sequence_folder(root, sequence_id)
        if sequence_id > len(files):
            raise ValueError(f"{folder}: expected at most the {len(files)} scenes of this run; choose another folder")
        if not (folder / "scene.json").is_file():
            raise FileNotFoundError(
                f"{folder / 'scene.json'}: no such file, and nothing else says whether this is a drive of the same "
                f"scene; choose another folder, or remove {folder} to make it anew"
            )
        try:
            wanted, there = files[sequence_id - 1], read_json(folder / "scene.json", SceneFile)
        except ValueError as error:
            raise ValueError(f"{error}; choose another folder, or remove {folder} to make it anew") from None
        field = _difference(_compared(wanted, there), _compared(there, wanted))
        if field is not None:
            raise ValueError(
                f"{folder / 'scene.json'}: {field}; choose another folder, or remove {folder} to make it anew"
            )
        finished[sequence_id] = there
    return {number: there for number, there in finished.items() if _is_whole(root, files[number - 1])}


def _compared(file: SceneFile, other: SceneFile) -> dict[str, Any]:
    """What of `file` has to be as in `other`, if both say it.

    Scenes were written with changes of a low beam that does not shine, and without digests of their lamps.
    """
    ego = file.scene.ego.with_beam(file.scene.ego.beam)
    known = {"scene": file.scene.model_copy(update={"ego": ego}), "lamps": file.lamps if other.lamps else {}}
    return file.model_copy(update=known).model_dump(mode="json")


def _is_whole(root: Path, file: SceneFile) -> bool:
    """Whether a finished sequence has lost no image and no file of its truth, nor a part of one."""
    folder, numbers = sequence_folder(root, file.sequence), range(file.scene.num_frames)
    image_ids = [file.sequence * MAX_FRAMES + number for number in numbers]
    images = [folder / "depth" / f"{number:06d}.png" for number in numbers]
    images += [root / "images" / folder.name / f"{image_id:06d}.png" for image_id in image_ids]
    if file.made_with.presets:
        images += [light_map_path(folder, image_id) for image_id in image_ids]
    return all(is_whole_png(path) for path in images) and _is_truth_whole(root, file)


def _is_truth_whole(root: Path, file: SceneFile) -> bool:
    folder = sequence_folder(root, file.sequence)
    try:
        truth = read_sequence(root, file.sequence)
        read_json(folder / "road.json", RoadFile)
        if file.made_with.presets:
            collections.deque(read_shares(shares_path(root, file.sequence)), maxlen=0)
    except (FileNotFoundError, ValueError):
        return False
    return len(truth.frames) == file.scene.num_frames


_NOTHING = object()
"""In place of a field or an entry that one of two records lacks."""


def _difference(wanted: Any, there: Any, field: str = "") -> str | None:
    """The first field in which two JSON values differ, as `field: expected ..., found ...`.

    >>> _difference({"a": {"b": [1, 2]}}, {"a": {"b": [1]}})
    'a.b.1: expected 2 as in this run, found nothing'
    """
    if wanted == there:
        return None
    pairs: Iterable[tuple[Any, Any, Any]] = ()
    if isinstance(wanted, dict) and isinstance(there, dict):
        pairs = ((key, wanted.get(key, _NOTHING), there.get(key, _NOTHING)) for key in {**wanted, **there})
    elif isinstance(wanted, list) and isinstance(there, list):
        longest = itertools.zip_longest(wanted, there, fillvalue=_NOTHING)
        pairs = ((index, *both) for index, both in enumerate(longest))
    for key, one, other in pairs:
        found = _difference(one, other, f"{field}.{key}".lstrip("."))
        if found is not None:
            return found
    texts = ["nothing" if value is _NOTHING else repr(value) for value in (wanted, there)]
    alike = itertools.takewhile(lambda both: both[0] == both[1], zip(*texts, strict=False))
    num_alike = sum(1 for _ in alike)
    expected, found = (_short(text, num_alike) for text in texts)
    return f"{field}: expected {expected} as in this run, found {found}"


def _short(text: str, num_alike: int) -> str:
    """At most 60 characters of a text, with those that follow the `num_alike` which another one begins with, too.

    >>> _short("a" * 100 + "b", 100)[-8:]
    'aaaaaaab'
    """
    begin = 0 if len(text) <= 60 else max(0, min(num_alike - 20, len(text) - 54))
    text = text if begin == 0 else f"...{text[begin:]}"
    return text if len(text) <= 60 else text[:57] + "..."
