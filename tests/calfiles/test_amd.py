"""Parameters of ASCET 6 components: read, and written into a copy of the file in which only numbers change."""

import difflib
import zipfile

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, losses, read, write
from kennfeld.calfiles.amd.reader import read_amd
from kennfeld.calfiles.amd.update import write_amd
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.domain.texts import Text
from kennfeld.files.calibrations import AMD
from kennfeld.files.identification import identify
from tests.draws import few_or_many
from tests.importers.ascet.amd_files import Component, Item, instance, message, parameter, write_archive, write_folder

X, Y = [0.0, 10.0, 30.5], [0.0, 1.0]
PLANT = Component(
    "Plant",
    [
        parameter("gain", 2.5, scope="exported", unit="Nm", comment="a  gain", limits=(0, 10)),
        parameter("count", 3, basic="udisc", scope="exported"),
        parameter("active", True, basic="log", scope="exported"),
        parameter("mode", "Off", basic="enumeration", scope="exported", reference="/Lib/Mode"),
        parameter("block", [1.0, 2.0, -3.5], scope="exported"),
        parameter("curve", (X, [1.5, 2.5, 4.0]), scope="exported", unit="V"),
        parameter("map", (X, Y, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])),
        parameter("T", 0.5, others={"Slow": 2.0}),
        message("torque", "exported", value=7.0),
        Item("state", value=1.0),
        instance("filter", "/Lib/Filter"),
    ],
)
FILTER = Component("Filter", [parameter("T", 0.1), parameter("K", 4.0)], folder="Lib", kind="ASCET_Class")


@pytest.fixture
def path(tmp_path):
    return write_archive(tmp_path, PLANT, FILTER)


