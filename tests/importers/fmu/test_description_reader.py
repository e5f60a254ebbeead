import math
import zipfile

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.fmu import description_reader
from kennfeld.importers.fmu.fmu_archive import digest_of, read_archive
from kennfeld.importers.fmu.fmu_parameters import parameters_of
from kennfeld.importers.fmu.importing import fmu, read_fmu
from kennfeld.importers.fmu.instance import load_instance
from tests.importers.fmu.lag_fmu import DESCRIPTIONS, description_2, description_3, pack

both = pytest.mark.parametrize("version", [2, 3])


def described(tmp_path, version, **changes):
    return read_archive(pack(tmp_path / "lag.fmu", DESCRIPTIONS[version](**changes), version=version))


@both
def test_variables_are_those_of_the_description(tmp_path, version):
    description = described(tmp_path, version, indicators=2)
    assert description.version == f"{version}.0"
    assert description.token == "{lag}"
    assert description.step == 0.1
    assert [v.name for v in description.states] == ["x"]
    assert [v.name for v in description.inputs] == ["u"]
    assert [(v.name, v.unit) for v in description.computed_outputs] == [("y", "Nm")]
    assert description.indicators == 2
    assert description.model_exchange.directional
    assert description.derivatives[0].references == {1, 3}
    assert description.outputs[0].references == {1}
    tau = next(v for v in description.parameters if v.name == "tau")
    assert (tau.variability, tau.start, tau.minimum, tau.maximum, tau.unit) == ("fixed", (2.0,), 0.01, 10.0, "s")


@both
def test_tables_have_their_rows_first(tmp_path, version):
    parameters, values = parameters_of(described(tmp_path, version).parameters, "plant.")
    table = parameters["plant.table"]
    np.testing.assert_array_equal(table.values, [[0, 1, 2], [3, 4, 5]])
    assert [axis.breakpoints.tolist() for axis in table.axes] == [[1, 2], [1, 2, 3]]
    order = [value.coordinates for value in values if value.parameter == "plant.table"]
    rows = [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]
    assert order == (rows[::-1] if version == 2 else rows)
    if version == 2:
        np.testing.assert_array_equal(table.upper, [[5, 6, 7], [8, 9, 10]])


def test_an_incomplete_family_is_a_set_of_scalars(tmp_path):
    text = description_2().replace('"table[2,3]"', '"other"')
    parameters = parameters_of(read_archive(pack(tmp_path / "lag.fmu", text)).parameters).parameters
    assert {"table[1,1]", "table[2,2]", "other"} <= set(parameters)


@both
def test_reading_runs_no_code(tmp_path, version):
    path = pack(tmp_path / "lag.fmu", DESCRIPTIONS[version](), library=None, version=version)
    with pytest.raises(InputError, match="has libraries for no platform"):
        fmu(path)
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"no library")
    function = read_fmu(pack(path, DESCRIPTIONS[version](), library=broken, version=version), "", "", None)
    assert function.step == 0.1
    assert function.memory
    assert function.remarks[0].message.startswith("slopes are the directional derivatives of the FMU")


def test_remarks_name_the_slopes_and_what_is_skipped(tmp_path):
    text = description_3("", 1).replace('<UInt64 name="columns"', '<String name="gear" valueReference="30" '
                                        'causality="input" start="1"/><UInt64 name="columns"')  # fmt: skip
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"")
    function = read_fmu(pack(tmp_path / "lag.fmu", text, library=broken, version=3), "", "", 0.5)
    words = " | ".join(remark.message for remark in function.remarks)
    assert "offers no directional derivatives" in words
    assert "1 event indicators" in words
    assert "gear" in words
    assert function.step == 0.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("<ModelExchange", "<ScheduledExecution"), "offers scheduled execution only, not model exchange"),
        (('modelIdentifier="lag"', 'modelIdentifier="lag" needsExecutionTool="true"'), "runs only within"),
        (('causality="output"', 'causality="local"'), ""),
        (('modelIdentifier="lag"', 'modelIdentifier="../lag"'), "invalid modelIdentifier"),
        (('fmiVersion="2.0"', 'fmiVersion="1.0"'), "FMI 1.0 is not supported"),
        (('start="2" min', 'start="two" min'), "start='two' must be a number"),
        (('name="k"', 'name="tau"'), "tau is also the name of the variable in line"),
        (('min="0.01" max="10"', 'min="10" max="0.01"'), r"tau has min=10 above max=0\.01"),
        (('valueReference="6"', 'valueReference="-6"'), "k has the valueReference -6"),
        (('valueReference="6"', 'valueReference="4294967296"'), "k has the valueReference"),
        (('derivative="2"', 'derivative="99"'), "is the derivative of no variable"),
        (('index="3"', 'index="99"'), "is that of no variable"),
        (('index="3"', 'index="2"'), "is listed as a derivative, but of no state"),
        (("</fmiModelDescription>", ""), "not well-formed XML"),
        (('<?xml version="1.0"?>', '<!DOCTYPE a [<!ENTITY b "c">]>'), "declares the entity b"),
        (("<ModelStructure>", "<a>" * 60), "nested more than"),
    ],
)
def test_unusable_descriptions_are_refused(tmp_path, change, message):
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"")
    path = pack(tmp_path / "lag.fmu", description_2().replace(*change), library=broken)
    if not message:
        assert fmu(path).graph.outputs == ("y",)  # listed in the structure, which decides
        return
    with pytest.raises(InputError, match=message):
        fmu(path)


