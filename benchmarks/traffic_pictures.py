"""The pictures of docs/scenes.md: `python -m benchmarks.traffic_pictures FOLDER`.

`scene_NAME.jpg` shows a frame of a scenario with traffic, in the long exposure and brightened for the eye.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from foreglow.lab.simulation import adapted, drive_frames, scenario
from foreglow.whole_files import write_atomic

PICTURES = {
    "motorway": ("motorway", 6, 5.0),
    "lit_motorway": ("motorway", 7, 5.0),
    "queue": ("queue", 7, 5.0),
    "lorry": ("queue", 6, 5.2),
    "following": ("following", 7, 5.0),
    "cyclists": ("cyclists", 5, 5.0),
    "town": ("town", 2, 4.0),
    "left_town": ("left_town", 1, 4.0),
}
"""Scenario, seed, and time in s."""

RENDERED_PX, SHOWN_PX = (1280, 960), (640, 480)
GAIN, BLACK_GREY = 1.7, 6.0


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for picture, (name, seed, time_s) in PICTURES.items():
        scene = scenario(name, seed).model_copy(update={"duration_s": 2.0 * time_s})
        _, shown = drive_frames(adapted(scene, RENDERED_PX, 1.0 / time_s, "night"))
        brightened = np.clip(GAIN * (shown.frame.image.astype(np.float64) - BLACK_GREY), 0, 255).astype(np.uint8)
        small = cv2.resize(brightened, SHOWN_PX, interpolation=cv2.INTER_AREA)
        jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
        write_atomic(folder / f"scene_{picture}.jpg", jpeg.tobytes())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
