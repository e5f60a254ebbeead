import re
import shutil
import subprocess
import zipfile
from functools import cache
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from kennfeld import ArgumentError, Axis, Curve, InputError, Map, ParameterSet, Scalar, calibrate, simulate
from kennfeld.base.fmi_platform import SUFFIXES, platform_folder, platform_tuple
from kennfeld.export.api import export_function
from kennfeld.export.cross_compiler import PLATFORMS
from kennfeld.export.host_compiler import HostCompiler
from kennfeld.graph import GraphBuilder
from kennfeld.models import Model
from tests.draws import mostly_slow
from tests.export.compiled import STRICT, needs_compiler
from tests.export.fmi2_instance import ERROR, OK, Fmi2

STATIC = "y[Nm] = M(Speed, Load) * K + Curve(Load) ^ 2 + exp(Load / 10)\nz = y * Load\noutput y\noutput z"
# explicit and implicit steps, and a feedback
MEMORY = """
output y
output y2
lagged = PT1(M(Speed, Load), 0.5)
y[Nm] = lagged * K + integrator(Load - prev(y, 0), 1)
y2 = Curve(t)
"""
COUNTING = "y = delay(Load, 3, 0) * K"


def _values(names=("M", "Curve", "K")):
    random = np.random.default_rng(1)
    every = [
        Map("M", Axis([0, 1, 2, 5], input="Speed"), [-1, 2, 3], random.normal(size=(4, 3)), unit="Nm"),
        Curve("Curve", Axis([0, 0.7, 1.3, 3, 4.5], free=True), random.normal(size=5), extrapolation="linear"),
        Scalar("K", 0.3),
    ]
    return ParameterSet(each for each in every if each.name in names)


def _used(text):
    return _values([name for name in ("M", "Curve", "K") if name in text])


@cache
def _content(text, options):
    """Return the bytes of an FMU, which is compiled once for all tests."""
    with TemporaryDirectory() as folder:
        return (
            export_function(text, _used(text), folder, to="fmu", name="engine", **dict(options)).files[0].read_bytes()
        )


def _written(text, folder, **options):
    folder.mkdir(exist_ok=True)
    path = folder / "engine.fmu"
    path.write_bytes(_content(text, tuple(options.items())))
    return path


def _fmu(text, folder, **options):
    return Fmi2(_written(text, folder, **options), folder / "unpacked")


def _columns(samples, seed=2):
    random = np.random.default_rng(seed)
    return {"Speed": random.uniform(-1, 6, samples), "Load": random.uniform(-1, 4, samples)}


def _expected(text, columns, time, outputs):
    result = simulate(text, {**columns, "time": time}, _used(text))
    return np.array([result[name].values for name in outputs])


