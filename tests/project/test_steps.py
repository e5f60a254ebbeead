"""`[[step]]` of a project file, from its text to the steps that are run."""

import numpy as np
import pytest

from kennfeld.optimize import Step


@pytest.fixture
def shop(shop):
    """The workshop with a map beside its curve."""
    shop.text = (
        "input Speed[rpm]\ninput Load\n"
        "base[Nm] = Gain(Speed) * Load + Table(Speed, Load)\nPredict[Nm] = base + offset\nother = base\n"
    )
    return shop.add(
        "[parameters.Table]\nx = { input = 'Speed', breakpoints = [1000, 1500, 2000, 2500, 3000] }\n"
        "y = { input = 'Load', breakpoints = [10, 11, 12, 13] }\ninitial = 0.0\nsmoothness = 1.0"
    )


def steps(shop, *texts):
    """The steps of a project that has no error."""
    for text in texts:
        shop.add(f"[[step]]\n{text}")
    assert shop.errors() == []
    return shop.project.options.steps


def test_a_project_without_steps_has_none(shop):
    assert shop.project.options.steps == ()


def test_a_step_has_the_values_of_all_keys(shop):
    (step,) = steps(
        shop,
        "name = 'coarse'\nfree = ['Gain', 'Ta*']\nsmoothness = 3\ngrid_reduction = 2\ncriteria = ['Predict']\n"
        "max_iterations = 7\ntolerance = 1e-4\ncontinuation = 'off'\nlock = { Gain = true }",
    )
    assert step == Step(
        name="coarse",
        free=("Gain", "Ta*"),
        lock={"Gain": True},
        smoothness=3,
        grid_reduction=2,
        criteria=("Predict",),
        max_iterations=7,
        tolerance=1e-4,
        continuation="off",
    )


def test_a_step_may_be_empty(shop):
    assert steps(shop, "", "") == (Step(), Step())


def test_numbers_may_be_set_by_parameter_and_axis(shop):
    (step,) = steps(
        shop, "grid_reduction = { Table = { x = 2 }, Gain = 3 }\nsmoothness = { '*' = 1, Table = { x = 1, y = 0.5 } }"
    )
    problem = shop.project.problem()
    assert step.reduction(problem.parameters["Table"]) == (2, 1)
    assert step.reduction(problem.parameters["Gain"]) == (3,)
    assert step.smoothness == {"*": 1.0, "Table": (1.0, 0.5)}


def test_smoothness_may_be_automatic_in_a_step(shop):
    whole, some = steps(
        shop, "smoothness = 'auto'", "grid_reduction = 2\nsmoothness = { Gain = 'auto', Table = { x = 'auto', y = 2 } }"
    )
    assert whole.smoothness == "auto"
    assert some.smoothness == {"Gain": "auto", "Table": ("auto", 2.0)}


def test_an_invalid_smoothness_of_a_step_is_refused(shop):
    shop.add("[[step]]\nsmoothness = { Table = { x = 'automatic' } }")
    assert "[[step]] 1 smoothness Table x: must be a number >= 0 or \"auto\", got 'automatic'" in shop.error()


def test_criteria_may_have_weights_by_node_or_number(shop):
    shop.add("[[criterion]]\nnode = 'other'\ntarget = 3.0")
    first, second = steps(shop, "criteria = { Predict = 0.5, 2 = 1 }", "criteria = [2]")
    assert first.criteria == {"Predict": 0.5, 2: 1.0}
    assert second.criteria == (2,)


def test_locks_are_ranges_of_axis_values_or_values_without_data(shop):
    shop.bench("bench.csv", (1000, 1100, 1200, 1300))
    (step,) = steps(shop, "lock = { Table = [{ x = [1000, 1500], y = [0, 11] }], Gain = 'no-data' }")
    expected = np.zeros((5, 4), bool)
    expected[:2, :2] = True
    assert np.array_equal(step.lock["Table"], expected)
    assert step.lock["Gain"].tolist() == [False, False, True]


