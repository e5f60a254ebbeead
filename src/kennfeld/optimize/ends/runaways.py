"""Values that a search leads towards infinity, where the function no longer depends on each of them.

A bell `h*exp(-((x - m)/s)^2)` whose place m leaves the data becomes an exponential slope: the farther it goes, the
better it follows the rising side of the data. `PT1(k*u, T)` with a large k and T is an integrator of k/T. There is no
optimum on that way, only a cost that falls towards a limit, and the derivatives vanish as at one.
"""

import numpy as np

from kennfeld.base.arrays import Bool, Float, ignore_floating_errors
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

FAR = 1e8  # ratio to the start, or to 1 if that is larger, from which a value may have run away
FARTHER = 1e3  # ratio to a start that is not 0 from which it may have
SAME, ALIKE = 1e-12, 1e-9  # eigenvalues of the scaled J'J of values whose effects are the same, relative to the largest
ROUNDING = 1e3 * float(np.finfo(float).eps)  # of the targets: noise of data that are met exactly
MOST = 1500  # values whose effects are compared
SHARE = 1e-4  # squared share of a value in such directions
MAX_NAMES = 5  # in a warning
REMEDY = "Set bounds, or start closer to plausible values."


def find_runaways(
    compiled: CompiledProblem, objective: LeastSquaresObjective, start: Float, end: Float
) -> list[Finding]:
    """Return a warning that names the parameters that ran away, if any did.

    They have grown by orders of magnitude, their effect is that of other values as well, and the data do not tell their
    size. A value with an effect of its own is an optimum, however large it is; so is the offset of a line over seconds
    since 1970.

    Args:
        compiled: the problem.
        objective: of it.
        start: free values, Float[values].
        end: the same at the end.
    """
    far, farther = _grown(objective, start, end)
    if not (far | farther).any() or end.size > MOST:
        return []
    effects = Effects.at(objective, end)
    # of weighted residuals, as the deviations are for noise of 1
    noise = np.sqrt(objective.data_cost(end) / max(compiled.residuals - end.size, 1))
    rounding = ROUNDING * np.sqrt(objective.target_squares / max(compiled.residuals, 1))
    # a deviation above the value itself: even its order of magnitude is unknown
    unknown = max(float(noise), float(rounding)) * effects.deviations > np.abs(end)
    lost = unknown & ((far & effects.replaceable(SAME)) | (farther & effects.replaceable(ALIKE)))
    ran = {n: end[part][lost[part]] for n, part in _parts(compiled).items() if lost[part].any()}
    if not ran:
        return []
    listed = join_names([f"{name} to {each[np.argmax(np.abs(each))]:.3g}" for name, each in ran.items()], MAX_NAMES)
    where = "where they have no effects of their own" if len(ran) > 1 else "where it has no effect of its own"
    message = f"The search led {listed}, {where}"
    return [Finding(Location(), message, REMEDY, severity="warning")]


def run_away(compiled: CompiledProblem, objective: LeastSquaresObjective, start: Float, end: Float) -> list[Bool]:
    """Mark the values of each parameter that may have run away, Bool[values], that which has grown most first."""
    far, farther = _grown(objective, start, end)
    if not (far | farther).any() or end.size > MOST:
        return []
    lost = (far | farther) & Effects.at(objective, end).replaceable(ALIKE)
    growth = np.where(lost, np.abs(end) / np.where(start != 0, np.abs(start), 1.0), 0.0)
    parts = [part for part in _parts(compiled).values() if lost[part].any()]
    parts.sort(key=lambda part: -growth[part].max())
    places = np.arange(end.size)
    return [(places >= part.start) & (places < part.stop) for part in parts]


def _grown(objective: LeastSquaresObjective, start: Float, end: Float) -> tuple[Bool, Bool]:
    """Mark the values that are far from their start, and those that are farther than its size explains.

    The latter only of small problems: in others, they are rather tables that share a size with a factor, whose fit is
    as good wherever they are, and searches that begin again take long.
    """
    size, grown = np.abs(start), np.abs(end)
    farther: Bool = (size > 0) & (grown > FARTHER * size)
    return grown > FAR * np.maximum(size, 1.0), farther if objective.uses_qr else np.zeros_like(farther)


