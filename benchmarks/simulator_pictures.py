"""The pictures of docs/simulator.md: `python -m benchmarks.simulator_pictures FOLDER`.

`scenarios.jpg` shows one frame of every scenario, in the short exposure above and in the long one below, each
brightened for the eye; `light.jpg` takes one frame apart: the image, the same without the hidden car, what its light
adds, the labels. `cameras.jpg`, the picture of docs/cameras.md, shows one moment in all camera profiles, as they are.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.tone import Tone
from foreglow.lab.simulation import SCENARIOS, DriveFrame, Scene, adapted, drive_exposures, drive_frames, scenario
from foreglow.lab.simulation.camera.profile import PROFILES, read_profile
from foreglow.lab.simulation.preview import labelled
from foreglow.whole_files import write_atomic

SEED = 0
SIZE_PX = (1280, 960)
TILE_PX = (480, 360)
TIMES_S = {"day": 3.3, "night": 3.3}
GAINS = {"day": 3.5, "night": 1.7}
BLACK_GREY = 6.0
CAMERAS_SCENE = ("village", 0)
CAMERAS_HZ, CAMERAS_TIME_S = 0.5, 6.0
Picture = NDArray[np.uint8]


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for names in (list(SCENARIOS)[:4], list(SCENARIOS)[4:8]):
        rows += [np.hstack([_tile(scenario(name, SEED), cycle, name) for name in names]) for cycle in TIMES_S]
    _write(folder / "scenarios.jpg", np.vstack(rows))
    _write(folder / "light.jpg", _taken_apart(scenario("curve", SEED)))
    _write(folder / "cameras.jpg", _in_all_cameras())


def _tile(scene: Scene, cycle: str, name: str) -> Picture:
    image = _frame(scene, cycle, TIMES_S[cycle]).frame.image
    picture = np.repeat(_brightened(image, GAINS[cycle])[:, :, None], 3, axis=2)
    small = np.asarray(cv2.resize(picture, TILE_PX, interpolation=cv2.INTER_AREA), np.uint8)
    exposure = "short" if cycle == "day" else "long"
    cv2.putText(small, f"{name}, {exposure} exposure", (10, 24), 0, 0.55, (235, 235, 235), 1, cv2.LINE_AA)
    return small


def _in_all_cameras() -> Picture:
    """A moment with a car near by and street lamps, in every profile."""
    profiles = [read_profile(name) for name in PROFILES]
    scene = adapted(scenario(*CAMERAS_SCENE), SIZE_PX, CAMERAS_HZ, "night")
    moments = drive_exposures(scene, profiles)
    frames = next(itertools.islice(moments, round(CAMERAS_TIME_S * CAMERAS_HZ), None))
    tiles = []
    for profile, known in zip(profiles, frames, strict=True):
        image = known.frame.image
        height = TILE_PX[0] * image.shape[0] // image.shape[1]
        tile = np.full((TILE_PX[1], TILE_PX[0]), 60, np.uint8)
        tile[:height] = cv2.resize(image, (TILE_PX[0], height), interpolation=cv2.INTER_AREA)
        cv2.putText(tile, profile.name, (10, TILE_PX[1] - 12), 0, 0.6, 235, 1, cv2.LINE_AA)
        tiles.append(tile)
    tiles += [np.full_like(tiles[0], 60)] * (-len(tiles) % 4)
    return np.vstack([np.hstack(tiles[first : first + 4]) for first in range(0, len(tiles), 4)])


def _taken_apart(scene: Scene) -> Picture:
    """The first frame in which light is seen of a car that is not, with and without that light."""
    alone = scene.model_copy(update={"vehicles": ()})
    shown = next(known for known in drive_frames(adapted(scene, SIZE_PX, 18.0, "day")) if _is_hidden(known))
    time_s = shown.frame.timestamp_ns / 1e9
    empty = _frame(alone, "day", time_s).frame.image
    added = np.clip(5.0 * (shown.frame.image.astype(float) - empty), 0, 255).astype(np.uint8)
    tiles = {
        "the image": _brightened(shown.frame.image, GAINS["day"]),
        "the same drive without the car": _brightened(empty, GAINS["day"]),
        "what the car's light adds, 5 times": added,
        "the labels": labelled(shown, Tone(_brightened(np.arange(256), GAINS["day"]))),
    }
    pictures = []
    for name, tile in tiles.items():
        colour = np.repeat(tile[:, :, None], 3, axis=2) if tile.ndim == 2 else tile
        small = np.asarray(cv2.resize(colour, (720, 540), interpolation=cv2.INTER_AREA), np.uint8)
        cv2.putText(small, name, (10, 530), 0, 0.6, (235, 235, 235), 1, cv2.LINE_AA)
        pictures.append(small)
    return np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])])


def _brightened(grey: NDArray[np.integer], gain: float) -> Picture:
    return np.clip(gain * (grey.astype(np.float64) - BLACK_GREY), 0, 255).astype(np.uint8)


def _is_hidden(known: DriveFrame) -> bool:
    marks = [artifact for vehicle in known.vehicles for artifact in vehicle.artifacts if not artifact.is_doubtful]
    return len(marks) > 0 and not any(artifact.is_direct for artifact in marks) and known.frame.timestamp_ns > 1e9


def _frame(scene: Scene, cycle: str, time_s: float) -> DriveFrame:
    """The frame at `time_s`: the second of a drive with so few frames a second."""
    frames = drive_frames(adapted(scene, SIZE_PX, 1.0 / time_s, cycle))
    next(frames)
    return next(frames)


def _write(path: Path, picture: Picture) -> None:
    write_atomic(path, cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
