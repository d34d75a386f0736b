"""How well `calibrate auto` finds the mount: `python -m benchmarks.auto_calibration [--drives N] [--out DIR]`.

Drives of the standard mixture, each with another mount of the camera, are rendered small and exposed for five camera
profiles; a command that was stopped goes on with the first drive that is missing. The calibration gets the lens of each
drive, and has to find the rest. It prints the errors of pitch and yaw and the share within the stated sigma.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.timing import CONSOLE, RESULTS, write_results
from foreglow.calibration.auto import calibrate_drive, lens_of
from foreglow.datasets import open_source
from foreglow.display.progress import SceneProgress
from foreglow.geometry import rotation_angles_rad
from foreglow.lab.simulation import (
    DatasetConfig,
    Scene,
    Target,
    adapted,
    draw_scenes,
    drive_exposures,
    simulate_datasets,
)
from foreglow.lab.simulation.camera.profile import CameraProfile, read_profiles
from foreglow.lab.simulation.scenes.draw import Draw

PROFILES = ("dashcam", "town_dashcam", "phone", "action_cam", "webcam")
SEED = 4022
SPLIT: Literal["test"] = "test"
SIZE_PX = (640, 480)
RATE_HZ = 4.0
PAIR_S = 0.06
"""Pairs of frames show motion; two pairs a second."""

QUALITY = "fast"


def mounted(scene: Scene, number: int) -> Scene:
    """`scene` with a camera that someone has fixed without a level."""
    draw = Draw(SEED, number)
    mount = {
        "pitch_deg": draw.uniform(-4.0, 3.0),
        "yaw_deg": draw.uniform(-3.0, 3.0),
        "roll_deg": draw.uniform(-1.0, 1.0),
        "mount_m": (draw.uniform(1.4, 2.2), draw.uniform(-0.3, 0.3), draw.uniform(1.1, 1.6)),
    }
    return scene.model_copy(update={"camera": scene.camera.model_copy(update=mount)})


def small(profile: CameraProfile) -> CameraProfile:
    """`profile` with its aspect ratio, no wider than the rendering."""
    width, height = profile.view.width_px or SIZE_PX[0], profile.view.height_px or SIZE_PX[1]
    view = {"width_px": SIZE_PX[0], "height_px": round(height * SIZE_PX[0] / width), "focal_px": None}
    return profile.model_copy(update={"view": profile.view.model_copy(update=view)})


def render(out: Path, num_scenes: int) -> list[Path]:
    """The splits of all profiles, rendered where they are missing."""
    drawn = draw_scenes(num_scenes, SEED, SPLIT, "standard")
    scenes = [adapted(mounted(scene, number), SIZE_PX, RATE_HZ, "night", PAIR_S) for number, scene in enumerate(drawn)]
    profiles = tuple(small(profile) for profile in read_profiles(",".join(PROFILES)))
    config = DatasetConfig.of(seed=SEED, split=SPLIT, cycle="night", quality=QUALITY)
    targets = [Target(out / profile.name, config.exposed_for(profile)) for profile in profiles]
    expose = functools.partial(drive_exposures, profiles=profiles, num_variants=1, quality=QUALITY)
    with SceneProgress(len(scenes), sum(scene.num_frames for scene in scenes)) as progress:
        return [summary.root for summary in simulate_datasets(targets, scenes, expose, progress=progress)]


def judge(drive: Path) -> dict[str, Any]:
    """What `calibrate auto` makes of a simulated drive, and the errors of pitch and yaw, degrees."""
    source = open_source(drive)
    first = next(iter(source))
    assert first.camera is not None
    name = f"{drive.parents[3].name}/{drive.name}"
    lens = lens_of(first, name)
    try:
        found = calibrate_drive(source, lens, name=name, rate_hz=source.rate_hz, num_frames=source.num_frames)
    except ValueError as error:
        return {"drive": name, "refused": str(error)}
    angles = [rotation_angles_rad(each.vehicle_from_camera.rotation) for each in (found.camera, first.camera)]
    yaw_deg, pitch_deg, _ = np.degrees(np.subtract(angles[0], angles[1])).tolist()
    sigmas = found.camera.mount_sigmas
    return {
        "drive": name,
        "pitch_error_deg": pitch_deg,
        "pitch_sigma_deg": math.degrees(sigmas.pitch_rad),
        "yaw_error_deg": yaw_deg,
        "yaw_sigma_deg": math.degrees(sigmas.yaw_rad),
        "line_frames": found.num_lines,
        "flow_pairs": found.num_flows,
        "frames": found.num_views,
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Median and 90 % of the absolute errors, and the share within one sigma."""
    figures: dict[str, float] = {"calibrated": len(rows)}
    for angle in ("pitch", "yaw"):
        errors = np.abs([row[f"{angle}_error_deg"] for row in rows])
        figures[f"{angle}_median_deg"], figures[f"{angle}_90_deg"] = np.percentile(errors, [50, 90]).tolist()
        figures[f"{angle}_within_sigma"] = float(np.mean(errors <= [row[f"{angle}_sigma_deg"] for row in rows]))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=40, help="number of drives, shared by five profiles")
    parser.add_argument("--out", type=Path, default=RESULTS / "auto_calibration")
    given = parser.parse_args()
    rows = []
    for root in render(given.out, -(-given.drives // len(PROFILES))):
        for drive in sorted((root / "images").iterdir()):
            rows.append(judge(drive))
            CONSOLE.print({name: round(v, 2) if isinstance(v, float) else v for name, v in rows[-1].items()})
    calibrated = [row for row in rows if "refused" not in row]
    figures = {"drives": len(rows), **(summary(calibrated) if calibrated else {})}
    CONSOLE.print({name: round(value, 3) for name, value in figures.items()})
    write_results(given.out / "auto_calibration.json", {"summary": figures, "drives": rows})


if __name__ == "__main__":
    main()
