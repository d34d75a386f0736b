"""How well `calibrate auto` finds the mount: `python -m benchmarks.auto_calibration [--drives N] [--seed N]`.

Drives of the standard mixture, each with another mount of the camera, are rendered small and exposed for five camera
profiles; a command that was stopped goes on with the first drive that is missing. `--splits` takes splits that were
simulated before, instead. Drives that were judged are not judged again. The calibration gets the lens of each drive and
the camera's height, and has to find the rest. It prints the errors of pitch and yaw, the share within the stated sigma,
and by how much the ranges of lamps are worse than with the exact calibration.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.timing import CONSOLE, RESULTS, write_results
from foreglow.calibration.auto import calibrate_drive, lens_of
from foreglow.config import preset
from foreglow.datasets import open_source
from foreglow.display.progress import SceneProgress
from foreglow.distance import make_estimator
from foreglow.geometry import Camera, rotation_angles_rad
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
SEED = 4026
"""Of drives that nothing was set by; the standard deviations were set by those of seeds 4021, 4022, 4024 and 4025."""

SPLIT: Literal["test"] = "test"
SIZE_PX = (640, 480)
RATE_HZ = 4.0
PAIR_S = 0.06
"""Pairs of frames show motion; two pairs a second."""

QUALITY = "fast"


def mounted(scene: Scene, seed: int, number: int) -> Scene:
    """`scene` with a camera that someone has fixed without a level."""
    draw = Draw(seed, number)
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


def render(out: Path, num_scenes: int, seed: int) -> list[Path]:
    """The splits of all profiles, rendered where they are missing."""
    drawn = draw_scenes(num_scenes, seed, SPLIT, "standard")
    scenes = [
        adapted(mounted(scene, seed, number), SIZE_PX, RATE_HZ, "night", PAIR_S) for number, scene in enumerate(drawn)
    ]
    profiles = tuple(small(profile) for profile in read_profiles(",".join(PROFILES)))
    config = DatasetConfig.of(seed=seed, split=SPLIT, cycle="night", quality=QUALITY)
    targets = [Target(out / profile.name, config.exposed_for(profile)) for profile in profiles]
    expose = functools.partial(drive_exposures, profiles=profiles, num_variants=1, quality=QUALITY)
    with SceneProgress(len(scenes), sum(scene.num_frames for scene in scenes)) as progress:
        return [summary.root for summary in simulate_datasets(targets, scenes, expose, progress=progress)]


def judge(drive: Path) -> dict[str, Any]:
    """What `calibrate auto` makes of a simulated drive: the errors of pitch and yaw, degrees, and of ranges."""
    source = open_source(drive)
    first = next(iter(source))
    assert first.camera is not None, "simulated"
    name = name_of(drive)
    try:
        found = calibrate_drive(
            source,
            lens_of(first, name),
            name=name,
            rate_hz=source.rate_hz,
            num_frames=source.num_frames,
            height_m=float(first.camera.vehicle_from_camera.position_m[2]),
        )
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
        "range_errors": range_errors(drive, found.camera),
    }


def name_of(drive: Path) -> str:
    """Profile and sequence."""
    return f"{drive.parents[3].name}/{drive.name}"


def range_errors(drive: Path, camera: Camera) -> list[list[float]]:
    """Relative errors of the ranges of lamps in sight: two for each lamp, with the exact calibration and with `camera`.

    Lamps that one of them gives no range are left out.
    """
    config = preset("foreglow")
    exact, found = make_estimator(config.distance), make_estimator(config.distance)
    errors = np.zeros((0, 2))
    for sample in SimulatedLights(drive.parents[1], config, int(drive.name.removeprefix("S"))):
        frame, detections = sample.frame, sample.detections
        lamps = [light for light in sample.lights if light.is_direct]
        boxes, truth_m = [lamp.box for lamp in lamps], np.array([lamp.truth_m for lamp in lamps])
        ranges_m = [
            estimator.estimate(each, detections).ranges_m[boxes]
            for estimator, each in ((exact, frame), (found, dataclasses.replace(frame, camera=camera)))
        ]
        errors = np.concatenate([errors, np.abs(np.stack(ranges_m, -1) / truth_m[:, None] - 1.0)])
    return [[float(error) for error in pair] for pair in errors if np.isfinite(pair).all()]


def judged(drives: Iterable[Path], path: Path) -> list[dict[str, Any]]:
    """What `calibrate auto` makes of the drives; those that have a line in the file `path` are read from there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = {row["drive"]: row for row in map(json.loads, path.read_text().splitlines())} if path.exists() else {}
    for drive in drives:
        if name_of(drive) in rows:
            continue
        row = rows[name_of(drive)] = judge(drive)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        shown = {name: value for name, value in row.items() if name != "range_errors"}
        CONSOLE.print({name: round(value, 2) if isinstance(value, float) else value for name, value in shown.items()})
    return list(rows.values())


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Median and 90 % of the absolute errors, and the share within one sigma; median errors of the ranges of lamps."""
    figures: dict[str, float] = {"calibrated": len(rows)}
    for angle in ("pitch", "yaw"):
        errors = np.abs([row[f"{angle}_error_deg"] for row in rows])
        figures[f"{angle}_median_deg"], figures[f"{angle}_90_deg"] = np.percentile(errors, [50, 90]).tolist()
        figures[f"{angle}_within_sigma"] = float(np.mean(errors <= [row[f"{angle}_sigma_deg"] for row in rows]))
    lamps = [pair for row in rows for pair in row["range_errors"]]
    if lamps:
        exact, found = np.median(lamps, axis=0).tolist()
        figures |= {"lamps": len(lamps), "range_error_exact": exact, "range_error": found, "ratio": found / exact}
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=40, help="number of drives, shared by profiles or splits")
    parser.add_argument("--seed", type=int, default=SEED, help="of the drives that are rendered")
    parser.add_argument("--splits", type=Path, nargs="+", help="splits that were simulated before")
    parser.add_argument("--out", type=Path, default=RESULTS / "auto_calibration")
    given = parser.parse_args()
    per_split = -(-given.drives // len(given.splits or PROFILES))
    roots = given.splits or render(given.out, per_split, given.seed)
    drives = [drive for root in roots for drive in sorted((root / "images").iterdir())[:per_split]]
    drives.sort(key=lambda drive: drive.name)  # a few of each profile if it is stopped
    rows = judged(drives, given.out / "drives.jsonl")
    calibrated = [row for row in rows if "refused" not in row]
    figures = {"drives": len(rows), **(summary(calibrated) if calibrated else {})}
    CONSOLE.print({name: round(value, 3) for name, value in figures.items()})
    write_results(given.out / "auto_calibration.json", {"summary": figures, "drives": rows})


if __name__ == "__main__":
    main()
