import pytest

from kennfeld.terminal.file_info import describe_file
from tests.importers.fmu.lag_fmu import DESCRIPTIONS, pack

GEAR = 'name="u" valueReference="3" causality="input"><Integer start="0"/>'


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_is_described_without_its_code(tmp_path, version):
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"no library")
    info = describe_file(pack(tmp_path / "lag.fmu", DESCRIPTIONS[version](), library=broken, version=version))
    assert info.summary.startswith(f"lag.fmu: FMI {version}.0 for model exchange, ")
    assert [table[0][0] for table in info.tables] == ["input", "parameter", "state", "output", "other variable"]
    rows = {row[0]: row for row in info.tables[1][1:]}
    assert rows["tau"] == ("tau", "scalar", "s", "2", "0.01", "10", "fixed")
    assert rows["table"][:4] == ("table", "map", "", "2 x 3")
    assert info.notes[0] == "a command that evaluates it runs code of lag.fmu"
    assert info.as_json["usable"]
    assert info.as_json["outputs"] == [{"name": "y", "unit": "Nm"}]
    assert [variable["name"] for variable in info.as_json["other_variables"]] == ["x", "der(x)"]


def test_an_fmu_that_cannot_be_used_is_described_with_the_reason(tmp_path):
    text = DESCRIPTIONS[2]().replace("<ModelExchange", "<CoSimulation")
    info = describe_file(pack(tmp_path / "lag.fmu", text))
    assert "FMI 2.0 for co-simulation, no platform" in info.summary
    assert info.notes[0].startswith("has libraries for no platform, not for ")
    assert not info.as_json["usable"]


def test_inputs_and_outputs_of_co_simulation_are_numbers_of_all_types(tmp_path):
    text = DESCRIPTIONS[2]().replace("<ModelExchange", "<CoSimulation")
    text = text.replace('name="u" valueReference="3" causality="input"><Real start="0" unit="Nm"/>', GEAR)
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"no library")
    info = describe_file(pack(tmp_path / "lag.fmu", text, library=broken))
    assert [table[0][0] for table in info.tables if len(table) > 1] == [
        "input",
        "parameter",
        "output",
        "other variable",
    ]
    assert info.tables[0][1:] == [("u", "")]
    assert info.notes[1].startswith("co-simulation: ")
    assert info.as_json["interface"] == "co-simulation"


ENDS = ("", ":co-simulation", ":co_simulation", ":model_exchange")


def test_the_interface_of_an_fmu_is_chosen_by_its_name(tmp_path):
    text = DESCRIPTIONS[2]().replace("<ModelExchange", '<CoSimulation modelIdentifier="lag"/><ModelExchange')
    broken = tmp_path / "lag.so"
    broken.write_bytes(b"no library")
    path = pack(tmp_path / "lag.fmu", text, library=broken)
    interfaces = [describe_file(f"{path}{end}").as_json["interface"] for end in ENDS]
    assert interfaces == ["model-exchange", "co-simulation", "co-simulation", "model-exchange"]
