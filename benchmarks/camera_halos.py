"""Halos of real lamps beside a profile's: `python -m benchmarks.camera_halos PROFILE=FILE[#FRAME]@X,Y[,APART] ...`.

Each FILE is a real image or clip, FRAME counts its decoded frames from 0, and X, Y is the middle of a lamp, or of a
pair of lamps that are APART pixels apart. Grey levels are measured in rings above the lamp. The profile's lens and
imager, at their middle dirt, then draw lamps at the same place; how bright they are and how bright the darkness is, is
fitted, since nobody knows it. What is left is the shape: the ratio of the grey levels at each angle. `halos.png` and
`halos.json` go into the folder.

A picture that somebody has brightened and marked with colours needs `--gamma` and `--leave-out-colours`.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import CONSOLE, RESULTS, table
from foreglow.lab.simulation.camera.imager import ElectronImager
from foreglow.lab.simulation.camera.optics import LampPoints
from foreglow.lab.simulation.camera.profile import read_profile
from foreglow.lab.simulation.camera.sensor import Sensor
from foreglow.lab.simulation.camera.view import View
from foreglow.lab.simulation.camera.windscreen import Windscreen
from foreglow.lab.simulation.drive import camera_of
from foreglow.lab.simulation.scenes.scene import CameraSpec, SensorSpec
from foreglow.whole_files import write_atomic

EDGES_DEG = np.array([0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 7.0, 10.0])
SKY_DEG = (25.0, 155.0)
"""Directions above a lamp in which its halo is measured: below it is its light on the road."""

COLOURED = 25
"""Difference of two channels from which on a pixel belongs to a coloured mark."""

LAMPS_LX = np.geomspace(1e-5, 1e2, 281)
DARKNESS_CD_M2 = np.concatenate([[0.0], np.geomspace(1e-5, 1.0, 160)])
LAMP_RADIUS_DEG = 0.03
"""A headlamp of 12 cm at 60 m."""

FINE_BITS = 16
"""In a real image, noise hides the converter's steps."""

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lamp:
    """A real lamp: where it is, in pixels, in which frame of which file; and the distance of a pair, 0 for one."""

    profile: str
    path: Path
    frame: int
    position_px: tuple[float, float]
    apart_px: float


def lamp_of(text: str) -> Lamp:
    """The lamp that `PROFILE=FILE[#FRAME]@X,Y[,APART]` names.

    Raises:
        ArgumentTypeError: If the text has another form.
    """
    profile, equals, rest = text.partition("=")
    file, at, place = rest.rpartition("@")
    file, _, frame = file.partition("#")
    try:
        x, y, *apart = (float(number) for number in place.split(","))
        if not (equals and at and len(apart) < 2):
            raise ValueError
        return Lamp(profile, Path(file), int(frame or 0), (x, y), apart[0] if apart else 0.0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected PROFILE=FILE[#FRAME]@X,Y[,APART], got {text!r}") from None


def read_real(lamp: Lamp, gamma: float, *, leaves_out_colours: bool) -> Values:
    """The real frame in grey levels, shape (H, W); NaN where a coloured mark is."""
    clip = cv2.VideoCapture(str(lamp.path))
    for _ in range(lamp.frame):
        clip.grab()
    is_read, image = clip.read()
    if not is_read:
        raise ValueError(f"{lamp.path}: expected a frame {lamp.frame}")
    grey: Values = 255.0 * (np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float64) / 255.0) ** gamma
    if leaves_out_colours:
        marked = np.ptp(image.astype(np.int16), axis=2) > COLOURED
        grey[cv2.dilate(marked.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0] = np.nan
    return grey


def rings(image: Values, position_px: tuple[float, float], focal_px: float) -> Values:
    """Median in rings above a position, shape (len(EDGES_DEG) - 1,); NaN where hardly anything of a ring is seen."""
    rows, columns = np.indices(image.shape) + 0.5
    x, y = position_px[0] + 0.5, position_px[1] + 0.5
    angles = np.degrees(np.arctan(np.hypot(columns - x, rows - y) / focal_px))
    direction = np.degrees(np.arctan2(y - rows, columns - x))
    is_seen = (direction > SKY_DEG[0]) & (direction < SKY_DEG[1]) & np.isfinite(image)
    found = [image[is_seen & (angles >= low) & (angles < high)] for low, high in itertools.pairwise(EDGES_DEG)]
    return np.array([np.median(ring) if ring.size > 3 else np.nan for ring in found])


class ProfileLamps:
    """Lamps through the lens and the imager of a profile at its middle dirt."""

    def __init__(self, name: str) -> None:
        profile = read_profile(name)
        lens = profile.lens.model_copy(update={"variety": 0.0})
        is_scene = profile.imager.model == "scene"
        imager = profile.imager if is_scene else profile.imager.model_copy(update={"bits": FINE_BITS})
        profile = profile.model_copy(update={"lens": lens, "imager": imager})
        self.camera = View(profile, camera_of(CameraSpec())).camera
        sensor = profile.scene_sensor(SensorSpec())
        self._optics = Windscreen(profile, sensor, self.camera)
        self._imager = (
            Sensor(sensor, self.camera, 0, self._optics) if is_scene else ElectronImager(profile, self._optics, 0)
        )
        self._ramp = np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 20000)])
        self._levels = self._grey(self._ramp)

    def luminances(self, position: Values, apart: float) -> Values:
        """Light in rings above a lamp of 1 lx, or a pair that shares it, cd/m²; both in shares of the image's width."""
        camera = self.camera
        x, y = position * camera.width_px + np.array(camera.centre_px)
        half = 0.5 * apart * camera.width_px
        positions = np.array([[x - half, y], [x + half, y]])
        radius = np.radians(LAMP_RADIUS_DEG) * camera.focal_px[0]
        lamps = LampPoints(positions, np.full(2, 0.5), np.full(2, radius))
        image = (self._optics.draw_points(lamps) * self._optics.fall_off).astype(np.float64)
        return rings(image, (x - 0.5, y - 0.5), camera.focal_px[0])

    def grey(self, luminances: Values) -> Values:
        """Grey levels of light on the pixels at the middle of the image, without noise."""
        return np.interp(luminances, self._ramp, self._levels)

    def _grey(self, luminances: Values) -> Values:
        shape = (self.camera.height_px, self.camera.width_px)
        image = np.zeros(shape, np.float32)
        image.ravel()[: luminances.size] = luminances
        grey = self._imager.expected_grey(np.asarray(image / self._optics.fall_off, np.float32))
        return np.asarray(grey.ravel()[: luminances.size], np.float64)


