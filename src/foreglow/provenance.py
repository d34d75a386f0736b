"""What made a result: the version of this package, the commit of the checkout that it runs from, the processor."""

from __future__ import annotations

import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any


def provenance() -> dict[str, Any]:
    """Version, commit and whether the checkout had changes of its own, for JSON; the last two null where installed."""
    commit, has_local_changes = checkout_state()
    return {"version": metadata.version("foreglow"), "commit": commit, "has_local_changes": has_local_changes}


def checkout_state() -> tuple[str | None, bool | None]:
    """The commit of the checkout that this package runs from and whether it has local changes; else None, None."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists() or not (root / "src" / "foreglow").is_dir():
        return None, None
    try:
        commit = _git(root, "rev-parse", "HEAD")
        return commit, bool(_git(root, "status", "--porcelain"))
    except (OSError, subprocess.SubprocessError):  # no git here, or a checkout that it refuses to read
        return None, None


def processor_name() -> str:
    """What the machine calls its processor, for example `Intel(R) Xeon(R) Gold 6338`."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "--no-optional-locks", "-C", str(root), *arguments]  # looking changes nothing there
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=10).stdout.strip()
