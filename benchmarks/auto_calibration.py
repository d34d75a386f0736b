"""How well `calibrate auto` finds the mount: `python -m benchmarks.auto_calibration [--drives N] [--out DIR]`.

Drives of the standard mixture, each with another mount of the camera, are rendered small and exposed for five camera
profiles; a command that was stopped goes on with the first drive that is missing. `--splits` takes splits that were
simulated before, instead. The calibration gets the lens of each drive and the camera's height, and has to find the
rest. It prints the errors of pitch and yaw, the share within the stated sigma, and by how much the ranges of lamps are
worse than with the exact calibration.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.timing import CONSOLE, RESULTS, write_results
from foreglow.calibration.auto import calibrate_drive, lens_of
from foreglow.config import preset
from foreglow.datasets import open_source
from foreglow.display.progress import SceneProgress
from foreglow.distance import make_estimator
from foreglow.geometry import Camera, Floats, rotation_angles_rad
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
from foreglow.lab.studies.distance.lights import SimulatedLights

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


def judge(drive: Path) -> tuple[dict[str, Any], Camera | None]:
    """What `calibrate auto` makes of a simulated drive, with the errors of pitch and yaw, degrees; and its camera."""
    source = open_source(drive)
    first = next(iter(source))
    assert first.camera is not None
    name = f"{drive.parents[3].name}/{drive.name}"
    lens = lens_of(first, name)
    try:
        found = calibrate_drive(
            source,
            lens,
            name=name,
            rate_hz=source.rate_hz,
            num_frames=source.num_frames,
            height_m=float(first.camera.vehicle_from_camera.position_m[2]),
        )
    except ValueError as error:
        return {"drive": name, "refused": str(error)}, None
    angles = [rotation_angles_rad(each.vehicle_from_camera.rotation) for each in (found.camera, first.camera)]
    yaw_deg, pitch_deg, _ = np.degrees(np.subtract(angles[0], angles[1])).tolist()
    sigmas = found.camera.mount_sigmas
    row = {
        "drive": name,
        "pitch_error_deg": pitch_deg,
        "pitch_sigma_deg": math.degrees(sigmas.pitch_rad),
        "yaw_error_deg": yaw_deg,
        "yaw_sigma_deg": math.degrees(sigmas.yaw_rad),
        "line_frames": found.num_lines,
        "flow_pairs": found.num_flows,
        "frames": found.num_views,
    }
    return row, found.camera


def range_errors(root: Path, cameras: Mapping[str, Camera]) -> Floats:
    """Relative errors of the ranges of lamps in sight, with the exact calibration and with `cameras`.

    Args:
        root: A split.
        cameras: The calibrations of its drives by name; drives without one are left out.

    Returns:
        Shape (N, 2), without lamps that one of them gives no range.
    """
    config = preset("foreglow")
    exact, found = make_estimator(config.distance), make_estimator(config.distance)
    errors = []
    sequence: str | None = None
    for sample in SimulatedLights(root, config):
        frame = sample.frame
        lamps = [light for light in sample.lights if light.is_direct]
        if frame.sequence not in cameras or not lamps:
            continue
        if frame.sequence != sequence:
            sequence = frame.sequence
            exact.reset()
            found.reset()
        recalibrated = dataclasses.replace(frame, camera=cameras[frame.sequence])
        boxes, truth_m = [lamp.box for lamp in lamps], np.array([lamp.truth_m for lamp in lamps])
        ranges_m = [
            estimator.estimate(each, sample.detections).ranges_m[boxes]
            for estimator, each in ((exact, frame), (found, recalibrated))
        ]
        errors.append((np.abs(np.stack(ranges_m) / truth_m - 1.0)).T)
    joined = np.concatenate([np.zeros((0, 2)), *errors])
    return np.asarray(joined[np.isfinite(joined).all(axis=1)])


def summary(rows: Sequence[dict[str, Any]], lamp_errors: Floats) -> dict[str, float]:
    """Median and 90 % of the absolute errors, and the share within one sigma; median errors of the ranges of lamps."""
    figures: dict[str, float] = {"calibrated": len(rows)}
    for angle in ("pitch", "yaw"):
        errors = np.abs([row[f"{angle}_error_deg"] for row in rows])
        figures[f"{angle}_median_deg"], figures[f"{angle}_90_deg"] = np.percentile(errors, [50, 90]).tolist()
        figures[f"{angle}_within_sigma"] = float(np.mean(errors <= [row[f"{angle}_sigma_deg"] for row in rows]))
    if len(lamp_errors):
        exact, found = np.median(lamp_errors, axis=0).tolist()
        figures |= {"lamps": len(lamp_errors), "range_error_exact": exact, "range_error": found, "ratio": found / exact}
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--drives", type=int, default=40, help="number of drives, shared by profiles or splits"
    )
    parser.add_argument("--splits", type=Path, nargs="+", help="splits that were simulated before")
    parser.add_argument("--out", type=Path, default=RESULTS / "auto_calibration")
    given = parser.parse_args()
    rows, lamp_errors = [], []
    per_split = -(-given.drives // len(given.splits or PROFILES))
    for root in given.splits or render(given.out, per_split):
        cameras = {}
        for drive in sorted((root / "images").iterdir())[:per_split]:
            row, camera = judge(drive)
            if camera is not None:
                cameras[drive.name] = camera
            rows.append(row)
            CONSOLE.print({name: round(value, 2) if isinstance(value, float) else value for name, value in row.items()})
        lamp_errors.append(range_errors(root, cameras))
    calibrated = [row for row in rows if "refused" not in row]
    figures = {"drives": len(rows), **(summary(calibrated, np.concatenate(lamp_errors)) if calibrated else {})}
    CONSOLE.print({name: round(value, 3) for name, value in figures.items()})
    write_results(given.out / "auto_calibration.json", {"summary": figures, "drives": rows})


if __name__ == "__main__":
    main()
