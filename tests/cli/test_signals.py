"""Signals: every command ends in order, before, in and after its loop."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from foreglow.datasets import shipped_drive
from tests.lab.learning.tiny_drives import CONFIG_TOML, make_drives

pytestmark = pytest.mark.process

ENDINGS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


WAIT = """
import os, signal, sys, time
from pathlib import Path


def wait(*_, **__):
    print("now", flush=True)
    for _ in range(6000):  # a signal that comes just before a sleep does not wake it
        time.sleep(0.01)

"""
MAIN = """
from foreglow.cli import main

main()
"""


def ended(code: str, number: signal.Signals, *arguments: object) -> tuple[int, str]:
    """Runs the command with `code` before it, sends the signal when it says `now`; the exit code and stderr."""
    program = WAIT + textwrap.dedent(code) + MAIN
    process = subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    for line in process.stdout:
        if line == "now\n":
            break
    process.send_signal(number)
    stderr = process.communicate(timeout=60)[1]
    return process.returncode, stderr


FORKED = """
import gc, json

gc.freeze()  # what is loaded here would be searched for garbage when each fork ends


def is_child(number):
    (out, child_out), (err, child_err) = os.pipe(), os.pipe()
    child = os.fork()
    if not child:
        os.dup2(child_out, 1)
        os.dup2(child_err, 2)
    os.close(child_out)
    os.close(child_err)
    if not child:
        os.close(out)
        os.close(err)
        return True
    with open(out) as stdout, open(err) as stderr:
        for line in stdout:
            if line == "now\\n":
                break
        os.kill(child, number)
        said = stderr.read()
    print(json.dumps([number, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said]), flush=True)
    return False


arguments = sys.argv[1:]
for number in NUMBERS:
    if is_child(number):
        sys.argv[1:] = [argument.replace("NUMBER", str(number)) for argument in arguments]
        main()
"""


def endings(code: str, loads: str, *arguments: object) -> dict[signal.Signals, tuple[int, str]]:
    """As `ended` for each signal, in processes forked from one that has loaded the modules `loads`, which takes long.

    NUMBER in the arguments is the signal's.
    """
    program = f"NUMBERS = {[int(number) for number in ENDINGS]}\n{WAIT}{textwrap.dedent(code)}\nimport {loads}\n"
    program += MAIN.replace("\nmain()\n", FORKED)
    command = [sys.executable, "-c", program, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    results = [json.loads(line) for line in done.stdout.splitlines()]
    return {signal.Signals(number): (code, said) for number, code, said in results}


LOADING = """
class Waiting:
    def find_spec(self, name, *_):
        if name == "foreglow.cli.simulate":
            wait()

sys.meta_path.insert(0, Waiting())
"""
BEFORE_THE_LOOP = """
import foreglow.cli.beam

foreglow.cli.beam._can_sink = wait
"""


INTERRUPTED = (130, "foreglow: interrupted\n")


@pytest.mark.parametrize("number", ENDINGS)
def test_ends_with_one_line_while_it_is_loaded(number: signal.Signals, tmp_path: Path) -> None:
    arguments = ("beam", shipped_drive(), "--can", "log", "--out", tmp_path / "out")
    assert ended(LOADING, number, *arguments) == INTERRUPTED
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_while_the_first_ends_the_loading(number: signal.Signals, tmp_path: Path) -> None:
    """It killed the process: its handler had been taken away before."""
    again = """
def put(number, handler, put=signal.signal):
    put(number, handler)
    if handler is signal.SIG_DFL:
        os.kill(os.getpid(), number)

