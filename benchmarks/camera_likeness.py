"""How drives of every camera profile look: `python -m benchmarks.camera_likeness CAMERAS > likeness.toml`.

CAMERAS has a folder for each profile, as
`foreglow simulate --out CAMERAS --seed 41 --scenes 10 --mixture standard --fps 0.5 --camera pvdn_day,...` writes it.
The statistics go to standard output, for `src/foreglow/lab/simulation/camera/likeness.toml`. On standard error,
each drive is judged by the others: how many are told right, and how far those are whose camera is left out.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tomli_w

from foreglow.datasets import read_image
from foreglow.lab.simulation.camera.likeness import NUM_IMAGES, Look, look_of, nearest_profile

Drives = Mapping[str, np.ndarray]
"""By profile, the look of each drive, shape (D, F)."""


def looks_of_drives(cameras: Path) -> list[Look]:
    """The look of each drive of a camera: of each folder of images below its folder."""
    looks = []
    for drive in sorted(cameras.glob("*/*/images/*")):
        images = sorted(drive.glob("*.png"))
        chosen = images[:: max(1, len(images) // NUM_IMAGES)][:NUM_IMAGES]
        looks.append(np.mean([look_of(read_image(path)) for path in chosen], axis=0))
    return looks


def summarised(drives: Drives, *, without: tuple[str, int | None] | None = None) -> dict[str, tuple[Look, Look]]:
    """Mean and standard deviation by profile; `without` one drive of a profile, or (None) without the whole profile."""
    found = {}
    for name, looks in drives.items():
        if without is not None and without[0] == name:
            if without[1] is None:
                continue
            looks = np.delete(looks, without[1], axis=0)
        found[name] = looks.mean(0), looks.std(0, ddof=1)
    return found


def main() -> None:
    drives = {path.name: np.array(looks_of_drives(path)) for path in sorted(Path(sys.argv[1]).iterdir())}
    stored = {
        name: {"means": means.round(3).tolist(), "spreads": spreads.round(3).tolist()}
        for name, (means, spreads) in summarised(drives).items()
    }
    print("# Written by `python -m benchmarks.camera_likeness`; the figures are those of `likeness.FIGURES`.")
    print(tomli_w.dumps(stored), end="")
    for name, looks in drives.items():
        own = [nearest_profile(look, summarised(drives, without=(name, k))) for k, look in enumerate(looks)]
        others = [nearest_profile(look, summarised(drives, without=(name, None))) for look in looks]
        taken_for = sorted({found for found, _ in own if found != name})
        distances = [distance for _, distance in own]
        away = np.median([distance for _, distance in others])
        print(
            f"{name}: {sum(found == name for found, _ in own)} of {len(looks)} told right, others as "
            f"{', '.join(taken_for) or 'none'}; distance to its own {np.median(distances):.2f} (most "
            f"{max(distances):.2f}), to the nearest other {away:.2f}",
            file=sys.stderr,
        )


if __name__ == "__main__":
    main()
