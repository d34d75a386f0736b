"""What 3D views show of a frame."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Camera, Pose, rotation
from foreglow.runtime.scene import tracks_in_view
from foreglow.types import Tracks, TrackState


def test_a_light_on_the_axis_whose_error_is_unknown() -> None:
    """Infinity times 0 is a warning, on the screen of whoever records or looks."""
    camera = Camera(64, 48, (60.0, 60.0), (32.0, 24.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), rotation(0.1)))
    one = np.ones(1, np.int64)
    tracks = Tracks(
        ids=one,
        states=np.full(1, int(TrackState.CONFIRMED)),
        boxes_xyxy_px=np.array([[30.0, 22.0, 34.0, 26.0]]),
        confidences=np.full(1, 0.5),
        num_hits=one,
        num_misses=0 * one,
        ages_s=np.full(1, 0.5),
        ranges_m=np.full(1, 50.0),
        sigmas_m=np.full(1, np.inf),
        detections=0 * one,
    )
    (seen,) = tracks_in_view(camera, tracks)
    assert seen.reach_m is None
    np.testing.assert_allclose(seen.position_m, [1.9 + 50 * np.cos(0.1), 50 * np.sin(0.1), 1.3])
