"""How long a frame takes, stage by stage: in process, in the live loop, and over a ROS 2 network."""

from __future__ import annotations

import importlib.util
import itertools
import math
import multiprocessing
import os
import random
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.config import PipelineConfig
from foreglow.datasets import LabelledSource, open_labelled
from foreglow.files import check_each_once
from foreglow.geometry import Floats
from foreglow.lab.evaluation.ratios import percentiles, ratio
from foreglow.lab.studies.progress import Progress
from foreglow.parallel import safe_path
from foreglow.pipeline import Pipeline
from foreglow.plugins import words_of
from foreglow.provenance import processor_name
from foreglow.runtime.can_output import CanBus
from foreglow.runtime.health import Health
from foreglow.runtime.live import BeamOutput, LiveLoop, Paced
from foreglow.runtime.memory import settled_memory
from foreglow.runtime.ros2 import STAGE_NODES
from foreglow.types import Frame, FrameResult

COMPLETE = "CP"
PARTS = {
    COMPLETE: "complete pipeline",
    "PG": "proposal generation",
    "PC": "classification",
    "DE": "distance",
    "OT": "tracker",
    "BC": "beam command",
}
"""The paper's boxes, and the beam's. Source: Ewecker et al., arXiv 2107.11302, figure on run-times."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkTimes:
    """Run-times of one way to run the pipeline.

    Attributes:
        parts_ms: By part, shape (F,), milliseconds, NaN for a frame that was lost; of `PARTS` and other names of what
            comes between. The complete pipeline is from the array to the beam command in process, and from exposure
            until the command was sent elsewhere.
        num_proposals: Shape (F,), of each frame; -1 where unknown.
        num_dropped: Frames that were given, and of which nothing came.
    """

    name: str
    parts_ms: Mapping[str, Floats]
    num_proposals: NDArray[np.int64]
    num_dropped: int

    @property
    def num_frames(self) -> int:
        """Frames of which a command came."""
        return int(np.isfinite(self.parts_ms[COMPLETE]).sum())

    def share_within(self, limit_s: float) -> float:
        """Share of all frames, dropped ones too, whose command was there in time."""
        return ratio((self.parts_ms[COMPLETE] <= 1e3 * limit_s).sum(), self.num_frames + self.num_dropped)


def median_p99_max(values: Floats) -> tuple[float, ...]:
    """Median, p99 and the greatest of the values that are not NaN; NaN for none.

    >>> median_p99_max(np.array([1.0, 2.0, 3.0, np.nan]))
    (2.0, 2.98, 3.0)
    """
    return percentiles(values, (50, 99, 100))


def frames_by_proposals(times: NetworkTimes, edges: Sequence[int]) -> Iterator[tuple[str, Floats]]:
    """Complete run-times by number of proposals: each group goes from one edge up to, not including, the next one."""
    for least, beyond in itertools.pairwise([*edges, math.inf]):
        is_in = (times.num_proposals >= least) & (times.num_proposals < beyond)
        words = f"{least} to {beyond - 1}" if math.isfinite(beyond) else f"{least} and more"
        complete = times.parts_ms[COMPLETE][is_in]
        yield words, complete[np.isfinite(complete)]


STAGES = {"PG": "proposals", "PC": "classifier", "DE": "distance", "OT": "tracking", "BC": "beam"}

NUM_WARM_UP = 20
"""Frames that are run before the first that counts: in a car, too, the pipeline has run before it matters."""

MIN_FRAMES = 100
"""With fewer frames that count, the 99th percentile is next to the worst of them."""

IN_PROCESS, LIVE, ONE_NODE, NETWORK = "in process", "live", "ROS 2, one node", "ROS 2, six processes"
PAPER_IN_PROCESS = "in process, paper's whole chain"
KINDS = {"process": IN_PROCESS, "live": LIVE, "node": ONE_NODE, "ros2": NETWORK}
"""What can be measured, by the name of the option."""


@dataclass(frozen=True, slots=True, eq=False)
class RuntimeResults:
    """What was measured.

    Attributes:
        frame_s: Time of a frame.
        missing: By name, why others were not.
    """

    name: str
    frame_s: float
    config: PipelineConfig
    processor: str
    networks: Sequence[NetworkTimes]
    missing: Mapping[str, str]


def run_experiment(
    split: Path,
    config: PipelineConfig,
    kinds: Sequence[str],
    num_paced: int,
    progress: Progress,
    paper: PipelineConfig | None = None,
) -> RuntimeResults:
    """Measures each of `kinds` on the sequences of `split`, one after the other, with one thread for computing.

    In process all frames are run, from memory; elsewhere, where they come at their own rate, the first `num_paced`,
    live of those after the first `NUM_WARM_UP`.
    A ROS 2 network that is not installed is left out, and the results say why. With `paper`, the paper's whole chain,
    that is measured in process as well.

    Raises:
        FileNotFoundError: If there is no such split.
        ValueError: If a kind is unknown or named twice, the configuration makes no tracks, or a file is broken.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise ValueError(f"--on: expected some of {', '.join(KINDS)}, got {unknown[0]!r}")
    check_each_once(kinds, "--on")
    config = config.commanding()
    dataset = open_labelled(split)
    if not dataset.frame_ids:
        raise ValueError(f"{split}: expected images to run on, found none")
    networks: list[NetworkTimes] = []
    missing: dict[str, str] = {}
    for kind in kinds:
        if kind in ("node", "ros2") and importlib.util.find_spec("rclpy") is None:
            missing[KINDS[kind]] = "rclpy is not installed: needs ROS 2, or foreglow[ros2]"
            continue
        progress(KINDS[kind], 0, 1)
        if kind == "process":
            networks.append(in_process(dataset, config, progress))
            if paper is not None:
                networks.append(in_process(dataset, paper.commanding(), progress, PAPER_IN_PROCESS))
        elif kind == "live":
            times = live(dataset, config, num_paced)
            if times.num_frames:
                networks.append(times)
            else:
                missing[LIVE] = (
                    f"expected more than {NUM_WARM_UP} images, which are run before the first that counts, got "
                    f"{len(dataset)}"
                )
        else:
            try:
                networks.append(in_fresh_process(over_ros2, split, config, num_paced, kind == "node"))
            except TimeoutError as error:
                missing[KINDS[kind]] = words_of(error)
        progress(KINDS[kind], 1, 1)
    return RuntimeResults(
        dataset.name, 1.0 / (dataset.rate_hz or 18.0), config, processor_name(), tuple(networks), missing
    )


