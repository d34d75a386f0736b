from __future__ import annotations

import numpy as np
import pytest

from foreglow.maps import GeographicOrigin


def test_lengths_of_a_hundredth_of_a_degree() -> None:
    """Tables of WGS 84 have 111.132 km and 78.847 km a degree at latitude 45."""
    east, north = GeographicOrigin(45.0, 9.0).local([45.005, 45.0], [9.0, 9.01])
    assert east.tolist() == pytest.approx([0.0, 555.66], abs=0.01)
    assert north.tolist() == pytest.approx([788.47, 0.05], abs=0.02)  # the parallel bends to the north


def test_distances_stay_within_the_stated_error() -> None:
    """Between neighbours 10 km away, as an origin beside them has it."""
    places = np.array([[48.09, 9.0], [48.09, 9.001], [48.0902, 9.001]])
    far = GeographicOrigin(48.0, 9.0).local(*places.T)
    near = GeographicOrigin(48.09, 9.0).local(*places.T)
    lengths = [np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (far, near)]
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=1.3e-6)


def test_headings_turn_with_the_meridians() -> None:
    origin = GeographicOrigin(48.0, 9.0)
    assert origin.yaw_rad(48.0, 9.0, 90.0) == pytest.approx(0.0)
    assert origin.yaw_rad(48.0, 9.0, 0.0) == pytest.approx(np.pi / 2)
    # The way between two places at the same longitude, 10 km to the east, is the north there.
    step = np.diff(origin.local([48.0, 48.001], [9.13, 9.13]), axis=0)[0]
    assert origin.yaw_rad(48.0, 9.13, 0.0) == pytest.approx(np.arctan2(step[1], step[0]), abs=1e-6)
    assert origin.yaw_rad(48.0, 9.13, 0.0) > np.pi / 2 + 1e-3
