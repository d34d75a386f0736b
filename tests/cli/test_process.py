"""The command as a process: exit codes, signals, pipes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from foreglow.datasets import shipped_drive
from tests.cli.commands import PNG, RESULTS, names, num_lines
from tests.cli.forked import Loaded
from tests.linux import needs_full_disk

pytestmark = pytest.mark.process


@pytest.fixture
def config(config: Path) -> Path:
    """With the native core, and without ranges and tracks: libraries of the others take half of the time to load."""
    native = config.read_text().replace("reference", "native", 1)
    config.write_text(native + '[distance]\nestimator = "none"\n[tracker]\nmethod = "none"\n')
    return config


def subprocess_command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "foreglow.cli", *map(str, arguments)]


def test_as_a_process(tmp_path: Path, folder: Path, config: Path) -> None:
    command = subprocess_command("run", folder, "--out", tmp_path / "out", "--config", config)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert names(tmp_path / "out") == RESULTS


def test_figures_do_not_depend_on_the_environment(tmp_path: Path, folder: Path, config: Path) -> None:
    """matplotlib refuses to be imported with a backend that it does not know, and with others would open windows."""
    pytest.importorskip("matplotlib")
    (tmp_path / "matplotlibrc").write_text("figure.facecolor: red\nfont.size: 30\n")
    pictures = []
    for variables, home in (({}, folder), ({"MPLBACKEND": "nonsense"}, tmp_path)):
        command = subprocess_command("stages", folder, "--out", tmp_path / "stages.png", "--config", config)
        environment = os.environ | variables
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=home, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        pictures.append((tmp_path / "stages.png").read_bytes())
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize("variable", ["OPENCV_IO_MAX_IMAGE_PIXELS=x", "OPENCV_TRACE=", "OPENCV_FOR_THREADS_NUM=-1"])
def test_variables_for_which_opencv_aborts(variable: str) -> None:
    name, value = variable.split("=")
    command = subprocess_command("--version")
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {name: value}, check=False)
    said = f"foreglow: {name}={value!r}: expected variables with which OpenCV can be used\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)


def test_variables_that_opencv_can_read(tmp_path: Path) -> None:
    variables = os.environ | {"OPENCV_LOG_LEVEL": "ERROR", "OPENCV_VIDEOIO_DEBUG": "0"}
    command = subprocess_command("run", tmp_path / "absent")
    done = subprocess.run(command, capture_output=True, text=True, env=variables, check=False)
    assert (done.returncode, done.stderr.partition(": ")[2].partition(":")[0]) == (2, str(tmp_path / "absent"))


def test_error_of_a_process_has_no_traceback(tmp_path: Path) -> None:
    command = subprocess_command("run", tmp_path / "absent", "--out", tmp_path / "out")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "Traceback" in subprocess.run([*command[:3], "--debug", *command[3:]], capture_output=True, text=True).stderr


def test_a_library_that_logs_adds_no_line(tmp_path: Path) -> None:
    """python-can logs what its drivers lack; without a handler, Python itself writes a line about that."""
    pytest.importorskip("can")
    command = subprocess_command("live", shipped_drive(), "--can", "pcan:none", "--out", tmp_path / "out")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1, done.stderr
    assert names(tmp_path) == set()


def test_a_name_that_the_terminal_cannot_show(tmp_path: Path, folder: Path, config: Path) -> None:
    out = os.fsencode(tmp_path) + b"/out\xff"
    command = [*map(os.fsencode, subprocess_command("run", folder, "--config", config, "--out")), out]
    done = subprocess.run(
        command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": "utf-8:strict"}, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"look in " + os.fsencode(tmp_path) + b"/out\\udcff: " in done.stdout


def test_too_little_memory_to_begin() -> None:
    program = (
        "import resource; from foreglow.cli import main; "
        "taken = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize(); "
        "resource.setrlimit(resource.RLIMIT_AS, (taken, taken)); main()"
    )
    done = subprocess.run([sys.executable, "-c", program, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "foreglow: not enough memory to begin\n")


@needs_full_disk
def test_a_disk_that_is_full_for_the_version() -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(subprocess_command("--version"), stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (2, "foreglow: standard output: No space left on device\n")


@needs_full_disk
def test_a_disk_that_is_full_for_what_a_command_says(tmp_path: Path, folder: Path, config: Path) -> None:
    command = subprocess_command("run", folder, "--out", tmp_path / "out", "--config", config)
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (2, "foreglow: standard output: No space left on device\n")
    assert names(tmp_path / "out") == RESULTS


@pytest.mark.parametrize("closing", ["2>&-", "<&- >&- 2>&-"])
def test_standard_streams_that_are_closed(tmp_path: Path, folder: Path, config: Path, closing: str) -> None:
    command = subprocess_command("run", folder, "--out", tmp_path / "out", "--config", config)
    done = subprocess.run(["sh", "-c", f'"$@" {closing}', "sh", *command], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert names(tmp_path / "out") == RESULTS


def test_reader_that_goes_away_is_no_error_of_ours(tmp_path: Path, folder: Path, config: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = subprocess_command("run", folder, "--out", tmp_path / "out", "--config", config)
    try:
        done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")
    assert names(tmp_path / "out") == RESULTS


@pytest.mark.parametrize("arguments", [("--help",), ("run", "--help"), ("labels", "export", "-h"), ("--version",)])
def test_reader_that_has_seen_enough_of_the_help(arguments: tuple[str, ...]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(subprocess_command(*arguments), stdout=writing, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of images that take longer than we wait."""
    images = tmp_path_factory.mktemp("many")
    for k in range(3000):
        (images / f"{k:06d}.png").write_bytes(PNG)
    return images


@pytest.mark.parametrize("interrupt", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_process_keeps_what_was_done(
    tmp_path: Path, config: Path, many: Path, program: Loaded, interrupt: signal.Signals
) -> None:
    out = tmp_path / "out"
    process = program.start("run", many, "--out", out, "--config", config)
    deadline = time.monotonic() + 20
    partial = out / "frames.jsonl.partial"
    while not (partial.exists() and partial.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(interrupt)
    assert process.ended()[0] == 130
    summary = json.loads((out / "summary.json").read_text())
    assert summary["is_complete"] is False
    assert 0 < summary["num_frames"] == num_lines(out) < 3000
    assert names(out) == RESULTS