def in_process(
    dataset: LabelledSource, config: PipelineConfig, progress: Progress, name: str = IN_PROCESS
) -> NetworkTimes:
    """The pipeline on every frame, from the array to the beam command; frames are decoded before."""
    pipeline = Pipeline(config)
    rows: list[dict[str, float]] = []
    counts: list[int] = []
    for sequence, group in itertools.groupby(dataset, key=lambda frame: frame.sequence):
        frames = list(group)
        with settled_memory():
            for frame in () if rows else frames[:NUM_WARM_UP]:
                pipeline.step(frame)
            pipeline.reset()
            for frame in frames:
                before_ns = time.perf_counter_ns()
                result = pipeline.step(frame)
                taken_ms = (time.perf_counter_ns() - before_ns) / 1e6
                rows.append({COMPLETE: taken_ms, **_stages(result.stage_ms)})
                counts.append(len(result.proposals))
        progress(f"{name}, {sequence}", len(rows), dataset.num_frames)
    return _times(name, rows, counts, 0)


class TimesSink:
    """A live sink that keeps run-times and numbers of proposals."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self.counts: list[int] = []

    def write(self, frame: Frame, result: FrameResult) -> None:  # noqa: ARG002
        """Keeps the run-times of a frame."""
        between = {name: value for name, value in result.stage_ms.items() if name not in STAGES.values()}
        self.rows.append({COMPLETE: sum(result.stage_ms.values()), **_stages(result.stage_ms), **between})
        self.counts.append(len(result.proposals))

    def write_health(self, health: Health) -> None:
        """Not needed."""

    def close(self) -> None:
        """Nothing is open."""

    def discard(self) -> None:
        """Nothing is open."""


def live(dataset: LabelledSource, config: PipelineConfig, num_frames: int) -> NetworkTimes:
    """The live loop on frames at their own rate, from exposure until the command is on a CAN bus.

    The first `NUM_WARM_UP` of them do not count.
    """
    sink = TimesSink()
    outputs: list[BeamOutput] = []
    if importlib.util.find_spec("can") is not None:
        outputs.append(CanBus("virtual:foreglow-runtime"))
    loop = LiveLoop(Paced(dataset), lambda: Pipeline(config), config, outputs=outputs, sinks=[sink])
    summary = loop.run(num_frames + NUM_WARM_UP)
    return _times(LIVE, sink.rows[NUM_WARM_UP:], sink.counts[NUM_WARM_UP:], summary.num_dropped)


def over_ros2(split: Path, config: PipelineConfig, num_frames: int, is_whole: bool) -> NetworkTimes:
    """A network of nodes in processes of their own, from exposure until the command is sent.

    To be called in a process that has not loaded ROS 2 yet: it reads the environment once.
    """
    from foreglow.runtime.ros2.environment import prepare

    prepare()
    os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randrange(1, 100))
    from foreglow.runtime.ros2.measurement import WHOLE, Network

    nodes = WHOLE if is_whole else STAGE_NODES
    frames = list(itertools.islice(open_labelled(split), num_frames))
    with Network(config, nodes, keeps_results=False) as network, settled_memory():
        network.warm_up(frames[0], NUM_WARM_UP)
        answers = network.run(frames)
    rows = []
    for answer in answers:
        known = {part: value for times_ms in answer.times_ms.values() for part, value in times_ms.items()}
        latency_ms = answer.latency_ms(nodes[-1])
        rows.append(
            {COMPLETE: math.nan if latency_ms is None else latency_ms, "sent": answer.sent_ms, **_stages(known)}
        )
    num_lost = sum(math.isnan(row[COMPLETE]) for row in rows)
    return _times(ONE_NODE if is_whole else NETWORK, rows, [-1] * len(rows), num_lost)


def in_fresh_process(call: Callable[..., NetworkTimes], *arguments: Any) -> NetworkTimes:
    """The result of a call in a fresh process."""
    with safe_path(), ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(call, *arguments).result()


def _stages(stage_ms: Mapping[str, float]) -> dict[str, float]:
    return {part: stage_ms[stage] for part, stage in STAGES.items() if stage in stage_ms}


def _times(name: str, rows: Sequence[Mapping[str, float]], counts: Sequence[int], num_dropped: int) -> NetworkTimes:
    names = dict.fromkeys((COMPLETE, *(part for row in rows for part in row)))
    parts_ms = {part: np.array([row.get(part, math.nan) for row in rows]) for part in names}
    return NetworkTimes(name, parts_ms, np.array(counts, np.int64), num_dropped)
