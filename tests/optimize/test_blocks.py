"""Stretches of recordings held out in turn: their bounds, and the sums of each for the linearised problem."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning.holdout_blocks import BLOCKS, FEWEST, NEVER, HoldoutBlocks
from tests.draws import few_or_many

TEXTS = {"memory": "y = PT1(C(x), T)", "none": "y = C(x) * T", "before": "y = C(PT1(x, 0.3)) * T"}


def recording(samples, seed=0, gaps=(), name="drive", timed=True):
    rng = np.random.default_rng(seed)
    wanted = rng.normal(size=samples)
    wanted[list(gaps)] = np.nan
    columns = {"x": rng.uniform(0, 3, samples), "wanted": wanted}
    return kf.Dataset.of(name, columns, time=0.1 * np.arange(samples) if timed else None)


def compiled(*datasets, text="memory", **changes):
    start = kf.ParameterSet([kf.Curve("C", range(4), [0.0, 1, 3, 2]), kf.Scalar("T", 0.7)])
    model = formula(TEXTS[text], parameters=list(start))
    return CompiledProblem(Problem(model, datasets, start, (kf.Criterion("y", "wanted"),), **changes))


@pytest.mark.parametrize("text", TEXTS)
def test_the_parts_add_up_to_the_whole(text):
    data = recording(300, gaps=range(40, 90)), recording(170, 1, name="other")
    problem = compiled(*data, text=text)
    blocks = HoldoutBlocks.of(problem)
    linear_blocks = list(blocks.linearise(problem.start))
    whole = problem.sums.normal(problem.start)
    assert blocks.sizes.size == len(linear_blocks) == BLOCKS
    assert sum(block.share for block in linear_blocks) == pytest.approx(1)
    assert sum(block.misfit for block in linear_blocks) == pytest.approx(problem.sums.cost(problem.start))
    np.testing.assert_allclose(sum(block.gradient for block in linear_blocks), whole.gradient, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sum(block.matrix for block in linear_blocks), whole.matrix, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("text", TEXTS)
def test_a_block_adds_the_sums_of_its_samples(text):
    """The states of a block come from what went before it, although nothing of that is scored."""
    data = recording(200)
    problem = compiled(data, text=text)
    blocks = HoldoutBlocks.of(problem)
    for number, block in list(enumerate(blocks.linearise(problem.start)))[:: BLOCKS // 3]:
        alone = compiled(replace(data, scored=blocks.numbers == number), text=text)
        expected = alone.sums.normal(alone.start)
        assert block.misfit == pytest.approx(alone.sums.cost(alone.start))
        np.testing.assert_allclose(block.gradient, expected.gradient, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(block.matrix, expected.matrix, rtol=1e-9, atol=1e-9)


@few_or_many(st.lists(st.integers(1, 400), min_size=1, max_size=60), st.integers(0, 2**31), few=10, many=60)
def test_every_scored_sample_is_held_out_once_in_blocks_that_do_not_cross_recordings(lengths, seed):
    total = sum(lengths)
    rng = np.random.default_rng(seed)
    wanted = np.where(rng.random(total) < 0.2, np.nan, rng.normal(size=total))
    starts = np.cumsum([0, *lengths[:-1]])
    time = np.concatenate([0.1 * np.arange(length) for length in lengths])
    data = kf.Dataset("d", (kf.Channel("x", rng.uniform(0, 3, total)), kf.Channel("wanted", wanted)), time, starts)
    blocks = HoldoutBlocks.of(compiled(data))
    scored = np.isfinite(wanted)
    if blocks is None:
        filled = sum(scored[a : a + n].any() for a, n in zip(starts, lengths, strict=True))
        assert filled < FEWEST or scored.sum() < BLOCKS
        return
    assert FEWEST <= blocks.sizes.size <= BLOCKS
    assert (blocks.numbers[scored] != NEVER).all()
    assert blocks.sizes.tolist() == np.bincount(blocks.numbers[scored], minlength=blocks.sizes.size).tolist()
    owner = np.repeat(np.arange(len(lengths)), lengths)
    for number in range(blocks.sizes.size):
        mine = np.flatnonzero((blocks.numbers == number) & scored)
        others = scored & (blocks.numbers != number) & (blocks.numbers != NEVER)
        assert not others[mine[0] : mine[-1]].any()
        whole = all((blocks.numbers[scored & (owner == i)] == number).all() for i in set(owner[mine].tolist()))
        assert whole or len(set(owner[mine].tolist())) == 1


def test_steady_points_are_never_held_out():
    steady = recording(50, name="map", timed=False)
    assert HoldoutBlocks.of(compiled(steady, text="none")) is None
    mixed = HoldoutBlocks.of(compiled(steady, recording(200), text="none"))
    assert (mixed.numbers[:50] == NEVER).all()
    assert mixed.sizes.sum() == 200


def test_too_little_data_make_no_blocks():
    assert HoldoutBlocks.of(compiled(recording(2))) is None
    assert HoldoutBlocks.of(compiled(recording(30, gaps=range(1, 30)))) is None
