"""Settings of the site: Sphinx builds the Markdown of this folder, `scripts/docs` calls it."""

import sys
from pathlib import Path
from typing import Any

import yaml

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parent / "scripts"))

from formula_lexer import FormulaLexer  # noqa: E402

project = "Kennfeld"
html_title = "Kennfeld"
root_doc = "index"
extensions = ["myst_parser"]
myst_heading_anchors = 4
highlight_language = "text"
smartquotes = False  # `--option` keeps its hyphens

html_theme = "furo"
html_static_path = ["static"]
html_favicon = html_logo = "../src/kennfeld/app/static/icon.svg"
_FONT = '-apple-system, "Segoe UI", Inter, Roboto, "Noto Sans", "DejaVu Sans Condensed", system-ui, sans-serif'
html_theme_options = {  # colours and type of the app, `web/src/tokens.css`
    "light_css_variables": {
        "font-stack": _FONT,
        "color-brand-primary": "#1f5fbf",
        "color-brand-content": "#1f5fbf",
        "color-brand-visited": "#1f5fbf",
        "color-foreground-primary": "#16191d",
        "color-foreground-secondary": "#5c636b",
        "color-background-primary": "#ffffff",
        "color-background-secondary": "#f6f7f9",
        "color-background-border": "#e1e4e8",
    },
    "dark_css_variables": {
        "color-brand-primary": "#74a7f2",
        "color-brand-content": "#74a7f2",
        "color-brand-visited": "#74a7f2",
        "color-foreground-primary": "#eef0f2",
        "color-foreground-secondary": "#959da6",
        "color-background-primary": "#171a1f",
        "color-background-secondary": "#101317",
        "color-background-border": "#2b3138",
    },
}
html_css_files = ["kennfeld.css"]
html_js_files = [("copy_button.js", {"defer": "defer"}), ("full_size.js", {"defer": "defer"})]
html_show_copyright = False
html_copy_source = False
html_show_sourcelink = False
html_use_index = False
pygments_style = "friendly"
pygments_dark_style = "monokai"


def toctrees() -> str:
    """Return the table of contents of each section in `navigation.yml`, of the pages that are there."""
    sections = yaml.safe_load((FOLDER / "navigation.yml").read_text(encoding="utf-8"))["nav"]
    return "\n".join(toctree(*section) for entry in sections for section in entry.items())


def toctree(section: str, entries: list[str | dict[str, str]]) -> str:
    """Return a hidden table of contents: it fills the sidebar only.

    >>> print(toctree("Start", ["index.md", {"First steps": "get-started.md"}]))
    ```{toctree}
    :hidden:
    :caption: Start
    index
    First steps <get-started>
    ```
    """
    pages = [("", entry) if isinstance(entry, str) else next(iter(entry.items())) for entry in entries]
    names = [(title, path.removesuffix(".md")) for title, path in pages if (FOLDER / path).exists()]
    lines = [f"{title} <{name}>" if title else name for title, name in names]
    return "\n".join(["```{toctree}", ":hidden:", f":caption: {section}", *lines, "```"])


def add_toctrees(app: Any, name: str, source: list[str]) -> None:
    """Append the navigation to the first page, so that the page itself reads well as plain Markdown."""
    if name == root_doc:
        source[0] += f"\n\n{toctrees()}\n"


def setup(app: Any) -> None:
    """Tell Sphinx of the formula language and of the navigation."""
    app.add_lexer("kf", FormulaLexer)
    app.connect("source-read", add_toctrees)
