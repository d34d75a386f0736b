"""Pictures of a simulated drive with its labels drawn: a contact sheet and a video."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from foreglow.datasets.simulated import Artifact, VehicleTruth
from foreglow.display.overlay import Colour, Picture
from foreglow.display.tone import Tone
from foreglow.display.video import Movie
from foreglow.files import read_toml
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.scenes.scene_file import scene_to_toml
from foreglow.lab.simulation.writing.dataset import Progress
from foreglow.own_folders import check_made_together, check_new
from foreglow.whole_files import atomic_path, together, write_atomic

KIND_BGR: dict[str, Colour] = {
    "lamp": (90, 235, 120),
    "rail": (60, 170, 255),
    "road": (255, 190, 70),
    "verge": (120, 200, 200),
    "foliage": (80, 220, 180),
    "wall": (220, 130, 220),
    "sign": (110, 110, 255),
    "vehicle": (200, 200, 120),
    "haze": (210, 210, 210),
}
"""Colour of an artifact's mark, by the kind of light; other kinds have that of the text."""

BOX_BGR = (150, 140, 130)
TEXT_BGR = (225, 225, 225)
NUM_COLUMNS, NUM_ROWS = 4, 4
TILE_PX = (480, 360)

_FONT = cv2.FONT_HERSHEY_SIMPLEX


def preview(
    frames: Iterable[DriveFrame], scene: Scene, folder: Path, progress: Progress | None = None
) -> tuple[Path, Path]:
    """Writes `contact_sheet.png` and `drive.mp4` to `folder`, which exists, and returns their paths.

    Beside them is `preview.toml`, the scene: a preview is known by it.

    Args:
        frames: The drive; the sheet shows some, evenly spread.
        scene: Its scene.
        folder: Folder of the files.
        progress: Called after every frame, as for data sets.

    Raises:
        ValueError: If one of the files is there without the others, `preview.toml` is no scene, or other files are
            there without it: they are of something else.
        OSError: If a file cannot be written.
    """
    sheet, film, mark = folder / "contact_sheet.png", folder / "drive.mp4", folder / "preview.toml"
    check_made_together((sheet, film, mark))
    if not mark.exists():
        check_new(str(folder), folder)
    elif not _is_scene(mark):
        raise ValueError(f"{mark}: expected the scene of an earlier preview, or nothing; choose another folder")
    shown = {round(number) for number in np.linspace(0, scene.num_frames - 1, NUM_COLUMNS * NUM_ROWS)}
    tone: Tone | None = None
    tiles: list[Picture] = []
    with together():
        with atomic_path(film) as temporary:
            movie = Movie(temporary, scene.rate_hz)
            try:
                for number, known in enumerate(frames):
                    tone = tone or Tone.of(known.frame.image)
                    picture = labelled(known, tone)
                    movie.add(picture, known.frame.timestamp_ns)
                    if progress is not None:
                        progress(1, number + 1, scene.num_frames)
                    if number in shown:
                        tiles.append(picture)
                movie.close()
            finally:
                movie.discard()
        write_atomic(sheet, cv2.imencode(".png", contact_sheet(tiles))[1].tobytes())
        write_atomic(mark, scene_to_toml(scene).encode())
    return sheet, film


def _is_scene(path: Path) -> bool:
    """Whether the file at `path` has the sections of a scene as it is written, of whatever version."""
    try:
        return {"name", "road", "ego", "camera", "sensor"} <= read_toml(path).keys()
    except ValueError:
        return False


def labelled(known: DriveFrame, tone: Tone) -> Picture:
    """The picture of a frame with its vehicles and artifacts; doubtful artifacts are mere dots."""
    grey = tone.apply(known.frame.image)
    picture = np.repeat(grey[:, :, None], 3, axis=2)
    unit = max(1, round(known.frame.width_px / 1280))
    for vehicle in known.vehicles:
        _draw_vehicle(picture, vehicle, unit)
    _write(picture, _caption(known), (8 * unit, 22 * unit), unit)
    return picture


def contact_sheet(tiles: Sequence[Picture]) -> Picture:
    """The pictures side by side, row by row."""
    width, height = TILE_PX
    sheet = np.zeros((NUM_ROWS * height, NUM_COLUMNS * width, 3), np.uint8)
    for number, tile in enumerate(tiles[: NUM_COLUMNS * NUM_ROWS]):
        row, column = divmod(number, NUM_COLUMNS)
        small = cv2.resize(tile, TILE_PX, interpolation=cv2.INTER_AREA)
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = small
    return sheet


def _draw_vehicle(picture: Picture, vehicle: VehicleTruth, unit: int) -> None:
    if vehicle.box_xyxy_px is not None and vehicle.visible_share > 0:
        x1, y1, x2, y2 = vehicle.box_xyxy_px
        cv2.rectangle(picture, (x1, y1), (x2 - 1, y2 - 1), BOX_BGR, unit)
    for artifact in vehicle.artifacts:
        _draw_artifact(picture, artifact, unit)


def _draw_artifact(picture: Picture, artifact: Artifact, unit: int) -> None:
    x, y = map(round, artifact.position_px)
    colour = KIND_BGR.get(artifact.kind, TEXT_BGR)
    radius = (6 if artifact.is_direct else 11) * unit
    if artifact.is_doubtful:
        cv2.circle(picture, (x, y), 2 * unit, colour, -1, cv2.LINE_AA)
        return
    cv2.circle(picture, (x, y), radius, colour, unit, cv2.LINE_AA)
    if not artifact.is_direct:
        _write(picture, f"{artifact.kind} {artifact.instance_id}", (x + radius, y - radius), unit, colour)


def _caption(known: DriveFrame) -> str:
    words = [f"{known.timestamp_ns / 1e9:.2f} s", f"{3.6 * known.ego_speed_mps:.0f} km/h"]
    words.append(known.category.name.lower().replace("_", " "))
    words += [f"{vehicle.kind} {vehicle.range_m:.0f} m" for vehicle in known.vehicles[:3]]
    if known.is_production_detected:
        words.append("production system")
    return "  ".join(words)


def _write(picture: Picture, text: str, origin: tuple[int, int], unit: int, colour: Colour = TEXT_BGR) -> None:
    scale = 0.42 * unit
    cv2.putText(picture, text, origin, _FONT, scale, (0, 0, 0), 3 * unit, cv2.LINE_AA)
    cv2.putText(picture, text, origin, _FONT, scale, colour, unit, cv2.LINE_AA)
