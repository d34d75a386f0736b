"""`simulate`: night drives."""

from __future__ import annotations

import contextlib
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from foreglow.cli.app import ClusterOption, app, file, folder, size_of

if TYPE_CHECKING:
    from foreglow.lab import simulation
    from foreglow.lab.simulation import Scene
    from foreglow.parallel import Workers


@app.command()
def simulate(
    out: Annotated[Path | None, folder(help="Folder of the data set, or of the preview.")] = None,
    scenes: Annotated[int, typer.Option(min=1, metavar="N", help="How many drives to draw.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is drawn: the same seed, the same bytes.")] = 7,
    split: Annotated[str, typer.Option(metavar="train|val|test", help="The split, with drives of its own.")] = "train",
    scene: Annotated[list[Path] | None, file(help="Your own scene, TOML, in place of drawn ones; repeatable.")] = None,
    preview: Annotated[str | None, typer.Option(metavar="NAME", help="Only show one drive of this scenario.")] = None,
    print_scene: Annotated[
        str | None, typer.Option("--print", metavar="NAME", help="Only write a drawn scenario as TOML to stdout.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images (default: 1280x960).")] = None,
    cycle: Annotated[str, typer.Option(metavar="day|night", help="Short or long exposure of the night.")] = "day",
    ego_beam: Annotated[
        str | None, typer.Option(metavar="low|high|matrix", help="Our own beam (default: low).")
    ] = None,
    empty: Annotated[bool, typer.Option("--empty", help="Leave out all vehicles whose lamps are lit.")] = False,
    fps: Annotated[float, typer.Option(min=0.1, max=1000.0, help="Frames a second.")] = 18.0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; one uses all cores and is quickest up to four.")] = 1,
    cluster: ClusterOption = None,
    quality: Annotated[str, typer.Option(metavar="fast|training|fine", help="How finely it renders.")] = "training",
) -> None:
    """Simulate night drives: a data set in PVDN's format with the truth beside it, or a preview of one drive."""
    from foreglow.lab import simulation
    from foreglow.parallel import workers_at

    workers = workers_at(jobs, cluster)
    if print_scene is not None:
        drawn = _changed((simulation.scenario(print_scene, seed),), ego_beam, empty)
        typer.echo(simulation.scene_to_toml(drawn[0]), nl=False)
    elif preview is not None:
        drawn = _own_scenes(scene) or (simulation.scenario(preview, seed),)
        _preview(
            _adapted(_changed(drawn, ego_beam, empty), size or "640x480", fps, cycle)[0],
            out or Path("preview_output") / preview,
            quality,
        )
    else:
        drawn = _own_scenes(scene) or simulation.draw_scenes(scenes, seed, cast("simulation.Split", split))
        drawn = _changed(drawn, ego_beam, empty)
        _simulate(_adapted(drawn, size or "1280x960", fps, cycle), out, (seed, split, cycle), workers, quality)


def _own_scenes(files: list[Path] | None) -> tuple[Scene, ...]:
    """The scenes in the given files."""
    from foreglow.lab.simulation import read_scene

    return tuple(read_scene(file) for file in files or ())


def _changed(scenes: tuple[Scene, ...], ego_beam: str | None, is_empty: bool) -> tuple[Scene, ...]:
    """The scenes with the beam of ours that was asked for, and without traffic if so."""
    from foreglow.lab.simulation import EGO_BEAMS, with_beam, without_traffic

    if ego_beam is not None:
        if ego_beam not in EGO_BEAMS:
            raise ValueError(f"--ego-beam: expected one of {', '.join(EGO_BEAMS)}, got {ego_beam!r}")
        scenes = tuple(with_beam(one, ego_beam) for one in scenes)
    return tuple(without_traffic(one) for one in scenes) if is_empty else scenes


def _adapted(scenes: tuple[Scene, ...], size: str, fps: float, cycle: str) -> tuple[Scene, ...]:
    """The scenes with the size, the frame rate and the exposure that were asked for."""
    from foreglow.lab.simulation import adapted

    size_px = size_of(size)
    return tuple(adapted(scene, size_px, fps, cycle) for scene in scenes)


def _preview(scene: Scene, out: Path, quality: str) -> None:
    """Renders one drive with its labels drawn, and says where to look."""
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.simulation import drive_frames
    from foreglow.lab.simulation.preview import preview

    out.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(SceneProgress(1, scene.num_frames)) as progress:
        sheet, movie = preview(drive_frames(scene, quality), scene.num_frames, scene.rate_hz, out, progress)
    typer.echo(f"{scene.num_frames} frames of {scene.name}: {sheet} and {movie}")


def _simulate(
    scenes: tuple[Scene, ...], out: Path | None, origin: tuple[int, str, str], workers: Workers, quality: str
) -> None:
    """Writes the data set, and says what is in it."""
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.reports.tables import dataset_lines
    from foreglow.lab.simulation import DatasetConfig, drive_frames, simulate_dataset

    if out is None:
        raise ValueError("simulate: expected --out DIR, --preview NAME or --print NAME")
    seed, split, cycle = origin
    config = DatasetConfig.of(seed=seed, split=split, cycle=cycle, quality=quality)
    drive = functools.partial(drive_frames, quality=quality)
    with contextlib.closing(SceneProgress(len(scenes), sum(one.num_frames for one in scenes))) as progress:
        summary = simulate_dataset(out, scenes, drive, config, workers=workers, progress=progress)
    typer.echo("\n".join(dataset_lines(summary)))
