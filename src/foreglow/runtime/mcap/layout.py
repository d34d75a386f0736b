"""A layout of Foxglove's panels for our recordings: `docs/foxglove_layout.json`."""

from __future__ import annotations

import json

import foxglove.layouts as fl

from foreglow.datasets.bags import FRAME_TOPIC
from foreglow.runtime.mcap.channels import (
    BOXES_TOPIC,
    CALIBRATION_TOPIC,
    HEALTH_TOPIC,
    IMAGE_TOPIC,
    LOG_TOPIC,
    RESULT_TOPIC,
    SCENE_TOPIC,
    VEHICLE_FRAME,
)

STAGES = ("proposals", "classifier", "distance", "tracking", "beam")

CAMERA_DISTANCE_M = 120.0
"""Distance of the scene panel's view point, above and behind the vehicle."""


def foxglove_layout() -> str:
    """The layout as JSON: image and scene above, beam, ranges and stage times below, health and log at the side."""
    content = fl.SplitContainer(
        direction="row",
        items=[
            fl.SplitItem(
                proportion=3,
                content=_column([(3, _row([_image(), _scene()])), (2, _row([_beam(), _ranges(), _times()]))]),
            ),
            fl.SplitItem(proportion=1, content=_column([(1, _mode()), (2, _log()), (1, _speed()), (1, _dropped())])),
        ],
    )
    return json.dumps(json.loads(fl.Layout(content=content).to_json()), indent=1) + "\n"


def _image() -> fl.ImagePanel:
    mode = fl.ImageModeConfig(
        image_topic=IMAGE_TOPIC,
        calibration_topic=CALIBRATION_TOPIC,
        annotations={BOXES_TOPIC: fl.ImageAnnotationSettings(visible=True)},
        synchronize=True,
    )
    return fl.ImagePanel(title="Image", config=fl.ImageConfig(image_mode=mode))


def _scene() -> fl.ThreeDeePanel:
    config = fl.ThreeDeeConfig(
        follow_tf=VEHICLE_FRAME,
        camera_state=fl.ThreeDeeCameraState(
            perspective=True, distance=CAMERA_DISTANCE_M, phi=45.0, theta_offset=90.0, target_offset=(50.0, 0.0, 0.0)
        ),
        topics={SCENE_TOPIC: fl.BaseRendererSceneUpdateTopicSettings(visible=True)},
        layers={"grid": fl.BaseRendererGridLayerSettings(frame_id=VEHICLE_FRAME, size=200.0, divisions=20.0)},
    )
    return fl.ThreeDeePanel(title="Scene", config=config)


def _beam() -> fl.PlotPanel:
    """The levels of the current frame's LEDs, by number."""
    lamps = ("left lamp", "right lamp")
    paths = [
        fl.PlotSeries(value=f"{RESULT_TOPIC}.beam.levels[{lamp}][:]", label=name) for lamp, name in enumerate(lamps)
    ]
    config = fl.PlotConfig(paths=paths, x_axis_val="index", min_y_value=0.0, max_y_value=1000.0)
    return fl.PlotPanel(title="LEDs, thousandths", config=config)


def _ranges() -> fl.PlotPanel:
    return _plot("Ranges of tracks, m", [f"{RESULT_TOPIC}.tracks[:].range_m"])


def _times() -> fl.PlotPanel:
    return _plot("Stages, ms", [f"{RESULT_TOPIC}.stage_ms.{stage}" for stage in STAGES])


def _speed() -> fl.PlotPanel:
    return _plot("Speed, m/s", [f"{FRAME_TOPIC}.motion.speed_mps"])


def _dropped() -> fl.PlotPanel:
    return _plot("Frames lost", [f"{HEALTH_TOPIC}.num_dropped", f"{HEALTH_TOPIC}.num_late"])


def _mode() -> fl.StateTransitionsPanel:
    series = fl.StateTransitionsSeries(value=f"{RESULT_TOPIC}.beam.mode", label="beam")
    return fl.StateTransitionsPanel(title="Beam", config=fl.StateTransitionsConfig(paths=[series]))


def _log() -> fl.LogPanel:
    return fl.LogPanel(title="Faults", config=fl.LogConfig(topic_to_render=LOG_TOPIC))


def _plot(title: str, values: list[str]) -> fl.PlotPanel:
    paths = [fl.PlotSeries(value=value, label=value.rpartition(".")[2]) for value in values]
    return fl.PlotPanel(title=title, config=fl.PlotConfig(paths=paths))


def _row(panels: list[fl.BasePanel]) -> fl.SplitContainer:
    return fl.SplitContainer(direction="row", items=[fl.SplitItem(content=panel) for panel in panels])


def _column(panels: list[tuple[float, fl.BasePanel | fl.SplitContainer]]) -> fl.SplitContainer:
    items = [fl.SplitItem(proportion=share, content=panel) for share, panel in panels]
    return fl.SplitContainer(direction="column", items=items)
