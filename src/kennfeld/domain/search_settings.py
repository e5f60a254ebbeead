"""Settings of a search that a project file and the Python API share; loading them is fast."""

from typing import Literal

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.file_keys import key

MAX_STARTS = 10_000  # each keeps its values until the end


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """`[optimizer]` of a project file; `optimize.Options` adds what only the Python API sets."""

    method: Literal["gauss-newton", "global"] = key(
        '`"global"` [searches without gradients](method.md#search-without-gradients), for few values and a cost with '
        "steps. All values need `bounds`",
        "gauss-newton",
    )
    max_evaluations: int = key(
        "maximum number of cost evaluations of the global search",
        0,
        least=1,
        default_text="2000 (values + 4) up to 5 values, else 500 (values + 4)",
    )
    continuation: Literal["auto", "off"] = key(
        '`"off"` searches on the exact model only: faster, and sufficient for smooth surfaces; see '
        "[kinks](method.md#kinks)",
        "auto",
    )
    max_iterations: int = key("maximum number of iterations of one descent", 200, least=1)
    tolerance: float | None = key(
        "relative change of the cost at which a [descent](method.md#descent) ends",
        None,
        above=0,
        default_text="1e-8; up to 3e-5 for large problems",
    )
    max_seconds: float | None = key(
        "time in s after which the search stops with the best values so far, once its current iteration is complete; "
        "the status is then `stopped`",
        None,
        above=0,
        default_text="unlimited",
    )
    starts: int = key(
        "number of [starts](method.md#several-starts): the first from the initial values, the others spread around "
        "them",
        1,
        least=1,
        most=MAX_STARTS,
    )
    seed: int = key(
        "selects the other starts and the points of a global search; the same seed gives the same result", 0, least=0
    )
    spread: float = key(
        "distance of the other starts: without bounds, in units of the largest value of the table", 0.5, above=0
    )
    save_every: int = key(
        "keep every nth accepted parameter set in `results/saves`, to [resume](results.md#resume-a-search) after a "
        "power failure; 0 keeps none",
        0,
        least=0,
    )
