"""`simulate`: night drives."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from foreglow.cli.app import app
from foreglow.command_line import file, flag, folder, listed, option, with_options
from foreglow.options import QualityOption, WorkerOptions, size_from

if TYPE_CHECKING:
    from foreglow.lab import simulation
    from foreglow.lab.simulation import DatasetConfig, DatasetSummary, Scene
    from foreglow.lab.simulation.camera.profile import CameraProfile
    from foreglow.parallel import Workers


_USED_BESIDE = {
    "print_camera": set[str](),
    "print_scene": {"seed", "ego_beam", "empty"},
    "preview": {"out", "scene", "seed", "size", "cycle", "ego_beam", "empty", "fps", "quality"},
}
"""What each option that asks for less than a data set goes with; the first that is given counts."""

_UNUSED_BESIDE = {"scene": {"num_scenes", "seed", "mixture"}, "camera": {"cycle"}}
"""What says nothing about scenes of one's own, and about cameras, whose profiles have a cycle."""


@app.command()
@with_options
def simulate(
    context: typer.Context,
    work: WorkerOptions,
    out: Annotated[Path | None, folder("Folder for the data set, or for the preview.")] = None,
    num_scenes: Annotated[int, option("N", "Number of drives to draw.", "--scenes", min=1)] = 40,
    seed: Annotated[int, option("N", "Seed of everything random; the same seed gives the same bytes.", min=0)] = 7,
    split: Annotated[str, option("train|val|test", "Split to draw; no two splits share a road.")] = "train",
    mixture: Annotated[
        str, option("pvdn|standard|r48", "Scenarios to draw from, as docs/scenes.md lists them.")
    ] = "pvdn",
    scene: Annotated[
        list[Path] | None, file("TOML file of a scene of your own, instead of drawn ones; repeatable.")
    ] = None,
    preview: Annotated[str | None, option("NAME", "Only show one drive of this scenario.")] = None,
    print_scene: Annotated[
        str | None, option("NAME", "Only draw a scene of this scenario, and print it as TOML.", "--print")
    ] = None,
    size: Annotated[
        str | None,
        option("WxH", "Size of the images (default: that of --scene, else 1280x960; 640x480 for --preview)."),
    ] = None,
    cycle: Annotated[
        str | None,
        option("day|night", "PVDN's short or long exposure of the night (default: that of --scene, else day)."),
    ] = None,
    camera: Annotated[
        str | None,
        option("NAME,...", "Camera profiles or their TOML files: each drive is rendered once and exposed for each."),
    ] = None,
    variants: Annotated[
        int,
        option(
            "K",
            "Sequences a drive and camera, with other strengths of light and veil, or unseen lamps.",
            min=1,
            max=1000,
        ),
    ] = 1,
    shares: Annotated[
        str | None, option("PRESET,...", "Store whose light is in the proposals of these presets.")
    ] = None,
    print_camera: Annotated[str | None, option("NAME", "Only print this camera profile as TOML.")] = None,
    ego_beam: Annotated[
        str | None, option("low|high|matrix", "Beam of the car with the camera (default: low).")
    ] = None,
    empty: Annotated[bool, flag("--empty", "Leave out all vehicles that have their lamps on.")] = False,
    fps: Annotated[
        float | None,
        option("HZ", "Frames per second (default: those of --scene, else 18).", min=0.1, max=1000.0),
    ] = None,
    pair_s: Annotated[
        float | None,
        option("S", "Frames come in pairs that are so far apart, half as often.", "--pairs", min=0.001, max=10.0),
    ] = None,
    quality: QualityOption = "training",
) -> None:
    """Simulate night drives: a data set in PVDN's format with its ground truth, or a preview of one drive.

    The renderer uses all cores: up to four of them, a single process is quickest.
    """
    from foreglow.lab import simulation

    _check_unused(context)
    workers = work.workers()
    _check_quality(quality)
    if print_camera is not None:
        from foreglow.lab.simulation.camera.profile import profile_to_toml, read_profile

        typer.echo(profile_to_toml(read_profile(print_camera)), nl=False)
    elif print_scene is not None:
        drawn = _changed((simulation.scenario(print_scene, seed),), ego_beam, empty)
        typer.echo(simulation.scene_to_toml(drawn[0]), nl=False)
    elif preview is not None:
        if len(scene or ()) > 1:
            raise ValueError(f"--preview: expected one --scene, got {len(scene or ())}")
        drawn = _own_scenes(scene) or _usual((simulation.scenario(preview, seed),))
        if scene and preview in simulation.SCENARIOS and preview not in (drawn[0].name, scene[0].stem):
            raise ValueError(
                f"--preview: expected {drawn[0].name}, as {scene[0]} calls its scene, or a name of your own: with "
                f"--scene, the scenario {preview} is not drawn"
            )
        scenes = _adapted(_changed(drawn, ego_beam, empty, scene), size or "640x480", fps, cycle)
        _preview(scenes[0], out or Path("preview_output") / preview, quality)
    elif out is None:
        raise ValueError("simulate: expected --out DIR, --preview NAME, --print NAME or --print-camera NAME")
    else:
        drawn_with = None if scene else seed  # scenes of one's own have their seeds themselves
        used = cycle or _cycle_of(_own_scenes(scene), camera)
        config = simulation.DatasetConfig.of(seed=drawn_with, split=split, cycle=used, quality=quality)
        exposing = _exposing(config, camera, variants, shares)
        for number in (1, num_scenes):  # bad options are told after the first scene, as drawing all takes long
            own_split = cast("simulation.Split", split)
            drawn = _own_scenes(scene) or _usual(simulation.draw_scenes(number, seed, own_split, mixture))
            scenes = _adapted(_changed(drawn, ego_beam, empty, scene if number == 1 else None), size, fps, used, pair_s)
            if exposing is not None:
                exposing.check(scenes)
        if exposing is None:
            _simulate(scenes, out, config, workers, quality)
        else:
            _expose(scenes, out, exposing, workers, quality)


