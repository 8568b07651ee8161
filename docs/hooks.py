"""Hooks of the documentation site (mkdocs.yml): API pages, links that leave docs/, no requests to other hosts."""

import pathlib
import re
from typing import Any

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

REPOSITORY = pathlib.Path(__file__).resolve().parent.parent
API = "reference/api/"
INCLUDED = {
    "ARCHITECTURE.md": "explanation/architecture.md",
    "CONTRIBUTING.md": "explanation/contributing.md",
    "datasets/README.md": "reference/datasheet.md",
    "examples/README.md": "how-to/examples.md",
}
"""Markdown files outside of docs/ and the page of the site that shows each of them."""

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")
_REQUEST = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"?(?:https?:)?//|<link\b[^>]*\bhref=\"?(?:https?:)?//"
)

_NAMES = re.compile(r"^( {4,})(\w+(?:, \w+)+)(: .*(?:\n\1 .*)*)", re.MULTILINE)


class ReadableDocstrings(griffe.Extension):
    """Griffe wants one entry per name, docstrings also have "start, goal: poses"; "decision 5" becomes a link.

    Classes and functions of a module name the file that defines them.
    """

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            text = _NAMES.sub(_one_entry_per_name, obj.docstring.value)
            text = re.sub(r"\b([Dd]ecisions?) (\d+)", r"[\1 \2][d\2]", text)
            if (obj.is_class or obj.is_function) and obj.parent and obj.parent.is_module:
                text = f"{text.rstrip()}\n\nDefined in `{obj.relative_package_filepath.as_posix()}`."
            obj.docstring.value = text


def _one_entry_per_name(entry: re.Match[str]) -> str:
    indent, names, text = entry.groups()
    return "\n".join(f"{indent}{name}{text}" for name in names.split(", "))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the API pages that the navigation names, and the files of ``INCLUDED``."""
    for path in _paths(config.nav):
        if path.startswith(API):
            package = pathlib.PurePosixPath(path).stem
            files.append(File.generated(config, path, content=f"# {package}\n\n::: {package}\n"))
    for source, path in INCLUDED.items():
        files.append(File.generated(config, path, content=(REPOSITORY / source).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: Any) -> str:
    """Point links that leave docs/ to the page that shows their target, or show the path where there is none."""
    docs = pathlib.Path(config.docs_dir)
    shown = {page: source for source, page in INCLUDED.items()}
    written = REPOSITORY / shown[page.file.src_uri] if page.file.src_uri in shown else docs / page.file.src_uri

    def replaced(link: re.Match[str]) -> str:
        picture, text, target, anchor = link.groups()
        path = (written.parent / target).resolve()
        if path.is_relative_to(docs):
            place = path.relative_to(docs).as_posix()
        elif not path.is_relative_to(REPOSITORY) or not path.exists():
            raise PluginError(f"{page.file.src_uri}: the link {target} leads to no file of the repository")
        else:
            source = path.relative_to(REPOSITORY).as_posix()
            place = INCLUDED.get(source, "")
            if not place:
                return f"`{source}`" if text.strip("`/") in source else f"{text} (`{source}`)"
        up = "../" * page.file.src_uri.count("/")
        return f"{picture}[{text}]({up}{place}{anchor or ''})"

    markdown = re.sub(r"^(### D(\d+): .*)$", r"\1 {#d\2}", markdown, flags=re.MULTILINE)
    return _LINK.sub(replaced, markdown)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """Refuse a page that would load anything from another host."""
    if found := _REQUEST.search(output):
        raise PluginError(f"{page.file.src_uri}: the page requests another host: {found.group()}")
    return output


def _paths(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [path for each in (entry.values() if isinstance(entry, dict) else entry) for path in _paths(each)]
