"""Writes one sequence of a simulated data set: images, truth, depth, and whose light it is where that is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from foreglow.datasets.images import png
from foreglow.datasets.simulated.files import MAX_FRAMES, TruthWriter, sequence_name
from foreglow.datasets.simulated.light_maps import encoded, light_map_path
from foreglow.datasets.simulated.shares import SHARES_FILE, BoxShares, write_shares
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.lidar import lidar_depth
from foreglow.lab.simulation.writing.scene_files import SceneFile, road_file
from foreglow.lab.simulation.writing.street_data import STREET_STREAM, StreetMap
from foreglow.whole_files import write_atomic

LIDAR_STREAM = 902
"""Random stream of a scene's scanner, `np.random.default_rng([scene.seed, LIDAR_STREAM])`."""

MAX_JITTER_NS = 1_000_000
"""Largest difference of a frame's time from its number over the frame rate, which is the time that readers will see."""


class Recorder:
    """Writes one sequence, frame by frame, into a folder."""

    def __init__(self, folder: Path, file: SceneFile) -> None:
        """Begins the sequence that `file` describes; `folder/images` must exist."""
        scene = file.scene
        self._folder, self._file = folder, file
        self._name = sequence_name(file.sequence)
        self._street = StreetMap(
            Road(scene.road), file.made_with.street, np.random.default_rng([scene.seed, STREET_STREAM])
        )
        self._lidar_rng = np.random.default_rng([scene.seed, LIDAR_STREAM])
        self._writer = TruthWriter(folder)
        self._shares: list[tuple[int, BoxShares]] = []
        self._start_ns, self._num_done = 0, 0

    def add(self, known: DriveFrame) -> None:
        """Writes the next frame.

        Raises:
            ValueError: If it contradicts the scene or the frames before it.
            OSError: If it cannot be written.
        """
        file, number = self._file, self._num_done
        if number == 0:
            self._start_ns = known.timestamp_ns
        _check_frame(known, number, file.scene, self._start_ns, self._name)
        image_id = file.sequence * MAX_FRAMES + number
        write_atomic(self._folder / "images" / f"{image_id:06d}.png", png(known.frame.image))
        depth = lidar_depth(known.depth_m, known.camera, self._lidar_rng, file.made_with.lidar)
        numbered = replace(known, image_id=image_id, street=self._street.message(known.ego_s_m))
        self._writer.add(numbered, known.camera, depth)
        self._shares += [(image_id, found) for found in known.shares]
        if known.light_cd_m2 is not None:
            path = light_map_path(self._folder, image_id)
            path.parent.mkdir(exist_ok=True)
            write_atomic(path, png(encoded(known.light_cd_m2)))
        self._num_done += 1

    def close(self) -> None:
        """Completes the sequence.

        Raises:
            ValueError: If there were fewer frames than the scene has.
            OSError: If a file cannot be written.
        """
        file = self._file
        if self._num_done != file.scene.num_frames:
            raise ValueError(f"{self._name}: drive: expected {file.scene.num_frames} frames, got {self._num_done}")
        if file.made_with.presets:
            write_shares(self._folder / SHARES_FILE, self._shares)
        self._writer.close(file.model_dump_json(indent=1), road_file(file.scene))


def _check_frame(known: DriveFrame, number: int, scene: Scene, start_ns: int, name: str) -> None:
    """Refuses a frame that would make the files contradict each other."""
    where = f"{name}: drive: frame {number}"
    if number >= scene.num_frames:
        raise ValueError(f"{where}: expected {scene.num_frames} frames, got more")
    expected_ns = start_ns + round(1e9 * scene.time_s(number))
    if abs(known.timestamp_ns - expected_ns) > MAX_JITTER_NS:
        raise ValueError(f"{where}: timestamp_ns: expected about {expected_ns}, got {known.timestamp_ns}")
    size_px, image_px = (known.camera.width_px, known.camera.height_px), (known.frame.width_px, known.frame.height_px)
    if image_px != size_px:
        raise ValueError(f"{where}: image: expected the camera's {size_px} px, got {image_px} px")
