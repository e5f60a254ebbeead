"""Databases of PEAK (.sym) in the form of older editors, the only one that canmatrix reads.

Since version 6 a section {SIGNALS} defines `Sig=Speed unsigned 8 /u:rpm`, and a message refers to it by `Sig=Speed 16`
with the first bit. Before, a message held the whole: `Var=Speed unsigned 16,8 /u:rpm`.
"""

import re

_SECTION = re.compile(r"\s*\{(\w+)\}")
_NAME = r'("[^"]*"|\S+)'
_DEFINITION = re.compile(rf"\s*Sig={_NAME}[ \t]+(\w+)(?:[ \t]+(\d+))?(.*)")
_REFERENCE = re.compile(rf"\s*Sig={_NAME}[ \t]+(\d+)")
_ENUMERATION = re.compile(r"(?m)^([ \t]*)Enum=(?=\S)")
_EMPTY_ENUMERATION = re.compile(r"(?m)^[ \t]*Enum=(\w+)\(\s*\).*\n?")
_TYPE = re.compile(rf"(?m)^([ \t]*(?:Sig|Var)={_NAME}[ \t]+)(\w+)")
_IDENTIFIERS = re.compile(r"(?m)^([ \t]*ID=\s*[0-9A-Fa-f]+h)-[0-9A-Fa-f]+h")
_ONE_IDENTIFIER = "a message of several identifiers, of which the first one is read"
_LENGTHS = {"bit": "1", "char": "8", "float": "32", "double": "64"}  # bits of types that state none


def with_whole_signals(content: bytes) -> tuple[bytes, list[str]]:
    r"""Return a database whose messages hold the definitions of their signals, and what that leaves out.

    >>> text = b"{SIGNALS}\nSig=Speed unsigned 8 /u:rpm\n{SEND}\n[Engine]\nID=001h\nSig=Speed 16\n"
    >>> with_whole_signals(text)[0].decode().splitlines()[-1]
    'Var=Speed unsigned 16,8 /u:rpm'
    """
    # each byte is a character, so that texts in any encoding remain as they are
    text = content.decode("latin-1")
    empty = set(_EMPTY_ENUMERATION.findall(text))
    # the older form is `enum Name(...)`; an empty one is a number without names
    text = _ENUMERATION.sub(r"\1enum ", _EMPTY_ENUMERATION.sub("", text))
    text = _TYPE.sub(lambda match: match[1] + "unsigned" if match[3] in empty else match[0], text)
    text, ranges = _IDENTIFIERS.subn(r"\1", text)
    definitions: dict[str, re.Match[str]] = {}
    section, lines = "", []
    for line in text.splitlines():
        section = match[1] if (match := _SECTION.match(line)) else section
        if section == "SIGNALS":
            definitions |= {match[1]: match} if (match := _DEFINITION.match(line)) else {}
            continue  # canmatrix takes these lines for a part of the section before
        lines.append(_whole_signal(line, definitions))
    return "\n".join(lines).encode("latin-1") + b"\n", [_ONE_IDENTIFIER] * ranges


def _whole_signal(line: str, definitions: dict[str, re.Match[str]]) -> str:
    reference = _REFERENCE.match(line)
    definition = definitions.get(reference[1]) if reference else None
    if reference is None or definition is None:
        return line
    name, kind, length, rest = definition.groups()
    return f"Var={name} {kind} {reference[2]},{length or _LENGTHS.get(kind, '0')}{rest}"
