"""Initial values from which nothing can move: `check` reports them, with values that can."""

import numpy as np
import pytest

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.project import Project


def factor(name, value):
    return Curve(name, Axis([10, 11, 12, 13], input="Load"), np.full(4, value))


@pytest.fixture
def product(shop):
    """A product of two tables."""
    shop.text = "input Speed\ninput Load\nPredict = Gain(Speed) * Other(Load) + offset\n"
    return shop


def start(shop, gain, other):
    table = Curve("Gain", Axis([1000, 2000, 3000], input="Speed"), np.full(3, gain))
    shop.values("start.json", table, factor("Other", other), Scalar("offset", 0.0))


def test_two_factors_of_zero_are_a_warning_with_a_start_that_moves(product):
    start(product, 0.0, 0.0)
    assert product.warning() == (
        "kennfeld.toml [parameters.Gain] initial: the initial value is 0, so the gradient of Other is zero and "
        "no step can change it. Write initial = 1, or all values. By default, a calibration starts at this value."
    )
    product.add("[parameters.Gain]\ninitial = 1")
    assert product.findings() == []


def test_one_factor_of_zero_is_not_a_warning(product):
    start(product, 1.0, 0.0)
    assert product.findings() == []


def test_sections_that_check_prints_for_factors_start_at_one(product):
    product.text = "input Speed\ninput Load\nPredict = Fresh(Speed) * New(Load) + Offset\n"
    findings = [finding for finding in product.findings() if finding.excerpt]
    assert [finding.excerpt.splitlines()[-1] for finding in findings] == [
        "initial = 1.0",
        "initial = 1.0",
        "initial = 0.0",
    ]
    for finding in findings:
        product.add(finding.excerpt.replace("count = 8", "count = 3"))
    project = Project.read(product.path)
    assert project.check() == []
    result = project.calibrate()
    assert result.converged
    assert result.quality[0].rmse_after < 0.5 * result.quality[0].rmse_before


def test_the_advice_for_a_section_without_values_is_a_level_that_moves(product):
    start(product, 1.0, 0.0)
    product.text = "input Speed\ninput Load\nPredict = Gain(Speed) * New(Load) + offset + Last(Load)\n"
    product.add('[parameters.New]\nx = { input = "Load", count = 3 }\n[parameters.Last]\nx = { count = 3 }')
    remedies = [finding.remedy for finding in product.findings() if "no values" in finding.message]
    assert remedies == ["Write initial = 1.0, or all values.", "Write initial = 0.0, or all values."]
