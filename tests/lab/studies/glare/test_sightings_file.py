"""What was expected of hidden vehicles is kept beside each drive, and is not believed if it has changed."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from foreglow.lab.evaluation.occurrence import Sighting
from foreglow.lab.studies.glare.run import keep_sightings, kept_sightings

SIGHTING = Sighting(1, 1.0, 0.1, math.nan, 2.25, is_covered=True)


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "S00001.json"
    keep_sightings(path, [SIGHTING])
    (sighting,) = kept_sightings(path)
    assert (sighting.lead_s, sighting.error_deg, sighting.is_covered) == (1.0, 0.1, True)
    assert math.isnan(sighting.error_s)


@pytest.mark.parametrize(
    "changed",
    [
        lambda kept: kept["sightings"],
        lambda kept: kept | {"sightings": [kept["sightings"][0] | {"lead_s": 1.5}]},
        lambda kept: kept | {"sightings": [{"lead": 1.0}]},
        lambda kept: kept | {"sightings": None},
        lambda kept: {"sightings": kept["sightings"]},
        lambda _: None,
    ],
)
def test_damage_is_told(tmp_path: Path, changed: Any) -> None:
    path = tmp_path / "S00001.json"
    keep_sightings(path, [SIGHTING])
    path.write_text(json.dumps(changed(json.loads(path.read_text()))))
    with pytest.raises(ValueError, match=r"S00001\.json: expected a drive's whole file, found it damaged"):
        list(kept_sightings(path))