def _check_unused(context: typer.Context) -> None:
    """ValueError if an option was given that has no effect beside another one."""
    names = {parameter.name: parameter.opts[0] for parameter in context.command.params}
    given = {name for name in names if (source := context.get_parameter_source(name)) and source.name != "DEFAULT"}
    unused = {beside: given & others for beside, others in _UNUSED_BESIDE.items() if beside in given}
    mode = next((name for name in _USED_BESIDE if name in given), None)
    if mode is not None:
        unused = {mode: given - _USED_BESIDE[mode] - {mode}, **unused}
    for beside, others in unused.items():
        for name in others:
            raise ValueError(f"{names[name]}: expected without {names[beside]}, beside which it has no effect")


def _check_quality(quality: str) -> None:
    from foreglow.lab.simulation.light.sampling import QUALITIES

    if quality not in QUALITIES:
        raise ValueError(f"--quality: expected one of {', '.join(QUALITIES)}, got {quality!r}")


def _own_scenes(files: list[Path] | None) -> tuple[Scene, ...]:
    from foreglow.lab.simulation.drivable import read_drivable

    return tuple(read_drivable(file) for file in files or ())


def _changed(
    scenes: tuple[Scene, ...], ego_beam: str | None, is_empty: bool, files: list[Path] | None = None
) -> tuple[Scene, ...]:
    """The scenes with the beam asked for, and without traffic if asked for; warns of what those of `files` lose."""
    from foreglow.lab.simulation import EGO_BEAMS, with_beam, without_traffic
    from foreglow.lab.simulation.drivable import with_beam_of

    if ego_beam is not None:
        if ego_beam not in EGO_BEAMS:
            raise ValueError(f"--ego-beam: expected one of {', '.join(EGO_BEAMS)}, got {ego_beam!r}")
        if files:
            scenes = tuple(with_beam_of(scene, ego_beam, file) for scene, file in zip(scenes, files, strict=True))
        else:
            scenes = tuple(with_beam(scene, ego_beam) for scene in scenes)
    return tuple(without_traffic(scene) for scene in scenes) if is_empty else scenes


def _usual(scenes: tuple[Scene, ...]) -> tuple[Scene, ...]:
    """Drawn scenes, as they are without options."""
    return _adapted(scenes, "1280x960", 18.0, "day")


def _cycle_of(scenes: tuple[Scene, ...], camera: str | None) -> str:
    """That of scenes of one's own, of which there may be none, where no camera has one and none was asked for."""
    found = {str(scene.sensor.exposure) for scene in scenes} or {"day"}
    if len(found) > 1 and camera is None:
        raise ValueError("--cycle: expected one, as the scenes have both day and night, and a data set has one")
    return min(found)


