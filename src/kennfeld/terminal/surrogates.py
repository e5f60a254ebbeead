"""A data-driven model in words."""

from collections.abc import Sequence

from kennfeld.surrogate import DynamicSurrogate, Surrogate
from kennfeld.terminal.table import aligned

__all__ = ["described", "quality_table", "summary"]


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
        [q.dataset, q.use, q.mode, str(q.samples), f"{q.rmse:.4g}", f"{q.r2:.4f}", f"{q.max_abs:.4g}"]
        for q in surrogate.quality
    ]
    return rows
