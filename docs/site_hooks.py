"""What `make docs` adds to MkDocs: links to files outside `docs/`, and equations without scripts.

A link to a file of the repository, such as `../src/foreglow/beam/policy.py`, is right on GitHub as it stands. In the
site it leads to a page that holds this file: Markdown as a page like any other, anything else as highlighted text.
Equations between dollar signs, as GitHub shows them, become MathML, which browsers show by themselves.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
"""The target of a relative link or picture, and its anchor."""
LANGUAGES = {".py": "python", ".toml": "toml", ".cpp": "cpp", ".hpp": "cpp", ".yml": "yaml"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Adds the equations to the Markdown that is understood."""
    config.markdown_extensions.append(Equations())  # type: ignore[arg-type]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds a page for every file outside `docs/` that a page links to, and for those that these link to."""
    waiting = [DOCS / file.src_uri for file in files.documentation_pages()]
    while waiting:
        for path in outside(waiting.pop()):
            if files.get_file_from_path(site_uri(path)) is None:
                files.append(File.generated(config, site_uri(path), content=as_page(path)))
                if path.suffix == ".md":
                    waiting.append(path)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """The page with its links to where the site has the files."""
    uri = page.file.src_uri
    source = ROOT / uri.removeprefix("repository/") if uri.startswith("repository/") else DOCS / uri
    if not source.exists():
        return markdown  # the text of a file that is not Markdown

    def in_the_site(match: re.Match[str]) -> str:
        path = Path(os.path.normpath(source.parent / match[1]))
        if not path.exists():
            return match[0]  # MkDocs says which page has it
        return os.path.relpath(site_uri(path), Path(uri).parent) + (match[2] or "")

    return LINK.sub(in_the_site, markdown)


def outside(page: Path) -> Iterator[Path]:
    """The existing files outside `docs/` that `page` links to."""
    for match in LINK.finditer(page.read_text(encoding="utf-8")):
        path = Path(os.path.normpath(page.parent / match[1]))
        if path.exists() and path.is_relative_to(ROOT) and not path.is_relative_to(DOCS):
            yield path


def site_uri(path: Path) -> str:
    """Where the site has the file `path` of the repository."""
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    return f"repository/{path.relative_to(ROOT).as_posix()}" + ("" if path.suffix == ".md" else ".md")


def as_page(path: Path) -> str:
    """The file as Markdown; of a folder, what is in it."""
    if path.suffix == ".md":
        return path.read_text(encoding="utf-8")
    title = f"---\nsearch:\n  exclude: true\n---\n\n# {path.relative_to(ROOT).as_posix()}\n\n"
    if path.is_dir():
        return title + "".join(f"- `{child.name}`\n" for child in sorted(path.iterdir()) if child.name[0] not in "_.")
    return title + f"````{LANGUAGES.get(path.suffix, 'text')}\n{path.read_text(encoding='utf-8')}\n````\n"


class Equations(Extension):
    """Equations in LaTeX, `$...$` in a line or `$$...$$` on their own, as MathML."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        """Equations come after code and before everything that would read `_` or `*`."""
        md.inlinePatterns.register(Equation(r"(\$\$?)([^$]+?)\1", md), "equation", 185)


class Equation(InlineProcessor):
    """Makes one equation into MathML."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[Any, int, int]:  # type: ignore[override]  # noqa: ARG002, N802
        """The element, and where the equation begins and ends."""
        mathml = convert(m[2].strip(), display="block" if m[1] == "$$" else "inline")
        return self.md.htmlStash.store(mathml), m.start(0), m.end(0)
