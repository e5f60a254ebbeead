"""Pictures as SVG elements, for light and dark pages: text and grid have the colour of the page."""

from collections.abc import Callable, Iterator, Sequence
from math import floor, log10

import numpy as np

from kennfeld.base.arrays import Float, runs_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.markup import Html, element

WIDTH, HEIGHT = 420, 200
STRIP_HEIGHT = 54
LINE = "#3b8eea"  # legible on white and on black
MARGIN_LEFT, MARGIN_BOTTOM, MARGIN = 56, 34, 18
MAX_TICKS = 6
# the heights of maps in reports and in the app
HEIGHTS = ((43, 64, 124), (36, 108, 158), (44, 152, 155), (108, 190, 122), (191, 214, 88), (247, 226, 98))


Rgb = tuple[int, int, int]


def height_colour(share: float) -> Rgb:
    """Return the colour of a height from 0 to 1.

    >>> height_colour(0.0), height_colour(1.0)
    ((43, 64, 124), (247, 226, 98))
    """
    at = min(max(share, 0.0), 1.0) * (len(HEIGHTS) - 1)
    first = min(floor(at), len(HEIGHTS) - 2)
    low, high = HEIGHTS[first], HEIGHTS[first + 1]
    red, green, blue = (round(a + (at - first) * (b - a)) for a, b in zip(low, high, strict=True))
    return red, green, blue


