"""`ros2`: the pipeline as a network of nodes."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foreglow.cli.app import app
from foreglow.cli.beam import lamp_bus
from foreglow.cli.shared_run import source_notes
from foreglow.cli.signals import INTERRUPTED
from foreglow.command_line import argument, flag, option, refuse_unused, with_options
from foreglow.options import (
    POSE_ERROR_M,
    CalibrationOption,
    CaptureOptions,
    LimitOption,
    PipelineOptions,
    SourceOptions,
    VehicleOptions,
)

if TYPE_CHECKING:
    from foreglow.datasets import FrameSource
    from foreglow.runtime.ros2.node import FrameNode
    from foreglow.runtime.run import InterruptFlag

ros2 = typer.Typer(no_args_is_help=True, help="Run the pipeline as ROS 2 nodes, each in a process of its own.")
app.add_typer(ros2, name="ros2")

PASSING = {"allow_extra_args": True, "ignore_unknown_options": True}
"""Settings of a command that passes arguments from --ros-args on to ROS 2."""

STATUS_S = 0.5
"""Between two updates of the status line."""

SourceArgument = Annotated[
    str, argument("SOURCE", "A source as for `run`, played at its own rate, or a camera as for `live`.")
]
SpeedOption = Annotated[float, option("X", "Play X times as fast as it was recorded.", min=0.01, max=1000.0)]
LoopOption = Annotated[bool, flag("--loop", "Start again at the end.")]
NetworkOption = Annotated[bool, flag("--network", "Let nodes on other machines take part.")]
ParentOption = Annotated[int | None, typer.Option(hidden=True)]


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """Node."""

    calibration: CalibrationOption = None
    is_networked: NetworkOption = False
    patience: Annotated[
        float | None, option("S", "Wait up to S seconds for the vehicle's data of a frame (0.02).", min=0.0, max=10.0)
    ] = None
    parent: ParentOption = None


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Beam commands."""

    can: Annotated[str | None, option("CHANNEL", "CAN bus for the commands: can0, or INTERFACE:CHANNEL.")] = None
    deadline: Annotated[
        float | None, option("S", "Command low beam after S seconds without input.", min=0.01, max=10.0)
    ] = None


@ros2.command(context_settings=PASSING)
@with_options
def source(
    context: typer.Context,
    frames: SourceArgument,
    reading: SourceOptions,
    vehicle: VehicleOptions,
    capture: CaptureOptions,
    speed: SpeedOption = 1.0,
    loop: LoopOption = False,
    wait: Annotated[bool, flag("--wait", "Start once the other nodes listen.")] = False,
    is_networked: NetworkOption = False,
    parent: ParentOption = None,
) -> None:
    """Publish the frames of SOURCE at their own rate, with what the car knew about them."""
    from foreglow.datasets.vehicle_logs import open_vehicle_data
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_camera
    from foreglow.runtime.run import InterruptFlag

    _check_source(frames, capture, reading, vehicle, speed, loop=loop)
    data = None if vehicle.calibration is None else open_vehicle_data(vehicle.calibration)
    camera = open_camera(frames, CameraOptions(size_px=capture.size_px, rate_hz=capture.rate, data=data))
    if camera is None:
        played = vehicle.equip(reading.open(frames), reading.limit)
    ros_arguments = _prepare(context, is_networked)
    from foreglow.runtime.ros2.source import Player, repeated

    with InterruptFlag() as interrupt:
        player = Player(_stop(lambda: interrupt.is_set, parent), ros_arguments)
        if wait:
            player.wait()
        if camera is not None:
            player.stream(camera, limit=reading.limit)
        else:
            num_frames = player.play(repeated(played, reading.limit, is_endless=loop), speed=speed)
            if num_frames or not interrupt.is_set:
                _say_left_out(played, num_frames)
    _finish(interrupt)


def _say_left_out(played: FrameSource, num_frames: int) -> None:
    """Prints what was left out, and what was assumed, of a source of which so many frames were played.

    Raises:
        ValueError: If that were all of them.
    """
    from foreglow.datasets import how_read, lost_parts
    from foreglow.display.summary_lines import left_out_lines
    from foreglow.plugins import printable
    from foreglow.runs.origin import origin_name
    from foreglow.runtime.run import check_readable

    check_readable(origin_name(played), num_frames, played.skipped)
    lines = [*left_out_lines(played.skipped, len(lost_parts(played))), *source_notes(played)]
    lines += filter(None, [how_read(played)["source_lack"]])
    for line in lines:
        typer.echo(printable(line))


