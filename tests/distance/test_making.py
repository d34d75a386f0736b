from __future__ import annotations

import pytest

from foreglow.config import DistanceConfig
from foreglow.distance import ESTIMATORS, make_estimator
from foreglow.distance.pitch import make_pitch_source


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"distance.estimator: expected one of gp, psd_3d, .*, got 'none'"):
        make_estimator(DistanceConfig(estimator="none"))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_names_make_their_class(name: str) -> None:
    config = DistanceConfig.model_validate({"estimator": name})
    assert type(make_estimator(config)) is ESTIMATORS[name]


def test_an_unknown_source_of_the_pitch() -> None:
    with pytest.raises(ValueError, match=r"distance.pitch: expected one of fixed, motion.*, got 'gyro'"):
        make_pitch_source("gyro")
