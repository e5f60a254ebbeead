"""Real files from public sources: read, written in every format, read again."""

import pytest

from kennfeld.calfiles import Comparison, compare, describe, read, write
from kennfeld.parameters import Block

FILES = {
    "dcm/MatlabDCMParser_MapToDcm.DCM": (6, 0, ["distrib"]),
    "dcm/MatlabDCMParser_SplitTestDCM.dcm": (7, 0, ["distrib"]),
    "dcm/MatlabDCMParser_TestDCM1.dcm": (7, 0, ["distrib\\Module_Block_Diagram"]),
    "dcm/MatlabDCMParser_TestDCM2.dcm": (6, 0, ["distrib"]),
    "dcm/dcmReader_Sample.dcm": (9, 1, ["DISTRIBUTION X", "DISTRIBUTION Y", "distrib"]),
    "dcm/pydcm_DEMO.DCM": (5, 0, []),
    "cvx/pycvx_DEMO.CSV": (5, 0, []),
    "cdfx/asamint_CDF20demo.cdfx": (9, 2, ["CDF20.axis.X_AXIS_xU16"]),
}


@pytest.mark.parametrize("file", FILES)
def test_every_file_is_read(shared_data, file):
    found = describe(shared_data / file)
    parameters, texts, axes = FILES[file]
    assert (len(found.parameters), len(found.texts)) == (parameters, texts)
    assert sorted(axis.name for axis in found.axes) == axes


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("ending", [".dcm", ".json", ".csv", ".cdfx", ".xlsx", ".m", ".mat"])
def test_every_file_is_read_back_from_every_format(shared_data, tmp_path, file, ending):
    parameters = read(shared_data / file)
    write(parameters, tmp_path / f"a{ending}")
    again = read(tmp_path / f"a{ending}")
    for name, member in parameters.items():
        assert again[name].values.tolist() == member.values.tolist()
        assert [axis.breakpoints.tolist() for axis in again[name].axes] == [
            axis.breakpoints.tolist() for axis in member.axes
        ]
        assert [axis.name for axis in again[name].axes] == [axis.name for axis in member.axes]


def test_the_demo_of_inca_is_the_same_in_dcm_and_cvx(shared_data):
    dcm, cvx = read(shared_data / "dcm/pydcm_DEMO.DCM"), read(shared_data / "cvx/pycvx_DEMO.CSV")
    assert list(dcm) == list(cvx)
    for name in dcm:
        assert dcm[name].changed(description="") == cvx[name].changed(functions=dcm[name].functions)


@pytest.mark.parametrize("first", ["dcm/pydcm_DEMO.DCM", "cvx/pycvx_DEMO.CSV"])
@pytest.mark.parametrize("through", [".dcm", ".json", ".csv", ".cdfx", ".xlsx", ".m", ".mat"])
@pytest.mark.parametrize("back", [".dcm", ".csv", ".cdfx"])
def test_the_demo_of_inca_comes_through_every_format_without_loss(shared_data, tmp_path, first, through, back):
    write(read(shared_data / first), tmp_path / f"a{through}")
    write(read(tmp_path / f"a{through}"), tmp_path / f"b{back}")
    for file in ("dcm/pydcm_DEMO.DCM", "cvx/pycvx_DEMO.CSV"):
        assert compare(read(shared_data / file), read(tmp_path / f"b{back}")) == Comparison((), 5)


def test_the_sample_has_every_kind_of_block(shared_data):
    parameters = read(shared_data / "dcm/dcmReader_Sample.dcm")
    assert parameters["valueParameter"].value == 25.0
    assert parameters["valueParameter"].unit == "°C"
    assert parameters["blockParameter2D"] == Block(
        "blockParameter2D",
        [[0.75, 10.75], [-0.25, -10.25], [0.5, 10.5], [1.5, 11.5]],
        unit="°C",
        description="Sample block parameters",
        functions=["BlockParameterFunction"],
        display_name="BlockParameterDisplayname",
    )
    assert parameters["fixedCharacteristicMap"].values[:, 0].tolist() == [0.0, 0.4, 0.8, 1.0, 1.4, 1.8]
    assert parameters.texts[0].text == "ParameterA"
