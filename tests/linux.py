"""What only Linux has; without it, the tests that need it are skipped, and the others say as much as they do there."""

from __future__ import annotations

from pathlib import Path

import pytest

FULL_DISK = Path("/dev/full")
"""Every write to it fails as on a full disk."""

needs_full_disk = pytest.mark.skipif(not FULL_DISK.exists(), reason="a full disk is played by /dev/full, of Linux")
needs_processes = pytest.mark.skipif(not Path("/proc").exists(), reason="processes are looked up in /proc, of Linux")
