"""Real files from public sources: read, written in every format, read again."""

import numpy as np
import pytest

from kennfeld.calfiles import Comparison, compare, describe, describe_a2l, read, write
from kennfeld.domain.parameters import Block
from tests.draws import mostly_slow

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
    description = describe(shared_data / file)
    parameters, texts, axes = FILES[file]
    assert (len(description.parameters), len(description.texts)) == (parameters, texts)
    assert sorted(axis.name for axis in description.axes) == axes


@pytest.mark.parametrize("file", mostly_slow(FILES, list(FILES)[::2]))
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


@pytest.mark.parametrize("first", mostly_slow(["dcm/pydcm_DEMO.DCM", "cvx/pycvx_DEMO.CSV"], 1))
@pytest.mark.parametrize("through", [".dcm", ".json", ".csv", ".cdfx", ".xlsx", ".m", ".mat"])
@pytest.mark.parametrize("back", mostly_slow([".dcm", ".csv", ".cdfx"], [".csv"]))
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


A2LS = {
    "a2l/ASAP2_Demo_V171.a2l": (94, 3, 31, "1.71"),
    "a2l/etas_ascet_ACCTest_PCL1.a2l": (35, 0, 55, "1.41"),
    "a2l/etas_ascet_BMS_Simulation_PCL1.a2l": (25, 0, 21, "1.41"),
    "cdfx/asamint_CDF20demo.a2l": (46, 14, 62, "1.61"),
}


@pytest.mark.parametrize("file", A2LS)
def test_every_a2l_file_is_described_without_a_finding(shared_data, file):
    description = describe_a2l(shared_data / file)
    assert description.findings == ()
    a2l = description.a2l
    assert (len(a2l.characteristics), len(a2l.axis_pts), a2l.measurements, a2l.version) == A2LS[file]
    assert len(description.labels) == len(a2l.characteristics) + len(a2l.axis_pts)


ONLY_CDFX = {
    "CDF20.BOOLEAN.FW_wU8": "the A2L file has a number for what CDFX calls true",
}


def test_the_image_of_the_demo_holds_the_values_of_its_cdfx(shared_data):
    flash, cdfx = read(shared_data / "cdfx/asamint_CDF20demo.hex"), read(shared_data / "cdfx/asamint_CDF20demo.cdfx")
    assert set(cdfx) <= set(flash)
    for name, there in cdfx.items():
        here = flash[name]
        assert (here.kind, here.unit) == (there.kind, there.unit)
        assert here.values == pytest.approx(there.values, rel=1e-9)
        for axis, other in zip(here.axes, there.axes, strict=True):
            # the A2L file gives this axis the conversion of a speed, CDFX that of a temperature, 50 less
            moved = 50 if axis.name == "CDF20.axis.X_AXIS_xU16" else 0
            assert axis.breakpoints - moved == pytest.approx(other.breakpoints, rel=1e-9)
    texts, others = ({text.name: text.text.strip() for text in one.texts} for one in (flash, cdfx))
    assert others.keys() - texts.keys() == ONLY_CDFX.keys()
    assert texts["CDF20.ASCII.N42_wU8"] == others["CDF20.ASCII.N42_wU8"] == "CDF20 Test String"
    assert flash["CDF20.BOOLEAN.FW_wU8"].value == 1


def test_image_and_cdfx_of_the_demo_skip_the_same_labels(shared_data):
    flash, cdfx = (
        describe(shared_data / "cdfx/asamint_CDF20demo.hex"),
        describe(shared_data / "cdfx/asamint_CDF20demo.cdfx"),
    )
    for name in ("CDF20.curve.KL_xRESs8_wS16", "CDF20.map.KF_xCURu16u8_yCURu16u8_wU8", "CDF20.axis.X_RE_AXIS_xS8"):
        assert all(
            any(f"({name})" in str(warning.location) for warning in description.findings)
            for description in (flash, cdfx)
        )


def test_the_image_of_the_demo_is_written_without_losing_a_byte(shared_data, tmp_path):
    image = shared_data / "cdfx/asamint_CDF20demo.hex"
    values = read(image)
    write(values, tmp_path / "same.hex")
    assert (tmp_path / "same.hex").read_bytes() == image.read_bytes()
    table = values["opt_ing_angle_z_table"]
    write(values.with_parameters(table.with_values(table.values * 0.9)), tmp_path / "new.hex")
    again = read(tmp_path / "new.hex", shared_data / "cdfx/asamint_CDF20demo.a2l")
    assert again["opt_ing_angle_z_table"].values == pytest.approx(table.values * 0.9, abs=0.5 / 16384)
    assert [name for name in values if not np.array_equal(values[name].values, again[name].values)] == [table.name]


def test_the_values_of_a_cdfx_go_into_an_image(shared_data, tmp_path):
    image = shared_data / "cdfx/asamint_CDF20demo.hex"
    parameters = read(shared_data / "cdfx/asamint_CDF20demo.cdfx").without(["CDF20.curve.GKL_xCOM_wU16"])
    values = type(parameters)(parameters.parameters, (), ())
    write(values, tmp_path / "same.hex", image)
    assert (tmp_path / "same.hex").read_bytes() == image.read_bytes()
