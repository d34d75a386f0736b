"""A PVDN split of two sequences and five images, made without the project's own writer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

SIZE_PX = (72, 96)  # height, width
IDS = {"S00003": [11, 13, 12], "S00001": [7, 5]}

VEHICLES: dict[int, list[dict[str, Any]]] = {
    11: [
        {
            "pos": [40, 30],
            "oid": 2,
            "direct": True,
            "instances": [
                {"pos": [38, 31], "iid": 0, "direct": True, "rear": False},
                {"pos": [44, 31], "iid": 1, "direct": True, "confidence": 0.25},
                {"pos": [20, 50], "iid": 2, "rear": True},
            ],
            "note": "extra",
        }
    ],
    12: [{"pos": [41, 30], "oid": 2, "instances": []}],
}


def tiny_image(image_id: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng(image_id).integers(0, 256, SIZE_PX, dtype=np.uint8)


def sequence(number: int, name: str, ids: list[int], **fields: Any) -> dict[str, Any]:
    return {
        "id": number,
        "dir": name,
        "start_time": 1500 * number,
        "end_time": 1500 * number + 111,
        "num_images": len(ids),
        "image_ids": ids,
        "proband_id": 4,
        "sector": 2,
        "direction": 5,
        "street_style": 6,
        "dome": False,
        "proband_behaviour": 1,
        "road_type": 1,
        "view": 1,
        "weather": 2,
        "environment_lighting": 2,
        **fields,
    }


def documents() -> tuple[dict[str, Any], dict[str, Any]]:
    """sequences.json and image_annotations.json."""
    ids = [13, 5, 11, 12, 7]
    images = [
        {
            "id": image_id,
            "file_name": f"{image_id:06d}.png",
            "height": SIZE_PX[0],
            "width": SIZE_PX[1],
            "date_captured": "2020/03/11",
            "timestamp": 1583,
            "licence": 0,
            "camera_configuration": 0,
            "gain": [1, {"db": 2.5}],
        }
        for image_id in ids
    ]
    annotations = [
        {"id": 90, "category": 1, "image_id": 12},
        {"id": 91, "category": 6, "image_id": 13, "certain": True, "by": None},
        {"id": 92, "category": 2, "image_id": 13},
    ]
    return (
        {
            "sequences": [
                sequence(3, "S00003", IDS["S00003"]),
                sequence(1, "S00001", IDS["S00001"], weather=0, dome=True),
            ]
        },
        {
            "info": {"description": "tiny", "year": 2020, "more": [1]},
            "licences": [{"id": 0, "name": "none"}],
            "camera_configurations": [{"camera": "Cam01", "cycle": "day"}],
            "categories": [{"supercategory": "image", "id": 1, "name": "first"}],
            "images": images,
            "annotations": annotations,
        },
    )


def labelled_vehicle(oid: int, *instances: tuple[int, int, bool], is_rear: bool = False) -> dict[str, Any]:
    """A vehicle of a keypoint file: column, row and whether it is direct of each of its lights."""
    listed = [
        {"pos": [x, y], "iid": number, "direct": is_direct, "rear": is_rear}
        for number, (x, y, is_direct) in enumerate(instances)
    ]
    return {"pos": [50, 50], "oid": oid, "direct": False, "instances": listed}


def make_pvdn(folder: Path, cycle: str = "night") -> Path:
    """The split's folder, `folder/cycle/val`."""
    root = folder / cycle / "val"
    sequences, images = documents()
    write(root / "labels/sequences.json", sequences)
    write(root / "labels/image_annotations.json", images)
    for name, ids in IDS.items():
        (root / "images" / name).mkdir(parents=True)
        for image_id in ids:
            assert cv2.imwrite(str(root / "images" / name / f"{image_id:06d}.png"), tiny_image(image_id))
            keypoints = {"image_id": image_id, "annotations": VEHICLES.get(image_id, [])}
            write(root / f"labels/keypoints/{image_id:06d}.json", keypoints)
    write(
        root / "labels/bounding_boxes/000011.json",
        {"bounding_boxes": [[36, 29, 46, 33], [60, 60, 70, 64]], "labels": [1.0, 0.0]},
    )
    return root


def write(path: Path, value: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))


def edit(path: Path, *keys: str | int, value: Any) -> None:
    """Sets one value in a JSON file; `value` may be a function of the old one."""
    document = json.loads(path.read_text())
    target = document
    for key in keys[:-1]:
        target = target[key]
    target[keys[-1]] = value(target[keys[-1]]) if callable(value) else value
    path.write_text(json.dumps(document))
