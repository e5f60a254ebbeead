"""Weights of single samples, as a project file gives them."""

import numpy as np
import pytest

REGIONS = "regions = [{ where = 'n > 1500', weight = 2.0 }, { where = 'Load < 12', weight = 0.5 }]"


def weighted(shop, where="criterion", name="w", **columns):
    """The project with weights by a channel."""
    shop.bench("bench.csv", **({"w": [1, 2, 0, 3, 1, 1]} | columns))
    old = 'target = "Torque"' if where == "criterion" else 'files = ["bench.csv"]'
    return shop.change(old, f'{old}\nweight_channel = "{name}"')


@pytest.mark.parametrize("where", ["criterion", "dataset"])
def test_a_channel_weighs_the_samples(shop, where):
    problem = weighted(shop, where).project.problem()
    named = problem.criteria[0] if where == "criterion" else problem.datasets[0]
    assert named.weight_channel == "w"
    result = shop.project.calibrate()
    error = np.array([1, 1.5, 2, 2.5, 3, 1.2]) - 1
    load = 10.0 + np.arange(6) % 4
    assert result.cost_before == pytest.approx(np.sum([1, 2, 0, 3, 1, 1] * (error * load + 5) ** 2), rel=1e-9)
    assert result.quality[0].samples == 5  # without that of weight 0


def test_a_calculated_channel_weighs_the_samples(shop):
    weighted(shop, name="inverse").add("[calculated]\ninverse = '1 / Load'")
    assert shop.warnings() == []
    assert shop.project.problem().datasets[0]["inverse"].values[0] == 0.1


def test_regions_weigh_the_samples_that_lie_in_them(shop):
    shop.change('target = "Torque"', f'target = "Torque"\n{REGIONS}')
    regions = shop.project.problem().criteria[0].regions
    assert [(region.where, region.weight) for region in regions] == [("n > 1500", 2.0), ("Load < 12", 0.5)]
    assert shop.warnings() == []


def test_a_missing_weight_channel_is_an_error_with_the_nearest(shop):
    assert weighted(shop, name="ww").error() == (
        "kennfeld.toml [[criterion]] 1 weight_channel: dataset bench has no channel ww. Did you mean w?"
    )


def test_a_missing_weight_channel_of_a_dataset_is_an_error(shop):
    assert weighted(shop, "dataset", "ww").error() == (
        "bench.csv: has no channel ww, the weights of its samples. Did you mean w?"
    )


def test_weights_below_zero_are_an_error(shop):
    assert weighted(shop, w=[1, 1, -2, 1, 1, -1]).error() == (
        "kennfeld.toml [[criterion]] 1 weight_channel: 2 weights of w in dataset bench are below 0 or infinite, "
        "the first, -2, at sample 3. Correct them."
    )


def test_missing_weights_are_a_warning(shop):
    assert weighted(shop, w=[1, 1, np.nan, 1, 1, 1]).warning() == (
        "kennfeld.toml [[criterion]] 1 weight_channel: w is NaN in 1 of 6 samples of dataset bench; "
        "these samples get weight 0"
    )


def test_weights_that_are_all_zero_are_an_error(shop):
    assert weighted(shop, w=[0, 0, 0, 0, 0, np.nan]).errors() == [
        "kennfeld.toml [[criterion]] 1: no training sample has a weight above 0. Check its weight channels and regions."
    ]


def test_weights_are_optional_in_test_data(shop):
    weighted(shop)
    shop.bench("fresh.csv", speed=(1100, 1600, 2100, 2600, 2900, 1300))
    shop.add("[[dataset]]\nfiles = 'fresh.csv'\nuse = 'test'")
    assert shop.warnings() == []


@pytest.mark.parametrize(
    ("regions", "error"),
    [
        ("3", "[[criterion]] 1 regions: must be a list of tables. Write regions = ["),
        ("[{ where = 'n > 1' }]", "[[criterion]] 1 region 1 weight: the key is missing."),
        ("[{ weight = 1 }]", "[[criterion]] 1 region 1 where: the key is missing."),
        ("[{ where = 'n > 1', weight = -1 }]", "[[criterion]] 1 region 1 weight: must be >= 0, got -1"),
        ("[{ where = 'n > 1', weihgt = 1, weight = 2 }]", "region 1 weihgt: unknown key"),
        ("[{ where = 'n >', weight = 2 }]", "[[criterion]] 1 region 1"),
        ("[{ where = 'nn > 1', weight = 2 }]", "region 1: dataset bench has no channel nn. Did you mean n?"),
        ("[{ where = 't > 1', weight = 2 }]", "region 1: the condition requires time stamps, but dataset bench has"),
    ],
)
def test_wrong_regions_are_errors(shop, regions, error):
    assert error in shop.change('target = "Torque"', f'target = "Torque"\nregions = {regions}').error()


def test_a_region_without_samples_is_a_warning(shop):
    shop.change('target = "Torque"', 'target = "Torque"\nregions = [{ where = "n > 9000", weight = 2 }]')
    assert shop.warning() == "kennfeld.toml [[criterion]] 1 region 1: n > 9000 is true at no training sample"
