"""One line and an exit code, whatever goes wrong."""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import json
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path

import cv2
import numpy as np
import pytest

import foreglow.runtime
import foreglow.runtime.ros2
from foreglow.cli import errors
from foreglow.datasets import open_source, shipped_drive
from tests.cli.commands import PNG, complaint, foreglow_command


def test_a_fault_of_ours_leaves_a_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fail(*_: object, **__: object) -> None:
        raise KeyError("not foreseen")

    monkeypatch.setattr("foreglow.pipeline.Pipeline.__init__", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "reports"))
    (tmp_path / "reports").mkdir()
    source = tmp_path / "image.png"
    cv2.imwrite(str(source), np.zeros((64, 96), np.uint8))
    result = foreglow_command("run", source, "--out", tmp_path / "out")
    (report,) = (tmp_path / "reports").iterdir()
    assert result.exit_code == errors.INTERNAL_ERROR
    assert str(report) in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert "not foreseen" in report.read_text(encoding="utf-8")
    assert "Traceback" in report.read_text(encoding="utf-8")


@contextlib.contextmanager
def as_nobody() -> Iterator[None]:
    """Root may enter every folder."""
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if is_root:
            os.seteuid(0)


def test_a_folder_that_may_not_be_entered_is_named() -> None:
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "images"
        folder.mkdir()
        (folder / "000001.png").write_bytes(PNG)
        Path(parent).chmod(0o755)
        folder.chmod(0o444)
        with as_nobody(), pytest.raises(PermissionError) as caught:
            open_source(folder)
        with as_nobody():
            line, code = errors.one_line(caught.value, [folder])
        folder.chmod(0o755)
    assert (line, code) == (f"{folder}: expected a folder that may be entered, the right to (x) is missing", 2)


def test_a_fault_of_ours_where_the_package_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.version", unknown)
    line, code = errors.one_line(KeyError("not foreseen"))
    assert line.endswith("report: none, it cannot be written: No package metadata was found for foreglow")
    assert code == errors.INTERNAL_ERROR