def _adapted(
    scenes: tuple[Scene, ...], size: str | None, fps: float | None, cycle: str | None, pair_s: float | None = None
) -> tuple[Scene, ...]:
    """The scenes with the image size, frame rate and exposure asked for, or else their own."""
    from foreglow.lab.simulation import adapted

    size_px = None if size is None else size_from(size)
    made = []
    for scene in scenes:
        rate_hz, exposure = fps or scene.rate_hz, cycle or scene.sensor.exposure
        if pair_s is not None and pair_s >= 2.0 / rate_hz:
            raise ValueError(f"--pairs: expected below two frames of --fps, {2.0 / rate_hz:g} s, got {pair_s:g}")
        own_size_px = scene.camera.width_px, scene.camera.height_px
        made.append(adapted(scene, size_px or own_size_px, rate_hz, exposure, pair_s or scene.pair_s))
    return tuple(made)


def _preview(scene: Scene, out: Path, quality: str) -> None:
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.simulation import drive_frames
    from foreglow.lab.simulation.preview import preview

    out.mkdir(parents=True, exist_ok=True)
    with SceneProgress(1, scene.num_frames) as progress:
        sheet, movie = preview(drive_frames(scene, quality), scene, out, progress)
    typer.echo(f"{scene.num_frames} frames of {scene.name}: {sheet} and {movie}")


def _simulate(scenes: tuple[Scene, ...], out: Path, config: DatasetConfig, workers: Workers, quality: str) -> None:
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.simulation import drive_frames, simulate_dataset

    drive = functools.partial(drive_frames, quality=quality)
    with SceneProgress(len(scenes), sum(scene.num_frames for scene in scenes)) as progress:
        summary = simulate_dataset(out, scenes, drive, config, workers=workers, progress=progress)
    typer.echo("\n".join(_lines(summary)))


@dataclass(frozen=True, slots=True)
class _Exposing:
    """What is made of each drive: for each camera, some variants, with shares for the proposals of some presets."""

    configs: tuple[DatasetConfig, ...]
    num_variants: int
    presets: tuple[str, ...]
    origins: tuple[str, ...]
    """Names or files of the cameras, as they were given."""

    @property
    def profiles(self) -> tuple[CameraProfile | None, ...]:
        return tuple(config.camera for config in self.configs)

    def check(self, scenes: tuple[Scene, ...]) -> None:
        from foreglow.lab.simulation.drive import check_exposures

        cameras = zip(self.origins, self.profiles, strict=True) if self.origins else ()
        check_exposures({f"--camera {origin}": each for origin, each in cameras if each}, scenes, self.presets)


def _exposing(config: DatasetConfig, camera: str | None, num_variants: int, shares: str | None) -> _Exposing | None:
    """What `--camera`, `--variants` and `--shares` ask for; None without any of them."""
    from foreglow.lab.simulation.camera.profile import read_profiles

    if camera is None and num_variants == 1 and shares is None:
        return None
    presets = () if shares is None else listed("--shares", shares)
    profiles = (None,) if camera is None else read_profiles(camera)
    origins = () if camera is None else tuple(part.strip() for part in camera.split(","))
    configs = tuple(config.exposed_for(profile, presets) for profile in profiles)
    return _Exposing(configs, num_variants, presets, origins)


def _expose(scenes: tuple[Scene, ...], out: Path, exposing: _Exposing, workers: Workers, quality: str) -> None:
    """Writes a data set for each camera."""
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.simulation import Target, drive_exposures, simulate_datasets

    names = [profile.name for profile in exposing.profiles if profile is not None]
    folders = [out / name for name in names] if len(names) > 1 else [out]
    targets = [Target(folder, config) for folder, config in zip(folders, exposing.configs, strict=True)]
    num_variants = exposing.num_variants
    expose = functools.partial(
        drive_exposures,
        profiles=exposing.profiles,
        num_variants=num_variants,
        quality=quality,
        presets=exposing.presets,
    )
    with SceneProgress(len(scenes), sum(scene.num_frames for scene in scenes)) as progress:
        summaries = simulate_datasets(
            targets, scenes, expose, num_variants=num_variants, workers=workers, progress=progress
        )
    for summary in summaries:
        typer.echo("\n".join(_lines(summary)))


def _lines(summary: DatasetSummary) -> list[str]:
    """What is in a simulated data set; the last line says where it is."""
    from foreglow.display.summary_lines import counted

    labels = summary.labels
    drives = counted(labels.num_sequences, "drive")
    if summary.num_kept:
        drives += f" ({summary.num_kept} of them were there)"
    return [
        f"{drives}, {counted(labels.num_images, 'image')}, {labels.num_empty_images} of them without any instance",
        f"instances: {labels.num_direct} direct, {labels.num_indirect} indirect, {labels.num_doubtful} doubtful",
        f"look in {summary.root}; foreglow run, evaluate and every later command read it as PVDN",
    ]
