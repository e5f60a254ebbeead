"""What the sections of a report share: pictures, notes, and how much is unfolded or listed."""

from kennfeld.report import figures
from kennfeld.report.markup import Html, element

__all__ = ["MOST_LISTED", "OPEN_PARTS", "Pictures", "note"]

OPEN_PARTS = 4  # how many datasets, and parameters, are unfolded at first
MOST_LISTED = 8


class Pictures:
    """The pictures of a page by number; each leaves a place where the page draws it."""

    def __init__(self) -> None:
        self.data: list[figures.Figure] = []

    def place(self, figure: figures.Figure | None, caption: str, label: str) -> Html | None:
        """A place for a picture, with a caption and, for those who cannot see it, a label."""
        if figure is None:
            return None
        self.data.append(figure)
        number = str(len(self.data) - 1)
        drawn = element("div", class_="plot", data_figure=number, role="img", aria_label=label)
        return element("figure", drawn, element("figcaption", caption) if caption else None, class_=figure["kind"])


def note(text: str) -> Html:
    """A sentence that explains what stands above."""
    return element("p", text, class_="note")
