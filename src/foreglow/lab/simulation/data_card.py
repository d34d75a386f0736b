"""The data card of simulated data: what is in it, counted from its files.

`python -m foreglow.lab.simulation.data_card DATA` writes it beside the splits in the folder `DATA`.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from foreglow.datasets.simulated.files import InfoFile, finished_sequences, has_truth, read_info
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.writing.scene_files import read_scenes
from foreglow.whole_files import write_atomic

FILE = "DATA_CARD.md"


@dataclass(frozen=True, slots=True)
class SplitCard:
    """A split of a data set.

    Attributes:
        root: Its folder.
        info: How it was made.
        scenes: The scenes of its drives.
    """

    root: Path
    info: InfoFile
    scenes: tuple[Scene, ...]

    @property
    def num_images(self) -> int:
        """Images, all exposures of all drives."""
        return sum(scene.num_frames for scene in self.scenes)


def write_data_card(data: Path) -> Path:
    """Writes the card of all splits below `data` beside them, and returns its path.

    Raises:
        FileNotFoundError: If there is no simulated split.
        ValueError: If a drive is missing, or two splits share one.
    """
    splits = [_split(path.parent) for path in sorted(data.rglob("scenes.jsonl")) if has_truth(path.parent)]
    if not splits:
        raise FileNotFoundError(f"{data}: expected simulated splits in this folder, found none")
    _check_disjoint(splits)
    write_atomic(data / FILE, ("\n".join(_lines(data, splits)) + "\n").encode())
    return data / FILE


def _split(root: Path) -> SplitCard:
    scenes = read_scenes(root / "scenes.jsonl")
    missing = {sequence for sequence, _ in scenes} - set(finished_sequences(root))
    if missing:
        raise ValueError(f"{root}: expected all {len(scenes)} drives, {len(missing)} are missing; simulate them first")
    return SplitCard(root, read_info(root), tuple(scene for _, scene in scenes))


def _check_disjoint(splits: Sequence[SplitCard]) -> None:
    """Seeds are drawn from 2^31 numbers, so that one may come up twice; a road may not."""
    owners: dict[str, str] = {}
    for split in splits:
        for scene in split.scenes:
            owner = owners.setdefault(scene.road.model_dump_json(), split.info.split)
            if owner != split.info.split:
                raise ValueError(f"{split.root}: expected roads of its own, one is also in the split {owner}")


def _lines(data: Path, splits: Sequence[SplitCard]) -> list[str]:
    first = splits[0].info
    drawn = "of scenes that were not drawn" if first.seed is None else f"seed {first.seed}"
    unlit = sum(_minutes(_unlit(split.scenes)) for split in splits) / sum(_minutes(split.scenes) for split in splits)
    return [
        "# Data card",
        "",
        f"Simulated night drives in PVDN's format: {sum(split.num_images for split in splits):,} images, "
        f"{unlit:.0%} of the minutes without any vehicle's light. No real image is in it, and no person.",
        f"Made by {first.made_with['generator']}, {drawn}; no two splits share a road.",
        "",
        "| split | drives | images | minutes | without vehicles' light, minutes | images a second |",
        "|---|---|---|---|---|---|",
        *(
            f"| `{split.root.relative_to(data)}` | {len(split.scenes)} | {split.num_images:,} | "
            f"{_minutes(split.scenes):.1f} | {_minutes(_unlit(split.scenes)):.1f} | {split.info.rate_hz:g} |"
            for split in splits
        ),
        "",
        "Every camera has the same drives; what follows counts each drive once.",
        "",
        *_table("scenario", Counter(scene.name for scene in _each_once(splits))),
        *_table("vehicles with lamps on", Counter(_lit_kinds(_each_once(splits)))),
        *_table("conditions", Counter(_conditions(_each_once(splits)))),
        "Labels: key points of lamps in sight and of their light on other things, as `simulation/info.json` of each "
        "split defines them (`label_rule`). What is not in it: glare of the sun, other countries' signs, tunnels, "
        "pedestrians, animals.",
    ]


def _each_once(splits: Sequence[SplitCard]) -> list[Scene]:
    """The scenes of all splits; those of further cameras are left out."""
    return list({scene.road.model_dump_json(): scene for split in splits for scene in split.scenes}.values())


def _table(title: str, counts: Counter[str]) -> list[str]:
    rows = [f"| {name} | {count} |" for name, count in counts.most_common()]
    return [f"| {title} | number |", "|---|---|", *rows, ""]


def _minutes(scenes: Iterable[Scene]) -> float:
    return sum(scene.duration_s for scene in scenes) / 60.0


def _unlit(scenes: Iterable[Scene]) -> list[Scene]:
    return [scene for scene in scenes if all(vehicle.beam == "off" for vehicle in scene.vehicles)]


def _lit_kinds(scenes: Iterable[Scene]) -> list[str]:
    return [vehicle.kind for scene in scenes for vehicle in scene.vehicles if vehicle.beam != "off"]


def _conditions(scenes: Iterable[Scene]) -> list[str]:
    found = []
    for scene in scenes:
        weather = scene.weather
        is_wet, is_misty = scene.road.wetness > 0.25, weather.scattering_per_m > 1e-3
        facts = {
            "rain": weather.rain_mm_h > 0,
            "snowfall": weather.snow_mm_h > 0,
            "mist": is_misty and not (weather.rain_mm_h or weather.snow_mm_h),
            "wet road": is_wet,
            "lit street": sum(lamp.intensity_cd > 0 for lamp in scene.surroundings.street_lamps) > 3,
            "left-hand traffic": scene.road.traffic == "left",
        }
        found += [name for name, holds in facts.items() if holds]
    return found


if __name__ == "__main__":
    print(write_data_card(Path(sys.argv[1])))  # noqa: T201
