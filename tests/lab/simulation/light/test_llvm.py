"""How the renderer finds its LLVM, and that nothing loads it before it is needed."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from importlib import metadata

import numpy as np
import pytest

from foreglow.lab.simulation.light import llvm


@pytest.mark.slow
def test_importing_the_simulator_loads_no_renderer() -> None:
    code = "import sys, foreglow.lab.simulation.light.render; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert not {"mitsuba", "drjit"} & set(loaded)
    assert "foreglow.lab.simulation.light.shading" in loaded


def test_missing_mitsuba_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ModuleNotFoundError) as raised:
        llvm.prepare.__wrapped__()
    assert raised.value.name == "mitsuba"


@pytest.mark.renderer
def test_unknown_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.VARIANT_VARIABLE, "scalar_rgb")
    with pytest.raises(ValueError, match=r"FOREGLOW_RENDER_VARIANT: expected one of .*got 'scalar_rgb'"):
        llvm.prepare.__wrapped__()


@pytest.mark.renderer
def test_missing_llvm_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setenv(llvm.VARIANT_VARIABLE, "llvm_ad_mono")
    monkeypatch.delenv(llvm.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(metadata, "files", absent)
    monkeypatch.setattr("ctypes.util.find_library", lambda _name: None)
    with pytest.raises(OSError, match=r"install foreglow\[sim\]") as raised:
        llvm.prepare.__wrapped__()
    assert "\n" not in str(raised.value)


def test_an_llvm_that_cannot_be_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.VARIANT_VARIABLE, "llvm_ad_mono")
    monkeypatch.setenv(llvm.LLVM_VARIABLE, "/nonexistent/libLLVM.so")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: object())
    with pytest.raises(OSError, match=r"DRJIT_LIBLLVM_PATH: expected a libLLVM\.so that can be loaded: /nonexistent"):
        llvm.prepare.__wrapped__()


def test_newest_system_library_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    libraries = {"LLVM-14": "libLLVM-14.so.1", "LLVM-17": "libLLVM-17.so.1", "LLVM.so.20.1": "libLLVM.so.20.1"}
    monkeypatch.setattr("ctypes.util.find_library", libraries.get)
    assert llvm._system_llvm() == "libLLVM.so.20.1"
    del libraries["LLVM.so.20.1"]
    assert llvm._system_llvm() == "libLLVM-17.so.1"


@pytest.mark.renderer
@pytest.mark.parametrize(("given", "expected"), [("1", 1), ("3,1", 3), ("all", 2)])
def test_as_many_threads_render_as_the_environment_says(
    monkeypatch: pytest.MonkeyPatch, given: str, expected: int
) -> None:
    drjit, before = importlib.import_module("drjit"), llvm.dr.thread_count()
    monkeypatch.setenv(llvm.THREADS_VARIABLE, given)
    try:
        drjit.set_thread_count(2)
        llvm.prepare.__wrapped__()
        assert drjit.thread_count() == expected
    finally:
        drjit.set_thread_count(before)


@pytest.mark.renderer
def test_angles() -> None:
    angles = np.linspace(-np.pi, np.pi, 1001)[:-1]
    found = llvm.angle_rad(
        llvm.mi.Float(np.sin(angles).astype(np.float32)), llvm.mi.Float(np.cos(angles).astype(np.float32))
    )
    np.testing.assert_allclose(np.exp(1j * np.array(found)), np.exp(1j * angles), atol=4e-7)
    assert float(llvm.angle_rad(llvm.mi.Float(0.0), llvm.mi.Float(0.0))[0]) == 0


@pytest.mark.renderer
def test_least_and_greatest() -> None:
    values = llvm.mi.Float(np.array([-2.0, 0.5, 3.0], np.float32))
    assert np.array(llvm.clipped(values, -1.0, 1.0)).tolist() == [-1.0, 0.5, 1.0]
    assert np.array(llvm.least(values, 0.0)).tolist() == [-2.0, 0.0, 0.0]
    assert np.array(llvm.greatest(values, 0.0)).tolist() == [0.0, 0.5, 3.0]