def test_all_parameters_of_an_archive_are_read(path):
    values = read(path)
    assert list(values) == ["gain", "count", "active", "block", "curve", "map", "Plant.T", "Filter.T", "K"]
    assert [values[name].value for name in ("gain", "count", "active", "Plant.T", "Filter.T")] == [
        2.5, 3.0, 1.0, 0.5, 0.1,
    ]  # fmt: skip
    gain = values["gain"]
    assert (gain.unit, gain.description, float(gain.lower), float(gain.upper)) == ("Nm", "a gain", 0.0, 10.0)
    assert values["block"].values.tolist() == [1.0, 2.0, -3.5]
    assert values["curve"].axes[0].breakpoints.tolist() == X
    assert values["map"].values.tolist() == [[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]
    assert values.texts == (Text("mode", "Off", kind="enumeration"),)


def test_other_data_sets_are_variants(path):
    values = read(path)
    (other,) = [item for item in values.others if item.name == "Plant.T"]
    assert (other.variant, other.value) == ("Slow", 2.0)
    (summary,) = [item for item in describe(path).parameters if item.name == "Plant.T"]
    assert summary.variants == ("", "Slow")


def test_a_data_file_is_read_with_the_files_beside_it(tmp_path):
    data = write_folder(tmp_path, PLANT, FILTER).with_name("Plant.data.amd")
    values = read(data)
    assert list(values) == ["gain", "count", "active", "block", "curve", "map", "T"]
    assert values["gain"].unit == "Nm"


def test_a_data_file_alone_is_read_with_a_warning(tmp_path):
    data = tmp_path / "Plant.data.amd"
    data.write_bytes(PLANT.files()["Engine/Plant.data.amd"])
    content = describe(data)
    assert "state" in [item.name for item in content.parameters]
    assert "variables cannot be distinguished from parameters" in str(content.findings[0])


def test_a_file_without_values_names_the_one_that_has_them(tmp_path):
    with pytest.raises(InputError, match=r"Name Plant\.data\.amd"):
        read(write_folder(tmp_path, PLANT))


def test_writing_what_was_read_gives_the_same_bytes(path, tmp_path):
    findings = write(read(path), tmp_path / "copy.axl")
    assert (tmp_path / "copy.axl").read_bytes() == path.read_bytes()
    assert findings == ()


def _changed(values):
    return values.with_parameters(
        values["gain"].with_values(3.0),
        values["count"].with_values(4.0),
        values["active"].with_values(0.0),
        values["map"].with_values([[1.0, 4.0], [2.0, 5.5], [3.0, 6.0]]),
        values["curve"].changed(axes=(values["curve"].axes[0].changed(breakpoints=[0.0, 12.5, 30.5]),)),
    )


def test_only_changed_numbers_are_written(path, tmp_path):
    changed = _changed(read(path))
    findings = write(changed, tmp_path / "copy.axl")
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(tmp_path / "copy.axl") as after:
        assert before.namelist() == after.namelist()
        members = [name for name in before.namelist() if before.read(name) != after.read(name)]
        assert members == ["Engine/Plant.data.amd"]
        old, new = (archive.read(members[0]).decode().replace("><", ">\n<") for archive in (before, after))
        dates = [(member.date_time, member.compress_type) for member in after.infolist()]
        assert dates == [(member.date_time, member.compress_type) for member in before.infolist()]
    lines = [line for line in difflib.ndiff(old.splitlines(), new.splitlines()) if line.startswith("+ ")]
    assert lines == [
        '+ <Numeric value="3.0"/>', '+ <Numeric value="4"/>', '+ <Logic value="false"/>', '+ <Numeric value="12.5"/>',
        '+ <Numeric value="5.5"/>',
    ]  # fmt: skip
    assert read(tmp_path / "copy.axl") == changed
    assert [finding.severity for finding in findings] == ["warning"]
    assert "signatures no longer fit: Plant.data.amd" in str(findings[0])


def test_a_data_file_is_written_likewise(tmp_path):
    data = write_folder(tmp_path, PLANT, FILTER).with_name("Plant.data.amd")
    changed = _changed(read(data))
    copy = tmp_path / "copy/Engine/Plant.data.amd"
    write_folder(tmp_path / "copy", PLANT, FILTER)
    write(changed, copy)
    assert read(copy) == changed


def test_labels_and_variants_are_written(path, tmp_path):
    values = read(path)
    others = [item.with_values(9.0) if item.name == "Plant.T" else item for item in values.others]
    new = ParameterSet(
        values.parameters, [Text("mode", "A&B", kind="enumeration")], values.axes, others, origin=values.origin
    )
    write(new, tmp_path / "copy.axl")
    again = read(tmp_path / "copy.axl")
    assert again.texts[0].text == "A&B"
    assert [item.value for item in again.others if item.name == "Plant.T"] == [9.0]


def test_the_number_of_an_enumeration_is_written_as_its_label(tmp_path):
    mode = Component("Mode", kind="ASCET_Enumeration", labels=("Off", "On"), folder="Lib")
    origin = read(write_archive(tmp_path, PLANT, FILTER, mode)).origin
    write(ParameterSet([Scalar("mode", 1.0)], origin=origin), tmp_path / "copy.axl")
    assert read(tmp_path / "copy.axl").texts[0].text == "On"
    with pytest.raises(InputError, match="no label for this number"):
        write(ParameterSet([Scalar("mode", 2.0)], origin=origin), tmp_path / "new.axl")


def test_long_names_are_those_of_the_file(path, tmp_path):
    new = ParameterSet([Scalar("Engine.Plant.gain", 1.0), Scalar("Else.K", 2.0)], origin=read(path).origin)
    findings = write(new, tmp_path / "copy.axl")
    assert read(tmp_path / "copy.axl")["gain"].value == 1.0
    assert "left out" in str(findings[0])
    assert "Else.K" in str(findings[0])


def test_a_set_of_another_file_size_or_kind_is_refused(path, tmp_path):
    origin = read(path).origin
    with pytest.raises(InputError, match="only be written over the one it was read from"):
        write(ParameterSet([Scalar("gain", 1.0)]), tmp_path / "new.axl")
    with pytest.raises(InputError, match="is a scalar, but a block 3 in the file"):
        write(ParameterSet([Scalar("block", 1.0)], origin=origin), tmp_path / "new.axl")
    with pytest.raises(InputError, match="is not a truth value"):
        write(ParameterSet([Scalar("active", 0.5)], origin=origin), tmp_path / "new.axl")
    with pytest.raises(InputError, match=r"ends in \.axl"):
        write(ParameterSet([Scalar("gain", 1.0)], origin=origin), tmp_path / "new.amd")


def test_a_file_in_another_encoding_is_read_but_not_changed():
    name = "Plant.data.amd"
    raw = PLANT.files()[f"Engine/{name}"].decode().replace('encoding="UTF-8"', 'encoding="UTF-16"').encode("utf-16")
    values = read_amd(CalibrationSource(name, raw)).parameters
    assert values["gain"].value == 2.5
    assert write_amd(values, name).raw == raw
    with pytest.raises(InputError) as caught:
        write_amd(values.with_parameters(values["gain"].with_values(3.0)), name)
    reason = "cannot be replaced, since the file is not encoded in UTF-8 or ASCII. Save it in UTF-8."
    assert str(caught.value) == f"{name} gain: {reason}"


def test_nothing_is_lost(path):
    assert losses(read(path), "copy.axl") == ()


def test_a_falling_axis_is_turned_and_stays_falling(tmp_path):
    curve = parameter("curve", ([30.5, 10.0, 0.0], [4.0, 2.5, 1.5]))
    path = write_archive(tmp_path, Component("Plant", [curve, parameter("K", 1.0)]))
    before = contents(path)
    values = read(path)
    table = values["curve"]
    assert (table.axes[0].breakpoints.tolist(), table.values.tolist()) == ([0.0, 10.0, 30.5], [1.5, 2.5, 4.0])
    assert table.axes[0].falling
    write(values, path)
    assert contents(path) == before
    write(values.with_parameters(Curve("curve", [0.0, 10.0, 31.0], [1.5, 2.5, 4.5])), path)
    changed = {name: raw.replace(b'"30.5"', b'"31.0"').replace(b'"4.0"', b'"4.5"') for name, raw in before.items()}
    assert contents(path) == changed != before


def contents(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.parametrize(
    ("value", "part"),
    [
        (([0.0, 0.0], [1.0, 2.0]), "breakpoints neither increase nor decrease"),
        (([0.0, 1.0], [1.0]), "has 1 values, expected 2"),
        (([0.0, 1.0], [1.0, float("nan")]), "'nan' in line"),
    ],
)
def test_damaged_values_are_skipped_with_a_warning(tmp_path, value, part):
    path = write_archive(tmp_path, Component("Plant", [parameter("curve", value), parameter("K", 1.0)]))
    content = describe(path)
    assert [item.name for item in content.parameters] == ["K"]
    assert part in str(content.findings[0])


def test_dcm_and_archive_are_merged(path, tmp_path, capsys):
    assert cli.run(["convert", str(path), str(tmp_path / "a.dcm")]) == 0
    changed = read(tmp_path / "a.dcm")
    write(changed.with_parameters(changed["K"].with_values(5.0)), tmp_path / "b.dcm")
    assert cli.run(["merge", str(path), str(tmp_path / "b.dcm"), "-o", str(tmp_path / "new.axl")]) == 0
    assert read(tmp_path / "new.axl")["K"].value == 5.0
    assert cli.run(["diff", str(path), str(tmp_path / "new.axl")]) == 1
    assert cli.run(["info", str(path)]) == 0
    assert "gain" in capsys.readouterr().out


def test_archives_are_recognised_by_their_content(path, tmp_path):
    assert identify(path).format is AMD
    contents = {"a.txt": PLANT.files()["Engine/Plant.data.amd"], "b.axl": b"KONSERVIERUNG_FORMAT 2.0"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    zipfile.ZipFile(tmp_path / "c.zip", "w").close()
    known = [identify(tmp_path / name).format.name for name in ("a.txt", "b.axl", "c.zip")]
    assert known == [AMD.name, "DCM", "ZIP archive"]


@few_or_many(st.lists(st.floats(-1e12, 1e12), min_size=3, max_size=3), few=10, many=100)
def test_any_numbers_are_read_back(numbers):
    name = "Plant.data.amd"
    source = CalibrationSource(name, PLANT.files()[f"Engine/{name}"])
    values = read_amd(source).parameters
    new = values.with_parameters(values["block"].with_values(numbers))
    again = read_amd(CalibrationSource(name, write_amd(new, name).raw)).parameters
    np.testing.assert_array_equal(again["block"].values, numbers)
