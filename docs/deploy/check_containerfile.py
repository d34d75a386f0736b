"""Checks the Containerfile where there is no container engine: `python docs/deploy/check_containerfile.py FOLDER`.

FOLDER stands for the root of both images. Files are copied as the file says, and no others; `python -m venv` and `pip`
run there, with an environment of nothing but a PATH and a HOME; packages of apt are looked up, users' groups, too.
At the end the entry point runs the drive that ships, with the variables that the file sets. Any other instruction is
an error. It takes the network and a compiler, and a few minutes.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
CONTAINERFILE = Path(__file__).with_name("Containerfile")
SYSTEM_PATH = "/usr/local/bin:/usr/bin:/bin"
DRIVE = PROJECT / "src" / "foreglow" / "shipped_drives" / "curve"


def instructions(text: str) -> list[tuple[str, str]]:
    """The names and arguments of all instructions, without comments."""
    lines = re.sub(r"\\\n", " ", text).splitlines()
    return [(name, rest) for name, _, rest in (line.partition(" ") for line in lines if line and line[0] != "#")]


def inside(text: str, root: Path) -> str:
    """A command whose absolute paths lie in `root`."""
    return re.sub(r"(?<![\w.])/(opt|source)\b", rf"{root}/\1", text)


def run(command: str, root: Path, environment: Mapping[str, str]) -> None:
    """Runs a command in `root`, with this environment alone; with this Python, as the image has only one."""
    local = inside(command, root).replace("python -m", f"{shlex.quote(sys.executable)} -m", 1)
    subprocess.run(["/bin/bash", "-ec", local], check=True, cwd=root, env=dict(environment))


def check_run(command: str, root: Path, environment: Mapping[str, str]) -> None:
    """Runs or looks up each part of a RUN instruction."""
    for part in command.split(" && "):
        words = shlex.split(part)
        if words[:2] == ["apt-get", "install"]:
            for package in (word for word in words[2:] if not word.startswith("-")):
                subprocess.run(["apt-cache", "show", package], check=True, stdout=subprocess.DEVNULL)
        elif words[0] == "useradd":
            for group in words[words.index("--groups") + 1].split(","):
                subprocess.run(["getent", "group", group], check=True, stdout=subprocess.DEVNULL)
        elif words[0] not in ("apt-get", "rm"):
            run(part, root, environment)


def copy(arguments: str, root: Path) -> None:
    """Carries out a COPY from the project."""
    *sources, target = arguments.split()
    for name in sources:
        path, goal = PROJECT / name, root / target.lstrip("/")
        if path.is_dir():
            shutil.copytree(path, goal, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
        else:
            goal.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, goal)


def main() -> None:
    """Carries out the file in the folder that is given."""
    root = Path(sys.argv[1]).resolve()
    root.mkdir(parents=True)
    environment = {"PATH": SYSTEM_PATH, "HOME": str(root)}
    entry: list[str] = []
    for name, rest in instructions(CONTAINERFILE.read_text()):
        sys.stdout.write(f"{name} {rest}\n")
        sys.stdout.flush()
        if name == "FROM":
            wanted = re.search(r"python:(\d+\.\d+)-", rest)
            if wanted is None or wanted[1] != f"{sys.version_info.major}.{sys.version_info.minor}":
                raise ValueError(f"{CONTAINERFILE}: FROM: expected this Python, got {rest}")
        elif name == "RUN":
            check_run(rest, root, environment)
        elif name == "COPY":
            if not rest.startswith("--from=build"):
                copy(rest, root)
            elif len(set(rest.split()[1:])) != 1:
                raise ValueError(f"{CONTAINERFILE}: COPY --from: expected the same path in both images, got {rest}")
        elif name == "ENV":
            key, _, value = rest.partition("=")
            environment[key] = value
        elif name in ("ENTRYPOINT", "CMD"):
            entry = [*entry, *json.loads(rest)]
        elif name != "USER":
            raise ValueError(f"{CONTAINERFILE}: expected an instruction that this program knows, got {name}")
    shutil.rmtree(root / "source")
    program, *arguments = entry
    environment["PATH"] = ""  # no compiler
    for given in (arguments, ["run", str(DRIVE), "--out", str(root / "results"), "--record", str(root / "drive.mcap")]):
        subprocess.run([inside(program, root), *given], check=True, cwd=root, env=environment)
    sys.stdout.write(f"{CONTAINERFILE.name}: every line does what it says\n")


if __name__ == "__main__":
    main()