def colour_scale(values: Float) -> Callable[[float], Rgb]:
    """Return the colours of numbers by their height among finite values, of any shape; equal ones are in the middle."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    width = high - low
    # the range of finite numbers may itself be infinite
    return lambda value: height_colour((value - low) / width if 0 < width < np.inf else 0.5)


def ink_on(colour: Rgb) -> str:
    """Return the colour of text on a background: black or white."""
    red, green, blue = colour
    # luma of ITU-R BT.601
    return "#000" if 0.299 * red + 0.587 * green + 0.114 * blue > 120 else "#fff"


def css(colour: Rgb) -> str:
    """Return a colour as hexadecimal number.

    >>> css((247, 226, 98))
    '#f7e262'
    """
    return "#" + "".join(f"{part:02x}" for part in colour)


def ticks(low: float, high: float, most: int = MAX_TICKS) -> list[float]:
    """Return round numbers within a range.

    >>> ticks(0.0, 10.0), ticks(703.0, 5120.0)
    ([0.0, 2.0, 4.0, 6.0, 8.0, 10.0], [1000.0, 2000.0, 3000.0, 4000.0, 5000.0])
    """
    width = high - low
    if not (np.isfinite(width) and width / most > np.finfo(float).tiny):
        return [low]
    power = 10.0 ** floor(log10(width / most))
    step = next((digit * power for digit in (1, 2, 5, 10) if width / (digit * power) <= most), 10 * power)
    # an end that is a tick stays one despite the rounding of the quotient
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    # 0.3 in place of 3 * 0.1 = 0.30000000000000004
    return [round(number * step, 12) if step > 1e-9 else number * step for number in range(first, last + 1)]


@dataclass(frozen=True)
class Span:
    """A range of numbers along a picture, from `start` to `end` in pixels; numbers that are equal are in the middle."""

    low: float
    high: float
    start: float
    end: float

    @classmethod
    def of(cls, values: Float, start: float, end: float) -> "Span":
        """Return the span of the finite values."""
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        return cls(low, high, start, end)

    def __call__(self, value: float) -> float:
        width = self.high - self.low
        share = (value - self.low) / width if 0 < width < np.inf else 0.5
        return round(self.start + share * (self.end - self.start), 1)


def line_chart(x: Float, y: Float, x_title: str, y_title: str, *, dots: bool = False) -> Html:
    """Draw a line over an axis with ticks.

    Args:
        x: Float[points].
        y: Float[points]; the line ends where a value is missing.
        x_title: name and unit of x.
        y_title: name and unit of y.
        dots: mark the points.
    """
    across = Span.of(x, MARGIN_LEFT, WIDTH - MARGIN)
    up = Span.of(y, HEIGHT - MARGIN_BOTTOM, MARGIN)
    marks = [
        element("circle", cx=across(a), cy=up(b), r=2.5, fill=LINE)
        for a, b in zip(x.tolist(), y.tolist(), strict=True)
        if dots and np.isfinite(b)
    ]
    label = f"{y_title} over {x_title}"
    return _picture(HEIGHT, label, [*_grid(across, up), _titles(x_title, y_title), *_lines(x, y, across, up), *marks])


def strip(x: Float, y: Float, label: str) -> Html:
    """Draw a small line without axes; x and y are Float[points]."""
    across, up = Span.of(x, 1, WIDTH - 1), Span.of(y, STRIP_HEIGHT - 3, 3)
    return _picture(STRIP_HEIGHT, label, [*_lines(x, y, across, up)])


def heat_map(values: Float, x: Float, y: Float, x_title: str, y_title: str, label: str) -> Html:
    """Draw colours over two axes; cells end between points.

    `values` Float[x, y] are at the points `x` Float[x] and `y` Float[y].
    """
    across, up = Span.of(x, MARGIN_LEFT, WIDTH - MARGIN), Span.of(y, HEIGHT - MARGIN_BOTTOM, MARGIN)
    colour = colour_scale(values)
    rows, columns = _edges(x, across), _edges(y, up)
    cells = []
    for i, row in enumerate(values.tolist()):
        for j, value in enumerate(row):
            if np.isfinite(value):
                # pixels count downwards, y grows upwards
                left, top = rows[i], min(columns[j], columns[j + 1])
                width, height = rows[i + 1] - left, abs(columns[j + 1] - columns[j])
                # cells overlap a little, so that no line of the page shows between them
                size = {"width": round(width + 0.3, 1), "height": round(height + 0.3, 1)}
                cells.append(element("rect", x=left, y=round(top, 1), fill=css(colour(value)), **size))
    sharp = element("g", cells, shape_rendering="crispEdges")
    return _picture(HEIGHT, label, [sharp, *_grid(across, up, lines=False), _titles(x_title, y_title)])


def _edges(points: Float, span: Span) -> list[float]:
    # halved first, since the sum of two doubles may overflow
    middles = 0.5 * points[1:] + 0.5 * points[:-1]
    if points.size == 1:
        return [span.start, span.end]
    return [span.start, *(span(value) for value in middles.tolist()), span.end]


def _lines(x: Float, y: Float, across: Span, up: Span) -> Iterator[Html]:
    """Yield a line for each run of finite values; a single value is a dot."""
    known = np.isfinite(x) & np.isfinite(y)
    for first, last in runs_of(known).tolist():
        pairs = zip(x[first:last].tolist(), y[first:last].tolist(), strict=True)
        points = [(across(a), up(b)) for a, b in pairs]
        if len(points) == 1:
            yield element("circle", cx=points[0][0], cy=points[0][1], r=1.5, fill=LINE)
        else:
            path = " ".join(f"{a:g},{b:g}" for a, b in points)
            yield element("polyline", points=path, fill="none", stroke=LINE, stroke_width="1.4")


def _grid(across: Span, up: Span, *, lines: bool = True) -> Iterator[Html]:
    """Yield lines and numbers at round values."""
    thin = {"stroke": "currentColor", "stroke_opacity": "0.18"}
    for value in ticks(across.low, across.high):
        at = across(value)
        if lines:
            yield element("line", x1=at, x2=at, y1=up.end, y2=up.start, **thin)
        yield _text(f"{value:g}", at, up.start + 13, "middle")
    for value in ticks(up.low, up.high):
        at = up(value)
        if lines:
            yield element("line", x1=across.start, x2=across.end, y1=at, y2=at, **thin)
        yield _text(f"{value:g}", across.start - 5, at + 3.5, "end")


def _titles(x_title: str, y_title: str) -> Html:
    middle = (HEIGHT - MARGIN_BOTTOM) / 2
    turned = element(
        "text",
        y_title,
        x=10,
        y=middle,
        text_anchor="middle",
        fill="currentColor",
        transform=f"rotate(-90 10 {middle:g})",
    )
    return Html(_text(x_title, (WIDTH + MARGIN_LEFT) / 2, HEIGHT - 6, "middle") + turned)


def _text(text: str, x: float, y: float, anchor: str) -> Html:
    return element("text", text, x=round(x, 1), y=round(y, 1), text_anchor=anchor, fill="currentColor")


def _picture(height: int, label: str, parts: Sequence[Html]) -> Html:
    style = f"max-width:100%;width:{WIDTH}px;font:10px sans-serif;display:block"
    return element("svg", parts, viewBox=f"0 0 {WIDTH} {height}", role="img", aria_label=label, style=style)
