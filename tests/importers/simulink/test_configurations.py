"""Configurations that are kept in a data dictionary."""

import numpy as np
import pytest

from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_data import entry, sldd, thing
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import run

LAYOUTS = ("slx inline", "slx parts", "mdl", "mdl package")


def solver(name, step):
    parts = thing("Simulink.SolverCC", "Solver", SolverName=name, FixedStep=step, StopTime="10")
    return thing("Simulink.ConfigSet", Components=parts)


def integrator(**options):
    drawn = Model(solver="", step="", configuration="Shared", **options)
    drawn.inport("u")
    drawn.block("Integrator", "I", ports=(1, 1))
    drawn.outport("y")
    drawn.chain("u", "I", "y")
    return drawn


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
@pytest.mark.parametrize("own", [True, False])
def test_the_solver_is_that_of_the_configuration_in_the_dictionary(layout, own, tmp_path):
    (tmp_path / "data.sldd").write_bytes(sldd({"Shared": solver("ode1", "T/2"), "T": entry(0.5)}))
    drawn = integrator(dictionary="data.sldd" if own else "")
    result = import_simulink(drawn.write(tmp_path, layout), parameters=[] if own else [tmp_path / "data.sldd"])
    assert (result.report.solver, result.report.step) == ("ode1", 0.25)
    y = run(result.model, {"u": np.arange(5.0)})["y"]
    np.testing.assert_allclose(y, [0, 0, 0.25, 0.75, 1.5])


def test_a_missing_configuration_is_reported(tmp_path):
    report = import_simulink(integrator().write(tmp_path)).report
    assert "configuration Shared was not found: give its dictionary as parameters" in report.substitutions
    assert report.step is None


def test_configurations_that_refer_to_each_other_are_reported(tmp_path):
    further = {name: thing("Simulink.ConfigSetRef", SourceName=to) for name, to in (("Shared", "A"), ("A", "Shared"))}
    (tmp_path / "data.sldd").write_bytes(sldd(further))
    report = import_simulink(integrator(dictionary="data.sldd").write(tmp_path)).report
    assert any("configuration Shared refers to itself" in one for one in report.substitutions)
