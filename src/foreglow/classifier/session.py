"""ONNX models in files, opened within bounds: a small file may ask for any memory, or for a loop without end."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from foreglow.classifier.divisions import check_types, computed_divisors
from foreglow.classifier.operations import check_operations
from foreglow.files import check_file, read_bytes, read_plain_json
from foreglow.models import BUNDLED, SHA256, model_path
from foreglow.own_files import is_own
from foreglow.wording import check_one_of, shortened

if TYPE_CHECKING:
    from onnxruntime import InferenceSession, SessionOptions

Device: TypeAlias = Literal["cpu", "cuda"]
"""What a network is computed on."""

MAX_MODEL_BYTES = 1 << 29
"""Largest model file; ours has less than a megabyte."""

MAX_TENSOR_BYTES = 1 << 31
"""Memory for the tensors of all models of this process."""

_DIGEST = "model_sha256"
"""Where the summary of a training has the SHA-256 of its model."""

CUDA = "CUDAExecutionProvider"
"""ONNX Runtime's name for computing on NVIDIA's GPUs."""


def open_session(path: Path, num_threads: int, device: Device = "cpu") -> InferenceSession:
    """A sequential session that does not spin while it waits.

    Raises:
        FileNotFoundError: If there is no such file.
        IsADirectoryError: If it is a folder, such as that of a training.
        ValueError: If it is not an ONNX model that can be run, or is beyond a bound; or if there is no such device.
    """
    check_one_of(device, Device, "device")
    if path.is_dir():
        within = f"{path / 'model.onnx'}" if (path / "model.onnx").is_file() else "model.onnx of a training"
        raise IsADirectoryError(f"{path}: expected an ONNX file such as {within}, got a folder")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such model file, expected an ONNX file, or `{BUNDLED}` for what ships")
    check_file(path)
    content = memoryview(read_bytes(path, MAX_MODEL_BYTES))
    try:
        check_operations(content)
    except ValueError as error:
        hint = "; `foreglow import-weights` converts PyTorch's" if path.suffix in (".pt", ".pth") else ""
        raise ValueError(f"{path}: {error}{hint}") from error
    # Newer versions store a device id in the home folder and send telemetry; the variable is read during the import.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime as ort

    ort.disable_telemetry_events()  # in case it was imported before
    _bound_memory()
    _check_divisors(path, content)
    options = _options(num_threads)
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    providers: list[str | tuple[str, dict[str, int]]] = ["CPUExecutionProvider"]
    if device == "cuda":
        if CUDA not in ort.get_available_providers():
            raise ValueError("classifier.device: expected cpu, this ONNX Runtime is not onnxruntime-gpu; got cuda")
        providers.insert(0, (CUDA, {"gpu_mem_limit": MAX_TENSOR_BYTES}))
    try:
        session = ort.InferenceSession(str(path), options, providers=providers)
        _read_texts(session)
    except model_errors() as error:
        raise unusable(path, error) from error
    if device == "cuda" and CUDA not in session.get_providers():  # it goes on without what it cannot load
        raise ValueError("classifier.device: expected cpu, ONNX Runtime cannot use a GPU here; got cuda")
    return session


def _options(num_threads: int) -> SessionOptions:
    """Those of every session: sequential, without spinning, with bounded memory."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = num_threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # errors are raised and need not be printed as well
    options.add_session_config_entry("session.load_model_format", "ONNX")  # what was checked, whatever its name ends in
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    return options


def _check_divisors(path: Path, model: memoryview) -> None:
    """ValueError if a model may divide whole numbers by 0 or -1, which would stop the process."""
    import onnxruntime as ort

    try:
        copy, names = computed_divisors(model)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if not names:
        return
    options = _options(1)
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.add_session_config_entry("session.disable_prepacking", "1")
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(path.parent))
    try:
        session = ort.InferenceSession(copy, options, providers=["CPUExecutionProvider"])
        types = [node.type for node in session.get_outputs()[-len(names) :]]
    except model_errors() as error:
        raise unusable(path, error) from error
    try:
        check_types(names, types)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _read_texts(session: InferenceSession) -> None:
    """UnicodeDecodeError if a name or the metadata of a model are no text; ONNX Runtime decodes them when asked."""
    _ = session.get_modelmeta().custom_metadata_map
    for node in (*session.get_inputs(), *session.get_outputs()):
        _ = node.name, node.type, node.shape


def model_errors() -> tuple[type[Exception], ...]:
    """What ONNX Runtime raises for a model that it cannot run."""
    from onnxruntime.capi import onnxruntime_pybind11_state as errors

    return (
        errors.EPFail,
        errors.Fail,
        errors.InvalidArgument,
        errors.InvalidGraph,
        errors.InvalidProtobuf,
        errors.NoSuchFile,
        errors.NotImplemented,
        errors.RuntimeException,
        UnicodeDecodeError,  # a name that is no text
    )


def check_whole(path: Path) -> None:
    """Passes a model that is as it was written, as far as that is known: of the one that ships, and of trainings.

    A training writes the SHA-256 of its `model.onnx` into the `summary.json` beside it. ONNX Runtime itself takes any
    weights, and a model has no checksums.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is another one, or the summary of the training that it lies in is damaged.
    """
    known, remedy = "", ""
    if path == model_path(Path(BUNDLED)):
        known, remedy = SHA256, "install Foreglow anew"
    elif path.name == "model.onnx" and path.is_file():
        known = _known_digest(path)
        remedy = "repeat that training's command, or keep another model elsewhere"
    if known and hashlib.sha256(read_bytes(path, MAX_MODEL_BYTES)).hexdigest() != known:
        origin = "that ships" if known is SHA256 else "of the training here, as its summary.json has it"
        raise ValueError(f"{path}: expected the model {origin}, found it damaged or replaced; {remedy}")


def _known_digest(model: Path) -> str:
    """The SHA-256 of a model by the summary beside it; empty if there is none, or one of something else.

    Raises:
        ValueError: If it is that of a training, and has no such number.
    """
    path, summary = model.with_name("summary.json"), None
    if not path.exists():
        return ""
    with contextlib.suppress(ValueError):  # something else may be called so
        summary = read_plain_json(path)
    digest = summary.get(_DIGEST) if isinstance(summary, dict) else None
    if isinstance(digest, str) and re.fullmatch("[0-9a-f]{64}", digest):
        return digest
    if is_own(path.with_name("recipe.toml")):  # written together with the summary
        found = "a damaged file" if not isinstance(summary, dict) else shortened(summary.get(_DIGEST))
        raise ValueError(
            f"{path}: {_DIGEST}: expected the SHA-256 of {model.name} beside it, as a training writes it, got {found}; "
            "remove this file and repeat that training's command, or keep another model elsewhere"
        )
    return ""


def unusable(path: Path, error: Exception) -> ValueError:
    """The error of a model that ONNX Runtime cannot run, in a line."""
    return ValueError(f"{path}: expected an ONNX model that can be run: {shortened(' '.join(str(error).split()))}")


@functools.cache
def _bound_memory() -> None:
    """Gives all sessions that ask for it one allocator, which refuses more than `MAX_TENSOR_BYTES`."""
    import onnxruntime as ort

    on_cpu = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    ort.create_and_register_allocator(on_cpu, ort.OrtArenaCfg({"max_mem": MAX_TENSOR_BYTES}))
