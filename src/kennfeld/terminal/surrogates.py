"""A data-driven model in words."""

from collections.abc import Sequence

from kennfeld.optimize.quality import r2_text
from kennfeld.surrogate import DynamicSurrogate, Surrogate
from kennfeld.terminal.table import aligned

__all__ = ["described", "quality_table", "ranges_table", "summary"]


def summary(surrogate: Surrogate) -> list[str]:
    """What it is, how it was checked, and how well it meets its recordings."""
    lines = [described(surrogate)]
    if isinstance(surrogate, DynamicSurrogate) and surrogate.stability:
        lines.append(surrogate.stability)
    return [*lines, "", *aligned(quality_table(surrogate))]


def described(surrogate: Surrogate) -> str:
    """One sentence: inputs, lags, size."""
    centres = f"{surrogate.expansion.size} centres"
    if not isinstance(surrogate, DynamicSurrogate):
        return f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)}), {centres}"
    lags = [f"{name} at {_listed(own)}" for name, own in zip(surrogate.inputs, surrogate.lags, strict=True)]
    looks = "; ".join([*lags, f"itself at {_listed(surrogate.output_lags)}"])
    called = f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)})"
    return f"{called}, steps of {surrogate.step:g} s, {centres}; samples back: {looks}"


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) or "none"


def quality_table(surrogate: Surrogate) -> list[list[str]]:
    """A row a dataset and way of running it."""
    rows = [["dataset", "use", "mode", "samples", "RMSE", "R2", "max |error|"]]
    rows += [
        [
            q.dataset,
            q.use,
            q.mode,
            str(q.samples),
            f"{q.rmse:.4g}",
            r2_text(q.r2, q.samples, q.rmse),
            f"{q.max_abs:.4g}",
        ]
        for q in surrogate.quality
    ]
    return rows


def ranges_table(surrogate: Surrogate) -> list[list[str]]:
    """A row an input, and for the output that is fed back: between which numbers the training data lie."""
    rows = [["trained on", "unit", "from", "to"]]
    validity = surrogate.validity
    if validity is None:
        return rows
    names, lags = [*surrogate.inputs], [1] * len(surrogate.inputs)
    if isinstance(surrogate, DynamicSurrogate):
        names = [surrogate.output, *surrogate.inputs]
        lags = [len(surrogate.output_lags), *map(len, surrogate.lags)]
    units = dict(zip([*surrogate.inputs, surrogate.output], surrogate.units, strict=False))
    first = 0
    for name, count in zip(names, lags, strict=True):
        part = slice(first, first + count)
        first += count
        if count:
            ends = validity.least[part].min(), validity.most[part].max()
            rows.append([name, units.get(name, ""), *(f"{end:.6g}" for end in ends)])
    return rows
