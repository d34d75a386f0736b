"""Options that several commands share, each defined once: single ones, and groups."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

from foreglow.command_line import argument, file, flag, folder, option, output_file
from foreglow.own_files import RECORDING, VIEW
from foreglow.plugins import raising

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig, ProposalConfig
    from foreglow.datasets import FrameSource, OnError, SplitName
    from foreglow.datasets.vehicle_logs import VehicleFiles
    from foreglow.parallel import Workers

DEFAULT_PRESET = "foreglow"

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
RECORD_HELP = "Also record everything as MCAP, for replay and for Foxglove."
RecordOption = Annotated[Path | None, output_file(RECORD_HELP, RECORDING)]
SplitOption = Annotated[str, option("train|val|test", "Split to measure on, if DATA is a whole data set.")]
PaperModelOption = Annotated[
    Path | None,
    file("Also run the paper's whole chain, with this model: ONNX or a folder of `train`.", metavar="MODEL"),
]
DeviceOption = Annotated[str, option("auto|cpu|cuda", "Device to train on.")]
QualityOption = Annotated[str, option("fast|training|fine", "Quality of the rendering.")]
WhiteOption = Annotated[
    int | None,
    option("N", "White of the camera, such as 4095 for 12 bits (default: that of the images' type).", min=1, max=65535),
]
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
            if self.model is None:
                _check_own_model(self.config, configuration.classifier.model)
        if self.model is not None:
            configuration = configuration.changed("classifier", model=self.model)
            if self.config is None:
                check_boxes("--model", self.model, configuration)
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


def check_boxes(name: str, model: Path, configuration: PipelineConfig) -> None:
    """Passes a configuration with the boxes that the model has learnt, as far as that is known; others need --config.

    Raises:
        ValueError: If they are others, on which the scores of the model, given by the option `name`, mean nothing.
    """
    from foreglow.classifier.learnt import have_same_boxes

    known = known_proposals(model)
    if known is not None and not have_same_boxes(configuration.proposals, known[0]):
        raise ValueError(
            f"proposals: expected {known[1]} with {name} {model}, which knows the boxes of these proposals only"
        )


def known_proposals(model: Path) -> tuple[ProposalConfig, str] | None:
    """The proposals whose boxes a model has learnt, and the option that gives them; None where nothing says it.

    That is known of the model that ships, by the model itself, or by the file of the training that it lies in.

    Raises:
        ValueError: If the model, or the file beside it, is broken.
    """
    from foreglow.classifier.learnt import have_same_boxes, learnt_proposals
    from foreglow.config import PRESETS, read_config
    from foreglow.files import read_toml

    if str(model) in PRESETS:
        return PRESETS[str(model)].proposals, f"--preset {model}"
    own = learnt_proposals(model)
    file = model.with_name("config.toml")  # also beside a model of another name, as a checkpoint that was kept
    fields = read_toml(file).get("proposals") if file.is_file() else None
    if isinstance(fields, dict) and fields.keys() >= PRESETS["paper"].proposals.model_dump().keys():
        beside = read_config(file).proposals  # a whole one, as a training writes it
        if own is None or have_same_boxes(beside, own):
            return beside, f"--config {file}"
    if own is None:
        return None
    preset = next((name for name, each in PRESETS.items() if have_same_boxes(each.proposals, own)), None)
    return own, "a --config of its training's proposals" if preset is None else f"--preset {preset}"


def _check_own_model(config: Path, model: Path | None) -> None:
    """Checks that the file of a training names the model beside it: in a copied folder, it names the one it was copied
    from, which may have been trained anew or be gone.

    Raises:
        ValueError: If there is another one beside it.
    """
    from foreglow.files import file_digest
    from foreglow.own_folders import TRAINING

    own = config.with_name("model.onnx")
    is_trainings = config.name == "config.toml" and own.is_file() and config.with_name(TRAINING).is_file()
    if not is_trainings or model is None or not model.is_absolute() or own.resolve() == model.resolve():
        return
    if not model.is_file() or file_digest(model) != file_digest(own):
        raise ValueError(
            f"{config}: classifier.model: expected the model beside it, as a training's folder has it, got {model}; "
            f"was the folder copied? --model {own} takes that one"
        )


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
    on_error: Annotated[
        str, option("stop|skip|mark", "Stop at a bad frame, skip it, or keep it marked, if it can be decoded.")
    ] = "stop"

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
    rate: Annotated[
        float | None,
        option("HZ", "Frame rate to request from a camera, and to expect of it or of a stream.", min=0.5, max=1000.0),
    ] = None

    @property
    def size_px(self) -> tuple[int, int] | None:
        """Width and height."""
        return None if self.size is None else size_from(self.size)


@dataclass(frozen=True, slots=True)
class BeamOptions:
    """Headlamps."""

    policy: Annotated[
        str | None,
        option(
            "foreglow|paper|low|high|MODULE:NAME",
            "Beam policy (default: that of the configuration, of a run its own, else foreglow).",
        ),
    ] = None
    lamps: Annotated[
        Path | None,
        file("TOML that describes the headlamps (default: those of the configuration, else those that ship)."),
    ] = None

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
        Path | None, output_file("Write what --view shows to FILE.rrd, to be opened in the Rerun viewer.", VIEW)
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
    from foreglow.datasets.images import MAX_SIDE_PX  # only here: the help comes without NumPy

    width, _, height = text.partition("x")
    are_numbers = text.isascii() and all(side.isdecimal() and len(side) < 6 for side in (width, height))
    if not (are_numbers and all(1 <= int(side) <= MAX_SIDE_PX for side in (width, height))):
        expected = f"WIDTHxHEIGHT such as 1280x960, of at most {MAX_SIDE_PX} px a side"
        raise ValueError(f"size: expected {expected}, got {text[:40]!r}")
    return int(width), int(height)
