"""The linear mean below a Gaussian process: an offset and a slope an input, about which nothing is known beforehand."""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float

__all__ = ["Plane"]

RANK = 1e-10  # share of the largest singular value below which inputs move together


@dataclass(frozen=True, eq=False)
class Plane:
    """Orthonormal directions of the planes over some points.

    Inputs that move together leave the plane undetermined across them; there it stays level.
    """

    basis: Float  # Float[points, rank]
    back: Float  # Float[1 + inputs, rank]: from coefficients of the basis to offset and slopes

    @classmethod
    def over(cls, x: Float) -> "Plane":
        """The planes over points Float[points, inputs]."""
        u, s, v = np.linalg.svd(_columns(x), full_matrices=False)
        keep = s > RANK * s[0]
        return cls(u[:, keep], v[keep].T / s[keep])

    @property
    def rank(self) -> int:
        """How many directions there are."""
        return int(self.basis.shape[1])

    def without(self, values: Float) -> Float:
        """What of Float[points, ...] is no plane."""
        rest: Float = values - self.basis @ (self.basis.T @ values)
        return rest

    def at(self, x: Float) -> Float:
        """The basis at other points: Float[points, rank]."""
        values: Float = _columns(x) @ self.back
        return values


def _columns(x: Float) -> Float:
    return np.column_stack([np.ones(len(x)), x])
