"""Mitsuba, and the LLVM that it compiles with; both are found and loaded when they are first needed."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import importlib
import importlib.util
import os
import re
from importlib import metadata
from pathlib import Path
from typing import Any

VARIANTS = ("cuda_ad_mono", "llvm_ad_mono")
"""Variants of Mitsuba for the renderer: monochrome, on a GPU or on the CPU."""

VARIANT_VARIABLE = "FOREGLOW_RENDER_VARIANT"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
THREADS_VARIABLE = "OMP_NUM_THREADS"

PACKAGE = "karellen-llvm-core"
"""Package on PyPI that contains `libLLVM.so`; the extra `sim` depends on it."""

RUNTIME_LIBRARIES = ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1")
"""Libraries in the package that its `libLLVM.so` is linked to, in the order of their dependencies."""

OLDEST_LLVM = 17
"""Oldest usable LLVM: Mitsuba 3.9 aborts with LLVM 14 to 16, which cannot translate its comparisons of floats."""


@functools.cache
def prepare() -> str:
    """Loads Mitsuba with a working LLVM, sets its variant, and returns the name of the variant.

    A GPU is used if there is one, unless the environment variable `FOREGLOW_RENDER_VARIANT` says otherwise. A
    `DRJIT_LIBLLVM_PATH` that is already set takes precedence over the package from PyPI, and that over the system's
    LLVM. As many threads render as `OMP_NUM_THREADS` says, else one for each core: threads of two renderers that wait
    for work keep each other's cores busy, so `parallel.local` sets it to 1 for its processes.

    Raises:
        ModuleNotFoundError: If Mitsuba is not installed.
        OSError: If there is no suitable LLVM.
        ValueError: If `FOREGLOW_RENDER_VARIANT` names something else.
    """
    if importlib.util.find_spec("mitsuba") is None:  # must not be imported before its LLVM is known
        raise ModuleNotFoundError("No module named 'mitsuba'", name="mitsuba")
    variant = os.environ.get(VARIANT_VARIABLE) or (VARIANTS[0] if _has_gpu() else VARIANTS[1])
    if variant not in VARIANTS:
        raise ValueError(f"{VARIANT_VARIABLE}: expected one of {', '.join(VARIANTS)}, got {variant!r}")
    if variant.startswith("llvm"):
        given = os.environ.get(LLVM_VARIABLE)
        if given:
            _check_given(given)
        else:
            os.environ[LLVM_VARIABLE] = str(_packaged_llvm() or _system_llvm())
    importlib.import_module("mitsuba").set_variant(variant)
    threads = os.environ.get(THREADS_VARIABLE, "").partition(",")[0].strip()  # OpenMP takes a number for each level
    if threads.isascii() and threads.isdecimal():
        importlib.import_module("drjit").set_thread_count(int(threads))
    return variant


def _check_given(path: str) -> None:
    try:
        ctypes.CDLL(path)
    except OSError as error:
        raise OSError(f"{LLVM_VARIABLE}: expected a libLLVM.so that can be loaded: {error}") from None


class Late:
    """A module that is loaded when one of its attributes is first used, so that importing it costs nothing."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith(("_", "pytest")):  # inspect, doctest and pytest ask every object for such names
            raise AttributeError(attribute)
        prepare()
        value = getattr(importlib.import_module(self._name), attribute)
        setattr(self, attribute, value)  # kept for the next time; the variant never changes
        return value


dr = Late("drjit")
mi = Late("mitsuba")


def _has_gpu() -> bool:
    """Whether NVIDIA's driver is installed and finds a device."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    count = ctypes.c_int(0)
    is_ready = driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0
    return bool(is_ready and count.value > 0)


def _packaged_llvm() -> Path | None:
    """The library of the package from PyPI, with its dependencies loaded; None if the package is not installed."""
    try:
        files = metadata.files(PACKAGE) or []
    except metadata.PackageNotFoundError:
        return None
    paths = {path.name: Path(str(path.locate())) for path in files}
    libraries = [name for name in paths if re.fullmatch(r"libLLVM\.so\.\d+\.\d+", name)]
    if not libraries or not all(name in paths for name in RUNTIME_LIBRARIES):
        return None
    for name in RUNTIME_LIBRARIES:
        # Once they are loaded, LLVM finds them by name. They are loaded locally, since their unwinder must not be used
        # by other libraries, whose exceptions it cannot unwind (ONNX Runtime then crashes instead of raising).
        ctypes.CDLL(str(paths[name]), mode=ctypes.RTLD_LOCAL)
    return paths[libraries[0]].resolve()


def _system_llvm() -> str:
    """The newest suitable library that the system's loader finds.

    Raises:
        OSError: If there is none.
    """
    for version in range(25, OLDEST_LLVM - 1, -1):
        for name in (f"LLVM-{version}", f"LLVM.so.{version}.1"):
            found = ctypes.util.find_library(name)
            if found:
                return found
    raise OSError(
        f"no LLVM of version {OLDEST_LLVM} or newer: install foreglow[sim] (Linux), or libllvm19 from the system, "
        f"or set {LLVM_VARIABLE} to a libLLVM"
    )


def least(first: Any, second: Any) -> Any:
    """Element-wise minimum; LLVM 19 cannot always translate `dr.minimum`, and aborts the process."""
    return dr.select(first < second, first, second)


def greatest(first: Any, second: Any) -> Any:
    """Element-wise maximum, instead of `dr.maximum`."""
    return dr.select(first > second, first, second)


def clipped(values: Any, low: Any, high: Any) -> Any:
    """The values clipped to `low` and `high`, instead of `dr.clip`."""
    return least(greatest(values, low), high)


ARCTAN = (
    0.0028662257,
    -0.0161657367,
    0.0429096138,
    -0.0752896400,
    0.1065626393,
    -0.1420889944,
    0.1999355085,
    -0.3333314528,
    1.0,
)
"""Coefficients from the highest power down. Source: Abramowitz, Stegun, Handbook of mathematical functions, 4.4.49."""


def angle_rad(y: Any, x: Any) -> Any:
    """The angle of (x, y) from the x axis, -pi..pi, to about 1e-7, instead of `dr.atan2`, which uses minima."""
    tall, wide = dr.abs(y), dr.abs(x)
    ratio = least(tall, wide) / greatest(greatest(tall, wide), 1e-30)
    square = dr.square(ratio)
    series = dr.full(type(square), ARCTAN[0])
    for coefficient in ARCTAN[1:]:
        series = dr.fma(series, square, coefficient)
    angle = ratio * series
    angle = dr.select(tall > wide, dr.pi / 2 - angle, angle)
    angle = dr.select(x < 0, dr.pi - angle, angle)
    return dr.select(y < 0, -angle, angle)
