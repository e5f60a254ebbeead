"""Losses: one rule for each name, whose influence is that of the loss."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from kennfeld.domain.criteria import ROBUST_LOSSES, Loss
from kennfeld.native.losses import LOSS_RULES
from tests.native.reference import loss

STEP = 1e-6


def test_every_loss_has_a_rule():
    assert tuple(LOSS_RULES) == get_args(Loss)


def test_the_formula_of_every_robust_loss_is_in_the_documents():
    page = Path(__file__).parents[2] / "docs" / "method.md"
    text = page.read_text(encoding="utf-8")
    assert [name for name in ROBUST_LOSSES if f"`{name}`" not in text] == [], "add it to docs/method.md, Cost"


@pytest.mark.parametrize("name", get_args(Loss))
@pytest.mark.parametrize("delta", [0.3, 2.0])
def test_the_influence_is_half_the_slope_of_the_loss(name, delta):
    r = np.array([-50.0, -2.5, -1.0, -0.2, -1e-3, 1e-3, 0.2, 1.0, 2.5, 50.0])
    ratio, slope = LOSS_RULES[name].influence(r, delta)
    assert LOSS_RULES[name].value(r, delta) == pytest.approx(loss(r, name, delta)[0], rel=1e-12)
    above, below = (loss(r + step, name, delta)[0] for step in (STEP, -STEP))
    assert ratio * r == pytest.approx((above - below) / (4 * STEP), rel=1e-4, abs=1e-5)
    beyond = LOSS_RULES[name].influence(r + STEP, delta)[0] * (r + STEP)
    assert slope == pytest.approx((beyond - ratio * r) / STEP, rel=1e-3, abs=1e-5)
