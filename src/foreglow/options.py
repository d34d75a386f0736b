"""Options that several commands share, each defined once: single ones, and groups that a command takes as one value.

>>> @dataclass(frozen=True)
... class GreetingOptions:
...     '''Greeting.'''
...
...     name: Annotated[str, option("NAME", "Whom to greet.")] = "you"
>>> @with_options
... def greet(greeting: GreetingOptions) -> None:
...     print(f"hello {greeting.name}")
>>> greet(name="there")
hello there
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
import re
import typing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from typer.models import OptionInfo

from foreglow.folder_lock import locked
from foreglow.inputs import named_by
from foreglow.outputs import check_kinds, check_outputs, exists, running
from foreglow.plugins import raising

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import FrameSource, OnError, SplitName
    from foreglow.datasets.vehicle_logs import VehicleFiles
    from foreglow.parallel import Workers

DEFAULT_PRESET = "foreglow"

MAX_INTEGER = 2**31 - 1
"""No count, size or seed on a command line is greater."""


def argument(metavar: str, text: str) -> Any:
    """An argument, with its help."""
    # The readers' errors take a single line, so that typer need not look.
    return typer.Argument(metavar=metavar, help=text, readable=False, callback=_checked)


def option(metavar: str, text: str, *names: str, **settings: Any) -> Any:
    """An option with a value, and its help. A number has a least and a greatest value, `min` and `max`.

    A metavar such as `day|night` lists words: no value of the option is a path, even if there is a file of that name.
    """
    made = typer.Option(*names, metavar=metavar, help=text, **{"callback": _checked, **settings})
    return _with_role(made, "word") if re.fullmatch(r"[a-z0-9_]+(\|[a-z0-9_]+)+", metavar) else made


def _checked(value: Any) -> Any:
    """`value`, if it is no number that no command has a use for.

    Raises:
        typer.BadParameter: For NaN, an infinity, or a whole number of more than 31 bits.
    """
    if isinstance(value, float) and not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    if isinstance(value, int) and abs(value) > MAX_INTEGER:
        raise typer.BadParameter(f"expected at most {MAX_INTEGER}, got a number of {len(str(abs(value)))} digits")
    return value


def flag(name: str, text: str) -> Any:
    """An option without a value, and its help."""
    return typer.Option(name, help=text)


def file(text: str, *names: str, metavar: str = "FILE") -> Any:
    """An option that takes a path, and its help."""
    return option(metavar, text, *names, readable=False)


def output_file(text: str, suffixes: tuple[str, ...], *names: str, metavar: str = "FILE", **settings: Any) -> Any:
    """An option with a file to write, and its help: the command may not read the same file.

    Its name has to end with one of `suffixes`.
    """
    made = _with_role(option(metavar, text, *names, readable=False, **settings), "output file")
    made.suffixes = suffixes
    return made


def folder(text: str, *names: str) -> Any:
    """An option with a folder to write into, and its help: one command does so at a time."""
    return _with_role(file(text, *names, metavar="DIR"), "output folder")


def _with_role(info: Any, role: str) -> Any:
    info.role = role
    return info


def listed(name: str, text: str) -> tuple[str, ...]:
    """The names in the value of an option that takes several, with commas between them.

    Raises:
        ValueError: If one comes twice.

    >>> listed("--split", "val, test")
    ('val', 'test')
    """
    from foreglow.files import check_each_once

    names = tuple(part.strip() for part in text.split(","))
    check_each_once(names, name)
    return names


def refuse_unused(source: str, given: Mapping[str, bool]) -> None:
    """Refuses options that have no effect on a source: those of `given`, by name, that were given.

    Raises:
        ValueError: If there is one; the message names it.
    """
    unused = ", ".join(name for name, is_given in given.items() if is_given)
    if unused:
        raise ValueError(f"{unused}: expected with another kind of SOURCE: no effect on {source}")


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """`function` as a command that checks what it writes, and takes groups of options.

    Each parameter whose type is a dataclass becomes one option per field. In the help, the options of such a group
    stand together, under the first line of the dataclass's docstring. No file or folder that the command writes may be
    one that it reads, and a folder that it writes into is locked while it runs.
    """
    hints = typing.get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if dataclasses.is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(function).parameters.items():
        parameters += _options_of(groups[name]) if name in groups else [parameter.replace(annotation=hints[name])]

    infos = {parameter.name: typing.get_args(parameter.annotation)[1:] for parameter in parameters}
    roles = {name: getattr(info[0], "role", "input") if info else "" for name, info in infos.items()}

    @functools.wraps(function)
    def command(**values: Any) -> None:
        inputs, files, folders = (
            _labelled((_label(name, infos[name][0]), path) for name, path in _paths(values, roles, role))
            for role in ("input", "output file", "output folder")
        )
        inputs |= named_by(inputs)
        suffixes = {
            _label(name, info[0]): info[0].suffixes for name, info in infos.items() if roles[name] == "output file"
        }
        with running(_command_of(function), inputs):
            check_outputs(inputs, files, folders)
            check_kinds(files, suffixes)
            for name, group in groups.items():
                values[name] = group(**{field.name: values.pop(field.name) for field in dataclasses.fields(group)})
            with contextlib.ExitStack() as around:
                around.enter_context(locked(folders))
                for group in values.values():
                    if isinstance(group, PipelineOptions):
                        around.enter_context(group.naming())
                function(**values)

    keywords = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    command.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _command_of(function: Callable[..., None]) -> str:
    """What the user calls the command; that of an experiment is the function `command` of its package."""
    name = function.__name__ if function.__name__ != "command" else f"experiment {function.__module__.split('.')[-2]}"
    return name.strip("_").replace("_", "-")


def _paths(values: dict[str, Any], roles: dict[str, str], role: str) -> Iterator[tuple[str, Path]]:
    """The paths among the values of a command's parameters that have this role; of inputs, those that exist."""
    for name, value in values.items():
        if roles.get(name) != role or value is None:
            continue
        for path in value if isinstance(value, list | tuple) else [value]:
            if isinstance(path, str) and role == "input":
                path = Path(path.removeprefix("simulate:"))
            if isinstance(path, Path) and (role != "input" or exists(path)):
                yield name, path


