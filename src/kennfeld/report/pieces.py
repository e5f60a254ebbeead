"""Figures, notes and display limits shared by the sections of a report."""

from kennfeld.report import figures
from kennfeld.report.markup import Html, element

OPEN_PARTS = 4  # datasets, and parameters, that are unfolded initially
MAX_LISTED = 8


class Pictures:
    """The figures of a page by number; each has a placeholder in which the page draws it."""

    def __init__(self) -> None:
        self.data: list[figures.Figure] = []

    def place(self, figure: figures.Figure | None, caption: str, label: str) -> Html | None:
        """Return the placeholder of a figure, with a caption and a label for screen readers."""
        if figure is None:
            return None
        self.data.append(figure)
        number = str(len(self.data) - 1)
        drawn = element("div", class_="plot", data_figure=number, role="img", aria_label=label)
        return element("figure", drawn, element("figcaption", caption) if caption else None, class_=figure["kind"])


def note(text: str) -> Html:
    """Return an explanatory paragraph."""
    return element("p", text, class_="note")
