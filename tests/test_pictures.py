"""The pictures in `docs/images`, which `python -m scripts.pictures` makes."""

import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
MOST_BYTES = {".svg": 60_000, ".png": 150_000, ".webp": 150_000}


@pytest.mark.parametrize("path", sorted(IMAGES.iterdir()), ids=lambda path: path.name)
def test_pictures_are_small(path):
    assert path.stat().st_size <= MOST_BYTES[path.suffix]


@pytest.mark.parametrize("path", sorted(IMAGES.glob("*.svg")), ids=lambda path: path.name)
def test_drawings_are_xml_that_loads_nothing_on_a_ground_of_their_own(path):
    text = path.read_text(encoding="utf-8")
    ElementTree.fromstring(text)
    assert not re.search(r'href="(?!#)(?!data:image/png)', text)
    assert "<script" not in text
    assert re.search(r'fill(=|: )"?(white|#ffffff)', text)


def test_the_picture_of_the_layers_shows_all_of_them():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layers = next(contract["layers"] for contract in contracts if contract["containers"] == ["kennfeld"])
    text = (IMAGES / "layers.svg").read_text(encoding="utf-8")
    shown = [name for name in re.findall(r"<text [^>]*>([^<]*)</text>", text) if re.fullmatch(r"\w+", name)]
    names = [name for layer in layers for name in layer.split(" | ")]
    assert [name for name in shown if name in names] == names
