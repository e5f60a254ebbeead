"""Recorded signals: in MAT-files, in variables, in the model file, and inputs in place of those that are not there."""

import io

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_data import Thing, mxarray
from tests.importers.simulink.simulink_data import matfile as object_file
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model, Reference
from tests.importers.simulink.simulink_runs import alone, imported, run

COUNT, T = 50, 0.1
TIME = T * np.arange(COUNT)
TIMES, A, B = np.array([0.5, 1.0, 1.0, 3.0]), np.array([2.0, 4.0, -1.0, 5.0]), np.array([0.0, 1.0, 1.0, 7.0])


def matfile(**variables):
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables)
    return stream.getvalue()


def interpolated(values):
    """Lines between the points, with a jump at 1 s, and the values at the ends beyond them."""
    first = np.interp(TIME, TIMES[:2], values[:2])
    return np.where(TIME + 1e-9 >= 1, np.interp(TIME, TIMES[2:], values[2:]), first)


def held(values):
    return values[np.clip(np.searchsorted(TIMES, TIME + 1e-9, side="right") - 1, 0, None)]


BEFORE = {
    "Linear extrapolation": lambda v: v[0] + (v[1] - v[0]) / 0.5 * (TIME - 0.5),
    "Hold first value": lambda v: v[0] + 0 * TIME,
    "Ground value": lambda v: 0 * TIME,
}
AFTER = {
    "Linear extrapolation": lambda v: v[3] + (v[3] - v[2]) / 2 * (TIME - 3),
    "Hold last value": lambda v: v[3] + 0 * TIME,
    "Ground value": lambda v: 0 * TIME,
}


@pytest.mark.parametrize("within", ["Linear interpolation", "Zero order hold"])
@pytest.mark.parametrize(("before", "after"), list(zip(BEFORE, AFTER, strict=True)))
def test_a_file_is_interpolated_held_and_extrapolated_as_its_dialog_says(before, after, within, tmp_path):
    (tmp_path / "log.mat").write_bytes(matfile(ans=np.stack([TIMES, A, B])))
    drawn = alone("FromFile", 0, FileName="log.mat", ExtrapolationBeforeFirstDataPoint=before,
                  InterpolationWithinTimeRange=within, ExtrapolationAfterLastDataPoint=after)  # fmt: skip
    outputs = run(imported(drawn, tmp_path), samples=COUNT)
    for at, values in enumerate((A, B), 1):
        inside = interpolated(values) if within.startswith("Linear") else held(values)
        expected = np.where(TIME < 0.5 - 1e-9, BEFORE[before](values), inside)
        expected = np.where(TIME > 3 + 1e-6, AFTER[after](values), expected)
        np.testing.assert_allclose(outputs[f"y1[{at}]"], expected, atol=1e-9)


@pytest.mark.parametrize("name", ["data/log.mat", "'log.mat'", "C:\\\\tests\\\\log.mat"])
def test_a_file_is_found_next_to_the_model_or_below_it(name, tmp_path):
    folder = tmp_path / "data" if "/" in name else tmp_path
    folder.mkdir(exist_ok=True)
    (folder / "log.mat").write_bytes(matfile(ans=np.array([[0.0, 9.0], [1.0, 10.0]])))
    output = run(imported(alone("FromFile", 0, FileName=name), tmp_path), samples=COUNT)["y1"]
    np.testing.assert_allclose(output, 1 + TIME, atol=1e-9)


def test_a_file_has_a_sample_time(tmp_path):
    (tmp_path / "log.mat").write_bytes(matfile(ans=np.array([[0.0, 9.0], [1.0, 10.0]])))
    output = run(imported(alone("FromFile", 0, FileName="log.mat", SampleTime="0.5"), tmp_path), samples=COUNT)["y1"]
    np.testing.assert_allclose(output, 1 + np.repeat(TIME[::5], 5), atol=1e-9)


