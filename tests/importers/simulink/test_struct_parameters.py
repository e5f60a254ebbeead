"""Parameter objects whose value is a struct: each field is a parameter of its own, from every source."""

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.importers.simulink.importing import simulink
from tests.importers.simulink.simulink_data import Thing, entry, matfile, mxarray, sldd, thing
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import run, slopes

U = np.array([1.0, -2.0, 3.0])
VALUE = {"A": 7.0, "in": {"B": 2.0, "T": [1.0, 4.0, 9.0]}}


def drawn():
    """A model y = P.A u + P.in.B + table(u)."""
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.block("Gain", "G", Gain="P.A")
    model.block("Bias", "B", Bias="P.in.B")
    model.block("Lookup_n-D", "L", NumberOfTableDimensions="1", Table="P.in.T", BreakpointsForDimension1="[0 1 2]",
                ExtrapMethod="Clip")  # fmt: skip
    model.block("Sum", "S", ports=(2, 1))
    model.outport("y")
    model.line("u", "G", "L")
    model.chain("G", "B", "S:1")
    model.line("L", "S:2")
    model.line("S", "y")
    return model


def parameter():
    return Thing("Simulink.Parameter", {"Value": VALUE, "Min": np.zeros((0, 0)), "DataType": "auto"})


def from_script(folder, drawing):
    (folder / "p.m").write_text(
        "V.A = single(7);\nV.in.B = 2;\nV.in.T = [1 4 9];\nP = Simulink.Parameter(V);\n"
        "P.CoderInfo.StorageClass = 'ExportedGlobal';\n"
    )
    return [folder / "p.m"]


def from_later_assignments(folder, drawing):
    (folder / "p.m").write_text(
        "P = Simulink.Parameter;\nP.Value = struct('A', 6, 'in', struct('B', 2));\n"
        "P.Value.A = 7;\nP.Value.in.T = [1 4 9];\nP.Description = 'constants';\n"
    )
    return [folder / "p.m"]


def from_objects_in_a_struct(folder, drawing):
    (folder / "p.m").write_text(
        "P.A = Simulink.Parameter(7);\nP.A.Max = 9;\nP.in.B = Simulink.Parameter(2);\nP.in.T = [1 4 9];\n"
    )
    return [folder / "p.m"]


def from_mat_file(folder, drawing):
    (folder / "p.mat").write_bytes(matfile({"P": parameter()}))
    return [folder / "p.mat"]


def from_dictionary(folder, drawing):
    (folder / "p.sldd").write_bytes(sldd({"P": thing("Simulink.Parameter", Value=entry(VALUE), DataType="auto")}))
    return [folder / "p.sldd"]


def from_workspace(folder, drawing):
    drawing.workspace = mxarray({"P": parameter()})
    return []


SOURCES = [
    from_script,
    from_later_assignments,
    from_objects_in_a_struct,
    from_mat_file,
    from_dictionary,
    from_workspace,
]


@pytest.mark.parametrize("source", SOURCES)
def test_fields_of_a_struct_are_parameters_of_their_own(source, tmp_path):
    drawing = drawn()
    files = source(tmp_path, drawing)
    model = simulink(drawing.write(tmp_path, "slx parts"), parameters=files)
    np.testing.assert_allclose(run(model, {"u": U})["y"], 7 * U + 2 + np.interp(U, [0, 1, 2], [1, 4, 9]))
    assert model.values["P.A"].values == 7.0
    assert set(model.graph.parameters) == {"P.A", "P.in.B", "P.in.T"}


def test_the_slope_of_a_field_is_that_of_its_use(tmp_path):
    model = simulink(drawn().write(tmp_path), parameters=from_script(tmp_path, None))
    exact, differences = slopes(model, {"u": U}, "P.A", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-6)


def test_a_calibration_replaces_one_field(tmp_path):

    files = from_script(tmp_path, None)
    model = simulink(drawn().write(tmp_path), parameters=[*files, ParameterSet([Scalar("P.A", 3.0)])])
    np.testing.assert_allclose(run(model, {"u": U})["y"], 3 * U + 2 + np.interp(U, [0, 1, 2], [1, 4, 9]))
