"""Several tasks of an application at once, simulated like loops in Python."""

import json

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.calfiles import read
from kennfeld.importers.ascet.importing import esdl, import_esdl
from kennfeld.models.formula import read as read_formula
from tests.importers.ascet.esdl_projects import TASKS, run, write_project


@pytest.fixture
def application(tmp_path):
    return write_project(tmp_path, TASKS) / "Plant/Plant.app"


def by_hand(demand, fine=1):
    """Messages after each step of 10 ms / `fine`: fast before slow before late, each when it is due."""
    fast, slow, late, twice, rows = 1.0, 2.0, 0.0, 0.0, []
    for step, now in enumerate(demand):
        if step % fine == 0:
            fast += (3.0 * now - slow + demand[0]) * 0.01
        if step % (3 * fine) == 0:
            slow += 0.25 * (fast - slow) + 0.03
        if step >= 2 * fine and (step - 2 * fine) % (4 * fine) == 0:
            late += fast + 0.04
            twice = 2.0 * fast
        rows.append((fast, slow, late, twice))
    return np.array(rows).T


DEMAND = np.sin(np.arange(90) / 7.0) + 0.5


def test_each_task_runs_at_its_period_in_the_order_of_priorities(application):
    model = esdl(application, task="*")
    assert model.step == 0.01
    assert set(model.graph.inputs) == {"demand"}
    nodes = run(model, {"demand": DEMAND})
    for name, values in zip(("fast", "slow", "late", "twice"), by_hand(DEMAND), strict=True):
        np.testing.assert_allclose(nodes[name], values, rtol=1e-12)


def test_a_finer_step_runs_the_tasks_at_the_same_times(application):
    model = esdl(application, task="*", step=0.002)
    demand = np.sin(np.arange(300) / 20.0)
    nodes = run(model, {"demand": demand})
    for name, values in zip(("fast", "slow", "late", "twice"), by_hand(demand, 5), strict=True):
        np.testing.assert_allclose(nodes[name], values, rtol=1e-12)


def test_messages_of_tasks_that_are_left_out_are_inputs(application):
    model = esdl(application, task=["Late", "Slow_30ms"])
    assert "fast" in model.graph.inputs
    assert model.step == 0.01
    report = import_esdl(application, task=["Late", "Slow_30ms"]).report
    assert [(task.name, task.period, task.delay) for task in report.tasks] == [
        ("Slow_30ms", 0.03, 0.0),
        ("Late", 0.04, 0.02),
    ]
    assert any("none interrupts another: Slow_30ms, Late" in str(remark) for remark in report.remarks)


def test_tasks_without_a_period_are_left_out_with_a_remark(application):
    remarks = [str(remark) for remark in import_esdl(application, task="*").report.remarks]
    assert "the task Key has no period and is left out" in remarks


def test_one_task_of_a_list_is_that_task(application):
    assert esdl(application, task=["Fast_10ms"]).graph == esdl(application, task="Fast_10ms").graph


def test_methods_of_one_class_run_in_their_tasks(application):
    model = esdl(application.parent / "Car/Fast.esdl", task="*")
    assert model.step == 0.01
    nodes = run(model, {"demand": DEMAND, "slow": np.full(90, 2.0)})
    fast = 1.0 + np.cumsum((3.0 * DEMAND - 2.0 + DEMAND[0]) * 0.01)
    np.testing.assert_allclose(nodes["fast"], fast, rtol=1e-12)
    late = np.cumsum(np.where(np.arange(90) % 4 == 2, fast + 0.04, 0.0))
    np.testing.assert_allclose(nodes["late"], late, rtol=1e-12)


def test_formula_text_of_several_tasks_gives_the_same_results(application, tmp_path):
    target = tmp_path / "plant.kf"
    assert cli.run(["convert", str(application), str(target), "--task", "Fast_10ms", "--task", "Slow_30ms"]) == 0
    model, again = esdl(application, task=["Fast_10ms", "Slow_30ms"]), read_formula(target)
    first = run(model, {"demand": DEMAND})
    second = run(again, {"demand": DEMAND}, parameters=read(target.with_suffix(".json")))
    np.testing.assert_array_equal(first["slow"], second["slow"])


def test_a_step_on_the_command_line_replaces_that_of_the_tasks(application, tmp_path, capsys):
    target = tmp_path / "plant.kf"
    tasks = ["--task", "Fast_10ms", "--task", "Slow_30ms", "--step", "0.005"]
    assert cli.run(["convert", str(application), str(target), *tasks]) == 0
    assert read_formula(target).step == 0.005
    capsys.readouterr()
    assert cli.run(["info", "--json", str(application), *tasks]) == 0
    assert json.loads(capsys.readouterr().out)["import"]["step"] == 0.005


def test_info_lists_the_tasks(application, capsys):
    assert cli.run(["info", str(application), "--task", "*"]) == 0
    text = capsys.readouterr().out
    assert "Late calls every 0.04 s, first at 0.02 s: Car.Fast.rare" in text
    assert text.index("Fast_10ms calls") < text.index("Slow_30ms calls")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": ["Fast_10ms", "Slw_30ms"]}, "unknown task Slw_30ms. Did you mean Slow_30ms?"),
        ({"task": ["Fast_10ms", "Key"]}, "the task Key has no period"),
        ({"task": ["Fast_10ms", "Idle"]}, "the task Idle has no processes here"),
        ({"task": "*", "step": 0.004}, "the step 0.004 s does not divide 0.01 s"),
        ({}, r'Name one or several of .*, or "\*" for all'),
    ],
)
def test_tasks_that_cannot_run_together_are_named(application, options, message):
    with pytest.raises(InputError, match=message):
        esdl(application, **options)


def test_periods_without_a_practical_common_step_are_refused(application):
    application.write_text(application.read_text().replace("30ms", "30.0001ms"))
    with pytest.raises(InputError, match="have no common step"):
        esdl(application, task="*")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"class_name": "Fast"}, "class requires a class"),
        ({"methods": iter(["calc"]), "startup": ["init"]}, "methods and startup require a class"),
    ],
)
def test_an_application_chooses_its_methods_itself(application, options, message):
    with pytest.raises(InputError, match=f"Plant.app: {message}, and this is an application. Name a task"):
        esdl(application, task="*", **options)
    assert esdl(application, methods=iter(()), startup=(), task="*").graph.inputs == ("demand",)