signal.signal = put
"""
    code, said = ended(LOADING + again, number, "beam", shipped_drive(), "--out", tmp_path / "out")
    assert (code, said.splitlines()[:1]) == (130, ["foreglow: interrupted"])


def test_ends_with_one_line_before_its_loop_and_leaves_nothing(tmp_path: Path) -> None:
    arguments = ("beam", shipped_drive(), "--can", "log", "--out", tmp_path / "NUMBER")
    found = endings(BEFORE_THE_LOOP, "foreglow.tracking, foreglow.runtime, scipy.interpolate", *arguments)
    assert found == dict.fromkeys(ENDINGS, INTERRUPTED)
    assert not list(tmp_path.rglob("*"))


def test_a_preview_leaves_no_half_film(tmp_path: Path) -> None:
    code = """
    from dataclasses import replace
    from foreglow.lab import simulation
    from tests.stand_ins import night_frames
    from foreglow.lab.simulation import preview

    preview.labelled = lambda known, tone: known.frame.image[:, :, None].repeat(3, axis=2)

    class Known:
        pass

    def frames(*_):
        for frame in night_frames(3):
            known = Known()
            known.frame = frame
            yield known
        wait()

    simulation.drive_frames = frames
    """
    pytest.importorskip("mitsuba")
    arguments = ("simulate", "--preview", "curve", "--out", tmp_path / "NUMBER")
    assert endings(code, "foreglow.lab.simulation", *arguments) == dict.fromkeys(ENDINGS, INTERRUPTED)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_hang_up_that_is_ignored_stays_so() -> None:
    code = """
    import os, signal
    from foreglow.runtime.run import InterruptFlag
    from foreglow.cli.signals import interruptible

    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with interruptible(), InterruptFlag() as interrupt:
        os.kill(os.getpid(), signal.SIGHUP)
        assert not interrupt.is_set
    sys.exit(7)
    """
    assert ended(code, signal.SIGINT)[0] == 7


def test_signals_that_come_together_are_one_wish() -> None:
    code = """
    import os, signal
    from foreglow.cli.signals import interruptible

    with interruptible():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
        finally:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.1)
            print("tidied up", file=sys.stderr)
    """
    assert ended(code, signal.SIGINT) == (130, "tidied up\nforeglow: interrupted\n")


DROPS = {
    "callback of a weak reference": """
        class Referent:
            pass

        referent = Referent()
        reference = weakref.ref(referent, kill)
        del referent
    """,
    "__del__": """
        class Dying:
            __del__ = kill

        Dying()
    """,
    "and again before its hook has ended": """
        begin = threading.Timer.start

        def begin_slowly(timer):
            begin(timer)
            threading.Timer.start = begin
            time.sleep(1)

        class Dying:
            __del__ = kill

        threading.Timer.start = begin_slowly
        Dying()
    """,
}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
@pytest.mark.parametrize("drop", DROPS)
def test_a_signal_that_is_dropped_ends_the_command_even_so(drop: str, number: signal.Signals) -> None:
    program = f"""
import os, signal, sys, threading, time, weakref
from foreglow.cli.signals import interruptible

def kill(*_):
    os.kill(os.getpid(), {int(number)})
    time.sleep(0)

with interruptible():
    {textwrap.indent(textwrap.dedent(DROPS[drop]), "    ").strip()}
    time.sleep(10)
    print("went on")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "foreglow: interrupted\n")


def test_a_signal_that_a_library_drops_makes_no_success() -> None:
    code = """
    from foreglow.cli.signals import interruptible

    with interruptible():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10)
        except BaseException:
            print("dropped", file=sys.stderr)
        sys.exit()
    """
    assert ended(code, signal.SIGINT) == (130, "dropped\nforeglow: interrupted\n")


def test_a_forked_process_ends_by_itself() -> None:
    code = """
    import os, signal
    from foreglow.cli.signals import interruptible

    with interruptible():
        child = os.fork()
        if not child:
            time.sleep(60)
        time.sleep(0.2)
        os.kill(child, signal.SIGTERM)
        sys.exit(0 if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGTERM else 1)
    """
    assert ended(code, signal.SIGINT) == (0, "")


