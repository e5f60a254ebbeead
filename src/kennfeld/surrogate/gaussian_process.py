"""Static Gaussian process: a kernel with a length scale per input, linear mean, estimated noise.

For comparison with scikit-learn, whose regressor has a constant mean, no sparse approximation and no leave-one-out
residuals, see `docs/benchmarks.md`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion, Hinge, Kernel, evaluate_hinges
from kennfeld.surrogate.exact_gp import Exact
from kennfeld.surrogate.gp_kernel import JITTER, Plane, greedy_centres
from kennfeld.surrogate.hinge_selection import select_hinges
from kennfeld.surrogate.hyperparameters import Hyperparameters, exact_hyperparameters, sparse_hyperparameters
from kennfeld.surrogate.outliers import far_inputs, gross_errors
from kennfeld.surrogate.sparse_gp import Sparse
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.student_noise import FREEDOM, student_gain, student_scale
from kennfeld.surrogate.training_data import Scaling, check_points
from kennfeld.surrogate.training_points import TrainingPoints
from kennfeld.surrogate.uncertainty import Deviation, Uncertainty, calibrated
from kennfeld.surrogate.validity import Validity

Method = Literal["auto", "exact", "sparse"]
KernelChoice = Literal["auto", "gaussian", "matern52"]
NoiseChoice = Literal["auto", "gaussian", "student"]

MOST_EXACT = 1000
MOST_FORCED = 10_000  # the kernel matrix takes 0.8 GB there
CENTRES = 300  # of a sparse process, unless the number is given
WORTH = 0.99  # a process stays if its left-out residuals are at most this share of the plane's
MORE_NOISE = (10.0, 10.0)  # factors by which the noise of a recording is increased, one after the other
CERTAIN = 6.0  # deviations from the model trained without it, beyond which a value is an error
WIDE = 4.0  # deviations beyond which residuals belong to the tails
LIKELIER = 0.25  # least gain of log-likelihood per row for which Student noise is taken
PROMISING = 0.5  # share of that gain from which the length scales for Student noise are searched
REWEIGHTED = 3  # times
CALIBRATED = 5000  # points that the deviation is calibrated on
GROUPS = 10  # of points that are left out together while hinges are selected
HOPELESS = 1.5  # times the residuals of the process, beyond which those of a kinked plane rule out kinks
SIGNIFICANT = 2.0  # standard errors by which squared residuals must be smaller for hinges to be kept


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """The mean of a trained process, the range it is valid in, and its residuals; all in physical units.

    Attributes:
        expansion: the mean; a plane, perhaps with hinges, without centres if the process is not better.
        validity: the neighbourhood of the training points.
        uncertainty: the predictive deviation.
        left_out: residual at each row of the training data, Float[rows], without its point or block, in closed form.
            Length scales and noise, and the inducing inputs of a sparse process, are those of all points.
        plane: the plane of least squares through the same points.
        plane_left_out: its residuals, each without its point or block.
        outliers: rows that were not used because of a gross error, Bool[rows].
        hyperparameters: of the process; None of a plane.
        tried: those of the best process, even if the plane is better.
        repeated: number of rows that repeat the inputs of another one.
        remarks: sentences on the training for the user.
    """

    expansion: Expansion
    validity: Validity
    uncertainty: Uncertainty
    left_out: Float
    plane: Expansion
    plane_left_out: Float
    outliers: Bool
    hyperparameters: Hyperparameters | None
    tried: Hyperparameters
    repeated: int
    remarks: tuple[str, ...]


def gaussian_process(
    x: Float,
    y: Float,
    *,
    method: Method = "auto",
    kernel: KernelChoice = "auto",
    noise: NoiseChoice = "auto",
    centres: int | None = None,
    starts: int = 3,
    seed: int = 0,
    names: Sequence[str] = (),
    blocks: Int | None = None,
    kinks: bool = True,
    stopped: Stopped = never,
) -> GaussianProcess:
    """Train a process on points `x` Float[points, inputs] and values `y` Float[points], in physical units.

    `method` "auto" is exact up to 1000 points, unless fewer `centres` are given, and else sparse with `centres`
    inducing inputs, by default 300, chosen greedily by variance. Length scales of a sparse process are searched on at
    most 2000 points, its noise on all; `seed` draws these points and some of the `starts` of the search.

    The kernel is the one with the smaller residuals of points left out; a plane is returned if these are not smaller
    than the plane's. With `kinks`, the plane gets hinges if that makes them smaller by more than chance. Noise is
    normal or, if that is more likely for residuals of points left out, Student's. Points of the same number in `blocks`
    Int[points], stretches of recordings, are left out together; their noise is normal unless Student's is asked for:
    neighbouring errors are alike, so that a stretch in which the model is wrong would pass for a tail. `names` of the
    inputs appear in messages.

    Once `stopped` returns true, the search ends at the best so far. Raises `ArgumentError` if the points cannot be
    used.

    >>> import numpy as np
    >>> x = np.linspace(0, 6, 40)[:, None]
    >>> process = gaussian_process(x, np.sin(x[:, 0]))
    >>> bool(abs(process.expansion(np.array([2.05])) - np.sin(2.05)) < 1e-3)
    True
    """
    rows, values = check_points(x, y, names)
    _check_choices(method, kernel, noise, centres)
    far = far_inputs(rows)
    # suspects are left out of the search, and taken back below unless the model trained without them rejects them
    outliers = far | _suspects(rows, values, ~far)
    if outliers.any():
        check_points(rows[~outliers], values[~outliers], names)
    setup = _TrainingSetup(rows, values, ~outliers, method, centres, seed)
    training = _Training(setup)
    if method == "exact" and len(training.points) > MOST_FORCED:
        raise ArgumentError(f"an exact Gaussian process takes at most {MOST_FORCED} points, not {len(training.points)}")
    kernels: tuple[Kernel, ...] = get_args(Kernel) if kernel == "auto" else (kernel,)
    candidates = training.search(kernels, starts, stopped)
    # a value that a steep function explains is a suspect by its neighbours, but near to the model
    wrong = far | (outliers & training.is_certain(candidates, blocks))
    if np.any(wrong != outliers):
        training = _Training(replace(setup, used=~wrong))
    process = training.choose(candidates, blocks, wrong)
    if kinks and not stopped():
        training, process = training.with_hinges(process, blocks, stopped)
    if noise == "gaussian" or (noise == "auto" and blocks is not None) or stopped():
        return process
    return training.with_student_noise(process, blocks, starts, forced=noise == "student", stopped=stopped)


def _check_choices(method: str, kernel: str, noise: str, centres: int | None) -> None:
    if method not in ("auto", "exact", "sparse"):
        raise ArgumentError(f"method={method!r} of a Gaussian process must be auto, exact or sparse")
    if kernel not in get_args(KernelChoice):
        raise ArgumentError(f"kernel={kernel!r} of a Gaussian process must be {' or '.join(get_args(KernelChoice))}")
    if noise not in get_args(NoiseChoice):
        raise ArgumentError(f"noise={noise!r} of a Gaussian process must be {' or '.join(get_args(NoiseChoice))}")
    if centres is not None and centres < 1:
        raise ArgumentError(f"centres={centres} of a Gaussian process must be at least 1")


def _suspects(x: Float, y: Float, among: Bool) -> Bool:
    """Return the rows among some whose values may have gross errors, Bool[rows]."""
    suspects = np.zeros(len(y), dtype=bool)
    rest = np.flatnonzero(among)
    spread = x[rest].std(0)
    suspects[rest] = gross_errors((x[rest] - x[rest].mean(0)) / np.where(spread > 0, spread, 1.0), y[rest])
    return suspects


@dataclass(frozen=True, eq=False)
class _TrainingSetup:
    """The data and the settings of a training, in physical units.

    Attributes:
        x: Float[rows, inputs].
        y: Float[rows], as measured.
        used: the rows that count, Bool[rows].
        method: exact or sparse.
        centres: number of inducing inputs, None by default.
        seed: of random draws.
        weights: of the rows, Float[rows]; None if all are equal.
        hinges: kinks of the plane, subtracted from `y`.
    """

    x: Float
    y: Float
    used: Bool
    method: Method
    centres: int | None
    seed: int
    weights: Float | None = None
    hinges: tuple[Hinge, ...] = ()


class _Training:
    """Rows that are used for training, scaled and merged, and the processes over them."""

    def __init__(self, setup: _TrainingSetup) -> None:
        self.setup, self.x, self.used, self.seed = setup, setup.x, setup.used, setup.seed
        self.y = setup.y - evaluate_hinges(setup.hinges, setup.x)
        self.scaling = Scaling.of(self.x[self.used], self.y[self.used])
        target = (self.y[self.used] - self.scaling.level) / self.scaling.height
        shares = None if setup.weights is None else setup.weights[self.used]
        self.points = TrainingPoints.of(self.scaling.inward(self.x[self.used]), target, shares)
        most = MOST_EXACT if setup.centres is None else min(setup.centres, MOST_EXACT)
        self.exact = setup.method == "exact" or (setup.method == "auto" and len(self.points) <= most)
        self.centres = setup.centres or CENTRES

    def search(
        self, kernels: Sequence[Kernel], starts: int, stopped: Stopped, near: Hyperparameters | None = None
    ) -> list[Hyperparameters]:
        """Return the best length scales and noise of each kernel; those of the first are a start of the next."""
        candidates: list[Hyperparameters] = []
        for kernel in kernels:
            near = candidates[0] if candidates else near
            if near and stopped():
                break
            if self.exact:
                best = exact_hyperparameters(self.points, kernel, starts, self.seed, stopped=stopped, near=near)
            else:
                best = sparse_hyperparameters(
                    self.points, kernel, self.centres, starts, self.seed, stopped=stopped, near=near
                )
            candidates.append(best)
        return candidates

    def process(self, at: Hyperparameters) -> Exact | Sparse:
        """Return the process over all points."""
        if self.exact:
            return Exact.at(self.points, at.lengths, at.noise, at.kernel)
        z = greedy_centres(self.points.x, self.centres, at.lengths, self.seed, kernel=at.kernel)
        return Sparse.at(self.points, z, at.lengths, at.noise, at.kernel)

    def is_certain(self, candidates: Sequence[Hyperparameters], blocks: Int | None) -> Bool:
        """Mark the rows whose value is far from the model that was trained without them, Bool[rows]."""
        if self.used.all():
            return np.zeros(len(self.y), dtype=bool)
        best = self.choose(candidates, blocks, ~self.used)
        deviation = Deviation(best.expansion, best.uncertainty)(self.x)
        certain: Bool = np.abs(best.expansion(self.x) - self.y) > CERTAIN * deviation
        return certain

    def with_student_noise(
        self, normal: GaussianProcess, blocks: Int | None, starts: int, *, forced: bool, stopped: Stopped
    ) -> GaussianProcess:
        """Return the process with Student noise, if that is clearly more likely for residuals of points left out.

        The noise of a row is normal with a variance that is drawn; its mean weight, given the residual r of the row
        left out, is (nu + 1) / (nu + (r / sigma)^2): K. L. Lange, R. J. A. Little, J. M. G. Taylor: Robust statistical
        modeling using the t distribution, 1989.
        """
        at, robust, before = normal.tried, normal, normal.left_out[self.used]
        sigma = student_scale(before)
        # on the same residuals a gain costs no training: without one, tails are not wide
        if sigma == 0 or not (forced or student_gain(before, before) > 0):
            return normal
        for round_ in range(REWEIGHTED):
            weights = (FREEDOM + 1) / (FREEDOM + (np.nan_to_num(robust.left_out) / sigma) ** 2)
            training = _Training(replace(self.setup, weights=weights))
            # a new search of length scales is by far the most expensive step: last, and only if it may pay
            if round_ == REWEIGHTED - 1:
                gain = student_gain(before, robust.left_out[self.used])
                if not forced and gain < PROMISING * LIKELIER:
                    return normal
                at = training.search((at.kernel,), starts, stopped, at)[0]
            robust = training.choose([at], blocks, normal.outliers)
            sigma = student_scale(robust.left_out[self.used]) or sigma
        after = robust.left_out[self.used]
        if robust.hyperparameters is None or not (forced or _is_likelier(before, after)):
            return normal
        remarks = (*robust.remarks, "the noise has wide tails; large errors count less")
        return replace(robust, plane=normal.plane, plane_left_out=normal.plane_left_out, remarks=remarks)

    def with_hinges(
        self, smooth: GaussianProcess, blocks: Int | None, stopped: Stopped
    ) -> "tuple[_Training, GaussianProcess]":
        """Return the process about a plane with kinks, if it is better on points left out by more than chance."""
        together = self._together(blocks)
        groups = self._groups() if together is None else together
        choice = select_hinges(self.points, groups)
        straight = self._by_row(_plane_left_out(self.points, groups))
        bent = self._by_row(choice.left_out)
        if not choice.hinges or not self._is_better(straight, bent, blocks):
            return self, smooth
        # ahead of a search of length scales about the kinked plane, which kinks that explain too little do not pay for
        if np.nanmean(bent**2) > HOPELESS**2 * np.nanmean(smooth.left_out**2):
            return self, smooth
        hinges = self.scaling.outward(choice.hinges)
        kinked = _Training(replace(self.setup, hinges=hinges))
        process = kinked.choose(kinked.search((smooth.tried.kernel,), 1, stopped), blocks, smooth.outliers)
        if process.hyperparameters is None:
            process = replace(process, left_out=bent)  # for which hinges were selected anew
        if not self._is_better(smooth.left_out, process.left_out, blocks):
            return self, smooth
        return kinked, replace(process, plane=smooth.plane, plane_left_out=smooth.plane_left_out)

    def _groups(self) -> list[Int]:
        """Return points that are drawn into a few groups."""
        order = np.random.default_rng(self.seed).permutation(len(self.points))
        return np.array_split(order, min(GROUPS, len(order)))

    def _is_better(self, before: Float, after: Float, blocks: Int | None) -> bool:
        """Return if the squares of residuals Float[rows] are smaller by more than chance, by points or blocks."""
        # paired: the difference at each point scatters less than the two sums
        gain: Float = (before**2 - after**2)[self.used]
        if blocks is not None:
            own = blocks[self.used]
            gain = np.bincount(own, gain).astype(np.float64)[np.unique(own)]
        scatter = np.sqrt(gain.size) * float(gain.std(ddof=1)) if gain.size > 1 else np.inf
        is_worth = np.nanmean(after**2) <= WORTH**2 * np.nanmean(before**2)
        return bool(is_worth and gain.sum() > SIGNIFICANT * scatter)

    def choose(self, candidates: Sequence[Hyperparameters], blocks: Int | None, outliers: Bool) -> GaussianProcess:
        """Choose the process, or the plane, with the smallest residuals of points or blocks left out."""
        together = self._together(blocks)
        plane = _plane_left_out(self.points, together)
        processes = [self.process(at) for at in candidates]
        residuals = [process.left_out(together) for process in processes]
        best = int(np.argmin([self._rmse(residual) for residual in residuals]))
        process, residual = processes[best], residuals[best]
        if together is not None:
            process, residual = self._smoothed(process, residual, together)
        # so that NaN is a plane, too
        is_plane = not self._rmse(residual) <= WORTH * self._rmse(plane)
        residual = self._by_row(plane if is_plane else residual)
        flat = _plane_through(self.points, self.scaling)
        expansion = flat
        if not is_plane:
            expansion = self.scaling.expansion(*process.terms(), process.lengths, process.kernel)
        return GaussianProcess(
            replace(expansion, hinges=self.setup.hinges),
            Validity.around(self.x[self.used], self.scaling.spread * process.lengths, self.seed),
            self._uncertainty(process, expansion, residual[self.used]),
            residual,
            flat,
            self._by_row(plane),
            outliers,
            None if is_plane else candidates[best],
            candidates[best],
            int(self.used.sum()) - len(self.points),
            (*self._remarks(), *_remarks(candidates[best], is_plane)),
        )

    def _remarks(self) -> Iterator[str]:
        centres = self.setup.centres
        if self.exact and centres is not None and centres < len(self.points):
            yield f"centres = {centres} is not used: an exact Gaussian process has one per point, {len(self.points)}"

    def _smoothed(
        self, process: Exact | Sparse, residual: Float, together: Sequence[Int]
    ) -> tuple[Exact | Sparse, Float]:
        """Return the process with more noise as long as residuals of blocks left out become smaller, and these.

        Errors of neighbouring samples of a recording are alike, so that it tells less on the function than as many
        points with independent errors would, for which the likelihood is.
        """
        for factor in MORE_NOISE:
            noise = process.noise * factor
            trial: Exact | Sparse
            if isinstance(process, Exact):
                trial = Exact.at(self.points, process.lengths, noise, process.kernel)
            else:
                # refine would move the noise back to where the likelihood is highest
                trial = Sparse.at(self.points, process.z, process.lengths, noise, process.kernel, refine=False)
            changed = trial.left_out(together)
            if self._rmse(changed) >= self._rmse(residual):
                break
            process, residual = trial, changed
        return process, residual

    def _together(self, blocks: Int | None) -> list[Int] | None:
        """Return the points of each block; a point of several rows is in the block of the first of them."""
        if blocks is None:
            return None
        first = np.unique(self.points.point, return_index=True)[1]
        block = blocks[self.used][first]
        return [np.flatnonzero(block == number) for number in np.unique(block)]

    def _rmse(self, residual: Float) -> float:
        """Return the weighted RMSE over the rows of points, given the residuals of their means."""
        weights = self.points.weights
        squares = weights * residual**2 + self.points.scatter
        return float(np.sqrt(squares.sum() / weights.sum()))

    def _by_row(self, residual: Float) -> Float:
        """Return residuals of points at each row, in physical units; NaN at rows that are not used."""
        by_row = np.full(len(self.y), np.nan)
        target = (self.y[self.used] - self.scaling.level) / self.scaling.height
        point = self.points.point
        by_row[self.used] = self.scaling.height * (target - self.points.y[point] + residual[point])
        return by_row

    def _uncertainty(self, process: Exact | Sparse, expansion: Expansion, residual: Float) -> Uncertainty:
        signal = self.scaling.height * np.sqrt(process.variance)
        nugget = np.full(expansion.size, JITTER)
        noise = float(signal * np.sqrt(process.noise))
        if not expansion.size:
            # of a plane: all of its residual is noise
            signal, noise = 0.0, float(np.sqrt(np.mean(residual**2)))
        elif isinstance(process, Exact):
            # every point is a centre, with the noise of its own weight
            nugget = np.maximum(process.noise / process.points.weights, JITTER)
        some = np.arange(len(residual))
        if len(some) > CALIBRATED:
            some = np.sort(np.random.default_rng(self.seed).choice(len(some), CALIBRATED, replace=False))
        return calibrated(Uncertainty(float(signal), noise, nugget), expansion, self.x[self.used][some], residual[some])


def _is_likelier(before: Float, after: Float) -> bool:
    """Return if Student noise is clearly more likely for residuals left out, and nothing predicts its tails.

    Residuals Float[rows] are `before` of normal and `after` of Student noise. A share p of wild values that nothing
    predicts raises the squares by 1 / (1 - p) at most if the process no longer follows them.
    """
    wild = float(np.mean(np.abs(after) > WIDE * student_scale(after)))
    predicted = (1 - wild) * np.mean(after**2) > np.mean(before**2) / WORTH
    return bool(not predicted and student_gain(before, after) > LIKELIER)


def _plane_through(points: TrainingPoints, scaling: Scaling) -> Expansion:
    """Return the plane of least squares through points in units of `scaling`."""
    plane = Plane.over(points.x, points.weights)
    flat = plane.back @ (plane.basis.T @ (points.y * np.sqrt(points.weights)))
    none = np.empty((0, points.x.shape[1]))
    return scaling.expansion(float(flat[0]), flat[1:], np.empty(0), none, np.ones(points.x.shape[1]))


def _plane_left_out(points: TrainingPoints, blocks: Sequence[Int] | None) -> Float:
    """Return the residual of the plane at each point, trained without it or its block, in units of spread."""
    plane = Plane.over(points.x, points.weights)
    roots = np.sqrt(points.weights)
    rest = plane.without(points.y * roots)
    # leave-one-out of a linear smoother H = QQ': r_i / (1 - H_ii); for blocks (I - H_BB)^-1 r_B
    residual: Float = rest / np.maximum(1 - np.einsum("ij,ij->i", plane.basis, plane.basis), 1e-12)
    for block in blocks or ():
        own = plane.basis[block]
        # Woodbury: a system of the size of the plane's rank instead of the block's
        inside = np.eye(plane.rank) * (1 + 1e-12) - own.T @ own
        residual[block] = rest[block] + own @ np.linalg.solve(inside, own.T @ rest[block])
    residual /= roots
    return residual


def _remarks(at: Hyperparameters, is_plane: bool) -> list[str]:
    """Return sentences on a process that is not better than the plane, or whose length scales ended at a limit."""
    remarks = []
    if is_plane:
        remarks.append("the Gaussian process is not better than the plane on points left out; the model is the plane")
    if at.at_limit == "upper" and not is_plane:
        remarks.append("all length scales ended at their upper limit: the model is nearly the plane")
    if at.at_limit == "lower" and not is_plane:
        remarks.append(
            "a length scale ended at its lower limit, 0.02 of the spread of its input: the output changes between "
            "neighbouring points, or an input is missing"
        )
    return remarks