@functools.cache
def profile_lamps(name: str) -> ProfileLamps:
    """The lamps of a profile; its lens takes a while."""
    return ProfileLamps(name)


def fitted(real: Values, per_lx: Values, lamps: ProfileLamps) -> tuple[float, Values]:
    """Illuminance of the lamp, and the profile's grey levels, that come nearest to the `real` ones in all rings."""
    light = LAMPS_LX[:, np.newaxis, np.newaxis] * per_lx + DARKNESS_CD_M2[:, np.newaxis]
    grey = lamps.grey(light)
    # One grey level is added to both: black is the same as black.
    misses = np.nansum(np.log((grey + 1.0) / (real + 1.0)) ** 2, axis=-1)
    lamp, darkness = np.unravel_index(np.argmin(misses), misses.shape)
    return float(LAMPS_LX[lamp]), grey[lamp, darkness]


def measured(lamp: Lamp, given: argparse.Namespace) -> dict[str, Any]:
    """A lamp's grey levels by angle, real and simulated, and their largest ratio."""
    image = read_real(lamp, given.gamma, leaves_out_colours=given.leave_out_colours)
    height, width = image.shape
    real = rings(image, lamp.position_px, 0.5 * width / float(np.tan(np.radians(given.hfov / 2))))
    lamps = profile_lamps(lamp.profile)
    position = (np.array(lamp.position_px) + 0.5 - np.array([width, height]) / 2) / width
    illuminance_lx, simulated = fitted(real, lamps.luminances(position, lamp.apart_px / width), lamps)
    ratios = (simulated + 1.0) / (real + 1.0)
    return {
        "real": real.tolist(),
        "simulated": simulated.tolist(),
        "illuminance_lx": illuminance_lx,
        "ratios": ratios.tolist(),
        "worst": float(np.exp(np.nanmax(np.abs(np.log(ratios))))),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lamps", nargs="+", type=lamp_of, metavar="PROFILE=FILE[#FRAME]@X,Y[,APART]")
    parser.add_argument("--hfov", type=float, default=65.0, help="horizontal field of view of the real files, degrees")
    parser.add_argument("--gamma", type=float, default=1.0, help="exponent that undoes a brightening (255 stays)")
    parser.add_argument("--leave-out-colours", action="store_true", help="pixels of coloured marks do not count")
    parser.add_argument("--out", type=Path, default=RESULTS / "camera_halos")
    given = parser.parse_args(arguments)
    middles = [f"{angle:.2g}" for angle in np.sqrt(EDGES_DEG[1:] * EDGES_DEG[:-1])]
    shown = table("Simulated over real grey level by angle, degrees", ("lamp",), (*middles, "worst"))
    results = {}
    for number, lamp in enumerate(given.lamps, 1):
        name = f"{number}: {lamp.profile}"
        results[name] = found = measured(lamp, given)
        shown.add_row(name, *(f"{ratio:.2f}" for ratio in found["ratios"]), f"{found['worst']:.2f}")
    CONSOLE.print(shown)
    given.out.mkdir(parents=True, exist_ok=True)
    write_atomic(given.out / "halos.json", (json.dumps(results, indent=1) + "\n").encode())
    _draw(results, given.out / "halos.png")
    CONSOLE.print(f"look in {given.out}")


def _draw(results: dict[str, dict[str, Any]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    num_columns = min(3, len(results))
    num_rows = -(-len(results) // num_columns)
    figure, axes = plt.subplots(
        num_rows, num_columns, figsize=(3.4 * num_columns, 2.7 * num_rows), squeeze=False, layout="constrained"
    )
    middles = np.sqrt(EDGES_DEG[1:] * EDGES_DEG[:-1])
    for axis in axes.flat[len(results) :]:
        axis.set_visible(False)
    for axis, (name, found) in zip(axes.flat, results.items(), strict=False):
        real = np.array(found["real"])
        axis.plot(middles, real + 1, "o-", label="real")
        axis.plot(middles, np.array(found["simulated"]) + 1, "s--", label="simulated")
        axis.fill_between(middles, (real + 1) / 1.5, (real + 1) * 1.5, alpha=0.15, label="factor 1.5")
        axis.set(xscale="log", xlabel="angle to the lamp, degrees", ylabel="grey level + 1", yscale="log", title=name)
        axis.set_xticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"], minor=False)
        axis.set_xticks([], minor=True)
        axis.title.set_fontsize(8)
        axis.legend(fontsize=7)
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    main()
