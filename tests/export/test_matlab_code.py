import shutil
import subprocess

import numpy as np
import pytest

from kennfeld import RBF, Expansion, ParameterSet, formula
from kennfeld.export.matlab_code import write_matlab
from tests.export.compiled import hostile, prepared, simulated
from tests.export.test_c_code import NAMES, TEXT, _values

OCTAVE = shutil.which("octave")


def in_octave(model, parameters, columns, folder, name="f"):
    """Return all outputs, Float[outputs, samples], computed by Octave."""
    function = prepared(model, parameters, name=name)
    files = write_matlab(function)
    for file, text in files.items():
        (folder / file).write_text(text, encoding="utf-8")
    step = min(files, key=len).removesuffix(".m")
    # NaN and infinities in a form that both read
    for signal in function.inputs:
        np.asarray(columns[signal.name], dtype=np.float64).tofile(folder / f"{signal.member}.bin")
    reads = [f"all_{u.member} = fread(fopen('{u.member}.bin'), Inf, 'double');" for u in function.inputs]
    sets = [f"u.{u.member} = all_{u.member}(k);" for u in function.inputs]
    count = len(columns[function.inputs[0].name])
    rows = ", ".join(f"y.{y.member}" for y in function.outputs)
    loop = [f"for k = 1:{count}", *sets, f"[y, s] = {step}(u, s);", f"out(:, k) = [{rows}];", "end"]
    end = ["fwrite(fopen('out.bin', 'w'), out, 'double'); fflush(stdout); fclose('all');"]
    begin = ["s = [];", f"out = zeros({len(function.outputs)}, {count});"]
    (folder / "drive.m").write_text("\n".join([*reads, *begin, *loop, *end]))
    run = subprocess.run([OCTAVE, "--no-gui", "-q", "drive.m"], cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return np.fromfile(folder / "out.bin").reshape(count, -1).T


@pytest.mark.skipif(OCTAVE is None, reason="Octave is not installed")
def test_octave_computes_the_same_numbers(tmp_path):
    model = formula(
        TEXT + "v = log(Load) + sqrt(Speed) + asin(Load) + Speed ^ 1.5 + max(Load, Speed)\noutput v\n", parameters=NAMES
    )
    columns = {**hostile(1, 200, ["Speed", "Load"]), "dt": np.full(200, 0.1), "t": np.arange(200) * 0.1}
    expected = simulated(model, _values(), columns)
    np.testing.assert_allclose(in_octave(model, _values(), columns, tmp_path), expected, rtol=1e-15)


@pytest.mark.skipif(OCTAVE is None, reason="Octave is not installed")
def test_octave_computes_expansions(tmp_path):
    random = np.random.default_rng(4)
    bell = (random.normal(size=5), random.normal(size=(5, 2)), random.uniform(0.3, 2, (5, 2)))
    bells = {kernel: RBF(kernel, Expansion(1.0, [0.5, -1], *bell, kernel)) for kernel in ("gaussian", "matern52")}
    model = formula("y = gaussian(u, v) - matern52(v, u)", parameters=list(bells))
    columns = {"u": random.normal(size=50), "v": random.normal(size=50)}
    values = ParameterSet(bells.values())
    np.testing.assert_allclose(
        in_octave(model, values, columns, tmp_path), simulated(model, values, columns), rtol=1e-12
    )


def test_maps_have_a_row_for_each_x():
    defaults = write_matlab(prepared(formula(TEXT, parameters=NAMES), _values()))["f_defaults.m"]
    values = _values()["MapTorque"].values
    (line,) = [line for line in defaults.splitlines() if line.startswith("p.MapTorque")]
    assert line.count(";") == values.shape[0]
    assert f"[{values[0, 0]!r}, ".replace("np.float64(", "").replace(")", "") in line


def test_keywords_of_matlab_are_not_names():
    code = write_matlab(prepared(formula("y = %end% * 2"), ParameterSet()))["f.m"]
    assert "u.end_ * 2.0" in code


def test_a_keyword_does_not_become_the_name_of_another_signal():
    code = write_matlab(prepared(formula("y = %end% * 2 + %end_%"), ParameterSet()))["f.m"]
    assert "u.end__ * 2.0" in code
    assert "u.end_;" in code


@pytest.mark.skipif(OCTAVE is None, reason="Octave is not installed")
@pytest.mark.parametrize("name", ["exp", "lesser"])
def test_a_function_with_the_name_of_one_that_it_calls_does_not_call_itself(name, tmp_path):
    model = formula("y = min(exp(u), 2)")
    columns = {"u": np.array([-1.0, 0.5, 3.0])}
    got = in_octave(model, ParameterSet(), columns, tmp_path, name=name)
    np.testing.assert_allclose(got, [np.minimum(np.exp(columns["u"]), 2)], rtol=1e-15)
