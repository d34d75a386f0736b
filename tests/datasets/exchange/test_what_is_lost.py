"""What an annotation tool says of a point and is not taken is counted."""

from __future__ import annotations

import json
from pathlib import Path

from foreglow.datasets.exchange import read_labels_file
from foreglow.datasets.exchange.marks import Kind


def test_what_only_points_of_other_kinds_have_is_counted(tmp_path: Path) -> None:
    """`rear` is of a light, and doubtful light is of no vehicle; `false` says nothing, nor does a track's number."""
    said = {"oid": 1, "iid": 7, "direct": True, "rear": True}
    usual = {"oid": 1, "direct": True, "rear": False}
    expected = {"'iid' of a vehicle": 1, "'rear' of a vehicle": 1, "'oid' of doubtful light": 1}
    points = [("vehicle", said), ("vehicle", usual | {"oid": 2}), ("light", said), ("doubtful", said)]
    shapes, annotations, regions = "", list[object](), list[object]()
    size = {"original_width": 96, "original_height": 72}
    for index, (label, given) in enumerate(points):
        inside = "".join(f"<attribute name='{key}'>{str(value).lower()}</attribute>" for key, value in given.items())
        shapes += f"<points label='{label}' points='1,2'>{inside}</points>"
        category = list(Kind).index(Kind(label)) + 1
        annotations.append({"image_id": 1, "category_id": category, "keypoints": [1, 2, 2], "attributes": given})
        part = {"id": f"r{index}", "type": "keypointlabels", "value": {"x": 1, "y": 2, "keypointlabels": [label]}}
        regions.append(size | part)
        for name in ("oid", "iid"):
            if name in given:
                value = {"number": given[name]}
                regions.append({"id": f"r{index}", "type": "number", "from_name": name, "value": value})
        choices = [name for name in ("direct", "rear") if given[name]]
        regions.append({"id": f"r{index}", "type": "choices", "from_name": "is", "value": {"choices": choices}})
    images = [{"id": 1, "file_name": "a.png", "width": 96, "height": 72}]
    categories = [{"id": index, "name": str(kind)} for index, kind in enumerate(Kind, start=1)]
    file = {"images": images, "categories": categories, "annotations": annotations}
    (tmp_path / "coco.json").write_text(json.dumps(file))
    task = {"data": {"image": "a.png"}, "annotations": [{"result": regions}]}
    (tmp_path / "tasks.json").write_text(json.dumps([task]))
    image = f"<image id='0' name='a.png' width='96' height='72'>{shapes}</image>"
    (tmp_path / "labels.xml").write_text(f"<annotations>{image}</annotations>")
    for name in ("coco.json", "tasks.json", "labels.xml"):
        assert read_labels_file(tmp_path / name).lost == expected, name
    shape = "<points frame='0' points='1,2'><attribute name='rear'>false</attribute></points>"
    track = f"<track id='7' label='vehicle'>{shape}</track>"
    (tmp_path / "labels.xml").write_text(f"<annotations>{track}</annotations>")
    assert not read_labels_file(tmp_path / "labels.xml").lost
