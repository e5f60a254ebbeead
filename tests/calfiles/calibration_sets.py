"""Random parameter sets within what a calibration format can hold."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text

finite = st.floats(allow_nan=False, allow_infinity=False)
_letters = "abcXYZ019_.[]"
names = st.text(_letters, min_size=1, max_size=8).map(lambda rest: "K" + rest)
line_texts = st.text(
    st.characters(min_codepoint=32, exclude_characters="\x7f", exclude_categories=("Cs",)), max_size=12
)
# CVX is cells: blanks around a unit and characters a cell splitter trims are lost.
plain_units = st.sampled_from(["", "rpm", "°C", 'm"s', "kg,h", "%", "-", ":", "*"])
no_texts = st.just("")


def values(*shape):
    return arrays(np.float64, shape, elements=finite)


@st.composite
def breakpoints(draw):
    return np.array(sorted(draw(st.sets(finite, min_size=1, max_size=5))))


@st.composite
def parameter_sets(draw, units=line_texts, descriptions=line_texts, quantities=no_texts, cubes=False, texts=True):
    groups = [
        Axis(draw(breakpoints()), draw(quantities), draw(units), name)
        for name in draw(st.lists(names.map(lambda name: "Axis" + name), unique=True, max_size=2))
    ]
    own_axes = st.builds(Axis, breakpoints(), input=quantities, unit=units)
    axes = st.one_of(own_axes, st.sampled_from(groups)) if groups else own_axes
    makers = [_scalar, _block, _curve, _map, *([_cube] if cubes else [])]
    unique = draw(st.lists(names, unique=True, max_size=6))
    members = [
        draw(st.sampled_from(makers))(draw, name, axes, unit=draw(units), description=draw(descriptions))
        for name in unique
    ]
    kinds = st.sampled_from(["text", "enumeration"])
    findings = [
        Text(f"T{name}", draw(line_texts), draw(descriptions), unit=draw(units), kind=draw(kinds))
        for name in unique[: 2 * texts]
    ]
    return ParameterSet(members, findings, groups)


def _scalar(draw, name, axes, **attributes):
    return Scalar(name, draw(finite), **attributes)


def _block(draw, name, axes, **attributes):
    shape = draw(st.sampled_from([(1,), (7,), (3, 2), (1, 3)]))
    return Block(name, draw(values(*shape)), **attributes)


def _curve(draw, name, axes, **attributes):
    x = draw(axes)
    return Curve(name, x, draw(values(len(x))), **attributes)


def _map(draw, name, axes, **attributes):
    x, y = draw(axes), draw(axes)
    return Map(name, x, y, draw(values(len(x), len(y))), **attributes)


def _cube(draw, name, axes, **attributes):
    axes_drawn = [draw(axes) for _ in range(draw(st.sampled_from([3, 4])))]
    return Cube(name, axes_drawn, draw(values(*map(len, axes_drawn))), **attributes)
