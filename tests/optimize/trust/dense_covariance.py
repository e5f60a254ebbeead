"""Covariances of fitted values as a textbook has them: dense matrices, and a basis of what the limits leave free."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

import kennfeld as kf


@dataclass(frozen=True)
class DenseCovariance:
    """Slopes of outputs and rows of roughness by the values, and rows by which active limits hold the values."""

    jacobian: np.ndarray  # shape (samples, values)
    holding: np.ndarray  # shape (limits, values)
    roughness: np.ndarray  # shape (rows, values)

    def error(self, noise):
        """The covariance if smoothness is a belief about the truth."""
        return noise**2 * self._inverse()

    def scatter(self, noise):
        """The covariance over repeated measurements."""
        inverse = self._inverse()
        return noise**2 * inverse @ self.jacobian.T @ self.jacobian @ inverse

    def _inverse(self):
        basis = null_space(self.holding) if self.holding.size else np.eye(self.jacobian.shape[1])
        rows = np.vstack([self.jacobian, self.roughness]) @ basis
        return basis @ np.linalg.inv(rows.T @ rows) @ basis.T


def slopes(text, inputs, parameters, node, *, step=1e-6):
    """Slopes of a node by every value, in the order of the parameters, by central differences of simulations."""

    def outputs(name, values):
        changed = parameters.with_parameters(parameters[name].with_values(values))
        return kf.simulate(text, inputs, changed)[node].values

    columns = []
    for name, parameter in parameters.items():
        flat = np.ravel(parameter.values)
        for move in step * np.eye(flat.size):
            ahead, behind = (np.reshape(flat + side * move, np.shape(parameter.values)) for side in (1, -1))
            columns.append((outputs(name, ahead) - outputs(name, behind)) / (2 * step))
    return np.array(columns).T
