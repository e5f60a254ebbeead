"""Scalars, curves, maps, cubes and sets of them as HTML."""

import numpy as np

from kennfeld.base.formatting import count_noun, size_text
from kennfeld.base.markup import Html, element, full_decimal
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import RBF
from kennfeld.notebook.pictures import heat_map, line_chart
from kennfeld.notebook.tables import block, caption, number_table, text_table

MAX_PICTURE = 60  # breakpoints of an axis; a larger map has a table alone


def with_unit(name: str, unit: str) -> str:
    """Return a name with its unit.

    >>> with_unit("Speed", "rpm"), with_unit("Gain", "-")
    ('Speed [rpm]', 'Gain')
    """
    return name if unit in ("", "-") else f"{name} [{unit}]"


def parameter_html(parameter: Parameter) -> Html:
    """Return a parameter with a picture and its values."""
    kind = parameter.kind if not parameter.axes else f"{parameter.kind}, {size_text(parameter.values.shape)}"
    title = [element("b", parameter.name), f" ({kind})"]
    notes = [caption(parameter.description)] if parameter.description else []
    if not parameter.values.ndim:
        value = f" = {with_unit(full_decimal(float(parameter.values)), parameter.unit)}"
        return block([*title, value], *notes, caption(bounds_text(parameter)))
    return block(title, *notes, *_grid_parts(parameter), caption(bounds_text(parameter)))


def _grid_parts(parameter: Parameter) -> list[Html]:
    if isinstance(parameter, RBF):
        rows = [(parameter.value_name(i), full_decimal(value)) for i, value in enumerate(parameter.values.tolist())]
        labels = parameter.input_labels
        rows += [
            (f"change of the slope in {labels[d]} at {full_decimal(position)}", full_decimal(height))
            for d, position, height in parameter.hinges
        ]
        return [text_table(("value", "number"), rows)]
    axes, values = parameter.index_axes, parameter.values
    titles = [_title(axis, letter) for axis, letter in zip(axes, AXIS_LETTERS, strict=False)]
    if len(axes) == 1:
        table = number_table(values[np.newaxis], [with_unit("value", parameter.unit)], _points(axes[0]), titles[0])
        if len(axes[0]) == 1:
            return [table]
        y_title = with_unit(parameter.name, parameter.unit)
        dots = len(axes[0]) <= MAX_PICTURE
        return [line_chart(axes[0].breakpoints, values, titles[0], y_title, dots=dots), table]
    # the first plane along all further axes
    plane = values.reshape(*values.shape[:2], -1)[:, :, 0]
    note = [
        caption(f"at {title} = {full_decimal(float(axis.breakpoints[0]))}, the first of {len(axis)}")
        for title, axis in zip(titles[2:], axes[2:], strict=True)
    ]
    picture = []
    if parameter.axes and max(plane.shape) <= MAX_PICTURE and min(plane.shape) > 1:
        label = f"{parameter.name} over {titles[0]} and {titles[1]}"
        picture = [heat_map(plane, axes[0].breakpoints, axes[1].breakpoints, titles[0], titles[1], label)]
    corner = f"{titles[0]} \\ {titles[1]}"
    return [*note, *picture, number_table(plane, _points(axes[0]), _points(axes[1]), corner)]


def _title(axis: Axis, letter: str) -> str:
    return with_unit(axis.input or axis.name or letter, axis.unit)


def _points(axis: Axis) -> list[str]:
    return [full_decimal(value) for value in axis.breakpoints.tolist()]


def bounds_text(parameter: Parameter) -> str:
    """Return the bounds and locks of a parameter in words; empty if it has none."""
    parts = []
    if parameter.limited:
        low, high = (np.unique(side) for side in (parameter.lower, parameter.upper))
        same = low.size == high.size == 1
        range_text = f"{full_decimal(float(low[0]))} to {full_decimal(float(high[0]))}"
        parts.append(f"bounds {range_text}" if same else "bounds that differ from value to value")
    locked = int(np.count_nonzero(parameter.locked))
    if locked:
        parts.append(f"{count_noun(locked, 'value')} locked")
    return ", ".join(parts)


def parameter_set_html(parameters: ParameterSet) -> Html:
    """Return a row for each parameter and text."""
    rows = []
    for name, member in parameters.items():
        axes = ", ".join(_title(a, letter) for a, letter in zip(member.axes, AXIS_LETTERS, strict=False))
        rows.append((name, member.kind, size_text(member.values.shape), axes, member.unit, _range(member)))
    rows += [(text.name, text.kind, "", "", text.unit, text.text) for text in parameters.texts]
    heading = ("parameter", "kind", "size", "axes", "unit", "values")
    title = [element("b", "ParameterSet"), f" ({count_noun(len(rows), 'parameter')})"]
    return block(title, text_table(heading, rows, words=5))


def _range(parameter: Parameter) -> str:
    known = parameter.values[np.isfinite(parameter.values)]
    if not known.size:
        return full_decimal(None)
    low, high = full_decimal(float(known.min())), full_decimal(float(known.max()))
    return low if low == high else f"{low} to {high}"
