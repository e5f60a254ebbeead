"""A data-driven model in time has a step of its own: at another one it means nothing."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding
from kennfeld.models import Model

__all__ = ["step_findings"]

SAME = 1e-3  # relative difference of steps that time stamps may have by rounding


def step_findings(
    model: Model, datasets: Iterable[Dataset], step: float | None, place: Callable[[Dataset], str]
) -> Iterator[Finding]:
    """Datasets whose step is not that of the model's surrogates; `step` is the model's own, where it has one."""
    wanted = _steps_of(model)
    for data in datasets if wanted else ():
        steps = _steps(data) if step is None else np.array([step])
        if steps is None:
            what = f"{', '.join(wanted)} runs in time, but dataset {data.name} has no time stamps"
            yield Finding(place(data), what, "Name the time channel `time`.")
            continue
        for name, own in wanted.items():
            wrong = steps[np.abs(steps - own) > SAME * own]
            if wrong.size:
                what = f"{name} was trained at steps of {own:g} s, and dataset {data.name} has one of {wrong[0]:g} s"
                yield Finding(place(data), what, f"Write raster = {own:g}, or train it at the step of the data.")


def _steps_of(model: Model) -> dict[str, float]:
    if not model.surrogates:
        return {}
    from kennfeld.surrogate import DynamicSurrogate

    return {s.name: s.step for s in model.surrogates if isinstance(s, DynamicSurrogate)}


def _steps(data: Dataset) -> Float | None:
    """The steps within pieces, in s."""
    return None if data.time is None else np.delete(np.diff(data.time), data.starts[1:] - 1)
