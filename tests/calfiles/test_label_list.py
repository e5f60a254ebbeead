"""Label lists of INCA, MDA and CANape."""

import codecs

import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.calfiles import compare
from kennfeld.calfiles.label_list import parse_label_list, read_label_list, write_label_list
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar

INCA = """\
[SETTINGS]
Version;V1.1
MultiRasterSeparator;&

[RAMCELL]
nEng;10ms&100ms
rl;10ms;load

[Label]
KfTrqOpt;;main map
KlEta
KwOff;

[FUNCTION]
AirPath

[GROUP]
Calibration
"""


def test_the_sections_of_inca_are_distinguished():
    labels = parse_label_list(INCA)
    assert labels.labels == ("KfTrqOpt", "KlEta", "KwOff")
    assert labels.measured == ("nEng", "rl")
    assert labels.functions == ("AirPath",)


@pytest.mark.parametrize("head", ["", "[Selected channels]\n", "[SETTINGS]\nVersion;V1.1\n\n[label] ;\n"])
def test_canape_writes_a_name_a_line_under_any_heading(head):
    text = f"{head}  KfTrqOpt  \n\n; a comment\n# another\n// and one more\nEngine/Air path[0]\nKfTrqOpt\n"
    assert parse_label_list(text).labels == ("KfTrqOpt", "Engine/Air path[0]")


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings_and_line_ends_are_those_of_calibration_files(tmp_path, encoding, ends):
    (tmp_path / "a.lab").write_bytes("[LABEL]\nKfÖl\nKlEta\n".replace("\n", ends).encode(encoding))
    assert read_label_list(tmp_path / "a.lab").labels == ("KfÖl", "KlEta")


def test_a_list_that_is_written_is_read_back(tmp_path):
    names = ["KfTrqOpt", "Ölmenge", "Engine/Air path[0]", "KfTrqOpt"]
    text, remarks = write_label_list(names, "a.lab")
    (tmp_path / "a.lab").write_bytes(text.encode())
    assert remarks == ()
    assert read_label_list(tmp_path / "a.lab").labels == tuple(dict.fromkeys(names))
    assert text.encode().startswith(codecs.BOM_UTF8)


@pytest.mark.parametrize("name", ["a;b", " a", "[a]", "#a", "//a", "a\nb"])
def test_a_name_that_a_list_cannot_hold_is_skipped_with_a_remark(name):
    text, remarks = write_label_list(["KlEta", name], "a.lab")
    assert text.endswith("[LABEL]\r\nKlEta\r\n")
    assert "a.lab: 1 name left out, as a label list cannot hold them" in str(remarks[0])


def test_binary_content_is_refused(tmp_path):
    (tmp_path / "a.lab").write_bytes(b"\0\1\2")
    with pytest.raises(InputError, match=r"a\.lab: is not a label list"):
        read_label_list(tmp_path / "a.lab")
    with pytest.raises(InputError, match="file not found"):
        read_label_list(tmp_path / "b.lab")


def set_of(*values, points=(0.0, 1.0)):
    axis = Axis(points, name="shared")
    return ParameterSet([Curve("A", axis, [values[0]] * 2), Scalar("B", values[1]), Scalar("C (x)", values[2])])


def test_a_comparison_names_what_differs_once():
    changed = compare(set_of(1, 2, 3), set_of(4, 2, 5, points=(0.0, 2.0)))
    assert changed.labels == ("A", "C (x)", "shared")
    assert compare(set_of(1, 2, 3), set_of(1, 2, 3)).labels == ()


class TestDiff:
    @pytest.fixture
    def files(self, tmp_path):
        paths = [tmp_path / "a.json", tmp_path / "b.json"]
        set_of(1, 2, 3).save(paths[0])
        set_of(1, 2.5, 3).merged(ParameterSet([Scalar("D", 1.0)])).save(paths[1])
        return list(map(str, paths))

    def test_writes_the_names_that_differ(self, files, tmp_path, capsys):
        assert cli.run(["diff", *files, "--lab", str(tmp_path / "c.lab")]) == 1
        assert read_label_list(tmp_path / "c.lab").labels == ("B", "D")
        assert capsys.readouterr().out.endswith(f"Written to {tmp_path / 'c.lab'}\n")

    def test_equal_files_give_an_empty_list(self, files, tmp_path):
        assert cli.run(["diff", files[0], files[0], "--lab", str(tmp_path / "c.lab")]) == 0
        assert read_label_list(tmp_path / "c.lab").labels == ()

    def test_keeps_an_existing_file_unless_forced(self, files, tmp_path, capsys):
        (tmp_path / "c.lab").write_text("mine", encoding="utf-8")
        assert cli.run(["diff", *files, "--lab", str(tmp_path / "c.lab")]) == 2
        assert "already exists. Add --force" in capsys.readouterr().err
        assert (tmp_path / "c.lab").read_text(encoding="utf-8") == "mine"
        assert cli.run(["diff", *files, "--lab", str(tmp_path / "c.lab"), "--force"]) == 1

    def test_leaves_json_alone(self, files, tmp_path, capsys):
        import json

        assert cli.run(["diff", *files, "--json", "--lab", str(tmp_path / "c.lab")]) == 1
        assert [each["name"] for each in json.loads(capsys.readouterr().out)["differences"]] == ["B", "D"]
