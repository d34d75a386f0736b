"""`ros2`: the pipeline as a network of nodes."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, cast

import typer

from foreglow.cli.app import (
    DEFAULT_PRESET,
    CalibrationOption,
    CanLogOption,
    ConfigOption,
    DbcOption,
    LimitOption,
    MapOption,
    MappingOption,
    ModelOption,
    OnErrorOption,
    PoseErrorOption,
    PosesOption,
    PresetOption,
    TimeOffsetOption,
    app,
    configuration_of,
    equipped,
    size_of,
)
from foreglow.cli.beaming import lamp_bus

if TYPE_CHECKING:
    from foreglow.config import PipelineConfig
    from foreglow.datasets import OnError

network = typer.Typer(no_args_is_help=True, help="The pipeline as ROS 2 nodes, in processes of their own.")
app.add_typer(network, name="ros2")

# What ROS 2 itself is told, from --ros-args on, is passed through.
PASSING = {"allow_extra_args": True, "ignore_unknown_options": True}

Source = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE", help="What `run` takes, at its own rate; or a camera or an address, as for `live`."
    ),
]
SizeOption = Annotated[str | None, typer.Option(metavar="WxH", help="Size to ask a camera for.")]
RateOption = Annotated[float | None, typer.Option(metavar="HZ", help="Rate to ask a camera for.")]
NetworkOption = Annotated[bool, typer.Option("--network", help="Let nodes on other machines take part.")]
CanOption = Annotated[
    str | None, typer.Option(metavar="CHANNEL", help="CAN bus for the commands: can0, or INTERFACE:CHANNEL.")
]
DeadlineOption = Annotated[
    float | None, typer.Option(metavar="S", min=0.01, help="Low beam after so long without input.")
]
ParentOption = Annotated[int | None, typer.Option(hidden=True)]
SpeedOption = Annotated[float, typer.Option(min=0.01, help="How many times quicker than it was recorded.")]
LoopOption = Annotated[bool, typer.Option("--loop", help="Begin again at the end.")]


@network.command(context_settings=PASSING)
def source(
    context: typer.Context,
    frames: Source,
    speed: SpeedOption = 1.0,
    loop: LoopOption = False,
    limit: LimitOption = None,
    calibration: CalibrationOption = None,
    can_log: CanLogOption = None,
    dbc: DbcOption = None,
    mapping: MappingOption = None,
    road_map: MapOption = None,
    poses: PosesOption = None,
    time_offset: TimeOffsetOption = 0.0,
    pose_error: PoseErrorOption = 5.0,
    on_error: OnErrorOption = "stop",
    size: SizeOption = None,
    rate: RateOption = None,
    wait: Annotated[bool, typer.Option("--wait", help="Begin once the network listens.")] = False,
    is_networked: NetworkOption = False,
    parent: ParentOption = None,
) -> None:
    """Publish the frames of SOURCE at their own rate, and what the car knew."""
    from foreglow.datasets import open_source
    from foreglow.datasets.vehicle_logs import open_vehicle_data
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_camera
    from foreglow.runtime.run import InterruptFlag

    files = (calibration, can_log, dbc, mapping, road_map, poses)
    data = None if calibration is None else open_vehicle_data(calibration)
    options = CameraOptions(size_px=None if size is None else size_of(size), rate_hz=rate, data=data)
    camera = open_camera(frames, options)
    if camera is None:
        images = open_source(frames, on_error=cast("OnError", on_error))
        played = equipped(images, files, time_offset, pose_error)
    ros_arguments = _begin(context, is_networked)
    from foreglow.runtime.ros2.source import Player, repeated

    with InterruptFlag() as interrupt:
        should_stop = _stop(lambda: interrupt.is_set, parent)
        player = Player(should_stop, ros_arguments)
        if wait:
            player.wait()
        if camera is not None:
            player.stream(camera, limit=limit)
        else:
            player.play(repeated(played, limit, is_endless=loop), speed=speed)


def _add_stage(name: str, text: str) -> None:
    """Adds the command of a node that wraps one stage."""

    def node(
        context: typer.Context,
        preset: PresetOption = DEFAULT_PRESET,
        model: ModelOption = None,
        config: ConfigOption = None,
        calibration: CalibrationOption = None,
        is_networked: NetworkOption = False,
        parent: ParentOption = None,
    ) -> None:
        ros_arguments = _begin(context, is_networked)
        _work(name, Told(configuration_of(preset, config, model), calibration), ros_arguments, parent)

    network.command(name, help=text, context_settings=PASSING)(node)


def _add_output(name: str, text: str) -> None:
    """Adds the command of a node that commands the beam."""

    def node(
        context: typer.Context,
        preset: PresetOption = DEFAULT_PRESET,
        model: ModelOption = None,
        config: ConfigOption = None,
        calibration: CalibrationOption = None,
        can: CanOption = None,
        deadline: DeadlineOption = None,
        is_networked: NetworkOption = False,
        parent: ParentOption = None,
    ) -> None:
        ros_arguments = _begin(context, is_networked)
        told = Told(configuration_of(preset, config, model), calibration, can, deadline)
        _work(name, told, ros_arguments, parent)

    network.command(name, help=text, context_settings=PASSING)(node)


_add_stage("detector", "Boxes that may hold light, and their scores: image to detections.")
_add_stage("distance", "How far away the light in each box is: detections to ranges.")
_add_stage("tracking", "Light followed over time: ranges to tracks.")
_add_output("beam", "What the headlamps shall shine, checked by the guard: tracks to beam, topic and CAN bus.")
_add_output("pipeline", "All four in one node: image to beam.")


@network.command("all", context_settings=PASSING)
def everything(
    context: typer.Context,
    frames: Source,
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: ConfigOption = None,
    calibration: CalibrationOption = None,
    can: CanOption = None,
    deadline: DeadlineOption = None,
    speed: SpeedOption = 1.0,
    loop: LoopOption = False,
    limit: LimitOption = None,
    size: SizeOption = None,
    rate: RateOption = None,
    is_networked: NetworkOption = False,
) -> None:
    """The five nodes as processes, from SOURCE to the beam; a node that dies is started again."""
    from foreglow.datasets import open_source
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_camera
    from foreglow.runtime.run import InterruptFlag

    ros_arguments = _begin(context, is_networked)
    from foreglow.runtime.ros2.supervisor import supervise

    if open_camera(frames, CameraOptions()) is None:
        open_source(frames)
    configuration_of(preset, config, model).commanding()
    shared = _options(preset=preset, model=model, config=config, calibration=calibration)
    ending = [*(["--network"] if is_networked else []), *ros_arguments]
    nodes = {name: [name, *shared, *ending] for name in ("detector", "distance", "tracking")}
    nodes["beam"] = ["beam", *shared, *_options(can=can, deadline=deadline), *ending]
    played = ["source", frames, *_options(speed=speed, limit=limit, calibration=calibration, size=size, rate=rate)]
    player = [*played, *(["--loop"] if loop else []), "--wait", *ending]
    with InterruptFlag() as interrupt:
        code = supervise(nodes, player, lambda: interrupt.is_set, lambda line: typer.echo(line, err=True))
    raise typer.Exit(code)


@network.command("launch-file")
def launch_file() -> None:
    """Say where the launch file is, for `ros2 launch`."""
    from importlib.resources import files

    typer.echo(files("foreglow") / "runtime" / "ros2" / "foreglow_launch.py")


class Told(NamedTuple):
    """What a compute node is told on the command line."""

    config: PipelineConfig
    calibration: Path | None
    can: str | None = None
    deadline_s: float | None = None


def _options(**values: object) -> list[str]:
    """Options as on the command line, without those that are None."""
    return [text for name, value in values.items() if value is not None for text in (f"--{name}", str(value))]


def _begin(context: typer.Context, is_networked: bool) -> list[str]:
    """Prepares what ROS 2 reads from the environment; returns what is meant for it."""
    if context.args and context.args[0] != "--ros-args":
        raise ValueError(f"{context.args[0]}: no such option; what is meant for ROS 2 follows --ros-args")
    from foreglow.runtime.ros2.environment import prepare

    prepare(is_networked=is_networked)
    importlib.import_module("rclpy")
    return list(context.args)


def _work(name: str, told: Told, ros_arguments: Sequence[str], parent: int | None) -> None:
    """Runs a compute node until it is told to end."""
    from foreglow.calibration import read_calibration
    from foreglow.runtime.ros2.stages import NODES, Setting
    from foreglow.runtime.run import InterruptFlag

    config = told.config.commanding()
    bus = None if told.can is None else lamp_bus(told.can, config)
    camera = None if told.calibration is None else read_calibration(told.calibration)
    setting = Setting(config, camera, bus, told.deadline_s, ros_arguments)
    with InterruptFlag() as interrupt:
        NODES[name](setting).spin(_stop(lambda: interrupt.is_set, parent))


def _stop(is_interrupted: Callable[[], bool], parent: int | None) -> Callable[[], bool]:
    """Whether to end: interrupted, or the process that started us is gone."""
    return lambda: is_interrupted() or (parent is not None and os.getppid() != parent)
