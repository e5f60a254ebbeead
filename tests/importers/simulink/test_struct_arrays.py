"""Arrays of structs and cells of structs as parameters: each number is a parameter named by its element."""

import numpy as np
import pytest
import scipy.io

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.importers.simulink.importing import simulink
from tests.importers.simulink.simulink_files import Mask, Model
from tests.importers.simulink.simulink_runs import run, slopes

U = np.array([1.0, -2.0, 3.0])
SCRIPT = """\
p(1).gain = 2;
p(2).gain = 3;
[p.shift] = deal(0.5);
c = {struct('gain', 5), 7};
one.gain = 4;
"""


def gains(*fields):
    """A model y = u times the fields, one after the other."""
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    for at, text in enumerate(fields):
        model.block("Gain", f"G{at}", Gain=text)
    model.outport("y")
    model.chain("u", *(f"G{at}" for at in range(len(fields))), "y")
    return model


def imported(model, tmp_path, *sources, script=SCRIPT):
    (tmp_path / "p.m").write_text(script)
    return simulink(model.write(tmp_path), parameters=[tmp_path / "p.m", *sources])


def test_a_field_of_an_element_is_a_parameter_with_its_derivative(tmp_path):
    model = imported(gains("p(2).gain", "2*p(1).gain", "c{1}.gain", "one(1).gain"), tmp_path)
    assert {name: model.values[name].values.item() for name in model.values} == {
        "p(2).gain": 3, "p(1).gain": 2, "c(1).gain": 5, "one.gain": 4,
    }  # fmt: skip
    np.testing.assert_allclose(run(model, {"u": U})["y"], U * 3 * 4 * 5 * 4)
    np.testing.assert_allclose(slopes(model, {"u": U}, "p(2).gain", "y")[0].ravel(), U * 4 * 5 * 4)


def test_a_calibration_sets_an_element_by_its_name(tmp_path):
    model = imported(gains("p(2).gain"), tmp_path, ParameterSet([Scalar("p(2).gain", 11.0)]))
    np.testing.assert_allclose(run(model, {"u": U})["y"], 11 * U)


def test_all_elements_are_a_list(tmp_path):
    model = imported(gains("sum([p.gain])", "numel(p)", "max([p.shift])"), tmp_path)
    np.testing.assert_allclose(run(model, {"u": U})["y"], U * 5 * 2 * 0.5)


def test_a_later_script_sees_an_array_of_structs(tmp_path):
    (tmp_path / "late.m").write_text(
        "p(end + 1).gain = 10;\nk = sum(arrayfun(@(s) s.gain, p));\np = p';\nn = size(p, 1);"
    )
    model = imported(gains("k", "n", "p(3).gain"), tmp_path, tmp_path / "late.m")
    np.testing.assert_allclose(run(model, {"u": U})["y"], U * 15 * 3 * 10)


def test_an_array_of_structs_of_a_mat_file_is_one_too(tmp_path):
    structs = np.array([[(2.0,), (3.0,)]], dtype=[("gain", object)])
    scipy.io.savemat(tmp_path / "d.mat", {"q": structs})
    (tmp_path / "d.m").write_text("load d.mat\nk = q(2).gain * numel(q);")
    model = imported(gains("q(2).gain", "k"), tmp_path, tmp_path / "d.m")
    np.testing.assert_allclose(run(model, {"u": U})["y"], U * 3 * 6)


def test_a_mask_passes_an_element_on(tmp_path):
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    inner = model.subsystem("Sub", mask=Mask({"s": "p(2)", "all": "p"}))
    inner.inport("a")
    inner.block("Gain", "G", Gain="s.gain + all(1).gain")
    inner.outport("b")
    inner.chain("a", "G", "b")
    model.outport("y")
    model.chain("u", "Sub", "y")
    masked = imported(model, tmp_path)
    assert set(masked.values) == {"p(2).gain", "p(1).gain"}
    np.testing.assert_allclose(run(masked, {"u": U})["y"], 5 * U)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("p(3).gain", "variable p(3).gain: undefined; used by G0"),
        ("p(2).other", "variable p(2).other: undefined; used by G0"),
        ("p.gain", "its Gain (p.gain) has no value: this expression has 2 values, expected one"),
        ("one(2).gain", "variable one(2).gain: undefined; used by G0"),
        ("p(0).gain", "indices must be integers >= 1, got 0"),
    ],
)
def test_an_element_that_is_not_there_is_an_error(field, message, tmp_path):
    with pytest.raises(InputError) as error:
        imported(gains(field), tmp_path)
    assert message in str(error.value)


def test_code_assigns_elements_of_an_array_of_structs(tmp_path):
    code = """function y = f(u, p)
q(3).x = u;
q(1).x = 2 * u;
for k = 1:3
    q(k).n = k;
end
q(2) = struct('x', -u, 'n', 10);
p(2).gain = u;
if u > 0
    q(1).x = 7;
    p(1).shift = 4;
end
y = q(1).x + 10 * q(2).x + 100 * q(3).x + sum([q.n]) + p(1).gain * p(2).gain + p(1).shift + numel(q) + isempty(q(2).n);
"""
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.function("F", code, data={"p": "Parameter"})
    model.outport("y")
    model.chain("u", "F", "y")
    first = np.where(U > 0, 7.0, 2 * U)
    expected = first - 10 * U + 100 * U + 14 + 2 * U + np.where(U > 0, 4.0, 0.5) + 3
    np.testing.assert_allclose(run(imported(model, tmp_path), {"u": U})["y"], expected)


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("q(ceil(abs(u))).x = 1;", "the index of an array of structs is not a constant scalar"),
        ("q(1) = 3;", "an array of 1x1 is assigned to an element of a struct"),
    ],
)
def test_an_assignment_to_an_element_that_code_cannot_tell_is_refused(statement, message, tmp_path):
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.function("F", f"function y = f(u)\nq(2).x = u;\n{statement}\ny = q(1).x;\n")
    model.outport("y")
    model.chain("u", "F", "y")
    with pytest.raises(InputError, match=message):
        imported(model, tmp_path)


def test_code_reads_elements_of_an_array_of_structs(tmp_path):
    code = """function y = f(u, p)
y = u * p(2).gain + numel(p);
for k = 1:numel(p)
    y = y + p(k).gain * u^k;
end
y = y + max([p.shift]);
if u > 0
    q = p;
else
    q = p;
end
y = y + q(1).gain;
"""
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.function("F", code, data={"p": "Parameter"})
    model.outport("y")
    model.chain("u", "F", "y")
    imported_model = imported(model, tmp_path)
    np.testing.assert_allclose(run(imported_model, {"u": U})["y"], 3 * U + 2 + 2 * U + 3 * U**2 + 0.5 + 2)
    np.testing.assert_allclose(slopes(imported_model, {"u": U}, "p(2).gain", "y")[0].ravel(), U + U**2)
