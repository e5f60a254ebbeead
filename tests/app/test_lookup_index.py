"""Lookups sorted by cell, beside a search through all of them."""

import numpy as np
import pytest

from kennfeld.app.session.lookup_index import LookupIndex
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import parameter
from kennfeld.graph.interpolation import position
from kennfeld.optimize.quality.lookup_coverage import Lookup

SAMPLES = 400


def lookups(table, seed):
    """Two lookups over the same samples in two blocks; some coordinates are missing, some beyond the ends."""
    rng = np.random.default_rng(seed)
    for first, count in [(0, 250), (250, SAMPLES - 250)] * 2:
        coordinates = [rng.uniform(axis.breakpoints[0] - 1, axis.breakpoints[-1] + 1, count) for axis in table.axes]
        places = [position(x, axis.breakpoints, "linear") for x, axis in zip(coordinates, table.axes, strict=True)]
        cells = [np.clip(p.astype(int), 0, max(len(axis) - 2, 0)) for p, axis in zip(places, table.axes, strict=True)]
        shares = [place - cell for place, cell in zip(places, cells, strict=True)]
        yield Lookup(table, first, rng.random(count) < 0.9, tuple(cells), tuple(shares))


@pytest.mark.parametrize("shape", [(5,), (1,), (4, 3), (1, 3), (3, 2, 4)])
def test_lookups_near_a_value_are_those_of_a_search_through_all(shape):
    axes = [Axis(np.cumsum(np.arange(1.0, count + 1)), name) for count, name in zip(shape, "xyz", strict=False)]
    table = parameter("Table", np.zeros(shape), axes, extrapolation="linear")
    index = LookupIndex(table, lookups(table, 3))
    for value in range(table.size):
        expected = np.zeros(SAMPLES)
        for lookup in lookups(table, 3):
            for at, share in lookup.corners:
                weights = np.where(at == value, share, 0.0)
                np.maximum(expected[lookup.samples], weights, out=expected[lookup.samples])
        np.testing.assert_allclose(index.weights(value, SAMPLES), expected, atol=2e-6)


def test_lookups_near_a_value_have_their_coordinates_and_weights():
    table = parameter("Curve", np.zeros(3), [Axis([0.0, 1.0, 3.0], "x")])
    lookup = Lookup(table, 10, np.array([True, False, True]), (np.array([0, 0, 1]),), (np.array([0.25, 0.5, 0.5]),))
    samples, coordinates, weights = LookupIndex(table, [lookup]).near(1, 1)
    assert samples.tolist() == [10, 12]
    np.testing.assert_allclose(coordinates, [[0.25, 2.0]])
    np.testing.assert_allclose(weights, [0.25, 0.5])


def test_a_table_without_lookups_has_no_lookups_near_a_value():
    samples, coordinates, weights = LookupIndex(parameter("Gain", 2.0), []).near(0, 1)
    assert (samples.size, coordinates.shape, weights.size) == (0, (0, 0), 0)


@pytest.mark.parametrize("shape", [(5,), (1,), (4, 3), (1, 3), (3, 2, 4)])
def test_sums_at_grid_points_are_those_over_all_lookups(shape):
    axes = [Axis(np.cumsum(np.arange(1.0, count + 1)), name) for count, name in zip(shape, "xyz", strict=False)]
    table = parameter("Table", np.zeros(shape), axes)
    values = np.random.default_rng(1).normal(size=SAMPLES)
    values[::7] = np.nan

    def clipped():
        for lookup in lookups(table, 5):
            shares = tuple(np.clip(share, 0.0, 1.0) for share in lookup.shares)
            yield Lookup(table, lookup.first, lookup.known, lookup.cells, shares)

    weighted, weight = np.zeros(table.size), np.zeros(table.size)
    for lookup in clipped():
        own = values[lookup.samples]
        for at, share in lookup.corners:
            share = np.where(np.isfinite(own), share, 0.0)
            weighted += np.bincount(at, share * np.nan_to_num(own), minlength=table.size)
            weight += np.bincount(at, share, minlength=table.size)
    sums = LookupIndex(table, clipped()).sums(values)
    np.testing.assert_allclose(sums[0], weighted, atol=1e-4)
    np.testing.assert_allclose(sums[1], weight, atol=1e-4)


def test_places_are_coordinates_of_lookups():
    table = parameter("Curve", np.zeros(3), [Axis([0.0, 1.0, 3.0], "x")])
    lookup = Lookup(table, 0, np.array([True, False, True]), (np.array([0, 0, 1]),), (np.array([0.25, 0.5, 0.5]),))
    np.testing.assert_allclose(LookupIndex(table, [lookup]).places(10), [[0.25, 2.0]])
    assert LookupIndex(table, [lookup]).places(1).shape == (1, 1)
