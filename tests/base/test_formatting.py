"""Text of messages: names as keys and strings of TOML."""

import tomllib

import pytest
from hypothesis import strategies as st

from kennfeld.base.formatting import quoted, toml_text
from kennfeld.measurement.time_column import unit_remedy
from kennfeld.models.quantities import UndefinedParameter
from tests.draws import few_or_many

NAMES = ["n_rpm", "air mass", r"n\ETKC:1", 'a "b"', "driver's", r"driver's\n", "a\"b'c\\d", "", "Öl", "a\tb", "a\x7fb"]


@pytest.mark.parametrize("name", NAMES)
def test_a_quoted_name_is_a_key_of_toml(name):
    assert tomllib.loads(f"[units]\n{quoted(name)} = {toml_text(name)}") == {"units": {name: name}}


@few_or_many(name=st.text(st.characters(codec="utf-8")), few=50, many=2000)
def test_any_quoted_name_is_a_key_of_toml(name):
    assert tomllib.loads(f"{quoted(name)} = {toml_text(name)}") == {name: name}


@pytest.mark.parametrize("name", NAMES)
def test_remedies_with_any_name_can_be_copied(name):
    setting = unit_remedy(name).removeprefix("If they are, write ").split(", else ")[0]
    assert tomllib.loads(setting.replace("] ", "]\n", 1)) == {"units": {name: "ms"}}
    section = UndefinedParameter(name, (), ("Plant/Gain:Gain",)).project_section
    assert list(tomllib.loads(section)["parameters"]) == [name]