def _check_source(
    text: str, capture: CaptureOptions, reading: SourceOptions, vehicle: VehicleOptions, speed: float, *, loop: bool
) -> None:
    """Checks that each option has an effect on the source called `text`."""
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_camera

    given = {"--size": capture.size is not None, "--rate": capture.rate is not None}
    if open_camera(text, CameraOptions()) is not None:
        given = {
            "--topic": reading.topic is not None,
            "--on-error": reading.on_error != "stop",
            "--speed": speed != 1.0,
            "--loop": loop,
            "--can-log": vehicle.can_log is not None,
            "--dbc": vehicle.dbc is not None,
            "--mapping": vehicle.mapping is not None,
            "--map": vehicle.road_map is not None,
            "--poses": vehicle.poses is not None,
            "--time-offset": vehicle.time_offset != 0.0,
            "--pose-error": vehicle.pose_error != POSE_ERROR_M,
        }
    refuse_unused(text, given)


def _add_stage(name: str, text: str) -> None:

    @ros2.command(name, help=text, context_settings=PASSING)
    @with_options
    def stage(context: typer.Context, pipeline: PipelineOptions, node: NodeOptions) -> None:
        _run_node(name, context, pipeline, node, OutputOptions())


def _add_output(name: str, text: str) -> None:

    @ros2.command(name, help=text, context_settings=PASSING)
    @with_options
    def output(context: typer.Context, pipeline: PipelineOptions, node: NodeOptions, output: OutputOptions) -> None:
        _run_node(name, context, pipeline, node, output)


_add_stage("proposals", "Find boxes that may hold light: image to proposals.")
_add_stage("classifier", "Score boxes by whether they hold light of a vehicle: proposals to detections.")
_add_stage("distance", "Estimate how far away the light in each box is: detections to ranges.")
_add_stage("tracking", "Follow light over time: ranges to tracks.")
_add_stage("markers", "Publish tracks as MarkerArray for RViz, and as Detection2DArray where vision_msgs is installed.")
_add_output("beam", "Command the headlamps, checked by the guard: tracks to beam, as a topic and on the CAN bus.")
_add_output("pipeline", "Run all five in one node: image to beam.")


@ros2.command("detector", hidden=True, context_settings=PASSING)
def detector() -> None:
    """Say what took this node's place."""
    raise ValueError("ros2 detector: now two nodes, foreglow ros2 proposals and foreglow ros2 classifier")


@ros2.command("all", context_settings=PASSING)
@with_options
def everything(
    context: typer.Context,
    frames: SourceArgument,
    pipeline: PipelineOptions,
    output: OutputOptions,
    capture: CaptureOptions,
    calibration: CalibrationOption = None,
    speed: SpeedOption = 1.0,
    loop: LoopOption = False,
    limit: LimitOption = None,
    is_networked: NetworkOption = False,
    markers: Annotated[bool, flag("--markers", "Run the node `markers`, too.")] = False,
) -> None:
    """Run all six nodes as processes, from SOURCE to the beam; a node that dies is started again.

    A terminal shows a status line.
    """
    from foreglow.datasets import open_source
    from foreglow.runtime.live.cameras import CameraOptions
    from foreglow.runtime.live.opening import open_camera
    from foreglow.runtime.run import InterruptFlag

    vehicle = VehicleOptions(calibration=calibration)
    _check_source(frames, capture, SourceOptions(), vehicle, speed, loop=loop)
    ros_arguments = _prepare(context, is_networked)
    from foreglow.runtime.ros2 import STAGE_NODES
    from foreglow.runtime.ros2.supervisor import supervise

    if open_camera(frames, CameraOptions()) is None:
        next(iter(vehicle.equip(open_source(frames), 1)), None)  # whether the calibration fits
    pipeline.configuration().commanding()
    ending = [*(["--network"] if is_networked else []), *ros_arguments]
    shared = _arguments(**dataclasses.asdict(pipeline))  # the source has the calibration, and sends it scaled
    nodes = {name: [name, *shared, *ending] for name in STAGE_NODES}
    nodes["beam"] = ["beam", *shared, *_arguments(**dataclasses.asdict(output)), *ending]
    if markers:
        nodes["markers"] = ["markers", *shared, *ending]
    played = _arguments(speed=speed, limit=limit, calibration=calibration, **dataclasses.asdict(capture))
    player = ["source", frames, *played, *(["--loop"] if loop else []), "--wait", *ending]
    with InterruptFlag() as interrupt, _status_line(list(nodes), ros_arguments) as wait:
        code = supervise(nodes, player, lambda: interrupt.is_set, lambda line: typer.echo(line, err=True), wait)
    raise typer.Exit(code)


