"""The experiment on glare: scenes driven in closed loop, scored in lux at other drivers' eyes."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pydantic import Field

from foreglow.beam.receiver import ReceiverConfig
from foreglow.config import FrozenModel, PipelineConfig, config_to_toml, read_config
from foreglow.datasets.json_files import Record, read_json
from foreglow.datasets.simulated.files import sequence_name
from foreglow.files import file_digest, read_plain_json, to_json, write_json_results
from foreglow.lab.evaluation.occurrence import LeadScore, Sighting, lead_scores
from foreglow.lab.learning.kept_files import checksum_of
from foreglow.lab.simulation import Scene, Split, long_drives, with_beam, without_traffic
from foreglow.lab.simulation.camera.profile import profile_to_toml, read_profile
from foreglow.lab.simulation.scenes.lamp_files import lamp_digests
from foreglow.lab.simulation.scenes.scenarios import SPLITS
from foreglow.lab.simulation.scenes.scene import LOW_BEAM_FIELDS
from foreglow.lab.simulation.writing.dataset import Progress
from foreglow.lab.simulation.writing.scene_files import read_scenes
from foreglow.lab.studies.config_files import MODULE, files_of
from foreglow.lab.studies.glare.drive import GlareDrive, read_glare_drive, write_glare_drive
from foreglow.lab.studies.glare.eyes import FMVSS_108, R123
from foreglow.lab.studies.glare.loop import Delays, Shone
from foreglow.lab.studies.glare.scores import POLICY_ROWS, GlareResults, SensitivityPoint, score_glare
from foreglow.lab.studies.glare.simulate import Drives, own_name, settings_of
from foreglow.lab.studies.paper_chain import paper_chain
from foreglow.parallel import Local, Parent, Workers
from foreglow.provenance import provenance
from foreglow.whole_files import together, write_atomic
from foreglow.wording import shortened

DRIVES = "drives"
"""Folder of the scenes that are finished."""

PLAN, CONFIG = "plan.json", "config.toml"


NUM_LONG, LONG_SEED = 24, 41
"""How many long drives there are of a split, unless told otherwise, and the seed that they are drawn with."""

WHAT_DECIDES = ("quality", "delays", "camera", "paper_model", "also")
"""Fields of a plan that decide what a finished scene holds, as the configuration does."""


class GlarePlan(FrozenModel):
    """What is driven, and how.

    Attributes:
        num_scenes: How many of the scenes, from the first on; None for all.
        num_empty: How many of these are also driven without traffic, to find dimming that nobody needs; but for those
            that have none: the same drive would count twice.
        quality: Of the renderer: `fast`, `training` or `fine`.
        paper_model: The paper's network, with which its row is its whole chain; None for our detector in it.
        also: Configurations of further cars, whose rows are called as the files.
        camera: A camera's name or profile; None for the scenes' own.
    """

    num_scenes: int | None = None
    num_empty: int = 0
    delays: Delays = Delays()
    quality: str = "training"
    seed: int = 1
    paper_model: Path | None = None
    also: tuple[Path, ...] = ()
    camera: str | None = None

    def drives(self, config: PipelineConfig) -> Drives:
        """What drives the scenes, with `config` for our pipeline.

        Raises:
            FileNotFoundError: If there is no such model of the paper, configuration or camera.
            ValueError: If the headlamps do not fit, or a configuration or camera is broken.
        """
        chain = None if self.paper_model is None else paper_chain(self.paper_model, config.guard.white_level)
        profile = None if self.camera is None else read_profile(self.camera)
        return Drives(config, self.delays, self.quality, chain, self.others(config), profile)

    def others(self, config: PipelineConfig) -> dict[str, PipelineConfig]:
        """The configurations of further cars, by the names of their rows: what differs from `config` is in the files.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If one is broken, is called as another row, has a latency other than the delays, or other
                headlamps: the light of all rows is computed with those of `config`.
        """
        names = [path.stem for path in self.also]
        taken = {*POLICY_ROWS, own_name(config), *(setting.name for setting in settings_of(self.delays))}
        found: dict[str, PipelineConfig] = {}
        for path in self.also:
            if path.stem in taken or names.count(path.stem) > 1:
                raise ValueError(f"{path}: expected a file that is called unlike any other row, got {path.stem!r}")
            own = read_config(path, config)
            try:
                found[path.stem] = self.delays.known_to(own)
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from error
            lamps, of_all = found[path.stem].beam.headlamps, config.beam.headlamps
            if lamps != of_all:
                raise ValueError(f"{path}: beam.headlamps: expected {of_all}, which all cars have, got {lamps}")
        return found


@dataclass(frozen=True, slots=True)
class NamedScene:
    """A scene and what its files are called."""

    name: str
    scene: Scene


@dataclass(frozen=True, slots=True)
class GlareExperiment:
    """The results of the experiment.

    Attributes:
        results: By the limits of 49 CFR 571.108, with the curves over latency, margin and thresholds.
        others: The results by other limits.
        leads: How well it was predicted where hidden vehicles would appear, over all scenes.
        remarks: What is different here from the scenes as their data set has them, or odd in them, a sentence each.
    """

    results: GlareResults
    others: tuple[GlareResults, ...]
    leads: tuple[LeadScore, ...]
    folder: Path
    remarks: tuple[str, ...] = ()

    def drives(self, names: Sequence[str]) -> tuple[GlareDrive, ...]:
        """The drives called `names`."""
        return tuple(read_glare_drive(_drive_file(self.folder, name)) for name in names)


def run_experiment(
    scenes: Path,
    config: PipelineConfig,
    plan: GlarePlan,
    folder: Path,
    *,
    workers: Workers | None = None,
    progress: Progress,
) -> GlareExperiment:
    """Drives the scenes that `folder` does not have yet, and scores all; without workers, drives in this process.

    Raises:
        FileNotFoundError: If there are no scenes, or a model of a car does not exist.
        ValueError: If they are broken, a stage of a car cannot be made, the folder holds an experiment with another
            plan, model or scene, or a file of a car is changed while it drives.
        OSError: If something cannot be written; scenes that are finished stay, and without any of them the plan goes.
    """
    config = plan.delays.known_to(config)
    wanted = named_scenes(scenes, plan)
    _check_rates(wanted, [config, *plan.others(config).values()])
    plan.drives(config).cars()  # what is wrong with one is known before there is a folder
    lamps = _lamp_digests(wanted)
    is_new, is_made = not (folder / PLAN).exists(), not folder.exists()
    (folder / DRIVES).mkdir(parents=True, exist_ok=True)
    _claim(folder, config, plan, wanted, lamps)
    try:
        _drive_missing(folder, config, plan, wanted, workers or Local(), progress)
    except Exception:
        if is_new and not any((folder / DRIVES).iterdir()):  # such as without the renderer: another plan may come
            for name in (PLAN, CONFIG):
                (folder / name).unlink()
            (folder / DRIVES).rmdir()
            if is_made:
                folder.rmdir()
        raise
    return _scored(folder, wanted, plan, own_name(config), name_of(scenes))


def _drive_missing(
    folder: Path,
    config: PipelineConfig,
    plan: GlarePlan,
    wanted: Sequence[NamedScene],
    workers: Workers,
    progress: Progress,
) -> None:
    todo: dict[str, tuple[int, NamedScene]] = {}
    for number, named in enumerate(wanted, start=1):
        if _sightings_file(folder, named.name).exists():  # written after the drive
            progress(number, named.scene.num_frames, named.scene.num_frames)
        else:
            todo[named.name] = number, named
    work = functools.partial(_drive, folder, config, plan)
    for _ in workers.each(work, todo, progress, paths=(folder,)):
        pass


def named_scenes(path: Path, plan: GlarePlan) -> list[NamedScene]:
    """The scenes of the plan, those without traffic last: those of a split's folder or file, or long drives of `val`.

    Raises:
        FileNotFoundError: If there is no such file or folder.
        ValueError: If it holds no scenes.
    """
    found: Sequence[tuple[int, Scene]]
    if str(path) in SPLITS and not path.exists():
        found = list(enumerate(long_drives(plan.num_scenes or NUM_LONG, LONG_SEED, cast("Split", str(path))), start=1))
    else:
        found = read_scenes(path / "scenes.jsonl" if path.is_dir() else path)[: plan.num_scenes]
    named = [NamedScene(sequence_name(number), scene) for number, scene in found]
    empty = [NamedScene(f"{whole.name}-empty", without_traffic(whole.scene)) for whole in named[: plan.num_empty]]
    scenes = [whole.scene for whole in named]
    return named + [each for each in empty if each.scene not in scenes]


def _check_rates(wanted: Sequence[NamedScene], configs: Sequence[PipelineConfig]) -> None:
    """Checks that no scene is so slow that guards or lamps, for which frames are missing then, never give light.

    Raises:
        ValueError: If one is.
    """
    longest_s = min([ReceiverConfig().deadline_s, *(config.guard.max_gap_s for config in configs)])
    for named in wanted:
        scene = named.scene
        step_s = max(scene.time_s(number + 1) - scene.time_s(number) for number in (0, 1))
        if step_s > longest_s + 1e-9:
            raise ValueError(
                f"{named.name}: rate_hz: expected at most {longest_s:g} s from frame to frame, as guard and lamps take "
                f"longer intervals for missing frames, got {scene.rate_hz:g} Hz with up to {step_s:g} s"
            )


class _Claimed(Record):
    """What `plan.json` says: the plan; digests of the whole, of models and other files of the configurations, and of
    scenes; and which version drove them, with all commits of it that did.
    """

    plan: dict[str, Any] = Field(default_factory=dict)
    digest: str = ""
    version: str = ""
    commits: list[str | None] = Field(default_factory=list)
    models: dict[str, str] = Field(default_factory=dict)
    scenes: dict[str, str] = Field(default_factory=dict)


def _lamp_digests(wanted: Sequence[NamedScene]) -> dict[str, str]:
    """Digests of the files with the light of other vehicles; that of our low beam is not used here."""
    return {
        f"{field} of {named.name}": digest
        for named in wanted
        for field, digest in lamp_digests(with_beam(named.scene, "matrix")).items()
    }


def _claim(
    folder: Path, config: PipelineConfig, plan: GlarePlan, wanted: Sequence[NamedScene], lamps: Mapping[str, str]
) -> None:
    """Writes the plan to the folder, or checks that the plan that is there is the same, and so is what both drive."""
    about: dict[str, Any] = {"plan": plan.model_dump(mode="json"), "digest": _digest(config, plan)}
    files = _file_digests(config, plan) | dict(lamps)
    scenes = {named.name: hashlib.sha256(named.scene.model_dump_json().encode()).hexdigest() for named in wanted}
    file, made_with = folder / PLAN, provenance()
    commits = [made_with["commit"]]
    if file.exists():
        known = read_json(file, _Claimed)
        if known.version not in ("", made_with["version"]):
            raise ValueError(
                f"{file}: version: expected {known.version}, which drove the scenes here, got {made_with['version']}; "
                "choose another folder"
            )
        commits = list(dict.fromkeys([*known.commits, *commits]))
        if known.digest != about["digest"]:
            for name in WHAT_DECIDES:
                before, now = known.plan.get(name, about["plan"][name]), about["plan"][name]
                if before != now:
                    words = f"expected {shortened(before)} as here before, got {shortened(now)}"
                    raise ValueError(f"{file}: plan.{name}: {words}; choose another folder")
            raise ValueError(f"{file}: expected the configurations as they were here before; choose another folder")
        for kind, digests, before in (("models", files, known.models), ("scenes", scenes, known.scenes)):
            other = next((name for name in digests if before.get(name, digests[name]) != digests[name]), None)
            if other is not None:
                raise ValueError(f"{file}: {kind}: expected {other} as it was here before; choose another folder")
            digests |= before
    about |= {"models": files, "scenes": scenes, "commits": commits}
    with together():
        write_json_results(file, about | made_with, indent=2)
        write_atomic(folder / CONFIG, config_to_toml(config).encode())


def _file_digests(config: PipelineConfig, plan: GlarePlan) -> dict[str, str]:
    """Digests of the files that the cars' configurations name, by name."""
    named = (files_of(each) for each in (config, *plan.others(config).values()))
    return {name: file_digest(path) for found in named for name, path in found.items()}