@needs_compiler
@pytest.mark.parametrize("text", mostly_slow([MEMORY, STATIC], 1), ids=["memory", "static"])
def test_inputs_at_the_end_of_a_step_give_the_simulation_on_uneven_time(text, tmp_path):
    time, columns = np.cumsum(np.random.default_rng(3).uniform(0.05, 0.3, 60)), _columns(60)
    outputs = ["y", "z"] if text == STATIC else ["y", "y2"]
    got = _fmu(text, tmp_path).instance().run(time, columns, outputs)
    # the length of the first step is not known at its start, where y2 and the lag do not need it
    np.testing.assert_allclose(got, _expected(text, columns, time, outputs), rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@needs_compiler
def test_inputs_at_the_start_of_a_step_give_the_simulation_before_and_behind_it(tmp_path):
    time, columns = np.arange(40) * 0.1, _columns(40)
    instance = _fmu(MEMORY, tmp_path, inputs="start").instance()
    instance.begin(**{name: column[0] for name, column in columns.items()})
    before, behind = [], []
    for k in range(40):
        instance.set(**{name: column[k] for name, column in columns.items()})
        before.append(instance.get("y", "y2"))
        assert instance.step(time[k], 0.1) == OK
        behind.append(instance.get("y", "y2"))
    expected = _expected(MEMORY, columns, time, ["y", "y2"])
    np.testing.assert_allclose(np.transpose(before), expected, atol=1e-12)
    np.testing.assert_allclose(np.transpose(behind), expected, atol=1e-12)


@needs_compiler
def test_the_description_states_the_rule_for_inputs(tmp_path):
    for inputs, words in (("end", "count at its end"), ("start", "count at its start")):
        description = _fmu(MEMORY, tmp_path / inputs, inputs=inputs).description
        assert words in description.get("description")


@needs_compiler
def test_a_step_of_another_length_is_an_error_if_the_function_counts_steps(tmp_path):
    fmu = _fmu(COUNTING, tmp_path, step=0.1)
    instance = fmu.instance().begin()
    assert instance.step(0.0, 0.1) == OK
    assert instance.step(0.1, 0.2) == ERROR
    assert fmu.messages == ["fmi2DoStep: the step has to be 0.1 s"]
    assert fmu.description.find("CoSimulation").get("canHandleVariableCommunicationStepSize") == "false"


def test_a_function_that_counts_steps_needs_one(tmp_path):
    with pytest.raises(InputError, match=r"the step of the FMU is not known.*State it with --step"):
        export_function(COUNTING, _used(COUNTING), tmp_path, to="fmu")


@needs_compiler
def test_a_wrong_guid_is_refused(tmp_path):
    fmu = _fmu(STATIC, tmp_path)
    assert fmu.instance("{00000000-0000-0000-0000-000000000000}") is None
    assert fmu.messages == [f"the GUID is not {fmu.description.get('guid')} of this FMU"]


@needs_compiler
def test_instances_do_not_know_each_other_and_start_anew_after_a_reset(tmp_path):
    fmu, time, columns = _fmu(MEMORY, tmp_path), np.arange(20) * 0.1, _columns(20)
    first, second = fmu.instance(), fmu.instance()
    before = first.run(time, columns, ["y"])
    second.begin()
    second.set(**{"K": 7.0, "M[4,3]": 9.0})
    second.step(0.0, 0.1)
    assert first.call("Reset") == OK
    np.testing.assert_array_equal(first.run(time, columns, ["y"]), before)
    assert second.get("K", "M[4,3]") == [7.0, 9.0]
    for instance in (first, second):
        assert instance.call("Terminate") == OK
        assert instance.step(0.0, 0.1) == ERROR
        instance.call("FreeInstance")


@needs_compiler
def test_a_state_is_stored_in_bytes_and_restored_in_another_instance(tmp_path):
    fmu, columns = _fmu(MEMORY, tmp_path), _columns(30)
    first = fmu.instance()
    first.run(np.arange(15) * 0.1, columns, ["y"])
    content, other = first.saved(), fmu.instance()
    assert other.restore(content) == OK
    ends = []
    for instance in (first, other):
        for k in range(15, 30):
            instance.set(**{name: column[k] for name, column in columns.items()})
            instance.step(0.1 * (k - 1), 0.1)
        ends.append(instance.get("y", "y2"))
    assert ends[0] == ends[1]
    assert other.restore(content[:-1]) == ERROR
    assert other.restore(b"x" + content[1:]) == ERROR


@needs_compiler
def test_tables_are_numbers_with_indices_from_1_rows_first(tmp_path):
    fmu, values = _fmu(STATIC, tmp_path), _values()
    instance = fmu.instance().begin(Speed=5.0, Load=2.0)
    assert instance.get("M[4,2]", "M[1,3]") == [values["M"].values[3, 1], values["M"].values[0, 2]]
    before = instance.get("y")[0]
    instance.set(**{"M[4,2]": values["M"].values[3, 1] + 1})
    np.testing.assert_allclose(instance.get("y")[0] - before, values["K"].value)


@needs_compiler
@pytest.mark.parametrize("text", [STATIC, MEMORY], ids=["static", "memory"])
def test_derivatives_are_those_of_finite_differences(text, tmp_path):
    random = np.random.default_rng(5)
    instance = _fmu(text, tmp_path).instance()
    instance.run(np.arange(6) * 0.1, _columns(6), ["y"])
    names = [name for name in instance.fmu.references if name not in ("y", "y2", "z")]
    start = dict(zip(names, instance.get(*names), strict=True))
    # the sample after a stored state, so that the memory is the same for all changes
    content, step = instance.saved(), 1e-6

    def output(shift):
        assert instance.restore(content) == OK
        instance.set(**{name: start[name] + shift * direction[name] for name in names})
        assert instance.step(0.5, 0.1) == OK
        return instance.get("y")[0]

    for _ in range(3):
        direction = dict(zip(names, random.normal(size=len(names)), strict=True))
        difference = (output(step) - output(-step)) / (2 * step)
        output(0.0)
        np.testing.assert_allclose(instance.derivative("y", direction), difference, rtol=2e-8, atol=2e-8)


@pytest.mark.slow
@needs_compiler
@pytest.mark.guests
def test_a_calibration_of_the_fmu_finds_the_values_of_the_function(tmp_path):
    from kennfeld import fmu

    columns, start = _columns(300), _used(STATIC)
    truth = ParameterSet(p.with_values(p.values + 0.3) for p in start.parameters)
    truth = truth.with_parameters(truth["K"].with_values(start["K"].values))
    data = {**columns, "target": simulate(STATIC, columns, truth)["y"].values}
    options = {"node": "y", "target": "target", "free": ["M", "Curve"]}
    fixed = start.with_parameters(start["Curve"].changed(axes=(start["Curve"].axes[0].changed(free=False),)))
    own = calibrate(STATIC, data, fixed, **options).parameters
    path = export_function(STATIC, fixed, tmp_path, to="fmu", name="engine").files[0]
    model = fmu(path)
    result = calibrate(model, data, model.values, **options).parameters
    for name in ("M", "Curve"):
        np.testing.assert_allclose(result[name].values, own[name].values, atol=1e-6)


@needs_compiler
@pytest.mark.guests
def test_kennfeld_reads_the_fmu_back(tmp_path):
    from kennfeld import fmu

    # Kennfeld sets the inputs of the sample before a step: with the rule "start", outputs come one sample later
    time, columns = np.arange(50) * 0.1, _columns(50)
    model = fmu(_written(MEMORY, tmp_path, inputs="start"))
    again = simulate(model, {**columns, "time": time}, model.values)
    expected = _expected(MEMORY, columns, time, ["y"])[0]
    np.testing.assert_allclose(again["y"].values[1:], expected[:-1], rtol=1e-9, atol=1e-9)


@needs_compiler
@pytest.mark.guests
def test_tables_are_arrays_in_fmi_3(tmp_path):
    from kennfeld import fmu

    path = _written(STATIC, tmp_path, fmi=3)
    with zipfile.ZipFile(path) as archive:
        description = archive.read("modelDescription.xml").decode()
    table = re.search(r'<Float64 name="M".*?</Float64>', description, re.DOTALL)[0]
    assert re.findall(r'Dimension start="(\d)"', table) == ["4", "3"]
    model, columns = fmu(path), _columns(30)
    np.testing.assert_array_equal(model.values["M"].values, _values()["M"].values)
    got = simulate(model, columns, model.values)
    expected = _expected(STATIC, columns, np.arange(30.0), ["y", "z"])
    np.testing.assert_allclose([got["y"].values, got["z"].values], expected, rtol=1e-12)


@needs_compiler
def test_the_sources_inside_compile_without_a_warning(tmp_path):
    for options in ({}, {"fmi": 3}):
        with zipfile.ZipFile(_written(MEMORY, tmp_path, **options)) as archive:
            archive.extractall(tmp_path)
    for compiler in [HostCompiler.find().command, *((name,) for name in ("clang",) if shutil.which(name))]:
        command = [*compiler, "-std=c99", *STRICT, "-c", "fmi2.c", "fmi3.c", "engine.c"]
        run = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
        assert (run.returncode, run.stderr) == (0, "")


def test_without_a_compiler_the_fmu_has_sources_only(tmp_path, monkeypatch):
    monkeypatch.setattr(HostCompiler, "find", lambda: None)
    done = export_function(STATIC, _values(), tmp_path, to="fmu", name="engine")
    with zipfile.ZipFile(done.files[0]) as archive:
        names = archive.namelist()
    assert "sources/fmi2.c" in names
    assert not [name for name in names if name.startswith("binaries")]
    assert ["the FMU has sources only" in str(finding) for finding in done.findings] == [True]


def test_equal_functions_give_equal_files(tmp_path):
    again = export_function(STATIC, _used(STATIC), tmp_path, to="fmu", name="engine").files[0].read_bytes()
    assert again == _content(STATIC, ())


def test_names_that_xml_cannot_hold_are_refused(tmp_path):
    builder = GraphBuilder()
    model = Model(builder.finish({"y": builder.call("neg", builder.input("n\x01"))}), name="m")
    with pytest.raises(InputError, match=r"the names 'n\\x01' hold characters that XML cannot"):
        export_function(model, folder=tmp_path, to="fmu")


def test_values_that_are_not_finite_are_refused(tmp_path):
    values = _values()
    infinite = values.with_parameters(values["K"].with_values(np.array(np.inf)))
    with pytest.raises(InputError, match="values of K are not finite"):
        export_function(STATIC, infinite, tmp_path, to="fmu")


@needs_compiler
def test_another_tool_takes_the_description_and_gives_the_same_numbers(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    for fmi in (2, 3):
        for text in (STATIC, MEMORY, "y = %Air/Mass [kg]% * K"):
            assert validate_fmu(str(_written(text, tmp_path, fmi=fmi))) == []
    time, columns = np.arange(40) * 0.1, _columns(40)
    inputs = np.rec.fromarrays([time, *columns.values()], names=["time", *columns])
    path = str(_written(MEMORY, tmp_path, inputs="start"))
    run = fmpy.simulate_fmu(path, input=inputs, output=["y"], output_interval=0.1, stop_time=3.9)
    expected = _expected(MEMORY, columns, time, ["y"])[0]
    np.testing.assert_allclose(run["y"][1:40], expected[:39], atol=1e-9)


def test_a_library_for_another_machine_needs_a_package_that_the_message_names(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.export.cross_compiler.find_spec", lambda name: None)
    other = "aarch64-darwin" if platform_tuple() != "aarch64-darwin" else "x86_64-windows"
    with pytest.raises(ArgumentError, match=f"{other} needs the package ziglang.*pip install"):
        export_function(STATIC, _values(), tmp_path, to="fmu", platforms=[other])
    with pytest.raises(ArgumentError, match="platforms: unknown 'win64'; known are x86_64-windows"):
        export_function(STATIC, _values(), tmp_path, to="fmu", platforms=["win64"])


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_has_libraries_for_other_machines(fmi, tmp_path):
    pytest.importorskip("ziglang")
    path = export_function(STATIC, _values(), tmp_path, to="fmu", name="engine", fmi=fmi, platforms=PLATFORMS).files[0]
    heads = {"windows": b"MZ", "linux": b"\x7fELF", "darwin": b"\xcf\xfa\xed\xfe"}
    with zipfile.ZipFile(path) as archive:
        for platform in PLATFORMS:
            system = platform.partition("-")[2]
            name = f"binaries/{platform_folder(f'{fmi}.0', platform)}/engine{SUFFIXES[system]}"
            content = archive.read(name)
            assert content.startswith(heads[system])
            assert f"fmi{fmi}DoStep".encode() in content
            # no paths of this machine, which would differ from one export to the next
            assert b"kennfeld-" not in content
            # Windows has what it needs, without a runtime to install
            needed = {library for library in re.findall(rb"[\w-]+\.dll", content) if library != b"engine.dll"}
            assert all(library.startswith(b"api-ms-win-crt-") for library in needed)
            assert bool(needed) == (system == "windows")


@pytest.mark.slow
def test_a_library_for_windows_takes_tables_that_exceed_a_page_of_the_stack(tmp_path):
    pytest.importorskip("ziglang")
    # the direction of a derivative is a copy of all parameters on the stack
    large = ParameterSet([Map("M", Axis(np.arange(70.0), input="u"), np.arange(60.0), np.zeros((70, 60)))])
    options = {"to": "fmu", "name": "large", "platforms": ["x86_64-windows"]}
    path = export_function("y = M(u, v)", large, tmp_path, **options).files[0]
    with zipfile.ZipFile(path) as archive:
        assert archive.read("binaries/win64/large.dll").startswith(b"MZ")