def _labelled(paths: Iterable[tuple[str, Path]]) -> dict[str, Path]:
    """The paths by label; further ones of the same label are numbered."""
    found: dict[str, Path] = {}
    counts: Counter[str] = Counter()
    for label, path in paths:
        counts[label] += 1
        found[label if counts[label] == 1 else f"{label} ({counts[label]})"] = path
    return found


def _label(name: str, info: Any) -> str:
    """What a parameter is called on the command line."""
    if not isinstance(info, OptionInfo):
        return str(info.metavar or name.upper())
    names = (*([info.default] if isinstance(info.default, str) else []), *(info.param_decls or ()))
    return names[0] if names else f"--{name.replace('_', '-')}"


def _options_of(group: type) -> Iterator[inspect.Parameter]:
    hints = typing.get_type_hints(group, include_extras=True)
    for name, parameter in inspect.signature(group).parameters.items():
        kind, info = typing.get_args(hints[name])
        if isinstance(info, OptionInfo):
            info = copy(info)  # which keeps its role
            info.rich_help_panel = (group.__doc__ or "").partition("\n")[0].rstrip(".")
        yield parameter.replace(annotation=Annotated[kind, info])


SourceArgument = Annotated[
    Path,
    argument(
        "SOURCE", "An image, a folder of images, a video, a recording, a PVDN split (PVDN/day/val) or a PVDN sequence."
    ),
]
OutOption = Annotated[Path, folder("Folder for the results; made if needed.")]
ReportOption = Annotated[Path, folder("Folder for the report.")]
ConfigOption = Annotated[Path | None, file("TOML file whose fields override the preset.")]
ModelOption = Annotated[
    Path | None,
    file("ONNX model of the classifier, or foreglow, which ships; overrides that of the configuration."),
]
CalibrationOption = Annotated[
    Path | None, file("Calibration of the camera (TOML), so that boxes and tracks get ranges.")
]
POSE_ERROR_M = 5.0
"""Of `--pose-error`, if it is not given."""

AUTO = Path("auto")
"""Instead of a calibration file: a calibration from the drive itself."""