@ros2.command("launch-file")
@with_options
def launch_file() -> None:
    """Print the path of the launch file, for `ros2 launch`."""
    from importlib.resources import files

    typer.echo(files("foreglow") / "runtime" / "ros2" / "foreglow_launch.py")


@contextlib.contextmanager
def _status_line(names: Sequence[str], ros_arguments: Sequence[str]) -> Iterator[Callable[[float], None]]:
    """How to let time pass: on a terminal, with a line that says what the nodes do."""
    from rich.console import Console
    from rich.markup import escape

    from foreglow.runtime.ros2.status_line import StatusLine

    console = Console(stderr=True)
    if not console.is_terminal:
        yield time.sleep
        return
    line = StatusLine(names, ros_arguments)
    with console.status("waiting for the first frame") as shown:
        due_s = 0.0

        def wait(seconds: float) -> None:
            nonlocal due_s
            line.receive(seconds)
            now_s = time.monotonic()
            if now_s >= due_s:
                due_s = now_s + STATUS_S
                shown.update(escape(line.text(now_s)))

        try:
            yield wait
        finally:
            line.close()


def _arguments(**options: object) -> list[str]:
    """Options as on the command line, without those that are None."""
    return [text for name, value in options.items() if value is not None for text in (f"--{name}", str(value))]


def _prepare(context: typer.Context, is_networked: bool) -> list[str]:
    """Sets up what ROS 2 reads from the environment; returns the arguments meant for ROS 2."""
    if context.args and context.args[0] != "--ros-args":
        raise ValueError(f"{context.args[0]}: no such option; what is meant for ROS 2 follows --ros-args")
    from foreglow.runtime.ros2.environment import prepare

    prepare(is_networked=is_networked)
    importlib.import_module("rclpy")
    return list(context.args)


def _run_node(
    name: str, context: typer.Context, pipeline: PipelineOptions, node: NodeOptions, output: OutputOptions
) -> None:
    ros_arguments = _prepare(context, node.is_networked)
    from foreglow.datasets.vehicle_logs import open_vehicle_data
    from foreglow.runtime.ros2.stages import NODES, Setting
    from foreglow.runtime.run import InterruptFlag

    config = pipeline.configuration().commanding()
    bus = None if output.can is None else lamp_bus(output.can, config)
    camera = None if node.calibration is None else open_vehicle_data(node.calibration)
    make: Callable[[Setting], FrameNode[Any]]
    if name == "markers":
        from foreglow.runtime.ros2.markers import MarkerNode

        make = MarkerNode
    else:
        make = NODES[name]
    setting = Setting(config, camera, bus, output.deadline, node.patience, ros_arguments)
    with InterruptFlag() as interrupt:
        limit_s = config.live.max_step_s + config.live.abandon_s
        make(setting).spin(_stop(lambda: interrupt.is_set, node.parent), limit_s)
    _finish(interrupt)


def _finish(interrupt: InterruptFlag) -> None:
    """Exits with 130 if the node was interrupted."""
    if interrupt.is_set:
        raise typer.Exit(INTERRUPTED)


def _stop(is_interrupted: Callable[[], bool], parent: int | None) -> Callable[[], bool]:
    """Whether to stop: after an interrupt, or when the process that started this one is gone."""
    return lambda: is_interrupted() or (parent is not None and os.getppid() != parent)
