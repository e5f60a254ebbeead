import tracemalloc

import pytest

from kennfeld.base.errors import InputError
from kennfeld.base.xml_document import XmlLimits, parse_xml

LIMITS = XmlLimits(size=2000, levels=5, elements=20, children=10, reduced="Write less.", complete="Copy it again.")


def parse(text, limits=LIMITS):
    return parse_xml(text if isinstance(text, bytes) else text.encode(), "a.xml", limits)


def test_elements_have_their_tags_lines_positions_attributes_and_texts():
    root = parse('<u:a xmlns:u="u">\n  <b c="1">x&amp;y<d/>z</b>\n<b/></u:a>')
    first, second = root.all("b")
    assert (root.tag, first.line, first.begin, first.text, first.get("c"), second.get("c", "?")) == (
        "a", 2, 20, "x&yz", "1", "?",
    )  # fmt: skip
    assert [element.tag for element in root.walk()] == ["a", "b", "d", "b"]
    assert root.at("b", "d") is first.first("d")
    assert root.at("d", "b") is None


def test_a_flag_is_a_word_or_a_digit():
    root = parse('<a b="true" c="1" d="false" e="yes"/>')
    assert [root.is_true(name) for name in "bcdef"] == [True, True, False, False, False]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<a>", r"a\.xml line 1: is not well-formed XML: .*\. Copy it again\."),
        ("", "is not well-formed XML: no element found"),
        (b"\xff\xfe<", "is not well-formed XML"),
        ('<?xml version="1.0" encoding="none"?><a/>', "is not well-formed XML: unknown encoding"),
        (
            "<a>\n" + "<b>" * 5 + "</b>" * 5 + "</a>",
            r"line 2: has elements nested more than 5 levels deep\. Write less",
        ),
        ("<a>" + "<b/>" * 11 + "</a>", r"a has more than 10 elements\. Write less\."),
        ("<a>" + "<b><c/><c/></b>" * 7 + "</a>", r"has more than 20 elements\. Write less\."),
        ("<a>" + " " * 2000 + "</a>", r"the file has 2007 bytes; the maximum is 2000\. Write less\."),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a/>', "declares the entity b"),
        ('<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]><a>&b;</a>', "declares the entity b"),
        ('<!DOCTYPE a [<!ENTITY % b SYSTEM "b.dtd"> %b;]><a/>', "declares the entity b"),
        ('<!DOCTYPE a SYSTEM "b.dtd"><a>&c;</a>', "uses the undeclared entity c"),
    ],
)
def test_damaged_archives_and_those_beyond_the_limits_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse(text)


def test_long_texts_are_joined_once():
    text = "1 " * 500_000
    tracemalloc.start()
    try:
        root = parse(f"<a>{text}</a>", LIMITS._replace(size=2_000_000))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert root.text == text
    assert peak < 20_000_000


def test_text_that_is_not_kept_is_still_checked():
    limits = XmlLimits(size=1000, levels=3, elements=10, children=10, keeps_text=False)
    assert parse_xml(b"<data>text</data>", "a.xml", limits).text == ""
    with pytest.raises(InputError, match="declares the entity bomb"):
        parse_xml(b'<!DOCTYPE data [<!ENTITY bomb "text">]><data>&bomb;</data>', "a.xml", limits)
    with pytest.raises(InputError, match="not well-formed"):
        parse_xml(b"<data>&unknown;</data>", "a.xml", limits)
