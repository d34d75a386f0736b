"""The probes, by class."""

from __future__ import annotations

import functools
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import typer

from benchmarks.knocks.circumstances import (
    ENVIRONMENTS,
    LATER,
    LINKED,
    RARE_IMAGES,
    UNFINISHED,
    with_variables,
    write_image,
)
from benchmarks.knocks.faults import FAULT_PROBES, live_fault
from benchmarks.knocks.lines import MISUSE, OVERWRITING, PLUG_INS
from benchmarks.knocks.materials import EVALUATE, MATERIALS, ON_VIDEO, beam, run
from benchmarks.knocks.mutations import DAMAGE, NO_FILES, TEXT_DAMAGE
from benchmarks.knocks.probe import Outcome, Probe, orderly, refused

Words = Sequence[str]


def laid_out(materials: Path, folder: Path, command: Words) -> list[str]:
    """Copies the materials into `folder/inputs`, and gives the command line with their paths."""
    shutil.copytree(materials, folder / "inputs", dirs_exist_ok=True, symlinks=True)
    return [word.replace("@", "inputs/", 1) if word.startswith("@") else word for word in command]


class Campaign:
    """All probes on the sound files in a folder; the same seed gives the same probes."""

    def __init__(self, materials: Path, seed: int) -> None:
        self._materials = materials
        self._seed = seed

    def probes(self) -> Iterator[Probe]:
        """Every probe, class by class."""
        yield from self.sound()
        yield from self.damaged(DAMAGE, "damaged bytes", 2, is_text=False)
        yield from self.damaged(TEXT_DAMAGE, "damaged texts", 3, is_text=True)
        yield from self.no_files()
        yield from self.wrong_kinds()
        yield from self.numbers()
        yield from self.overwriting()
        yield from self.no_plain_outputs()
        yield from self.plug_ins()
        yield from self.names()
        yield from self.signals()
        yield from self.limits()
        yield from self.streams()
        yield from self.two_at_once()
        yield from self.misuse()
        yield from self.environments()
        yield from self.unfinished()
        yield from self.other_frames()
        yield from self.foreign_folders()
        yield from self.linked()
        yield from self.rare_images()
        yield from (Probe("live faults", name, functools.partial(live_fault, name)) for name in FAULT_PROBES)

    def _laid_out(self, command: Words) -> Callable[[Path], list[str]]:
        return lambda folder: laid_out(self._materials, folder, command)

    def sound(self) -> Iterator[Probe]:
        """What is sound is done: otherwise the others would prove nothing."""

        def done(folder: Path, outcome: Outcome) -> list[str]:
            return orderly(folder, outcome) + ([] if outcome.code == 0 else ["sound, and refused"])

        for name, material in MATERIALS.items():
            yield Probe("sound files", name, self._laid_out(material.command), done)

    def damaged(
        self, kinds: dict[str, Callable[[bytes, np.random.Generator], bytes]], kind: str, num: int, is_text: bool
    ) -> Iterator[Probe]:
        for number, (name, material) in enumerate(MATERIALS.items()):
            if is_text and not material.is_text:
                continue
            for position, (what, damage) in enumerate(kinds.items()):
                for again in range(1 if what == "empty" else num):

                    def prepare(
                        folder: Path, *, change: Any = damage, on: Any = material, seed: Any = (number, position, again)
                    ) -> Words:
                        words = laid_out(self._materials, folder, on.command)
                        path = folder / "inputs" / on.file
                        path.write_bytes(change(path.read_bytes(), np.random.default_rng([self._seed, *seed])))
                        return words

                    yield Probe(kind, f"{name}: {what}, {again}", prepare)

    def no_files(self) -> Iterator[Probe]:
        for name, material in MATERIALS.items():
            for what, make in NO_FILES.items():

                def prepare(folder: Path, *, make: Any = make, on: Any = material) -> Words:
                    words = laid_out(self._materials, folder, on.command)
                    path = folder / "inputs" / on.file
                    path.unlink()
                    make(path)
                    return words

                yield Probe("no regular files", f"{name}: {what}", prepare)

    def wrong_kinds(self) -> Iterator[Probe]:
        """Every file in place of another, the next but so many of the table."""
        names = list(MATERIALS)
        for step in (1, 7, 13):
            for number, name in enumerate(names):
                other = MATERIALS[names[(number + step) % len(names)]]

                def prepare(folder: Path, *, on: Any = MATERIALS[name], other: Any = other) -> Words:
                    words = laid_out(self._materials, folder, on.command)
                    shutil.copy(self._materials / other.file, folder / "inputs" / on.file)
                    return words

                yield Probe("files of another kind", f"{name}: {other.file}", prepare)

    def numbers(self) -> Iterator[Probe]:
        """Every option with a number, with what is none or far off."""
        from foreglow.cli import app

        for path, option in numeric_options(typer.main.get_command(app)):
            for value in ("nan", "-1e30", "1e400", "9" * 400, ""):
                words = [*path.split()[1:], f"{option}={value}"]
                yield Probe("numbers", f"{path} {option}={value[:12]}", self._laid_out(words), refused)

    def overwriting(self) -> Iterator[Probe]:
        """Outputs that are, hold or lie in what is read."""
        for line in OVERWRITING.splitlines():
            words = shlex.split(line)
            yield Probe("outputs over inputs", " ".join(words), self._laid_out(words), refused)
            linked = [
                word.replace("@", "@linked/", 1) if words[index - 1] in OUTPUTS else word
                for index, word in enumerate(words)
            ]
            yield Probe("outputs over inputs", f"{' '.join(words)}, by a link", self._through_link(linked), refused)

    def no_plain_outputs(self) -> Iterator[Probe]:
        """Outputs that are pipes or sockets, or have a part of an input for their folder."""
        outputs = {
            "report": ("report", "@results", "--out", "there.html"),
            "predictions": ("evaluate", "@night/val", "--predictions", "@predictions.jsonl", "--json", "there.json"),
            "recording": (*ON_VIDEO, "--record", "there.mcap"),
            "labels": ("labels", "export", "@night/val", "--out", "there.xml"),
            "scene": ("beam", "@results", "--out", "out", "--save", "there.rrd"),
        }
        for name, words in outputs.items():
            for what in ("a pipe", "a socket"):

                def prepare(folder: Path, *, words: Words = words, what: str = what) -> Words:
                    NO_FILES[what](folder / next(word for word in words if word.startswith("there")))
                    return laid_out(self._materials, folder, words)

                yield Probe("outputs that are no files", f"{name}: {what}", prepare, refused)
        for words, unfinished in (
            (run("images"), "out/frames.jsonl.partial"),
            (run("images"), "out/times.jsonl"),
            (("record", "@images", "--out", "there.mcap"), "there.mcap.partial"),
        ):

            def lay(folder: Path, *, words: Words = words, unfinished: str = unfinished) -> Words:
                (folder / unfinished).parent.mkdir(exist_ok=True)
                os.mkfifo(folder / unfinished)
                return laid_out(self._materials, folder, words)

            yield Probe("outputs that are no files", f"a pipe as {unfinished}", lay, refused)
        for inside in ("@night/val/images", "@night/val/labels", "@night/val/images/S00003"):
            words = ("run", "@night/val", "--out", inside)
            yield Probe("outputs that are no files", " ".join(words), self._laid_out(words), refused)

    def streams(self) -> Iterator[Probe]:
        """Standard streams that are closed: the results are there all the same."""
        for numbers in ((0,), (1,), (2,), (0, 1, 2)):
            for name, words in (("run", run("images")), ("demo", ("demo", "@images", "--out", "out"))):

                def prepare(folder: Path, *, words: Words = words, numbers: Sequence[int] = numbers) -> Any:
                    prepared = laid_out(self._materials, folder, words)
                    return functools.partial(without_streams, prepared, numbers)

                yield Probe("streams", f"{name} without {numbers}", prepare)

    def _through_link(self, words: Words) -> Callable[[Path], list[str]]:
        def prepare(folder: Path) -> list[str]:
            prepared = laid_out(self._materials, folder, words)
            (folder / "inputs" / "linked").symlink_to(".")
            return prepared

        return prepare

    def plug_ins(self) -> Iterator[Probe]:
        """Trackers that cannot be imported, raise, end the program, or return something else."""
        for text in PLUG_INS:

            def prepare(folder: Path, *, text: str = text) -> Words:
                (folder / "own.toml").write_text('[tracker]\nmethod = "own:Own"\n')
                (folder / "own.py").write_text(text)
                return [*laid_out(self._materials, folder, run("images")), "--config", "own.toml"]

            yield Probe("plug-ins", " ".join(text.split()), prepare, refused)

    def names(self) -> Iterator[Probe]:
        """Odd names of a source and of an output."""
        odd = [
            "a b",
            "a\nb",
            "-x",
            "--out",
            "a:b",
            "http",
            "ä" * 80,
            "x" * 250,
            "\udcff\udcfe",
            "%Y%n",
            "$(touch x)",
            "a'b\"c",
            "~",
            "*",
            "a/../b",
            "[red]a",
            "con",
            "\x1b[31m",
            "{}",
            "camera:0",
        ]
        for name in odd:
            for command in (("run", "SOURCE.png", "--out", "out"), ("run", "@night.png", "--out", "./NAME")):

                def prepare(folder: Path, *, name: str = name, command: Words = command) -> Words:
                    words = laid_out(self._materials, folder, command)
                    source = folder / "inputs" / f"{name}.png"
                    if "SOURCE.png" in words:
                        source.parent.mkdir(parents=True, exist_ok=True)
                        shutil.copy(self._materials / "night.png", source)
                    return [word.replace("SOURCE", f"inputs/{name}").replace("NAME", name) for word in words]

                yield Probe("odd names", f"{name!r} as {command[1]}", prepare)
        for option in ("--out", "--record", "--save"):
            yield Probe("odd names", f"no name for {option}", self._laid_out((*ON_VIDEO, option, "")), refused)

    def signals(self) -> Iterator[Probe]:
        """Ended at any moment: exit code 130, or done before; nothing half-written."""
        commands = {
            "run": run("images", "--video"),
            "live": ("live", "@images", "--speed", "0.5", "--out", "out"),
            "record": ("record", "@images", "--out", "out.mcap"),
            "beam": beam("--can", "blf"),
            "report": ("report", "@results", "--out", "out.html"),
        }
        moments_s = (0.02, 0.1, 0.3, 0.6, 1.0)
        for name, words in commands.items():
            for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                for after_s in moments_s:
                    yield Probe(
                        "signals",
                        f"{name}: {kind.name} after {after_s} s",
                        self._laid_out(words),
                        ended,
                        (kind, after_s),
                    )

    def limits(self) -> Iterator[Probe]:
        """A disk that is full, few open files, a folder that cannot be written."""
        commands = [
            run("images", "--video"),
            ("record", "@images", "--out", "out.mcap"),
            ("report", "@results", "--out", "out.html"),
            beam("--can", "blf"),
            ("live", "@images", "--speed", "0", "--out", "out", "--record", "o.mcap"),
        ]
        for words in commands:
            for size in (0, 100, 5_000, 40_000):
                limit = ((resource.RLIMIT_FSIZE, size),)
                yield Probe("limits", f"{' '.join(words)}: files of {size} bytes", self._laid_out(words), limits=limit)
            files = ((resource.RLIMIT_NOFILE, 20),)
            yield Probe("limits", f"{' '.join(words)}: 20 open files", self._laid_out(words), limits=files)
            small = [word if word not in ("out", "out.html", "out.mcap") else f"/proc/{word}" for word in words]
            yield Probe("limits", f"{' '.join(small)}", self._laid_out(small))

    def two_at_once(self) -> Iterator[Probe]:
        """Two commands into one output: one of them says so, and the results are of the other."""
        commands = [
            run("images"),
            ("live", "@images", "--speed", "0", "--out", "out"),
            beam(),
            ("record", "@images", "--out", "out.mcap"),
        ]
        for number, words in enumerate(commands):
            for again in range(5):

                def prepare(folder: Path, *, words: Words = words) -> Callable[[], int]:
                    prepared = laid_out(self._materials, folder, words)
                    return functools.partial(together, prepared)

                yield Probe("two at once", f"{number}: {' '.join(words)}, {again}", prepare)

    def misuse(self) -> Iterator[Probe]:
        """Arguments that do not go together, are missing, or come twice."""
        for line in MISUSE.splitlines():
            words = shlex.split(line.replace("ON_VIDEO", " ".join(ON_VIDEO)))
            yield Probe("misuse", " ".join(words) or "(nothing)", self._laid_out(words), refused)

    def environments(self) -> Iterator[Probe]:
        """Variables that libraries read when they are loaded."""
        commands = {"run": run("images", "--video"), "evaluate": (*EVALUATE, "--out", "out")}
        for variables in ENVIRONMENTS:
            for name, words in commands.items():

                def prepare(folder: Path, *, words: Words = words, variables: str = variables) -> Callable[[], int]:
                    return functools.partial(with_variables, laid_out(self._materials, folder, words), variables)

                yield Probe("environments", f"{name}: {variables}", prepare)

    def unfinished(self) -> Iterator[Probe]:
        """Runs that were killed, cut or made by an early version, in every later command."""
        for name, words in LATER.items():
            labelled = [word.replace("@results", "@of_split") if "@night/val" in words else word for word in words]
            for what, change in UNFINISHED.items():

                def prepare(folder: Path, *, words: Words = labelled, change: Any = change) -> Words:
                    prepared = laid_out(self._materials, folder, words)
                    for run_folder in ("results", "of_split"):
                        change(folder / "inputs" / run_folder)
                    return prepared

                yield Probe("unfinished runs", f"{name}: {what}", prepare)

    def other_frames(self) -> Iterator[Probe]:
        """Images that are gone since a run on them: what it found is not taken for that of others."""
        for gone in ("000000.png", "000007.png"):

            def prepare(folder: Path, *, gone: str = gone) -> Words:
                prepared = laid_out(self._materials, folder, LATER["labels"])
                (folder / "inputs" / "images" / gone).unlink()
                return [word.replace("night/val", "images") for word in prepared]

            yield Probe("other frames", f"without {gone}", prepare, refused)

    def foreign_folders(self) -> Iterator[Probe]:
        """Folders with a `config.toml` of something else: it stays as it is."""
        for words in (run("images"), beam(), ("live", "@images", "--speed", "0", "--out", "out")):

            def prepare(folder: Path, *, words: Words = words) -> Words:
                prepared = laid_out(self._materials, folder, words)
                shutil.copy(self._materials / "camera.toml", folder / "inputs" / "config.toml")
                return ["inputs" if word == "out" else word for word in prepared]

            yield Probe("foreign folders", words[0], prepare, refused)

    def linked(self) -> Iterator[Probe]:
        """Links in place of outputs: what they lead to stays as it is."""
        for name, (output, target, words) in LINKED.items():

            def prepare(folder: Path, *, output: str = output, target: str = target, words: Words = words) -> Words:
                (folder / output).parent.mkdir(exist_ok=True)
                (folder / output).symlink_to(target)
                return laid_out(self._materials, folder, words)

            yield Probe("linked outputs", name, prepare)

    def rare_images(self) -> Iterator[Probe]:
        """Images of rare kinds, alone and amid others."""
        for name, (suffix, image) in RARE_IMAGES.items():
            for words in (run(f"rare.{suffix}"), run("images", "--on-error", "mark", "--video")):

                def prepare(folder: Path, *, words: Words = words, suffix: str = suffix, image: Any = image) -> Words:
                    prepared = laid_out(self._materials, folder, words)
                    for path in (f"rare.{suffix}", f"images/000003.{suffix}"):
                        write_image(folder / "inputs" / path, image)
                    return prepared

                yield Probe("rare images", f"{name}: {words[1]}", prepare)


