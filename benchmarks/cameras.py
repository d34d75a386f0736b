"""What one more exposure of a rendered moment costs: `python -m benchmarks.cameras [--out FILE.json] [--quick]`.

For every profile, the run-time of an exposure of a moment of 1280x960 pixels, with its image alone and with its labels,
beside the rendering of the moment, all on one thread but for the renderer's own. Ratios are to the rendering.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from benchmarks.timing import CONSOLE, Contender, Row, interleaved, options, table, write_results
from foreglow.lab.simulation.camera.profile import PROFILES, read_profile
from foreglow.lab.simulation.drive import Drive, DriveCamera
from foreglow.lab.simulation.moment import Moments
from foreglow.lab.simulation.scenes.scenarios import adapted, scenario

SIZE_PX = (1280, 960)
SCENARIO, SEED, RATE_HZ, MOMENT = "curve", 3, 2.0, 9
"""A moment of a drive in which a car is in sight."""

ROUNDS, QUICK_ROUNDS = 7, 1


def measure(rounds: int) -> list[Row]:
    """A row for each profile: run-times of an image and of a labelled frame, and their ratios to the rendering."""
    scene = adapted(scenario(SCENARIO, SEED), SIZE_PX, RATE_HZ, "night")
    source = Drive(scene)
    moments = Moments(scene, source.camera, source.settings, source.headlamps, is_split=True)
    levels = np.ones((2, source.headlamps.num_leds))
    moment = moments.at(MOMENT, levels)
    contenders = {"render": Contender(lambda: moments.at(MOMENT, levels), calls=1)}
    for name in PROFILES:
        camera = DriveCamera(scene, source.camera, read_profile(name))

        def image(camera: DriveCamera = camera) -> None:
            camera.expose(moments, moment).captured(moment.number)

        def labelled(camera: DriveCamera = camera) -> None:
            camera.frame(moments, moment)

        contenders[f"{name} image"] = Contender(image, calls=1)
        contenders[f"{name} labelled"] = Contender(labelled, calls=1)
    times = interleaved(contenders, rounds, warm_up=1)
    rendering = times["render"]
    rows: list[Row] = [{"profile": "the rendering itself", "image_ms": rendering.median_ms}]
    for name in PROFILES:
        taken, labelled_times = times[f"{name} image"], times[f"{name} labelled"]
        rows.append(
            {
                "profile": name,
                "image_ms": taken.median_ms,
                "labelled_ms": labelled_times.median_ms,
                "image_share": 1.0 / taken.speed_up_over(rendering),
                "labelled_share": 1.0 / labelled_times.speed_up_over(rendering),
            }
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "cameras", arguments)
    cv2.setNumThreads(1)
    results: dict[str, Any] = {"exposures": measure(QUICK_ROUNDS if given.quick else ROUNDS)}
    shown = table(
        "One more exposure", ("profile",), ("image ms", "labelled ms", "image / rendering", "labelled / rendering")
    )
    for row in results["exposures"]:
        keys = ("image_ms", "labelled_ms", "image_share", "labelled_share")
        shown.add_row(row["profile"], *(f"{row[key]:.2f}" if key in row else "" for key in keys))
    CONSOLE.print(shown)
    write_results(given.out, results)
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
