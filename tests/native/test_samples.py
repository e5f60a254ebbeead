from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.native.samples import Chunk, Piece, Samples, shares
from tests.draws import few_or_many


def samples(*lengths):
    edges = np.cumsum([0, *lengths])
    pieces = tuple(Piece(int(a), int(b), np.ones(1)) for a, b in pairwise(edges))
    return Samples(np.zeros((1, edges[-1])), np.zeros((1, edges[-1])), pieces)


@few_or_many(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.integers(1, 50), few=20, many=100)
def test_chunks_cover_every_sample_once_and_never_two_pieces(lengths, length):
    layout = samples(*lengths)
    chunks = layout.chunks(length)
    assert [c.number for c in chunks] == list(range(len(chunks)))
    assert [k for c in chunks for k in range(c.first, c.last)] == list(range(layout.count))
    assert all(0 < c.length <= length for c in chunks)
    for c in chunks:
        assert layout.pieces[c.piece].first <= c.first < c.last <= layout.pieces[c.piece].last


def test_a_chunk_knows_its_length():
    assert Chunk(number=0, piece=0, first=3, last=10).length == 7


def ordered(order, targets, scores):
    pieces = [Piece(0, len(order), np.array(scores))]
    return Samples(np.zeros((1, len(targets[0]))), np.array(targets), pieces, np.array(order, dtype=np.uint32))


def test_samples_that_are_not_visited_are_not_counted():
    layout = ordered([4, 0, 2], [[0.0, 1.0, np.nan, 3.0, 4.0], [np.nan, 1.0, 2.0, np.nan, np.nan]], [1.0, 1.0])
    assert layout.count == 3
    assert layout.scored(layout.pieces[0]).tolist() == [2, 1]


@given(st.integers(0, 9000), st.integers(1, 9000))
def test_chunks_end_at_the_last_sample_that_counts(last, more):
    targets = np.full((2, last + more), np.nan)
    targets[0, :last], targets[1] = 1.0, 2.0
    layout = Samples(np.zeros((0, last + more)), targets, [Piece(0, last + more, np.array([1.0, 0.0]))])
    assert sum(chunk.length for chunk in layout.chunks(1000)) == last


def test_thinned_samples_are_taken_in_the_order_of_visits():
    x = np.arange(1000.0)
    order = np.random.default_rng(0).permutation(1000).astype(np.uint32)
    layout = Samples([x], [x + 0.5], [Piece(0, 1000, np.array([3.0]))], order).thinned(0.1)
    assert (layout.count, layout.order, layout.pieces[0].scores.tolist()) == (100, None, [30.0])
    visits = np.linspace(0, 999, 100).astype(int)
    assert layout.inputs.take(np.arange(100))[0].tolist() == x[order[visits]].tolist()
    assert layout.targets_of(np.arange(100))[0].tolist() == (x[order[visits]] + 0.5).tolist()


def test_inputs_can_be_picked_and_all_else_stays():
    targets, order = np.zeros((1, 3)), np.array([2, 1], dtype=np.uint32)
    layout = Samples([np.full(3, 1.0), np.full(3, 2.0)], targets, [Piece(0, 2, np.ones(1))], order)
    picked = layout.with_inputs([1])
    assert picked.inputs.take(np.array([0])).tolist() == [[2.0]]
    assert (picked.order is layout.order, picked.count, picked.pieces) == (True, 2, layout.pieces)


@few_or_many(st.lists(st.integers(1, 1000), min_size=1, max_size=40), st.integers(1, 8), few=20, many=100)
def test_shares_deal_everything_once_in_order(work, count):
    dealt = shares(work, count)
    assert [i for share in dealt for i in share] == list(range(len(work)))
    assert 1 <= len(dealt) <= count
    assert all(len(share) for share in dealt)


@few_or_many(st.lists(st.integers(90, 110), min_size=16, max_size=40), few=20, many=100)
def test_shares_of_like_items_are_about_equal(work):
    loads = [sum(work[i] for i in share) for share in shares(work, 4)]
    assert len(loads) == 4
    assert max(loads) < 2 * min(loads)


def test_fewer_pieces_are_spread_evenly_and_weigh_as_much_as_all():
    bench = [Piece(10 * i, 10 * i + 10, np.array([2.0, 1.0])) for i in range(40)]
    other = [Piece(400 + 5 * i, 405 + 5 * i, np.array([0.0, 3.0])) for i in range(3)]
    targets = np.zeros((2, 415))
    targets[0, 300:310] = np.nan  # the first output of piece 30
    fewer = Samples(np.zeros((0, 415)), targets, [*bench, *other]).in_fewer_pieces(0.1, 2)
    assert [piece.first for piece in fewer.pieces] == [0, 130, 250, 300, 390, 400, 410]
    scored = np.array([fewer.scored(piece) for piece in fewer.pieces])
    weights = sum(piece.scores * own for piece, own in zip(fewer.pieces, scored, strict=True))
    assert weights.tolist() == [2.0 * 390, 1.0 * 400 + 3.0 * 15]
    assert fewer.count == 415