@pytest.mark.parametrize(
    ("variable", "message"),
    [
        ('<Int32 name="count" valueReference="41" previous="42"/>', "has discrete states.* for model exchange: count"),
        ('<Clock name="tick" valueReference="40" causality="input"/>', "has input clocks.*: tick"),
    ],
)
def test_discrete_states_and_input_clocks_are_refused_by_name(tmp_path, variable, message):
    text = description_3().replace("<ModelVariables>", f"<ModelVariables>{variable}")
    with pytest.raises(InputError, match=message):
        fmu(pack(tmp_path / "lag.fmu", text, version=3))


def test_the_message_of_a_damaged_member_names_it(tmp_path):
    library = tmp_path / "lag.so"
    library.write_bytes(np.random.default_rng(0).integers(0, 20, 20_000, dtype=np.uint8).tobytes())
    path = pack(tmp_path / "lag.fmu", description_2(), library=library)
    raw = bytearray(path.read_bytes())
    at = raw.index(b"lag.so") + 2000
    raw[at : at + 500] = b"\xff" * 500
    path.write_bytes(raw)
    assert fmu(path).graph.outputs == ("y",)  # the description is whole
    with pytest.raises(InputError, match=r"its member 'binaries/.*lag\.so' is damaged: .*complete copy"):
        load_instance(str(path), digest_of(path))


@pytest.mark.parametrize("member", ["../evil", "/etc/evil", "a/../../evil", "C:/evil", "..\\evil"])
def test_members_outside_of_the_folder_are_refused(tmp_path, member):
    path = pack(tmp_path / "lag.fmu", description_2(), {member: "x"})
    with pytest.raises(InputError, match="outside of its folder"):
        read_archive(path)


def test_the_message_of_a_damaged_archive_is_one_short_line(tmp_path):
    path = pack(tmp_path / "lag.fmu", description_2())
    raw = path.read_bytes()
    at = raw.index(b"PK\x03\x04") + 26  # the length of the name, which reaches far into the description
    path.write_bytes(raw[:at] + (4000).to_bytes(2, "little") + raw[at + 2 :])
    with pytest.raises(InputError, match="is not a readable ZIP archive") as caught:
        read_archive(path)
    assert len(caught.value.findings[0].message) < 300


def test_zip_bombs_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 80)
    path = pack(tmp_path / "lag.fmu", description_2(), {"resources/zeros": b"\0" * 10_000_000})
    with pytest.raises(InputError, match="packed into"):
        read_archive(path)


@pytest.mark.parametrize(
    ("limit", "message"),
    [("elements", "has more than 12 elements"), ("children", "ModelVariables has more than 12 elements")],
)
def test_numbers_of_variables_are_limited(tmp_path, monkeypatch, limit, message):
    monkeypatch.setattr(description_reader, "LIMITS", description_reader.LIMITS._replace(**{limit: 12}))
    with pytest.raises(InputError, match=message):
        described(tmp_path, 2)


@pytest.mark.parametrize("size", ["0", "99999999", "-1", "x"])
def test_sizes_of_arrays_are_limited(tmp_path, size):
    text = description_3().replace('<Dimension start="2"/>', f'<Dimension start="{size}"/>')
    with pytest.raises(InputError, match="table has"):
        read_archive(pack(tmp_path / "lag.fmu", text, version=3))


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "lag.fmu"
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match="not a readable ZIP archive"):
        read_archive(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("other.xml", "<a/>")
    with pytest.raises(InputError, match=r"has no modelDescription\.xml"):
        read_archive(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_archive(tmp_path / "missing.fmu")


def test_limits_of_a_variable_may_be_infinite(tmp_path):
    text = description_2().replace('max="10"', 'max="INF"')
    description = read_archive(pack(tmp_path / "lag.fmu", text))
    assert next(v for v in description.parameters if v.name == "tau").maximum == math.inf


@both
def test_a_library_of_another_kind_is_reported_when_it_is_needed(tmp_path, version):
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"no library")
    path = pack(tmp_path / "lag.fmu", DESCRIPTIONS[version](), library=broken, version=version)
    with pytest.raises(InputError, match=r"its library lag\.so cannot be loaded: it is not a library"):
        load_instance(str(path), digest_of(path))
