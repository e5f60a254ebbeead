import re
import sys
import tomllib
from pathlib import Path

import pytest

from kennfeld.base.errors import InputError, Location
from kennfeld.base.optional_packages import optional_package

ROOT = Path(__file__).parents[2]


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    message = r'^drive\.mf4: the package asammdf is not installed\. Run: pip install "kennfeld\[mdf\]"$'
    with pytest.raises(InputError, match=message), optional_package(Location("drive.mf4"), "mdf"):
        import asammdf  # noqa: F401


def test_every_extra_that_a_message_names_exists():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py")]
    calls = [re.findall(r'(?:optional_package\([^"]*|install_command\()"(\w+)"\)', source) for source in sources]
    named = {extra for names in calls for extra in names}
    assert "mdf" in named
    assert named <= set(extras)


def test_the_extra_all_holds_every_other_for_users():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]

    def inside(name):
        own = re.fullmatch(r"kennfeld\[([\w,]+)\]", extras[name][0])
        return {name} if own is None else {name}.union(*map(inside, own.group(1).split(",")))

    assert inside("all") == set(extras) - {"dev", "docs", "platforms"}  # the last is a compiler of 100 MB
