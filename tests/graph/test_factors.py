"""Parameters that would switch off others at 0."""

import pytest

from kennfeld.graph.factors import factors
from kennfeld.models.formula import formula
from kennfeld.project.demo import torque


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("y = A(u) + a * u", set()),
        ("y = A(u) * a", {"A", "a"}),
        ("y = A(u) * (B(v) + a)", {"A", "B", "a"}),
        ("y = A(a * u)", set()),
        ("y = A(u) * -if(v > 0, B(v), a)", {"A", "B", "a"}),
        ("y = u / a + b", {"a"}),
        ("y = single(a + b) * single(A(u))", {"A", "a", "b"}),
        ("y = sqrt(a * u) + b^2", {"a", "b"}),
        ("y = PT1(a * u, T, b)", {"a", "T"}),
        (torque.FORMULA, {"MapOptTorque", "CurveEtaDeltaSpark"}),
    ],
)
def test_factors_are_what_multiplies_or_divides_not_what_is_added_or_looked_up(text, expected):
    names = ("A", "B", "a", "b", "T", "MapOptTorque", "MapOptIgnition", "CurveEtaDeltaSpark", "MapDragTorque")
    used = [name for name in names if name in text]
    assert factors(formula(text, parameters=used).graph) == expected
