"""`record`: a run as an MCAP file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

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
    Source,
    TimeOffsetOption,
    TopicOption,
    app,
    configuration_of,
    equipped,
    file,
    finish,
    progress_sink,
    recording_sinks,
)

if TYPE_CHECKING:
    from foreglow.datasets import OnError


@app.command()
def record(
    source: Source,
    out: Annotated[Path, file(help="The recording: FILE.mcap.")],
    preset: PresetOption = DEFAULT_PRESET,
    model: ModelOption = None,
    config: ConfigOption = None,
    calibration: CalibrationOption = None,
    can_log: CanLogOption = None,
    dbc: DbcOption = None,
    mapping: MappingOption = None,
    road_map: MapOption = None,
    poses: PosesOption = None,
    time_offset: TimeOffsetOption = 0.0,
    pose_error: PoseErrorOption = 5.0,
    topic: TopicOption = None,
    limit: LimitOption = None,
    on_error: OnErrorOption = "stop",
) -> None:
    """Record SOURCE with what is found in it as MCAP, to replay and to look at in Foxglove."""
    from foreglow.datasets import open_source
    from foreglow.pipeline import Pipeline
    from foreglow.runtime import run

    pipeline = Pipeline(configuration_of(preset, config, model))
    opened = open_source(source, on_error=cast("OnError", on_error), topic=topic)
    frames = equipped(opened, (calibration, can_log, dbc, mapping, road_map, poses), time_offset, pose_error)
    sinks = [progress_sink(frames, limit), *recording_sinks(out, source, pipeline.config)]
    finish(run(frames, pipeline, None, sinks=sinks, limit=limit, source_name=str(source)), out)
