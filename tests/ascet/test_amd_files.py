"""Files of ASCET 6: harmful archives are refused, components are found by their folders."""

import warnings
import zipfile
from io import BytesIO

import pytest

from kennfeld.ascet.amd.components import read_component
from kennfeld.ascet.amd.data_sets import chosen_entries, read_data_sets
from kennfeld.ascet.amd.files import component_stem, open_archive, open_folder
from kennfeld.ascet.amd.library import ComponentLibrary
from kennfeld.ascet.amd.ranges import read_ranges
from kennfeld.ascet.amd.xml_document import parse_amd
from kennfeld.base.errors import InputError

MAIN = b'<ComponentMain><Component name="C" nameSpace="/A/B" componentType="ASCET_Class"/></ComponentMain>'


def archive(*members):
    raw = BytesIO()
    with zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in members:
            file.writestr(name, content)
    return raw.getvalue()


def test_the_components_of_an_archive_are_its_main_files():
    files = open_archive(archive(("A/B/C.main.amd", MAIN), ("A/B/C.data.amd", b""), ("A/x.bmp", b"")), "a.axl")
    library = ComponentLibrary(files)
    assert library.paths == ("A/B/C",)
    assert library.component("A/B/C").name == "C"
    assert library.locate("/A/B/C") == library.locate("/Elsewhere/C") == "A/B/C"
    assert library.locate("/A/B/D") is None
    assert library.by_qualified_name("A.B.C") == "A/B/C"


def test_the_files_of_a_folder_begin_where_the_name_space_begins(tmp_path):
    folder = tmp_path / "A/B"
    folder.mkdir(parents=True)
    (folder / "C.main.amd").write_bytes(MAIN)
    (tmp_path / "A/D.main.amd").write_bytes(MAIN)
    files, own = open_folder(folder / "C.data.amd")
    assert own == "A/B/C"
    assert set(files.paths) == {"A/B/C.main.amd", "A/D.main.amd"}


def test_files_of_a_folder_with_another_name_are_its_siblings(tmp_path):
    (tmp_path / "C.main.amd").write_bytes(MAIN)
    files, own = open_folder(tmp_path / "C.amd")
    assert own == "C"
    assert files.paths == ("C.main.amd",)


@pytest.mark.parametrize(
    ("members", "length", "part"),
    [
        ([bytes(20_000_000)], None, "packed into"),
        ([MAIN, MAIN], None, "two members of one name"),
        ([MAIN], -10, "not a readable archive"),
        ([], 4, "not a readable archive"),
    ],
    ids=["bomb", "equal names", "cut off", "few bytes"],
)
def test_harmful_archives_are_refused(members, length, part, monkeypatch):
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 40)
    raw = archive(*(("a.main.amd", content) for content in members))
    with pytest.raises(InputError, match=part):
        open_archive(raw[:length], "a.axl")


def test_a_member_with_a_wrong_sum_is_reported():
    plain = BytesIO()
    with zipfile.ZipFile(plain, "w") as file:
        file.writestr("a.main.amd", MAIN)
    raw = plain.getvalue().replace(b'name="C"', b'name="D"')
    with pytest.raises(InputError, match="cannot be unpacked"):
        open_archive(raw, "a.axl").read("a.main.amd")


@pytest.mark.parametrize(
    "name", ["C.main.amd", "C.data.dp.amd", "C.specification.amd", "C.implementation.dp.amd", "C.amd", "C.project.amd"]
)
def test_files_of_a_component_share_its_stem(name):
    assert component_stem(name) == "C"


def test_entries_are_those_of_the_shared_and_the_default_data_set():
    def entry(value):
        numeric = f'<ScalarType><Numeric value="{value}"/></ScalarType>'
        return f'<DataEntry elementName="K"><DataVariant name="default">{numeric}</DataVariant></DataEntry>'

    def data_set(name, default, shared, *values):
        inner = "".join(map(entry, values))
        return f'<DataSet name="{name}" default="{default}" classConfig="{shared}">{inner}</DataSet>'

    text = data_set("C", "false", "true") + data_set("D", "true", "false", 2) + data_set("E", "false", "false", 3)
    sets = read_data_sets(parse_amd(f"<ComponentData>{text}</ComponentData>".encode(), "C.data.amd"))
    assert [item.name for item in sets] == ["C", "D", "E"]
    assert chosen_entries(sets)["K"].values[0].number == 2.0


def test_ranges_are_physical_intervals():
    def implementation(name, low, high):
        return (
            f'<ElementImplementation elementName="{name}"><NumericImplementation limitAssignments="true">'
            f'<PhysicalInterval min="{low}" max="{high}"/></NumericImplementation></ElementImplementation>'
        )

    text = implementation("a", -1, 2.5) + implementation("b", 3, 3) + implementation("c", "x", 1)
    ranges = read_ranges(parse_amd(f"<ComponentImplementation>{text}</ComponentImplementation>".encode(), "C"))
    assert {name: (own.low, own.high, own.is_limited) for (_, name), own in ranges.items()} == {"a": (-1.0, 2.5, True)}
    assert read_ranges(None) == {}


def test_a_file_without_a_component_is_reported():
    with pytest.raises(InputError, match="declares no component"):
        read_component(parse_amd(b"<ComponentMain/>", "C.main.amd"), "C.main.amd")
