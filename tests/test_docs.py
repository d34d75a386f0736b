"""Pages name only what exists: links and anchors, files, modules and their names; the example of the README runs."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

import foreglow
from foreglow.cli import app

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "foreglow"
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((SOURCE / "models").glob("*.md")),
]
COMMAND = typer.main.get_command(app)

FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)(#[^)\s]+)?\)")
NAME = re.compile(r"(?<![\w./-])foreglow(?:\.[A-Za-z_]\w*)+")
FILE = re.compile(r"(?<![\w./-])(?:src/foreglow|native|tests|benchmarks|docs)/[\w./-]*\w")
OF_FILES = {"onnx", "toml", "md", "dbc", "html"}


def short(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def anchors(page: Path) -> Iterator[str]:
    """The anchors of the headings, as GitHub names them."""
    seen: dict[str, int] = {}
    for line in FENCE.sub("", page.read_text(encoding="utf-8")).splitlines():
        if line.startswith("#"):
            text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", line.lstrip("#").strip())
            slug = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
            yield f"#{slug}" + (f"-{seen[slug]}" if slug in seen else "")
            seen[slug] = seen.get(slug, 0) + 1


def test_links_lead_somewhere() -> None:
    broken = []
    for page in PAGES:
        for target, anchor in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
            path = (page.parent / target).resolve() if target else page
            if not path.exists() or (anchor and anchor not in anchors(path)):
                broken.append(f"{short(page)}: {target}{anchor}")
    assert not broken


def test_a_page_has_each_heading_once() -> None:
    repeated = [
        f"{short(page)}: {anchor}"
        for page in PAGES
        if page.name not in ("CHANGELOG.md", "commands.md")
        for anchor in anchors(page)
        if re.search(r"-[1-9]$", anchor) and anchor[:-2] in anchors(page)
    ]
    assert not repeated


@cache
def names_of(module: Path) -> frozenset[str]:
    """The names at the top of a module: what is defined, assigned or imported there."""
    names = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            names.add(node.name)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            names |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return frozenset(names)


@cache
def schemas() -> frozenset[str]:
    """Names such as `foreglow.Frame` that the package writes as text: types of recorded messages."""
    texts = (path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py"))
    return frozenset(name for text in texts for name in re.findall(r'"(foreglow\.\w+)"', text))


def exists(name: str) -> bool:
    """Whether `foreglow.a.b.c` is a module, or a name in one; of what is in a class only the class is looked for."""
    folder, parts = SOURCE, name.split(".")[1:]
    for k, part in enumerate(parts):
        if (folder / part).is_dir():
            folder /= part
        elif (folder / f"{part}.py").is_file():
            rest = parts[k + 1 :]
            return not rest or rest[0] in names_of(folder / f"{part}.py")
        elif folder == SOURCE:
            return part in foreglow.__all__ or name in schemas()
        else:
            return part in names_of(folder / "__init__.py")
    return True


def imported(text: str) -> Iterator[str]:
    """What the Python examples import from the package, as `foreglow.module.name`."""
    for example in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        for node in ast.walk(ast.parse(example)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "foreglow":
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_names_and_files_exist() -> None:
    missing = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        if page.name != "CHANGELOG.md" and not page.name.startswith("0013"):  # both also have names of before
            names = {name for name in NAME.findall(text) if name.split(".")[1] not in OF_FILES} | set(imported(text))
            missing += [f"{short(page)}: {name}" for name in names if not exists(name)]
        missing += [f"{short(page)}: {file}" for file in FILE.findall(text) if not (ROOT / file).exists()]
    assert not missing


def commands(text: str) -> Iterator[str]:
    """The command lines that begin with `foreglow`, of shell examples and in the running text."""
    for example in re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield from re.findall(r"^foreglow .*$", example.replace("\\\n", " "), re.MULTILINE)
    yield from (" ".join(span.split()) for span in re.findall(r"`(foreglow [a-z][^`]*)`", FENCE.sub("", text)))


def unknown(line: str) -> list[str]:
    """What the command line names that the program does not know: commands and options, not their values."""
    command: Any = COMMAND
    words = shlex.split(line, comments=True)[1:]
    while words and hasattr(command, "commands"):
        name = words.pop(0)
        if name not in command.commands:
            return [name] if re.fullmatch(r"[a-z][a-z0-9-]*", name) else []
        command = command.commands[name]
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    used = words[: words.index("--ros-args")] if "--ros-args" in words else words
    return [word for word in used if word.startswith("--") and word.split("=")[0] not in known]


def test_commands_and_their_options_exist() -> None:
    lines = {(page, line) for page in PAGES for line in commands(page.read_text(encoding="utf-8"))}
    assert len(lines) > 50
    findings = {f"{short(page)}: {line}": unknown(line) for page, line in sorted(lines)}
    assert not {line: names for line, names in findings.items() if names}


def test_what_is_not_there_is_noticed() -> None:
    assert exists("foreglow.Pipeline")
    assert exists("foreglow.lab.evaluation.bootstrap.paired_bootstrap")
    assert exists("foreglow.Health")
    assert not exists("foreglow.Nothing")
    assert not exists("foreglow.nothing.at_all")
    assert not exists("foreglow.lab.evaluation.bootstrap.nothing")
    assert list(imported("```python\nfrom foreglow.beam import Guard\n```\n")) == ["foreglow.beam.Guard"]
    assert unknown("foreglow nothing") == ["nothing"]
    assert unknown("foreglow run SOURCE --nothing 1  # --neither") == ["--nothing"]
    assert "#a-page-of-its-own" not in anchors(ROOT / "docs" / "index.md")


def test_the_map_is_complete() -> None:
    text = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    rooms = [path.relative_to(SOURCE.parent) for path in (*SOURCE.iterdir(), *(SOURCE / "lab").iterdir())]
    names = {".".join(path.with_suffix("").parts) for path in rooms if re.fullmatch(r"[a-z]\w*(\.py)?", path.name)}
    assert not {name for name in names - {"foreglow.lab"} if f"`{name}`" not in text}


def test_the_readme_is_short_and_says_how_to_test() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 80
    assert max(map(len, lines)) <= 100
    assert {"`make demo`", "`make test`"} <= set(re.findall(r"`make \w+`", "\n".join(lines)))


def cells(page: str, heading: str) -> list[list[str]]:
    """The rows of the first table under a heading, without links."""
    table = re.search(rf"^## {heading}\n(?:[^|#\n].*\n|\n)*((?:\|.*\n)+)", page, re.MULTILINE)
    assert table is not None
    plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", table[1])
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in plain.splitlines()[2:]]


def test_the_readme_s_results_are_those_of_the_page_of_the_paper() -> None:
    told = cells((ROOT / "README.md").read_text(encoding="utf-8"), "Results")
    measured = cells((ROOT / "docs" / "reproduction.md").read_text(encoding="utf-8"), "In short")
    assert told
    assert not [row for row in told if row not in measured]


@pytest.mark.slow
def test_the_readme_s_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    readme = (ROOT / "README.md").read_text()
    (example,) = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    (confirmed_s,) = re.findall(r"^confirmed by the tracker +([\d.]+) s$", readme, re.MULTILINE)
    exec(compile(example, "README.md", "exec"), {})
    assert re.search(rf"^{confirmed_s} s: vehicle \d+, its light \d+ m away$", capsys.readouterr().out, re.MULTILINE)
