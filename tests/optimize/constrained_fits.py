"""Random fits of tables within linear limits, most with grid points that no data reach, and the same for CVXPY."""

from dataclasses import dataclass

import numpy as np

import kennfeld as kf
from kennfeld.domain.constraints import Shape
from kennfeld.graph.interpolation import cell_weights, position, table_weights
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective


@dataclass(frozen=True)
class ConstrainedFit:
    """A curve or map C over data x (and y), fitted to z within shapes and bounds, without smoothness."""

    data: dict
    table: kf.Curve | kf.Map
    shapes: tuple

    @property
    def result(self):
        text = f"m = C({', '.join(name for name in self.data if name != 'z')})"
        return kf.calibrate(text, self.data, kf.ParameterSet([self.table]), "z", constraints=self.shapes)

    @property
    def least_cost(self):
        """The least cost by Clarabel."""
        import cvxpy as cp

        values = cp.Variable(self.table.size)
        squares = cp.sum_squares(self._matrix() @ values - self.data["z"])
        lower, upper = (np.broadcast_to(side, self.table.values.shape).ravel() for side in self._bounds())
        within = [values[np.isfinite(lower)] >= lower[np.isfinite(lower)]]
        within += [values[np.isfinite(upper)] <= upper[np.isfinite(upper)]]
        for shape in self.shapes:
            differences = self._differences(np.eye(self.table.size).reshape(*self.table.values.shape, -1), shape)
            rows = differences.reshape(-1, self.table.size)
            within += [rows @ values >= shape.lower] if np.isfinite(shape.lower) else []
            within += [rows @ values <= shape.upper] if np.isfinite(shape.upper) else []
        problem = cp.Problem(cp.Minimize(squares), within)
        problem.solve(solver=cp.CLARABEL)
        return problem.value

    def violation(self, parameters):
        """The distance of the table from its limits, in units of its largest value; bounds count without a unit."""
        values = parameters["C"].values
        size = np.abs(values).max()
        lower, upper = self._bounds()
        missed = [np.maximum(lower - values, values - upper).max()]
        for shape in self.shapes:
            slopes = self._differences(values, shape)
            if slopes.size:
                missed.append(np.maximum(shape.lower - slopes, slopes - shape.upper).max() / size)
        return max(0.0, *missed)

    def _bounds(self):
        return self.table.lower, self.table.upper

    def _matrix(self):
        axes = [self.data[name] for name in self.data if name != "z"]
        sides = [
            cell_weights(position(at, axis.breakpoints, "clip"), len(axis))[0]
            for at, axis in zip(axes, self.table.axes, strict=True)
        ]
        return table_weights(sides, self.table.values.shape)

    def _differences(self, values, shape):
        """Slopes along the axis of a shape, or how these change; `values` may have further axes."""
        x = self.table.axes[shape.axis].breakpoints
        values = np.moveaxis(values, shape.axis, 0)
        slopes = (np.diff(values, axis=0).T / np.diff(x)).T
        return slopes if shape.kind == "slope" else (np.diff(slopes, axis=0).T * 2 / (x[2:] - x[:-2])).T


def curve_fit(random):
    """A curve with more grid points than data, or about as many; rising, falling or within a band of slopes."""
    size, samples = int(random.integers(3, 9)), int(random.integers(1, 16))
    bands = [(0.0, np.inf), (0.1, np.inf), (0.0, 1.0), (0.1, 1.0), (-np.inf, 0.0), (-np.inf, -0.1)]
    data = {"x": random.uniform(-0.5, size - 0.5, samples), "z": random.normal(0, 2, samples)}
    table = kf.Curve("C", np.arange(size), np.zeros(size))
    lower, upper = bands[random.integers(len(bands))]
    return ConstrainedFit(data, table, (Shape("C", 0, "slope", lower=lower, upper=upper),))


def map_fit(random):
    """A map with few data in some of its cells, rising along one or both axes, at times concave or within bounds."""
    nx, ny = (int(size) for size in random.integers(2, 9, 2))
    samples = int(random.integers(1, 2 * nx * ny))
    data = {"x": random.uniform(-0.5, nx - 0.5, samples), "y": random.uniform(-0.5, ny - 0.5, samples)}
    data["z"] = random.normal(0, 2, samples)
    lower, upper = ((-1.0, 1.5), (-np.inf, np.inf), (-np.inf, np.inf))[random.integers(3)]
    table = kf.Map("C", np.arange(nx), np.arange(ny), np.zeros((nx, ny)), lower=lower, upper=upper)
    shapes = [Shape("C", 0, "slope", lower=0.0)]
    shapes += [Shape("C", 1, "slope", lower=0.0)] if random.random() < 0.7 else []
    shapes += [Shape("C", 0, "curvature", lower=-np.inf, upper=0.0)] if random.random() < 0.3 else []
    return ConstrainedFit(data, table, tuple(shapes))


def least_cost(problem: Problem):
    """The least cost by Clarabel for a problem that is linear in its values, roughness among its costs."""
    import cvxpy as cp

    compiled = CompiledProblem(problem)
    residual, jacobian = LeastSquaresObjective(compiled).rows(np.zeros(compiled.values.free))
    rows = linear_limits(problem, compiled.values).rows
    matrix = rows.matrix(np.arange(rows.count), compiled.values.free)
    size = np.abs(matrix).max(axis=1)
    values = cp.Variable(compiled.values.free)
    taken = (matrix / size[:, None]) @ values
    below, above = np.isfinite(rows.lower), np.isfinite(rows.upper)
    within = [taken[below] >= (rows.lower / size)[below]]
    within += [taken[above] <= (rows.upper / size)[above]] if above.any() else []
    program = cp.Problem(cp.Minimize(cp.sum_squares(jacobian @ values + residual)), within)
    program.solve(solver=cp.CLARABEL)
    return program.value