def as_channels(groups, active):
    """The form before R2010, of one signal, as structs in arrays are not written here."""
    arrays = [tuple(np.array([part], dtype=float) for part in zip(*group[0], strict=True)) for group in groups]
    x, y = arrays[active - 1]
    channels = {"xData": x, "yData": y, "label": "s", "outIndex": 1.0, "allXData": tuple(x for x, _ in arrays),
                "allYData": tuple(y for _, y in arrays)}  # fmt: skip
    names = tuple({"name": f"Group {at}"} for at in range(1, len(groups) + 1))
    return mxarray({"channels": channels, "dataSet": names, "dataSetIdx": float(active)})


def as_suite(groups, active):
    """The form since R2010: objects."""

    def signal(points):
        x, y = (np.array([part], dtype=float) for part in zip(*points, strict=True))
        return Thing("SigSuiteSignal", {"Name": "s", "XData": x, "YData": y})

    things = [
        Thing("SigSuiteGroup", {"Name": f"Group {at}", "Signals": [signal(points) for points in group]})
        for at, group in enumerate(groups, 1)
    ]
    return mxarray({"sbobj": Thing("SigSuite", {"Groups": things, "ActiveGroup": float(active)})})


def builder(raw, outputs=1, **settings):
    """A Signal Builder, in which a From Workspace block refers to the signals."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    if raw:
        drawn.records["DataTag7"] = raw
    inner = drawn.subsystem("Signals", mask=Mask({}, type="Sigbuilder block"))
    data = {"SigBuilderData": Reference("DataTag7")} if raw else {}
    inner.block("FromWorkspace", "FromWs", ports=(0, 1), VariableName="tuvar", **data, **settings)
    inner.block("Demux", "D", ports=(1, outputs), Outputs=str(outputs))
    inner.line("FromWs", "D")
    for at in range(1, outputs + 1):
        inner.outport(f"s{at}")
        inner.line(f"D:{at}", f"s{at}")
        drawn.outport(f"y{at}")
        drawn.line(f"Signals:{at}", f"y{at}")
    return drawn


STAIRS = [(0, 1), (1, 1), (1, 3), (4, 6)]
WAVE = [(0, 0), (2, 4), (3, 0)]


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts", "mdl"]))
@pytest.mark.parametrize("form", [as_channels, as_suite])
def test_a_signal_builder_gives_the_signals_of_its_active_group(form, layout, tmp_path):
    drawn = builder(form([[WAVE], [STAIRS]], 2), OutputAfterFinalValue="Holding final value")
    result = import_simulink(drawn.write(tmp_path, layout))
    expected = np.where(TIME + 1e-9 < 1, 1, np.minimum(3 + (TIME - 1), 6))
    np.testing.assert_allclose(run(result.model, samples=COUNT)["y1"], expected, atol=1e-9)
    assert any("active group 'Group 2', one of 2 of the Signal Builder Signals" in str(n) for n in result.report.notes)


def test_the_signals_of_a_signal_builder_are_in_the_order_of_its_outputs(tmp_path):
    outputs = run(imported(builder(as_suite([[WAVE, STAIRS]], 1), 2), tmp_path), samples=COUNT)
    np.testing.assert_allclose(outputs["y1"][:30], np.interp(TIME, [0, 2, 3], [0, 4, 0])[:30], atol=1e-9)
    np.testing.assert_allclose(outputs["y2"][20], 4.0)


@pytest.mark.parametrize("raw", [b"", b"damaged", mxarray({"gridSetting": "on"})])
def test_a_signal_builder_without_data_is_an_input_by_its_name(raw, tmp_path):
    drawn = builder(raw, 2)
    result = import_simulink(drawn.write(tmp_path))
    outputs = run(result.model, {"Signals[1]": TIME, "Signals[2]": -TIME})
    np.testing.assert_array_equal(outputs["y2"], -TIME)
    assert any("is the input Signals of the model" in str(note) for note in result.report.notes)


@pytest.mark.parametrize(
    ("kind", "parameters", "name"),
    [
        ("FromWorkspace", {"VariableName": "simin"}, "simin"),
        ("FromFile", {"FileName": "lost.mat"}, "B"),
        ("FromFile", {"FileName": "text.mat"}, "B"),
        ("FromSpreadsheet", {"FileName": "log.xlsx"}, "B"),
    ],
)
def test_a_recording_that_is_not_there_is_an_input_with_a_remark(kind, parameters, name, tmp_path):
    (tmp_path / "text.mat").write_bytes(matfile(s="a text"))
    result = import_simulink(alone(kind, 0, **parameters).write(tmp_path))
    np.testing.assert_array_equal(run(result.model, {name: TIME})["y1"], TIME)
    assert any(f"B is the input {name} of the model: its " in str(note) for note in result.report.notes)
    model = imported(alone(kind, 0, **parameters), tmp_path, bind={"B": "2 * noise"})
    assert run(model, {"noise": [1.0, 2.0]})["y1"].tolist() == [2.0, 4.0]


@pytest.mark.parametrize("several", [False, True])
def test_a_structure_with_time_is_a_recording(several, tmp_path):
    t = np.array([0.0, 2.0, 4.0])
    first, second = np.array([1.0, 3.0, -1.0]), np.array([[0.0], [5.0], [5.0]])
    signals = [{"values": first}, {"values": second}] if several else {"values": np.column_stack([first, second])}
    model = imported(alone("FromWorkspace", 0, VariableName="simin"), tmp_path,
                     parameters=[{"simin": {"time": t, "signals": signals}}])  # fmt: skip
    outputs = run(model, samples=40)
    np.testing.assert_allclose(outputs["y1[1]"], np.interp(TIME[:40], t, first), atol=1e-9)
    np.testing.assert_allclose(outputs["y1[2]"], np.interp(TIME[:40], t, second[:, 0]), atol=1e-9)


def test_points_of_a_file_that_go_back_in_time_are_refused(tmp_path):
    (tmp_path / "log.mat").write_bytes(matfile(ans=np.array([[0.0, 2.0, 1.0], [1.0, 2.0, 3.0]])))
    with pytest.raises(InputError, match="its times must increase"):
        imported(alone("FromFile", 0, FileName="log.mat"), tmp_path)


def series(times, values, first=1.0, **info):
    """A timeseries object; without times, evenly spaced; `first` is 1 if the rows of the values are the times."""
    spaced = {} if times is None else {"Time_": np.array([times], dtype=float).T}
    time = Thing("tsdata.timemetadata", {"Units": "seconds", **spaced, **info})
    return Thing("timeseries", {"Name": "s", "TimeInfo": time, "Data_": np.asarray(values), "IsTimeFirst_": first})


def dataset(*elements):
    """A dataset as files contain it, each layer of its classes below `any`."""
    storage = Thing("Simulink.SimulationData.Storage.RamDatasetStorage", {"Elements": tuple(elements)})
    return Thing("Simulink.SimulationData.Dataset", {"Name": "", "any": {"Storage": storage}})


def editor(outputs=1, **parameters):
    """A Signal Editor of the scenario Warm, linked to its library."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("E", "SignalEditorBlockLib/Signal Editor", "SignalEditor", ports=(0, outputs), FileName="s.mat",
               ActiveScenario="Warm", **parameters)  # fmt: skip
    for at in range(1, outputs + 1):
        drawn.outport(f"y{at}")
        drawn.line(f"E:{at}", f"y{at}")
    return drawn