def test_a_lock_without_grid_points_is_a_warning(shop):
    shop.add("[[step]]\nlock = { Table = [{ x = [1, 2] }], 'G*' = [{ x = [1000, 1000] }] }")
    assert "[[step]] 1 lock Table: no grid point is in these ranges" in shop.warning()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid_reduction = 0", "[[step]] 1 grid_reduction: must be an integer >= 1, got 0"),
        ("grid_reduction = 1.5", "[[step]] 1 grid_reduction: must be an integer >= 1, got 1.5"),
        (
            "grid_reduction = { Tabel = 2 }",
            "[[step]] 1 grid_reduction: Tabel matches no parameter. Did you mean Table?",
        ),
        ("grid_reduction = { Gain = { y = 2 } }", "grid_reduction Gain: Gain has no axis y. It has x."),
        ("smoothness = -1", "[[step]] 1 smoothness: must be >= 0, got -1"),
        ("smoothness = { Table = { q = 1 } }", "smoothness Table q: unknown key"),
        ("free = ['Gian']", "[[step]] 1 free: Gian matches no parameter that the function uses. Did you mean Gain?"),
        ("free = []", "[[step]] 1 free: no parameter that the function uses is free"),
        ("lock = 'no-data'", "[[step]] 1 lock: must be a table, got 'no-data'. Write lock = { ... }."),
        ("lock = { Gain = 3 }", "[[step]] 1 lock Gain: must be a lock, got 3"),
        ("lock = { Gain = [{ y = [0, 1] }] }", "[[step]] 1 lock Gain: Gain has no axis y"),
        ("lock = { Gian = true }", "[[step]] 1 lock: Gian matches no parameter. Did you mean Gain?"),
        ("criteria = ['Predct']", "there is no criterion for Predct. Did you mean Predict?"),
        ("criteria = [2]", "[[step]] 1 criteria: there is no criterion 2. Use numbers from 1 to 1."),
        ("criteria = [true]", "[[step]] 1 criteria: must name criteria, got [True]"),
        ("criteria = { Predict = 0 }", "[[step]] 1 criteria: no criterion has a weight > 0"),
        ("criteria = { Predict = 'much' }", "[[step]] 1 criteria Predict: must be a number, got 'much'"),
        ("max_iterations = 0", "[[step]] 1 max_iterations: must be an integer >= 1, got 0"),
        ("tolerance = 0", "[[step]] 1 tolerance: must be > 0, got 0"),
        ("continuation = 'on'", "[[step]] 1 continuation: unknown value 'on'"),
        ("grid_reducton = 2", "grid_reducton: unknown key. Did you mean grid_reduction?"),
    ],
)
def test_an_invalid_step_is_one_finding_with_its_location(shop, text, message):
    shop.add(f"[[step]]\n{text}\n[[step]]")
    assert message in shop.error()


def test_findings_have_the_number_of_the_step(shop):
    shop.add("[[step]]\n[[step]]\nfree = ['Gian']\n[[step]]\ncriteria = ['x']")
    first, second = shop.errors()
    assert first.startswith("kennfeld.toml [[step]] 2 free")
    assert second.startswith("kennfeld.toml [[step]] 3 criteria")


def test_a_sequence_that_ends_on_a_coarse_grid_is_a_warning(shop):
    shop.bench("bench.csv", np.linspace(1000, 3000, 40))
    shop.add("[[step]]\n[[step]]\ngrid_reduction = 2")
    assert "[[step]] 2: the last step has a coarse grid; values between its points are interpolated" in shop.warning()


def test_a_calibration_runs_the_steps(shop):
    shop.bench("bench.csv", np.linspace(1000, 3000, 40))
    shop.add("[[step]]\nfree = ['offset']\n[[step]]\nname = 'all'\ngrid_reduction = 2\n[[step]]")
    result = shop.project.calibrate()
    names = list(dict.fromkeys(line.stage.split(":")[0] for line in result.trace))
    assert names[:2] == ["step 1", "all"]
    assert result.quality[0].rmse_after < 1e-3


def test_a_calibration_runs_the_starts(shop):
    shop.bench("bench.csv", np.linspace(1000, 3000, 12))
    shop.add("[optimizer]\nstarts = 2\nseed = 2\nspread = 0.1")
    options = shop.project.options
    assert (options.starts, options.seed, options.spread) == (2, 2, 0.1)
    assert len(shop.project.calibrate(workers=1).starts) == 2
