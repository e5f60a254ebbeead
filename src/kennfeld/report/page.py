"""The page: sections, table of contents, data and program in one file that needs nothing else."""

import json
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from kennfeld import __version__
from kennfeld.report.markup import Html, element
from kennfeld.report.sections import Pictures, sections
from kennfeld.report.subject import Subject

__all__ = ["page"]

STATIC = Path(__file__).parent / "static"
SCRIPTS = ("plot.js", "charts.js", "surface.js", "table.js", "page.js")
# nothing is loaded from anywhere, whatever a name in the data may try
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def page(subject: Subject, made: datetime | None = None) -> str:
    """The report as the text of an HTML file; `made` is the time it bears, now by default."""
    time = (made or datetime.now().astimezone()).isoformat(" ", "seconds")
    pictures = Pictures()
    parts = list(sections(subject, pictures))
    title = f"{subject.project.name}: calibration report"
    data = {
        "version": __version__,
        "made": time,
        "result": subject.written,
        "figures": pictures.data,
    }
    return "<!doctype html>\n" + element(
        "html",
        element(
            "head",
            element("meta", charset="utf-8"),
            element("meta", http_equiv="Content-Security-Policy", content=POLICY),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("title", title),
            element("style", Html(_static("report.css"))),
        ),
        element(
            "body",
            _contents(parts),
            element("main", _head(subject, time), [_section(*part[:3]) for part in parts], _foot(time)),
            element("script", _json(data), type="application/json", id="report-data"),
            [element("script", Html(_static(name))) for name in SCRIPTS],
        ),
        lang="en",
    )


def _contents(parts: Any) -> Html:
    """The table of contents."""
    entries = []
    for anchor, title, _, below in parts:
        entries.append(element("a", title, href=f"#{anchor}"))
        links = [element("a", name, href=f"#{to}", class_="below", title=name) for to, name in below]
        entries += [element("div", links, class_="group")] if links else []
    return element("nav", element("div", "Kennfeld", class_="brand"), entries, aria_label="Contents")


def _head(subject: Subject, time: str) -> Html:
    status = "not calibrated yet" if subject.result is None else subject.result.status
    return element(
        "header",
        element("h1", subject.project.name),
        element(
            "p",
            f"Calibration report · {subject.project.path.resolve()} · {time} · kennfeld {__version__} · ",
            element("span", status, class_=f"status {status.partition(' ')[0]}"),
            class_="note",
        ),
        element(
            "noscript", element("p", "The pictures of this report are drawn by the page itself: allow JavaScript.")
        ),
    )


def _section(anchor: str, title: str, content: Html) -> Html:
    return element("section", element("h2", title), content, id=anchor)


def _foot(time: str) -> Html:
    return element("footer", f"Made by kennfeld {__version__} at {time}. This file needs no network and no other file.")


@cache
def _static(name: str) -> str:
    return (STATIC / name).read_text(encoding="utf-8")


def _json(data: Any) -> Html:
    """JSON within a script element, which no text in it can end."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Html(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))