def _parts(compiled: CompiledProblem) -> dict[str, slice]:
    """Return where the free values of each parameter are."""
    parameters, offsets = compiled.problem.parameters, compiled.values.offsets
    names = compiled.problem.free_names
    return {name: slice(offsets[name], offsets[name] + parameters[name].size) for name in names}


@dataclass(frozen=True)
class Effects:
    """The effects of values on the residuals, and how far they differ: the spectrum of J'J with a diagonal of 1.

    Args:
        sizes: eigenvalues, Float[used].
        directions: eigenvectors in their columns, Float[used, used].
        used: mark the values with an effect, Bool[values].
        units: lengths of the columns of J, Float[values].
    """

    sizes: Float
    directions: Float
    used: Bool
    units: Float

    @classmethod
    def at(cls, objective: LeastSquaresObjective, values: Float) -> "Effects":
        """Compute the effects of values, Float[values]; as if all differed if they are not finite."""
        with ignore_floating_errors():
            if objective.uses_qr:
                matrix: Float = np.asarray(np.linalg.qr(objective.rows(values)[1], mode="r"))
                units = np.linalg.norm(matrix, axis=0)
            else:
                matrix = as_array(objective.normal(values)[1])
                units = np.sqrt(matrix.diagonal())
            used = np.isfinite(units) & (units > 0)
            own = units[used]
            # J'J with a diagonal of 1, or its factor R: what differs is the direction of effects, not their size
            scaled = matrix[:, used] / own if objective.uses_qr else matrix[np.ix_(used, used)] / np.outer(own, own)
        if not np.isfinite(scaled).all():
            return cls(np.zeros(0), np.zeros((units.size, 0)), used | True, units)
        return cls(*(_spectrum_of_triangle if objective.uses_qr else _spectrum)(scaled), used, units)

    def replaceable(self, same: float) -> Bool:
        """Mark values without an effect, or with that of others but for eigenvalues up to `same`, Bool[values]."""
        replaceable = ~self.used
        # changes along these have no effect: a value with a part in one can be replaced by the others
        alike = self.directions[:, self.sizes <= same * self.sizes.max(initial=0.0)]
        replaceable[self.used] = np.sum(np.square(alike), axis=1) > SHARE
        return replaceable

    @property
    def deviations(self) -> Float:
        """Standard deviations of the values by noise of 1, Float[values]; infinite without an effect."""
        deviations = np.full(self.used.size, np.inf)
        # eigenvalues below it are rounding of a singular value
        least = np.square(np.finfo(float).eps) * self.sizes.max(initial=0.0)
        variances = np.sum(np.square(self.directions) / np.maximum(self.sizes, least), axis=1)
        deviations[self.used] = np.sqrt(variances) / self.units[self.used]
        return deviations


def _spectrum_of_triangle(triangle: Float) -> tuple[Float, Float]:
    """Return eigenvalues and eigenvectors of R'R; R may have fewer rows than columns."""
    missing = max(triangle.shape[1] - len(triangle), 0)
    _, singular, directions = np.linalg.svd(np.vstack([triangle, np.zeros((missing, triangle.shape[1]))]))
    return np.square(singular), directions.T


def _spectrum(matrix: Float) -> tuple[Float, Float]:
    """Return eigenvalues and eigenvectors of a symmetric matrix; none if a Cholesky factor shows that all are large."""
    bound = np.abs(matrix).sum(axis=0).max(initial=0.0)  # of the eigenvalues
    try:
        # positive definite with this shift: all eigenvalues are above it, known without a spectrum
        np.linalg.cholesky(matrix - ALIKE * bound * np.eye(len(matrix)))
    except np.linalg.LinAlgError:
        sizes, directions = np.linalg.eigh(matrix)
        return sizes, directions
    return np.zeros(0), np.zeros((len(matrix), 0))