LimitOption = Annotated[int | None, option("N", "Stop after N frames.", min=1)]
TopicOption = Annotated[str | None, option("NAME", "Image topic to read from a recording (default: the first).")]
RECORDING_SUFFIXES = (".mcap",)
RECORD_HELP = "Also record everything as MCAP, for replay and for Foxglove."
RecordOption = Annotated[Path | None, output_file(RECORD_HELP, RECORDING_SUFFIXES)]
SplitOption = Annotated[str, option("train|val|test", "Split to measure on, if DATA is a whole data set.")]
PaperModelOption = Annotated[
    Path | None,
    file("Also run the paper's whole chain, with this model: ONNX or a folder of `train`.", metavar="MODEL"),
]
DeviceOption = Annotated[str, option("auto|cpu|cuda", "Device to train on.")]
QualityOption = Annotated[str, option("fast|training|fine", "Quality of the rendering.")]
PatienceOption = Annotated[int | None, option("N", "Stop when N epochs in a row brought no better model.", min=1)]


@dataclass(frozen=True, slots=True)
class PipelineOptions:
    """Pipeline."""

    preset: Annotated[str | None, option("foreglow|paper|baseline", "Preset to start from (default: foreglow).")] = None
    model: ModelOption = None
    config: ConfigOption = None

    def configuration(self) -> PipelineConfig:
        """The preset's configuration, overridden by the fields of the file, and by the model."""
        from foreglow import config

        configuration = config.preset(self.preset or DEFAULT_PRESET)
        if self.config is not None:
            configuration = config.read_config(self.config, configuration)
        if self.model is not None:
            classifier = configuration.classifier.model_copy(update={"model": self.model})
            configuration = configuration.model_copy(update={"classifier": classifier})
        return configuration

    @contextlib.contextmanager
    def naming(self) -> Iterator[None]:
        """Adds the name of the file to what is found wrong with a field of it later, such as at the first frame."""
        try:
            yield
        except ValueError as error:
            if self.config is None or raising(error) is not None or not _sets(self.config, str(error)):
                raise
            raise ValueError(f"{self.config}: {error}") from error


def _sets(config: Path, message: str) -> bool:
    """Whether `message` begins with a field that the configuration in the file `config` sets."""
    from foreglow.files import read_toml

    section, _, rest = message.partition(".")
    fields = read_toml(config).get(section)
    return isinstance(fields, dict) and rest.partition(":")[0] in fields


