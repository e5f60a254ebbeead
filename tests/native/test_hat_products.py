"""Products of rows with hat functions, straight from the entries and carried through the rows, are those of numpy."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.missing.candidate_columns import CandidateColumns
from kennfeld.analysis.missing.candidate_shares import RowShare, SparseShare
from kennfeld.analysis.missing.families import HatAxis, channel_families
from kennfeld.analysis.missing.probes import Nodes, Probes, is_probe
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.sums.compiled import CompiledProblem


@pytest.mark.parametrize("share_type", [SparseShare, RowShare])
def test_the_sums_are_products_of_whole_columns(share_type):
    rng = np.random.default_rng(0)
    data = {name: rng.uniform(-1, 1, 200) for name in ("x", "z", "m")}
    curve = kf.Curve("C", [-1, 0, 1], [0.5, 1.0, 3.0])
    problem = ProblemSetup("a = C(x)\ny = a * exp(z)", data, {"C": curve}, "m", node="y").problem()
    nodes = Nodes.of(problem)
    probes = Probes.of(problem, nodes.names)
    compiled = CompiledProblem(probes.problem)
    axes = [HatAxis("z", "z", (-1.0, 0.2, 1.0)), HatAxis("x", "x", (-0.5, 0.5))]
    [family] = channel_families(probes, axes, ("add", "multiply"), nodes.constant, compiled.values.free)
    [samples] = CandidateColumns.of_all(compiled, [family], {}, 0)
    shares = {}

    def visit(share, space, chunk, begins):
        shares.setdefault(share, share_type(samples)).add(space, chunk, begins, None)

    compiled.sums.each_tape(compiled.start, visit)
    sums = shares[0].sums()
    for share in list(shares.values())[1:]:
        sums.merge(share.sums())
    residual, jacobian = compiled.sums.rows(compiled.start)
    order = samples.numbers
    columns = []
    for axis in axes:
        hats = np.array([np.interp(data[axis.channel], axis.points, row) for row in np.eye(len(axis.points))])[:, order]
        slopes = jacobian[:, samples.probes]
        columns += [hats[hat] * slopes[:, at] for hat in range(len(axis.points)) for at in range(len(family.factors))]
    wanted = [at for name, at in compiled.values.offsets.items() if not is_probe(name)]
    B = np.array(columns).T
    rows = slice(wanted[0], wanted[0] + 3)
    np.testing.assert_allclose(sums.jb[rows], (jacobian.T @ B)[rows], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(sums.br.sum(axis=0), residual @ B, rtol=1e-12, atol=1e-12)
    first = np.arange(3) * len(family.factors)
    np.testing.assert_allclose(sums.squares[0][0].sum(axis=0), (B.T @ B)[np.ix_(first, first)], rtol=1e-12, atol=1e-12)