@pytest.mark.parametrize("text", ["[" * 100_000, "[1" + "0" * 400 + "]", "{" * 5000])
def test_reading_an_input_names_it(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lines.jsonl"
    path.write_text(text, encoding="utf-8")
    result = foreglow_command("export-mot", tmp_path, tmp_path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1


def test_an_unforeseen_error_of_a_reader_names_its_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OverflowError("int too large")

    monkeypatch.setattr("foreglow.datasets.image_folder.ImageFolder.__init__", fail)
    source = tmp_path / "images"
    source.mkdir()
    (source / "a.png").touch()
    result = foreglow_command("run", source, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr == f"foreglow: {source}: cannot be read: OverflowError: int too large\n"


def test_the_innermost_reader_says_which_file(tmp_path: Path) -> None:
    folder, path = tmp_path, tmp_path / "a.json"
    code = "def read(path):\n    return 1 // 0\n"
    space: dict[str, object] = {"__name__": "foreglow.datasets.made_up"}
    exec(compile(code, "made_up.py", "exec"), space)
    with pytest.raises(ZeroDivisionError) as caught:
        space["read"](path)  # type: ignore[operator]
    line, code_ = errors.one_line(caught.value, [folder])
    assert (line.partition(": ")[0], code_) == (str(path), 2)


def test_outputs_are_no_inputs(tmp_path: Path) -> None:
    (tmp_path / "in").touch()
    (tmp_path / "out").touch()
    line = [
        "--config",
        str(tmp_path / "in"),
        f"--model={tmp_path / 'in'}",
        "--out",
        str(tmp_path / "out"),
        "\0",
        "x" * 9999,
    ]
    assert errors._inputs(line) == [tmp_path / "in"] * 2


def test_a_thread_that_cannot_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("threading._start_new_thread", fail)
    with pytest.raises(RuntimeError) as caught:
        threading.Thread(target=print).start()
    assert errors.one_line(caught.value) == (
        "no further thread can be started: expected more memory, or fewer processes",
        2,
    )


def test_long_messages_are_cut() -> None:
    line, _ = errors.one_line(ValueError("x" * 10_000_000))
    assert len(line) <= errors.MAX_LENGTH


@pytest.mark.parametrize("kind", [ValueError, OSError, RuntimeError, ImportError])
@pytest.mark.parametrize("says", [1, None, KeyError("broken")])
def test_an_error_that_cannot_say_what_it_is(
    kind: type[Exception], says: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def text(_: Exception) -> object:
        if isinstance(says, Exception):
            raise says
        return says

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    line, _ = errors.one_line(type("Broken", (kind,), {"__str__": text})())
    assert "what it says cannot be read" in line


def test_names_that_are_not_utf_8() -> None:
    line, _ = errors.one_line(FileNotFoundError(2, "no such file", os.fsdecode(b"/tmp/\xff\xfe.png")))
    line.encode("utf-8")


def test_usage_is_one_line_where_nobody_looks() -> None:
    import subprocess

    command = [sys.executable, "-m", "foreglow.cli", "run", "--no-such-option"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("foreglow: ")
    assert len(done.stderr.splitlines()) == 1
    assert json.dumps(done.stdout) == '""'


def test_an_interrupt_while_a_module_loads(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr("foreglow.datasets.open_source", interrupted)
    (tmp_path / "a.png").write_bytes(PNG)
    result = foreglow_command("run", tmp_path / "a.png", "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr == "foreglow: interrupted\n"


@pytest.mark.parametrize(
    ("error", "complaint"),
    [
        ("ZeroDivisionError('nothing')", "ZeroDivisionError: nothing"),
        ("OSError(28, 'No space', 'a')", "OSError: [Errno 28] No space: 'a'"),
        ("MemoryError()", "MemoryError"),
        ("BrokenPipeError(32, 'Broken pipe')", "BrokenPipeError: [Errno 32] Broken pipe"),
        ("SystemExit(0)", "SystemExit: 0"),
        ("GeneratorExit()", "GeneratorExit"),
        ("type('Mute', (ValueError,), {'__str__': lambda self: 1 / 0})()", "Mute: what it says cannot be read"),
    ],
)
def test_what_a_plug_in_raises_is_no_fault_of_ours(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: str, complaint: str
) -> None:
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    module = f"tracker_{complaint.partition(':')[0].lower()}"
    lines = ["class Raising:", "    def __init__(self, config):", f"        raise {error}"]
    Path(f"{module}.py").write_text("\n".join(lines), encoding="utf-8")
    Path("own.toml").write_text(f'[tracker]\nmethod = "{module}:Raising"\n', encoding="utf-8")
    cv2.imwrite("image.png", np.zeros((64, 96), np.uint8))
    result = foreglow_command("run", "image.png", "--out", "out", "--config", "own.toml")
    assert result.exit_code == 2
    where = f"{Path(f'{module}.py').resolve()}, line 3"
    assert result.stderr.strip() == f"foreglow: {where}: the plug-in raised {complaint}".strip()
    assert not Path("out").exists()


def test_too_little_memory_is_not_blamed_on_the_input() -> None:
    """An error that says how much was asked for may be about a number in a file; Python's own says nothing."""
    inputs = [Path("drive"), Path("own.toml")]
    assert errors.one_line(MemoryError(), inputs) == ("not enough memory", 2)
    line = "drive, own.toml: expected values that can be worked with: MemoryError: Unable to allocate 9 TiB"
    assert errors.one_line(MemoryError("Unable to allocate 9 TiB"), inputs) == (line, 2)


def test_a_package_that_cannot_be_loaded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As ROS 2's without its libraries: the error names none of our modules, nor is anything missing."""
    (tmp_path / "cantools").mkdir()
    (tmp_path / "cantools" / "__init__.py").write_text("import cantools.database", encoding="utf-8")
    (tmp_path / "cantools" / "database.py").write_text("raise ImportError('libcan.so: no such file')", encoding="utf-8")
    for name in [name for name in sys.modules if name.partition(".")[0] == "cantools"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    space: dict[str, object] = {"__name__": "foreglow.datasets.made_up"}
    exec("def read():\n    import cantools\n", space)
    with pytest.raises(ImportError) as caught:
        space["read"]()  # type: ignore[operator]
    line = "cantools is installed, but cannot be loaded: libcan.so: no such file"
    assert errors.one_line(caught.value) == (line, 2)


def test_ros_2_whose_libraries_are_not_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Its message has advice for its developers behind the reason; the way out is that of every ROS 2 program."""
    pytest.importorskip("foxglove")
    (tmp_path / "rclpy").mkdir()
    reason = "librcl_action.so: cannot open shared object file: No such file or directory"
    (tmp_path / "rclpy" / "__init__.py").write_text(f"raise ImportError({reason!r} + chr(10) + 'The C extension')")
    monkeypatch.setattr(foreglow.runtime, "ros2", foreglow.runtime.ros2)  # later tests get this one again
    for name in [name for name in sys.modules if name.startswith(("rclpy", "foreglow.runtime.ros2"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    line = complaint("record", shipped_drive(), "--limit", 1, "--out", tmp_path / "drive.mcap", "--ros2")
    hint = "; source the setup file of ROS 2 first"
    assert line == f"foreglow: rclpy is installed, but cannot be loaded: {reason}{hint}\n"
    assert not list(tmp_path.glob("drive*"))


@pytest.mark.parametrize("lacking", ["rclpy", "builtin_interfaces", "nav_msgs", "sensor_msgs", "std_msgs"])
def test_a_part_of_ros_2_that_is_not_installed(lacking: str) -> None:
    error = ModuleNotFoundError(f"No module named {lacking!r}", name=lacking)
    line = f"{lacking} is not installed; this command needs: pip install 'foreglow[ros2]'"
    assert errors.one_line(error) == (line, 2)


def test_a_package_that_another_process_cannot_load() -> None:
    """Its error comes back without the way to it; `concurrent`, through which it came, is not what is broken."""
    future: Future[None] = Future()
    future.set_exception(ImportError("librcl_action.so: cannot open shared object file"))
    space: dict[str, object] = {"__name__": "foreglow.lab.made_up", "future": future}
    exec("def wait():\n    future.result()\n", space)
    with pytest.raises(ImportError) as caught:
        space["wait"]()  # type: ignore[operator]
    reason = "librcl_action.so: cannot open shared object file"
    line = f"a package that this needs is installed, but cannot be loaded: {reason}"
    assert errors.one_line(caught.value) == (line, 2)


def test_a_working_directory_that_is_gone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    with pytest.raises(FileNotFoundError) as caught:
        Path.cwd()
    assert errors.one_line(caught.value) == ("the working directory is there no more", 2)


def test_no_folder_for_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", list)
    monkeypatch.setattr(tempfile, "tempdir", None)
    with pytest.raises(FileNotFoundError) as caught:
        tempfile.gettempdir()
    line, code = errors.one_line(caught.value)
    assert line.startswith(
        "expected room for a temporary file, or TMPDIR to name a folder with some: No usable temporary"
    )
    assert code == 2


def test_our_own_cameras_are_no_plug_ins() -> None:
    result = foreglow_command("live", "camera:x", "--give-up", "0.5")
    assert result.exit_code == 2
    assert "plug-in" not in result.stderr


def test_a_plug_in_that_lacks_a_method(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    Path("silent_tracker.py").write_text(
        "class Silent:\n    def __init__(self, config): self.update = print\n", encoding="utf-8"
    )
    Path("own.toml").write_text('[tracker]\nmethod = "silent_tracker:Silent"\n', encoding="utf-8")
    cv2.imwrite("image.png", np.zeros((64, 96), np.uint8))
    result = foreglow_command("run", "image.png", "--out", "out", "--config", "own.toml")
    assert result.exit_code == 2
    assert "silent_tracker:Silent: expected a class, or what makes an object, with the methods" in result.stderr


def test_a_plug_in_that_ends_the_program_when_it_is_imported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    Path("ending_policy.py").write_text("raise SystemExit(0)", encoding="utf-8")
    cv2.imwrite("image.png", np.zeros((64, 96), np.uint8))
    result = foreglow_command("beam", "image.png", "--out", "out", "--policy", "ending_policy:Ending")
    assert result.exit_code == 2
    assert "--policy: ending_policy:Ending cannot be imported: SystemExit: 0" in result.stderr


def test_a_name_that_no_text_can_hold() -> None:
    with pytest.raises(UnicodeEncodeError) as caught:
        f"model = '/models/{os.fsdecode(bytes([255]))}.onnx'".encode()
    line, code = errors.one_line(caught.value)
    assert code == 2
    assert "/models/\\udcff.onnx" in line
