"""The files that a scene names, with the light of low beams."""

from __future__ import annotations

from pathlib import Path

from foreglow.files import file_digest
from foreglow.lab.simulation.scenes.scene import EgoSpec, Scene, VehicleSpec


def lamp_files(scene: Scene) -> dict[str, Path]:
    """By field, such as `vehicles.0.low_beam_file`, the files that `scene` names."""
    owners: dict[str, EgoSpec | VehicleSpec] = {"ego": scene.ego}
    owners |= {f"vehicles.{index}": vehicle for index, vehicle in enumerate(scene.vehicles)}
    named = {f"{owner}.low_beam_file": spec.low_beam_file for owner, spec in owners.items()}
    return {field: Path(file) for field, file in named.items() if file is not None}


def lamp_digests(scene: Scene) -> dict[str, str]:
    """By field, the SHA-256 of each of `lamp_files`: images depend on their contents, whatever they are called.

    Raises:
        OSError: If there is no such file, or it cannot be read.
        ValueError: If one is no regular file.
    """
    return {field: f"sha256:{file_digest(path)}" for field, path in lamp_files(scene).items()}
