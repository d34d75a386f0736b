"""A network of its own for every test, apart from others on this machine."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    from foreglow.runtime.ros2.environment import prepare
    from foreglow.runtime.ros2.measurement import own_domain

    wanted = dict(os.environ)
    prepare(environment=wanted)
    for name in wanted.keys() - os.environ.keys():
        monkeypatch.setenv(name, wanted[name])
    with own_domain(1 + (os.getpid() + time.time_ns() // 1000) % 100):
        yield