ENDS = {
    "while it leaves the command": ("import foreglow.cli; foreglow.cli.end_despite_hanging = raise_it", 130),
    "in an exit function": ("import atexit, foreglow.cli; atexit.register(raise_it)", 130),
    "while a thread is waited for": ("import threading; threading.Thread(target=late, args=(raise_it,)).start()", 130),
    "while modules are cleared": ("kept = Late(raise_it)", 0),
}
LATE = """
class Late:
    def __init__(self, raise_it):
        self.raise_it = raise_it

    def __del__(self):
        self.raise_it()


def raise_it(*_, kill=os.kill, own=os.getpid(), number=NUMBER):
    kill(own, number)


def late(raise_it):
    import sys, threading, time, traceback

    while "end_despite_hanging" not in {
        frame.f_code.co_name for frame, _ in traceback.walk_stack(sys._current_frames()[threading.main_thread().ident])
    }:
        time.sleep(0.02)
    raise_it()
"""


@pytest.mark.parametrize("moment", ENDS)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_the_very_end_of_a_command(moment: str, number: signal.Signals) -> None:
    begin, code = ENDS[moment]
    program = f"import os\n{LATE.replace('NUMBER', str(int(number)))}\n{begin}\n{MAIN}"
    done = subprocess.run([sys.executable, "-c", program, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, "")
    assert done.stdout.startswith("foreglow ")


def test_a_ros_2_node_that_is_interrupted_says_so() -> None:
    code = """
    import types
    import foreglow.cli.ros2

    class Node:
        def __init__(self, setting):
            pass

        def spin(self, should_stop, limit_s):
            print("now", flush=True)
            while not should_stop():
                time.sleep(0.01)

    foreglow.cli.ros2._prepare = lambda *_: []
    stages = types.ModuleType("foreglow.runtime.ros2.stages")
    stages.NODES, stages.Setting = {"tracking": Node}, lambda *_: None
    sys.modules[stages.__name__] = stages
    """
    assert endings(code, "foreglow.config", "ros2", "tracking") == dict.fromkeys(ENDINGS, (130, ""))


HALF_WRITTEN = """
import contextlib
from foreglow import whole_files

whole = whole_files.open_atomic


@contextlib.contextmanager
def waiting(path):
    with whole(path) as file:
        if path.name == NAME:
            file.write(b"half")
            file.flush()
            wait()
        yield file


whole_files.open_atomic = waiting
"""


UNDRAWN = """
import matplotlib.figure

matplotlib.figure.Figure.savefig = lambda _, file, **__: file.write(b"no picture")
"""


def test_a_report_is_not_left_half_written(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    run = Path(__file__).parents[1] / "runs" / "run_of_0_1_0"
    code = f"NAME = {path.name!r}\n{UNDRAWN}\n{HALF_WRITTEN}"
    found = endings(
        code, "foreglow.lab.reports.run_page, matplotlib.backends.backend_agg", "report", run, "--out", path
    )
    assert found == dict.fromkeys(ENDINGS, INTERRUPTED)
    assert not list(tmp_path.iterdir())


@pytest.mark.torch
@pytest.mark.slow
def test_a_training_leaves_whole_files(tmp_path: Path) -> None:
    """It is interrupted after its first epoch, while the curves are written."""
    pytest.importorskip("onnx")
    data = make_drives(tmp_path / "data", num_images=2)
    (tmp_path / "config.toml").write_text(CONFIG_TOML)
    code = f"NAME = 'curves.csv'\n{HALF_WRITTEN}"
    options = ["--epochs", 2, "--device", "cpu", "--preset", "paper", "--config", tmp_path / "config.toml"]
    modules = "foreglow.lab.learning.training, foreglow.lab.learning.training_run, onnx, matplotlib.pyplot"
    loads = f"{modules}, torch._dynamo"  # which every optimiser loads, in a second
    found = endings(code, loads, "train", data, "--out", tmp_path / "NUMBER", *options)
    assert found.keys() == set(ENDINGS)
    for number, code_and_words in found.items():
        out = tmp_path / str(int(number))
        words = f"{out}: the same command continues from the last whole epoch\nforeglow: interrupted\n"
        assert code_and_words == (130, words)
        left = {path.name for path in out.iterdir()}
        assert "checkpoint.pt" in left
        assert not [
            name for name in left if name.startswith(".") or name in {"curves.csv", "model.onnx", "summary.json"}
        ]
