"""The memory that many free values would take: better refused by a check than by the system during a search."""

from kennfeld.errors import Finding

__all__ = ["matrix_findings"]

MOST = 4e9  # bytes of one matrix, of which a fit and its account of trust keep several


def matrix_findings(place: str, values: int) -> list[Finding]:
    """Return an error if the matrix of a fit, with a row and a column for each free value, does not fit into memory.

    Args:
        place: where the parameters are said to be free.
        values: how many values are free.
    """
    size = 8.0 * values**2
    if size <= MOST:
        return []
    what = f"{values} values to fit need matrices of {size / 1e9:.3g} GB"
    return [Finding(place, what, "Use fewer breakpoints, or fit fewer parameters at once.")]
