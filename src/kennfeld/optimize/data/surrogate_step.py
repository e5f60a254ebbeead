"""A data-driven model in time has a step of its own: it means nothing at another one."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from kennfeld.dataset import Dataset
from kennfeld.errors import Finding
from kennfeld.models import Model

__all__ = ["step_findings"]

SAME = 1e-3  # relative difference of steps that time stamps may have by rounding


def step_findings(
    model: Model, datasets: Iterable[Dataset], step: float | None, place: Callable[[Dataset], str]
) -> Iterator[Finding]:
    """Datasets whose step is not that of the model's surrogates; `step` is the model's own, where it has one."""
    wanted = {s.name: float(s.step) for s in model.surrogates if hasattr(s, "step")}
    for data in datasets if wanted else ():
        steps = np.array([step]) if step else np.diff(data.time) if data.time is not None else np.zeros(0)
        if data.time is None and step is None:
            names = ", ".join(wanted)
            yield Finding(place(data), f"{names} runs in time, but dataset {data.name} has no time stamps")
            continue
        steps = steps if step else np.delete(steps, data.starts[1:] - 1)
        for name, own in wanted.items():
            wrong = steps[np.abs(steps - own) > SAME * own]
            if wrong.size:
                what = f"{name} was trained at steps of {own:g} s, and dataset {data.name} has one of {wrong[0]:g} s"
                yield Finding(place(data), what, f"Write raster = {own:g}, or train it at the step of the data.")
