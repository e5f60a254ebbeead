"""How well a criterion is met."""

from dataclasses import dataclass

__all__ = ["Quality"]


@dataclass(frozen=True)
class Quality:
    """How well one criterion is met on one dataset, in the unit of its target, before and after."""

    criterion: str
    dataset: str
    use: str
    samples: int
    rmse_before: float
    rmse_after: float
    r2_after: float
    max_abs_after: float