def _check_claimed(folder: Path, config: PipelineConfig, plan: GlarePlan, named: NamedScene) -> None:
    """Checks that all files are as the plan in the folder says, as each drive opens them anew; but not those of
    plug-ins, which a process loads once, and on which somebody may work meanwhile.

    Raises:
        ValueError: If one is not.
    """
    file, digests = folder / PLAN, _file_digests(config, plan) | _lamp_digests([named])
    known = read_json(file, _Claimed)
    opened = {name: digest for name, digest in digests.items() if not name.startswith(MODULE)}
    changed = [name for name, digest in opened.items() if known.models.get(name, digest) != digest]
    if changed or known.digest != _digest(config, plan):
        what = changed[0] if changed else "a configuration, the camera or the paper's model"
        raise ValueError(f"{file}: {what} was changed while scenes were driven; choose another folder")


def _digest(config: PipelineConfig, plan: GlarePlan) -> str:
    """Digest of everything that decides what a finished scene holds; more scenes may be added later."""
    parts: list[Any] = [config.model_dump(mode="json"), plan.delays.model_dump(mode="json"), plan.quality]
    parts += [config.model_dump(mode="json") for config in plan.others(config).values()]
    if plan.camera is not None:
        parts.append(profile_to_toml(read_profile(plan.camera)))
    if plan.paper_model is not None:
        chain = paper_chain(plan.paper_model, config.guard.white_level)
        assert chain.classifier.model is not None
        parts.append(file_digest(chain.classifier.model))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _drive(folder: Path, config: PipelineConfig, plan: GlarePlan, item: tuple[int, NamedScene], parent: Parent) -> None:
    number, named = item
    drives = plan.drives(config)

    def frames() -> Iterator[tuple[Shone, ...]]:
        for num_done, shone in enumerate(drives.frames(named.scene), start=1):
            yield shone
            parent.report_progress(number, num_done, named.scene.num_frames)
            if parent.is_stopped:
                raise KeyboardInterrupt

    drive, sightings = drives.driven(named.scene, named.name, frames())
    _check_claimed(folder, config, plan, named)
    write_glare_drive(_drive_file(folder, named.name), drive)
    keep_sightings(_sightings_file(folder, named.name), sightings)