OUTPUTS = {"--out", "--record", "--save", "--json"}


def numeric_options(command: Any, path: str = "foreglow") -> Iterator[tuple[str, str]]:
    for name, child in getattr(command, "commands", {}).items():
        yield from numeric_options(child, f"{path} {name}")
    for parameter in command.params:
        if getattr(parameter.type_descriptor, "annotation", None) in (int, float) and not parameter.hidden:
            yield path, parameter.opts[0]


def ended(folder: Path, outcome: Outcome) -> list[str]:
    """As `orderly`; a signal that comes while the process begins may end it at once."""
    if outcome.code in (-signal.SIGTERM, -signal.SIGHUP) and not outcome.written:
        return []
    wrong = orderly(folder, outcome)
    return wrong if outcome.code in (0, 130) else [*wrong, f"exit code {outcome.code} after a signal"]


def without_streams(words: list[str], numbers: Sequence[int]) -> int:
    """A command without some of its standard streams; 0 if it was done, and results are there."""
    command = [sys.executable, "-m", "foreglow.cli", *words]
    closing = " ".join(f"{number}{'<' if number == 0 else '>'}&-" for number in numbers)
    code = subprocess.run(["sh", "-c", f'"$@" {closing}', "sh", *command], check=False).returncode
    return code if code else int(not Path("out/summary.json").is_file())


def together(words: list[str]) -> int:
    """Two processes with the same command line; 0 if each is done, or says in one line that the other is at it."""
    from foreglow.cli import main

    sys.argv = ["foreglow", *words]
    pids = []
    for number in range(2):
        pid = os.fork()
        if pid == 0:
            os.dup2(os.open(f"stderr_{number}", os.O_WRONLY | os.O_CREAT, 0o600), 2)
            code: object = 0
            try:
                main()
            except SystemExit as ending:
                code = ending.code
            sys.stderr.flush()
            os._exit(code if isinstance(code, int) else 0)
        pids.append(pid)
    codes = [os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in pids]
    lines = [Path(f"stderr_{number}").read_text().splitlines() for number in range(2)]
    sound = all(code == 0 or (code == 2 and len(said) == 1) for code, said in zip(codes, lines, strict=True))
    print(codes, lines)
    return 0 if sound and 0 in codes else 1
