"""Since when the beam was dark where a vehicle came into sight."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from foreglow.datasets import PVDN
from foreglow.geometry import Floats
from foreglow.lab.studies.demo.story import Story


def gap_opened_s(dataset: PVDN, story: Story, gaps_rad: Mapping[int, Floats]) -> float:
    """When the dark gap opened in which the vehicle of `story` came into sight, from the sequence's first image.

    A gap may move: one that overlaps a gap of the image before is the same one. So it may also have opened for
    something else, and before the vehicle's first light.

    Args:
        dataset: Images with calibration.
        story: Of one of its sequences.
        gaps_rad: By image id, shape (G, 2), right and left borders of a run's gaps, as in `BeamCommand`.

    Returns:
        NaN if there was no gap, it never came into sight, or there is no calibration.
    """
    if story.sight is None:
        return math.nan
    sight_id = story.sight.light.image_id
    camera = dataset.read(sight_id).camera
    if camera is None:
        return math.nan
    ray = camera.vehicle_from_camera.rotation @ camera.rays(np.array([story.sight.light.position_px]))[0]
    right = left = math.atan2(ray[1], ray[0])
    opened_s = math.nan
    image_ids = [one for one in sorted(dataset.sequence(sight_id).image_ids) if one <= sight_id]
    for image_id in reversed(image_ids):
        its = [gap for gap in gaps_rad.get(image_id, np.zeros((0, 2))).tolist() if gap[0] <= left and right <= gap[1]]
        if not its:
            break
        right, left = min(gap[0] for gap in its), max(gap[1] for gap in its)
        opened_s = dataset.time_s(image_id)
    return opened_s