@dataclass(frozen=True, slots=True)
class SplitOptions:
    """Data."""

    data: Annotated[Path, argument("DATA", "A data set at its full frame rate, or one of its splits.")]
    split: SplitOption = "test"

    def root(self) -> Path:
        """The folder of the split."""
        from foreglow.datasets import split_in

        return split_in(self.data, cast("SplitName", self.split))


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Reading the source."""

    topic: TopicOption = None
    limit: LimitOption = None
    on_error: Annotated[str, option("stop|skip|mark", "Stop at a bad frame, skip it, or keep it marked.")] = "stop"

    def open(self, source: Path | str) -> FrameSource:
        """The frames of `source`."""
        from foreglow.datasets import open_source

        return open_source(source, on_error=cast("OnError", self.on_error), topic=self.topic)


@dataclass(frozen=True, slots=True)
class VehicleOptions:
    """Camera, vehicle data and map."""

    calibration: CalibrationOption = None
    can_log: Annotated[Path | None, file("CAN log of one drive, with the motion of the car and street messages.")] = (
        None
    )
    dbc: Annotated[Path | None, file("DBC that describes the frames of the log (default: Foreglow's own).")] = None
    mapping: Annotated[Path | None, file("TOML that says what the signals of the DBC mean.")] = None
    road_map: Annotated[Path | None, file("GeoJSON, OpenDRIVE or Lanelet2 map; needs --poses.", "--map")] = None
    poses: Annotated[Path | None, file("Poses of the car on the map over one drive: CSV or TUM.")] = None
    time_offset: Annotated[
        float,
        option("S", "Added to the times of log and poses, to get the times of the frames.", min=-1e10, max=1e10),
    ] = 0.0
    pose_error: Annotated[float, option("M", "Largest error of the poses along the road.", min=0.0, max=1000.0)] = (
        POSE_ERROR_M
    )

    def check(self) -> None:
        """Checks that each number that was given has an effect.

        Raises:
            ValueError: If one has none.
        """
        if self.time_offset != 0.0 and self.can_log is None and self.poses is None:
            raise ValueError("--time-offset: expected with --can-log or --poses, whose times it shifts")
        if self.pose_error != POSE_ERROR_M and self.poses is None:
            raise ValueError("--pose-error: expected with --poses")

    def read(self) -> VehicleFiles | None:
        """What the files say about each frame; None if no file is given."""
        self.check()
        if self.calibration == AUTO:
            raise ValueError(
                "--calibration auto: expected with `foreglow run`, which reads the drive twice; make a file with "
                "`foreglow calibrate auto` first"
            )
        files = (self.calibration, self.can_log, self.dbc, self.mapping, self.road_map, self.poses)
        if all(path is None for path in files):
            return None
        from foreglow.datasets.vehicle_logs import open_vehicle_data

        return open_vehicle_data(*files, time_offset_s=self.time_offset, pose_error_m=self.pose_error)

    def equip(self, frames: FrameSource, limit: int | None = None) -> FrameSource:
        """`frames`, of which the first `limit` will be read, with what the files say about each of them."""
        data = self.read()
        if data is None:
            return frames
        from foreglow.datasets import Equipped

        equipped = Equipped(frames, data)
        equipped.check(limit)
        return equipped


@dataclass(frozen=True, slots=True)
class LensOptions:
    """Camera to calibrate."""

    focal: Annotated[float | None, option("PX", "Focal length of the camera.", min=1.0, max=1e6)] = None
    fov: Annotated[
        float | None,
        option("DEG", "Field of view from the left edge of the image to the right one.", min=1.0, max=170.0),
    ] = None
    mount_height: Annotated[
        float | None,
        option("M", "Metres of the camera above the road (default: 1.3, give or take 0.15).", min=0.1, max=10.0),
    ] = None


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """Live camera."""

    size: Annotated[str | None, option("WxH", "Image size to request from the camera.")] = None
    rate: Annotated[float | None, option("HZ", "Frame rate to request from the camera.", min=0.5, max=1000.0)] = None

    @property
    def size_px(self) -> tuple[int, int] | None:
        """Width and height."""
        return None if self.size is None else size_from(self.size)


@dataclass(frozen=True, slots=True)
class BeamOptions:
    """Headlamps."""

    policy: Annotated[str | None, option("foreglow|paper|low|high|MODULE:NAME", "Beam policy (default: foreglow).")] = (
        None
    )
    lamps: Annotated[Path | None, file("TOML that describes the headlamps (default: those that ship).")] = None

    def commanding(self, configuration: PipelineConfig) -> PipelineConfig:
        """`configuration` with a beam, and with the policy and the headlamps given."""
        from foreglow.beam import policy_class

        if self.policy is not None:
            policy_class(self.policy, "--policy")
        given = {"policy": self.policy, "headlamps": self.lamps}
        return configuration.commanding(**{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Viewer (needs the extra `view`)."""

    view: Annotated[bool, flag("--view", "Show the run in a window of the Rerun viewer.")] = False
    save: Annotated[
        Path | None, output_file("Write what --view shows to FILE.rrd, to be opened in the Rerun viewer.", (".rrd",))
    ] = None


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Parallel work."""

    jobs: Annotated[int, option("N", "Number of worker processes; 1 does the work in this process.", min=1)] = 1
    cluster: Annotated[
        str | None, option("ADDRESS", "Work on a dask cluster: its scheduler, such as tcp://host:8786.")
    ] = None

    @property
    def is_parallel(self) -> bool:
        """Whether the work leaves this process."""
        return self.jobs > 1 or self.cluster is not None

    def workers(self) -> Workers:
        """The workers asked for."""
        from foreglow.parallel import workers_at

        return workers_at(self.jobs, self.cluster)


def size_from(text: str) -> tuple[int, int]:
    """Width and height from a text such as 1280x960."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"size: expected WIDTHxHEIGHT such as 1280x960, got {text!r}")
    return int(width), int(height)