@pytest.mark.parametrize("last", ["Setting to zero", "Holding final value"])
def test_a_signal_editor_gives_the_signals_of_its_active_scenario(last, tmp_path):
    pairs = np.array([[1.0, 10.0], [3.0, 20.0], [-1.0, 0.0]])
    second = Thing("Simulink.SimulationData.Signal", {"Values": series(None, [[5.0], [6.0]], Start_=0.0, Increment_=2.0,
                                                                       Length=2.0)})  # fmt: skip
    scenarios = {"Cold": dataset(series([0, 1], [[0.0], [0.0]])), "Warm": dataset(series([0, 1, 2], pairs), second)}
    (tmp_path / "s.mat").write_bytes(object_file(scenarios))
    result = import_simulink(editor(2, OutputAfterFinalValue=last).write(tmp_path))
    assert result.model is not None, result.problems
    outputs = run(result.model, samples=COUNT)
    ends = TIME > 2 + 1e-6
    for at, values in enumerate(pairs.T, 1):
        beyond = 0 if last.startswith("Setting") else values[-1]
        np.testing.assert_allclose(outputs[f"y1[{at}]"], np.where(ends, beyond, np.interp(TIME, [0, 1, 2], values)),
                                   atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(outputs["y2"][:20], 5 + TIME[:20] / 2, atol=1e-9)
    assert any("interpolates and ends all its signals" in str(note) for note in result.report.notes)


def test_a_scenario_that_is_not_there_becomes_inputs_by_the_names_of_the_ports(tmp_path):
    (tmp_path / "s.mat").write_bytes(object_file({"Cold": dataset(series([0, 1], [[0.0], [0.0]]))}))
    result = import_simulink(editor(2).write(tmp_path))
    outputs = run(result.model, {"E:1": TIME, "E:2": -TIME})
    np.testing.assert_array_equal(outputs["y2"], -TIME)
    assert any("it has no scenario Warm, but Cold" in str(note) for note in result.report.notes)


@pytest.mark.parametrize(("values", "first"), [([[1.0], [3.0]], 1.0), ([[1.0, 3.0]], 0.0)])
@pytest.mark.parametrize(("unit", "scale"), [("seconds", 1.0), ("minutes", 60.0)])
def test_a_timeseries_is_a_recording_in_a_workspace_and_in_a_file(unit, scale, values, first, tmp_path):
    raw = object_file({"simin": series([0, 2], values, first, Units=unit)})
    (tmp_path / "s.mat").write_bytes(raw)
    expected = 1 + TIME / scale
    model = imported(alone("FromWorkspace", 0, VariableName="simin"), tmp_path, parameters=[tmp_path / "s.mat"])
    np.testing.assert_allclose(run(model, samples=COUNT)["y1"], expected, atol=1e-9)
    model = imported(alone("FromFile", 0, FileName="s.mat"), tmp_path)
    np.testing.assert_allclose(run(model, samples=COUNT)["y1"], expected, atol=1e-9)


@pytest.mark.parametrize("library", ["arduinolib", "stm32f4xxblockslib", "mbedblockslib", "sldrtlib", "c2837xDlib"])
def test_what_hardware_reads_is_an_input(library, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("Pot", f"{library}/Analog Input", "", ports=(0, 1))
    drawn.link("LED", f"{library}/Digital Output", "", ports=(1, 0))
    drawn.block("Gain", "Twice", ports=(1, 1), Gain="2")
    drawn.chain("Pot", "Twice", "LED")
    result = import_simulink(drawn.write(tmp_path, "slx parts"))
    assert result.model is not None
    assert (result.model.graph.inputs, result.model.graph.outputs) == (("Pot",), ("Twice",))
    assert run(result.model, {"Pot": [1.0, 2.0]})["Twice"].tolist() == [2.0, 4.0]
    assert "Pot is the input Pot of the model: it reads hardware" in str(result.report.remarks[0])


@pytest.mark.parametrize("block", ["I2C Transfer", "Audio Input", "Serial Receive"])
def test_hardware_that_answers_an_input_or_receives_frames_is_not_supported(block, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    answers = block == "I2C Transfer"
    drawn.link("Bus", f"arduinolib/{block}", "", ports=(int(answers), 1))
    drawn.outport("y")
    drawn.chain(*(["u"] if answers else []), "Bus", "y")
    with pytest.raises(InputError, match="it drives hardware, by the library arduinolib"):
        imported(drawn, tmp_path)
