"""Search in the description of a file."""

import json

import pytest

from kennfeld.base.errors import InputError
from kennfeld.terminal.file_info import describe_file, text_lines
from kennfeld.terminal.label_search import find_entries

DRIVE = "time [s],EngineSpeed [rpm],WheelSpeed [rpm],Torque [Nm],rad[3],note\n" + "".join(
    f"{i / 10},{i},{i},{i},{i},cold\n" for i in range(3)
)


@pytest.fixture
def drive(tmp_path):
    (tmp_path / "drive.csv").write_text(DRIVE, encoding="utf-8")
    return describe_file(tmp_path / "drive.csv")


def channels(matches):
    """The names in the text, which have to be those in the JSON."""
    text = [row[0] for table in matches.tables for row in table[1:]]
    assert [c["name"] for table in matches.as_json["tables"] for c in table["channels"]] == text
    json.dumps(matches.as_json, allow_nan=False)
    return text


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("speed", ["EngineSpeed", "WheelSpeed"]),
        (" SPEED ", ["EngineSpeed", "WheelSpeed"]),
        ("*speed", ["EngineSpeed", "WheelSpeed"]),
        ("e*", ["EngineSpeed"]),
        ("?orque", ["Torque"]),
        ("rad[3]", ["rad[3]"]),
        ("[", ["rad[3]"]),
    ],
)
def test_channels_match_by_a_part_or_a_pattern_of_their_name(drive, text, names):
    assert channels(find_entries(drive, text)) == names


def test_the_number_of_matches_is_reported(drive):
    assert find_entries(drive, "speed").summary.endswith("; 2 found")


def test_a_column_without_numbers_is_listed_as_such(drive):
    matches = find_entries(drive, "note")
    assert channels(matches) == []
    assert text_lines(matches)[-1] == "columns without numbers: note"
    assert matches.as_json["tables"][0]["left_out"] == ("note",) or matches.as_json["tables"][0]["left_out"] == ["note"]


def test_without_a_match_the_nearest_names_are_suggested(drive):
    with pytest.raises(
        InputError, match=r"^drive.csv: no name or description contains .torqe.\. Did you mean Torque\?$"
    ):
        find_entries(drive, "torqe")
    with pytest.raises(InputError, match=r"Search for part of a name\.$"):
        find_entries(drive, "xyzxyz")


def test_descriptions_are_searched_too(tmp_path):
    (tmp_path / "a.dcm").write_text(
        'KONSERVIERUNG_FORMAT 2.0\nFESTWERT K1\n  LANGNAME "Oil gain"\n  WERT 1\nEND\n'
        'FESTWERT K2\n  LANGNAME "Fuel gain"\n  WERT 2\nEND\nSTUETZSTELLENVERTEILUNG AxisOil 2\n  ST/X 1 2\nEND\n',
        encoding="utf-8",
    )
    matches = find_entries(describe_file(tmp_path / "a.dcm"), "oil")
    assert [p["name"] for p in matches.as_json["parameters"]] == ["K1"]
    assert [a["name"] for a in matches.as_json["axes"]] == ["AxisOil"]
    assert [row[0] for table in matches.tables for row in table[1:]] == ["K1", "AxisOil"]


def test_nodes_inputs_and_parameters_of_a_function_are_searched(tmp_path):
    (tmp_path / "a.kf").write_text("input Speed\nSpeedLow = MapSpeed(Speed)\nother = 2 * SpeedLow\n", encoding="utf-8")
    matches = find_entries(describe_file(tmp_path / "a.kf"), "speed")
    assert [row[0] for table in matches.tables for row in table[1:]] == ["Speed", "MapSpeed", "SpeedLow"]
    assert [one["name"] for one in matches.as_json["nodes"]] == ["SpeedLow"]


def test_parts_of_a_project_are_searched(tmp_path):
    (tmp_path / "kennfeld.toml").write_text(
        '[model]\nfile = "a.kf"\n[[dataset]]\nname = "bench"\nfiles = "a.csv"\n[parameters.MapA]\n[parameters.B]\n'
        '[[criterion]]\nnode = "y"\ntarget = 1\n',
        encoding="utf-8",
    )
    matches = find_entries(describe_file(tmp_path / "kennfeld.toml"), "map")
    assert matches.as_json["parameters"] == ["MapA"]
    assert matches.as_json["datasets"] == []
