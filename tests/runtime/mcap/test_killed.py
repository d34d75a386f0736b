"""A process that records is killed: what it had written is there and readable."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import Recording
from tests.runtime.mcap.drives import full_frame

pytestmark = pytest.mark.process

pytest.importorskip("foxglove")

RECORDING = """
import itertools, sys, time
from pathlib import Path
from foreglow.runtime.mcap import McapRecorder
from tests.runtime.mcap.drives import STEP_NS, full_frame, full_result

recorder = McapRecorder(Path(sys.argv[1]))
for index in itertools.count():
    frame = full_frame(index % 50, time_ns=index * STEP_NS)
    recorder.write(frame, full_result(frame))
    print(index, flush=True)
"""

FRAMES_A_CHUNK = 11
"""Half a second of 50 ms each, and the frame that is beyond."""


@pytest.mark.parametrize("num_written", [15, 40, 137])
def test_a_killed_process(tmp_path: Path, num_written: int) -> None:
    path = tmp_path / "drive.mcap"
    command = [sys.executable, "-c", RECORDING, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line) + 1 >= num_written:
                break
        time.sleep(0.001 * (num_written % 7))  # anywhere within a frame
        process.send_signal(signal.SIGKILL)
        num_said = num_written + len(process.stdout.read().split())
    assert process.returncode == -signal.SIGKILL
    assert [each.name for each in tmp_path.iterdir()] == ["drive.mcap.partial"]
    with pytest.warns(UserWarning, match="the recording was not finished"):
        source = Recording(tmp_path / "drive.mcap.partial")
    frames = list(source)
    assert source.skipped == []
    assert num_said - FRAMES_A_CHUNK < len(frames) <= num_said + 1
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, full_frame(index % 50).image)
        assert frame.camera is not None
        assert frame.motion is not None