def _drive_file(folder: Path, name: str) -> Path:
    return folder / DRIVES / f"{name}.npz"


def _sightings_file(folder: Path, name: str) -> Path:
    return folder / DRIVES / f"{name}.json"


def keep_sightings(path: Path, sightings: Sequence[Sighting]) -> None:
    """Writes what was expected of a drive's hidden vehicles, with a checksum."""
    rows = to_json(list(sightings))
    write_json_results(path, {"sightings": rows, "checksum": checksum_of(rows)})


def kept_sightings(path: Path) -> list[Sighting]:
    """What `keep_sightings` has written.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not as it was written.
    """
    kept = read_plain_json(path)
    rows = kept.get("sightings") if isinstance(kept, dict) else None
    if not isinstance(rows, list) or kept.get("checksum") != checksum_of(rows):
        raise ValueError(f"{path}: expected a drive's whole file, found it damaged; remove it to drive the scene again")
    return [Sighting.from_json(row) for row in rows]


def name_of(scenes: Path) -> str:
    """What the scenes at this path are called: by the split's folder, or the file where that has another name.

    >>> name_of(Path("val")), name_of(Path("data/day/test/scenes.jsonl")), name_of(Path("mine.jsonl"))
    ('val', 'test', 'mine.jsonl')
    """
    named = scenes.resolve()
    return named.parent.name if named.name == "scenes.jsonl" else named.name


