"""`experiment glare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foreglow.command_line import argument, folder, option
from foreglow.options import BeamOptions, PaperModelOption, PipelineOptions, QualityOption, WorkerOptions

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.lab.studies.glare.run import GlarePlan, NamedScene


def command(
    scenes: Annotated[Path, argument("SCENES", "A simulated split, its scenes.jsonl, or val for long drives.")],
    out: Annotated[Path, folder("Folder for the report; an interrupted experiment in it is continued.")],
    lamps: BeamOptions,
    pipeline: PipelineOptions,
    work: WorkerOptions,
    paper_model: PaperModelOption = None,
    num: Annotated[int | None, option("N", "Only the first N scenes.", "--scenes", min=1)] = None,
    empty: Annotated[int, option("N", "Also drive the first N scenes without traffic.", min=0)] = 0,
    camera_delay: Annotated[
        float, option("S", "Time from the exposure until the command is on the bus.", min=0.0, max=1.0)
    ] = 0.05,
    lamp_delay: Annotated[float, option("S", "Time from the command until the light follows.", min=0.0, max=1.0)] = 0.1,
    video: Annotated[str | None, option("NAME", "Also film this scene, such as S00004.")] = None,
    also: Annotated[
        list[Path] | None, option("CONFIG.toml", "Also drive with this configuration, as a row of its own; repeatable.")
    ] = None,
    camera: Annotated[
        str | None, option("NAME", "Camera of the simulator, or its profile, instead of the scenes' own.")
    ] = None,
    quality: QualityOption = "training",
    seed: Annotated[int, option("N", "Seed of the confidence intervals.", min=0)] = 1,
) -> None:
    """Drive scenes in closed loop with six beam policies, and measure the light at other drivers' eyes in lux."""
    from foreglow.display.progress import SceneProgress
    from foreglow.lab.reports.figures import require_matplotlib
    from foreglow.lab.studies.glare.loop import Delays
    from foreglow.lab.studies.glare.page import summary_lines, write_experiment
    from foreglow.lab.studies.glare.run import GlarePlan, named_scenes, run_experiment
    from foreglow.lab.studies.reproduction.claims import beside_paper

    require_matplotlib()
    workers = work.workers()
    delays = Delays(camera_s=camera_delay, lamp_s=lamp_delay)
    plan = GlarePlan(
        num_scenes=num,
        num_empty=empty,
        delays=delays,
        quality=quality,
        seed=seed,
        paper_model=paper_model,
        also=tuple(also or ()),
        camera=camera,
    )
    chosen = named_scenes(scenes, plan)
    filmed = [named for named in chosen if named.name == video]
    if video is not None and not filmed:
        raise ValueError(f"--video: expected one of the scenes, {chosen[0].name} to {chosen[-1].name}, got {video!r}")
    configuration = lamps.commanding(pipeline.configuration())
    with SceneProgress(len(chosen), sum(named.scene.num_frames for named in chosen)) as progress:
        experiment = run_experiment(scenes, configuration, plan, out, workers=workers, progress=progress)
    for named in filmed:
        _film(named, configuration, plan, out)
    report = write_experiment(experiment)
    beside = beside_paper("glare", out / "results.json")
    typer.echo("\n".join([*summary_lines(experiment.results), *experiment.remarks, *beside, f"look in {report}"]))


def _film(named: NamedScene, config: PipelineConfig, plan: GlarePlan, out: Path) -> None:
    from foreglow.lab.studies.glare.film import write_film
    from foreglow.lab.studies.glare.simulate import own_name
    from foreglow.photometry import read_headlamps

    drives = plan.drives(plan.delays.known_to(config))
    titles, rate_hz = ("paper", own_name(config)), named.scene.rate_hz
    headlamps = read_headlamps(config.beam.headlamps)
    frames = ((paper, ours) for ours, paper, *_ in drives.frames(named.scene))
    write_film(frames, titles, headlamps, rate_hz, out / f"film_{named.name}.mp4")
