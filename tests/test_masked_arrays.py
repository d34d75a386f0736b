"""Arrays in which something is masked are refused: the mask would be ignored."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import foreglow
from foreglow.types import Frame, Proposals, RoadAhead
from tests.test_types import BOXES


def test_a_masked_image_becomes_a_plain_one_if_nothing_is_masked() -> None:
    image = np.arange(15, dtype=np.uint8).reshape(3, 5)
    frame = Frame(np.ma.masked_array(image), 0)
    assert type(frame.image) is np.ndarray
    np.testing.assert_array_equal(frame.image, image)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Frame(np.ma.masked_greater(np.arange(15, dtype=np.uint8).reshape(3, 5), 7), 0),
        lambda: foreglow.to_grey(np.ma.masked_greater(np.arange(15, dtype=np.uint8).reshape(3, 5), 7)),
        lambda: Proposals(np.ma.masked_greater(BOXES, 7)),
        lambda: RoadAhead(np.ma.masked_greater(np.eye(3), 0), 4.0),
    ],
)
def test_masked_values_are_refused(make: Callable[[], object]) -> None:
    """The mask was ignored."""
    with pytest.raises(ValueError, match=r"expected (no masked values, got \d+: fill them first|numbers, got)"):
        make()
