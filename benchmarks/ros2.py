"""The ROS 2 network at a camera's rate: `python -m benchmarks.ros2 [--out FILE.json] [--quick]`.

Needs `foreglow[ros2]`. Latency from exposure (the stamp) until the beam command is sent, on the drive that ships, each
node a process and one thread: six nodes, and all stages in one, beside the pipeline in process; with and without our
profile of Fast DDS; and quicker than the stages can follow. Then nodes are killed: how long until there is low beam,
and until light is back.
"""

from __future__ import annotations

import dataclasses
import itertools
import multiprocessing
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Row, in_ms, options, table, write_results
from foreglow.config import PipelineConfig, preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.pipeline import Pipeline
from foreglow.runtime.ros2 import STAGE_NODES
from foreglow.types import BeamMode, Frame

IN_PROCESS = "in process"
FRAME_NS = 55_555_556

NO_PROFILE = """<dds xmlns="http://www.eprosima.com"><profiles>
<participant profile_name="plain" is_default_profile="true"><rtps><name>plain</name></rtps></participant>
</profiles></dds>
"""


class Contender(NamedTuple):
    """A network to be measured."""

    name: str
    is_whole: bool = False
    has_profile: bool = True
    speed: float = 1.0


CONTENDERS = (
    Contender("one node", is_whole=True),
    Contender("six processes"),
    Contender("six processes, no profile", has_profile=False),
    Contender("six processes, 3 times the rate", speed=3.0),
    Contender("six processes, 10 times the rate", speed=10.0),
)


def drive(num_frames: int) -> Iterator[Frame]:
    """The drive that ships, over and over."""
    from foreglow.runtime.ros2.source import repeated

    return itertools.islice(repeated(list(PVDN(shipped_drive())), is_endless=True), num_frames)


def prepared(has_profile: bool = True) -> PipelineConfig:
    """Sets up what ROS 2 reads from the environment, in a process that has not loaded it yet."""
    from foreglow.runtime.ros2.environment import PROFILES, prepare

    if not has_profile:
        empty = Path(tempfile.gettempdir()) / "foreglow_no_profile.xml"
        empty.write_text(NO_PROFILE, encoding="utf-8")
        os.environ[PROFILES[0]] = str(empty)
    prepare()
    os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randrange(1, 100))
    return preset("foreglow").commanding()


def measure(contender: Contender, num_frames: int) -> Row:
    """Latencies and lost frames of one network, and where the time goes."""
    config = prepared(contender.has_profile)
    from foreglow.runtime.ros2.measurement import WHOLE, Network

    nodes = WHOLE if contender.is_whole else STAGE_NODES
    with Network(config, nodes, keeps_results=False) as network:
        try:
            network.warm_up(next(drive(1)))
        except TimeoutError:  # no image gets through
            return {"what": contender.name, "num_lost": num_frames, "num_frames": num_frames}
        answers = network.run(drive(num_frames), speed=contender.speed)
    latencies = [answer.latency_ms(nodes[-1]) for answer in answers]
    came = [latency_ms for latency_ms in latencies if latency_ms is not None]
    parts = {
        node: {
            part: float(np.median([times_ms[part] for times_ms in of_node if part in times_ms]))
            for part in next(times_ms for times_ms in of_node if times_ms)
        }
        for node, of_node in ((node, [answer.times_ms.get(node, {}) for answer in answers]) for node in nodes)
    }
    return {
        "what": contender.name,
        "num_frames": num_frames,
        "num_lost": num_frames - len(came),
        "sent_ms": float(np.median([answer.sent_ms for answer in answers])),
        "parts_ms": parts,
        **percentiles(came),
    }


def in_process(num_frames: int) -> Row:
    """The same frames through the pipeline, at their own rate."""

    pipeline, times_ms = Pipeline(preset("foreglow").commanding()), []
    for frame in drive(num_frames):
        time.sleep(0.03)  # as long as others may push the data out of the caches
        before_ns = time.perf_counter_ns()
        pipeline.step(frame)
        times_ms.append((time.perf_counter_ns() - before_ns) / 1e6)
    return {"what": IN_PROCESS, "num_frames": num_frames, "num_lost": 0, **percentiles(times_ms)}


def percentiles(values_ms: Sequence[float]) -> Row:
    p50, p99, worst = np.percentile(values_ms, (50, 99, 100)).tolist()
    return {"median_ms": p50, "p99_ms": p99, "max_ms": worst}


def reactions(rounds: int) -> list[Row]:
    """How long it takes, once a node is killed, to low beam and back to light above it, milliseconds."""
    config = prepared()
    from foreglow.runtime.ros2.measurement import Network

    rows: list[Row] = []
    with Network(config, keeps_results=False) as network:
        network.warm_up(next(drive(1)))
        network.run(killing(network, STAGE_NODES[:-1] * rounds, rows))
    return rows


def killing(network: Any, victims: Sequence[str], rows: list[Row]) -> Iterator[Frame]:
    """Frames without end or beginning, while one node after the other is killed; notes what follows in `rows`."""
    turns = enumerate(itertools.cycle(list(drive(90))))
    endless = (dataclasses.replace(frame, timestamp_ns=number * FRAME_NS) for number, frame in turns)
    commands = network.commands
    for victim in victims:
        yield from itertools.islice(endless, 18)
        known, killed_ns = len(commands), time.time_ns()
        os.kill(network.processes[victim].popen.pid, signal.SIGKILL)
        while (low := next((sent for sent in commands[known:] if sent.beam.mode == BeamMode.LOW), None)) is None:
            yield next(endless)
        known = commands.index(low)
        while (high := next((sent for sent in commands[known:] if sent.beam.mode != BeamMode.LOW), None)) is None:
            yield next(endless)
        row = {"low_beam_ms": (low.received_ns - killed_ns) / 1e6, "high_beam_ms": (high.received_ns - killed_ns) / 1e6}
        rows.append({"killed": victim, "fault": " ".join(low.beam.faults), **row})


def apart(call: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a call in a process of its own: ROS 2 reads the environment once."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(call, *arguments).result()


def network_table(rows: Sequence[Row]) -> Table:
    shown = table(
        "Exposure to beam command", ("",), ("frames", "lost", "median ms", "p99 ms", "max ms", "times in process")
    )
    reference = next(row["median_ms"] for row in rows if row["what"] == IN_PROCESS)
    for row in rows:
        figures = ["", "", "", ""]
        if "median_ms" in row:
            figures = [*in_ms(row, "median_ms", "p99_ms", "max_ms"), f"{row['median_ms'] / reference:.1f}"]
        shown.add_row(row["what"], str(row["num_frames"]), str(row["num_lost"]), *figures)
    return shown


def reaction_table(rows: Sequence[Row]) -> Table:
    shown = table("After kill -9", ("node", "fault"), ("low beam ms", "light again ms"))
    for row in rows:
        shown.add_row(row["killed"], row["fault"], f"{row['low_beam_ms']:.0f}", f"{row['high_beam_ms']:.0f}")
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "ros2", arguments)
    num_frames = 20 if given.quick else 540
    contenders = CONTENDERS[:2] if given.quick else CONTENDERS
    rows = [apart(in_process, num_frames), *(apart(measure, contender, num_frames) for contender in contenders)]
    CONSOLE.print(network_table(rows))
    killed = [] if given.quick else apart(reactions, 5)
    CONSOLE.print(reaction_table(killed))
    write_results(given.out, {"network": rows, "reactions": killed})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