def _scored(folder: Path, wanted: Sequence[NamedScene], plan: GlarePlan, own: str, name: str) -> GlareExperiment:
    settings = settings_of(plan.delays)
    names = {setting.name for setting in settings}
    if plan.paper_model is not None:
        name = f"{name}, the paper's row by its whole chain"
    scored = []
    for limits in (FMVSS_108, R123):
        drives = (read_glare_drive(_drive_file(folder, named.name)) for named in wanted)
        scored.append(score_glare(name, drives, limits, seed=plan.seed))
    points = tuple(
        SensitivityPoint.of(setting.parameter, setting.unit, setting.value, scored[0].policy(setting.name), own)
        for setting in settings
    )
    results, r123 = (
        dataclasses.replace(
            found, policies=tuple(policy for policy in found.policies if policy.name not in names), sensitivity=points
        )
        for found in scored
    )
    sightings = [sighting for named in wanted for sighting in kept_sightings(_sightings_file(folder, named.name))]
    return GlareExperiment(results, (r123,), lead_scores(sightings), folder, tuple(remarks_on(wanted)))


def remarks_on(wanted: Sequence[NamedScene]) -> Iterator[str]:
    """What to know of the scenes: low beams that the matrix beam replaces, and those that are made for abroad."""
    changed = {named.name: named.scene.ego.changed_low_beam for named in wanted}
    others = [name for name, fields in changed.items() if fields]
    if others:
        fields = ", ".join(f"ego.{field}" for field in LOW_BEAM_FIELDS if any(field in of for of in changed.values()))
        yield (
            f"The scenes of {len(others)} of {len(wanted)} drives ({_some(others)}) have a low beam of their own "
            f"({fields}); here that of the headlamps (--lamps) is in its place."
        )
    for side, other in (("left", "right"), ("right", "left")):
        abroad = [
            named.name for named in wanted if (named.scene.road.traffic, named.scene.ego.traffic) == (side, other)
        ]
        if abroad:
            yield (
                f"The scenes of {len(abroad)} of {len(wanted)} drives ({_some(abroad)}) have traffic on the {side}, "
                f'and a car whose low beam is made for traffic on the {other} (ego.traffic = "{other}"): it shines '
                "highest at oncoming drivers."
            )


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (" and others" if len(names) > 3 else "")
