"""The third stage: how far away the light in each box is.

All estimators work in the vehicle's frame (x forward, y left, z up, z = 0 is the road under the car) and give the range
from the camera along the viewing ray, to the lamp or to the surface that it lights.
"""

from __future__ import annotations

from foreglow.config import DistanceConfig
from foreglow.distance.ground_plane import GroundPlane
from foreglow.distance.interface import RangeEstimator
from foreglow.distance.psd import PSD2D, PSD3D, PSD3DPlus
from foreglow.distance.road_surface import RoadSurface
from foreglow.plugins import METHODS, make
from foreglow.types.arrays import check_kind

__all__ = [
    "ESTIMATORS",
    "PSD2D",
    "PSD3D",
    "GroundPlane",
    "PSD3DPlus",
    "RangeEstimator",
    "RoadSurface",
    "make_estimator",
]

ESTIMATORS: dict[str, type[RangeEstimator]] = {
    "gp": GroundPlane,
    "psd_3d": PSD3D,
    "psd_3d_plus": PSD3DPlus,
    "psd_2d": PSD2D,
    "road_surface": RoadSurface,
}
"""Our estimators by name."""


def make_estimator(config: DistanceConfig) -> RangeEstimator:
    """The estimator that `config.estimator` names: one of `ESTIMATORS`, or a plug-in.

    Raises:
        ValueError: If it names none, or one that cannot be imported or lacks a method.
    """
    check_kind("config", config, DistanceConfig)
    return make(
        "distance.estimator", config.estimator, ESTIMATORS, "foreglow.estimators", config, methods=METHODS["estimator"]
    )
