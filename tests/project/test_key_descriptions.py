"""Descriptions of the keys of a project file: complete, in plain words, from the schema."""

from kennfeld.project.forms import Form, keys_of
from kennfeld.project.key_descriptions import describe_form, describe_sections, plain_text
from kennfeld.project.schema import ProjectFile

SECTIONS = {section["name"]: section for section in describe_sections()}


def test_every_key_is_explained() -> None:
    assert list(SECTIONS) == list(keys_of(ProjectFile))
    for section in SECTIONS.values():
        assert section["help"]
        for key in section["form"].get("keys", ()):
            assert key["help"], key["name"]
            assert "](" not in key["help"]
            assert "`" not in key["help"] + key["default"] + key["type"]


def test_limits_units_and_defaults_come_from_the_schema() -> None:
    dataset = {key["name"]: key for key in SECTIONS["dataset"]["form"]["keys"]}
    assert (dataset["raster"]["unit"], dataset["raster"]["form"]["above"]) == ("s", 0)
    assert (dataset["where"]["holds"], dataset["shift"]["by"]) == ("condition", "channel")
    assert dataset["shift"]["form"]["values"]["words"] == ["auto"]
    assert dataset["weight"]["default"] == "1"
    assert dataset["use"]["form"]["options"] == ["training", "test", "off"]
    assert plain_text("a `[formula](formula.md)`") == "a formula"


def test_sections_have_their_notation() -> None:
    headings = [section["heading"] for section in SECTIONS.values()]
    assert headings[:5] == ["[model]", "[channels]", "[calculated]", "[units]", "[[dataset]]"]
    assert "[parameters.NAME]" in headings


def test_required_keys_are_marked() -> None:
    criterion = {key["name"]: key["required"] for key in SECTIONS["criterion"]["form"]["keys"]}
    assert [name for name, required in criterion.items() if required] == ["node", "target"]


def test_alternatives_have_different_titles() -> None:
    keys = {key["name"]: key["form"] for key in SECTIONS["parameters"]["form"]["keys"]}
    assert [(form["title"], form["kind"]) for form in keys["lock"]["forms"]] == [
        ("all", "flag"),
        ("no data", "choice"),
        ("ranges", "entries"),
    ]
    step = {key["name"]: key["form"] for key in SECTIONS["step"]["form"]["keys"]}
    for_all, by_name = step["smoothness"]["forms"]
    assert for_all["words"] == ["auto"]
    assert by_name["values"]["forms"][1]["names"] == ["x", "y", "z", "w"]


def test_a_form_without_a_field_of_its_own_is_edited_as_toml() -> None:
    assert describe_form(Form()) == {"kind": "toml"}
