from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.native.samples import Chunk, Piece, Samples, shares


def samples(*lengths):
    edges = np.cumsum([0, *lengths])
    pieces = tuple(Piece(int(a), int(b), np.ones(1)) for a, b in pairwise(edges))
    return Samples(np.zeros((1, edges[-1])), np.zeros((1, edges[-1])), pieces)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.integers(1, 50))
def test_chunks_cover_every_sample_once_and_never_two_pieces(lengths, length):
    made = samples(*lengths)
    chunks = made.chunks(length)
    assert [c.number for c in chunks] == list(range(len(chunks)))
    assert [k for c in chunks for k in range(c.first, c.last)] == list(range(made.count))
    assert all(0 < c.length <= length for c in chunks)
    for c in chunks:
        assert made.pieces[c.piece].first <= c.first < c.last <= made.pieces[c.piece].last


def test_a_chunk_knows_its_length():
    assert Chunk(number=0, piece=0, first=3, last=10).length == 7


def test_samples_are_contiguous_doubles():
    made = Samples(np.zeros((4, 2), dtype=np.float32).T, np.zeros((3, 4))[:, ::2], ())
    assert made.data.flags.c_contiguous
    assert made.data.dtype == np.float64
    assert made.targets.flags.c_contiguous
    assert made.count == 2


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=40), st.integers(1, 8))
def test_shares_deal_everything_once_in_order(work, count):
    dealt = shares(work, count)
    assert [i for share in dealt for i in share] == list(range(len(work)))
    assert 1 <= len(dealt) <= count
    assert all(len(share) for share in dealt)


@given(st.lists(st.integers(90, 110), min_size=16, max_size=40))
def test_shares_of_like_items_are_about_equal(work):
    loads = [sum(work[i] for i in share) for share in shares(work, 4)]
    assert len(loads) == 4
    assert max(loads) < 2 * min(loads)
