"""Idiomatic technical English in what users and the next engineer read."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OPENINGS = "What", "Whether", "How", "Why", "Which"
MESSAGES = {  # pattern: what to write instead
    r"(?<![Tt]here )\b(?:is|are) no (?!longer\b|more\b|fewer\b|less\b|effect\b|need\b)": "must be, unknown, is not a",
    r"\bleft aside\b": "skipped",
    r"\bmend(?:s|ed)?\b": "fix, remedy",
    r"\bfrom 0 on\b": ">= 0",
    r"\bhas no meaning\b": "requires ..., does not apply to ...",
    r"\bbesides? beside\b": "in addition to",
    r"\bstands already\b": "duplicate of ...",
    r"\bsays? no\b": "states no, does not state",
    r"[Ww]hat the data leave open": "not determined by the data",
}
DOCSTRINGS = {
    rf"^(?:{'|'.join(OPENINGS)})\b": "begin with a verb, or with a noun for a property",
    r"\bleft aside\b": "skipped",
    r"\bmend(?:s|ed)?\b": "fix, remedy",
    r"\bfrom 0 on\b": ">= 0",
}
SOURCE = ROOT / "src" / "kennfeld"
PACKAGES = ["", *sorted({path.parent.relative_to(SOURCE).parts[0] for path in SOURCE.rglob("*/*.py")})]
DOCUMENTS = [
    *(
        ROOT / name
        for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "editors/vscode/README.md")
    ),
    *sorted((ROOT / "docs").rglob("*.md")),
]
SEARCHED = [rf'"""\s*(?:{"|".join(OPENINGS)})\b', *MESSAGES]
# the same, with a first search that does not ask what stands before a match, which takes most of the time
STEPS = [(re.compile(re.sub(r"^(\(\?<!.*? \))?\\b", "", pattern)), re.compile(pattern)) for pattern in SEARCHED]


def may_have_faults(text):
    """Return whether the text of a module, of which a tree takes longer, has a fault, maybe in code or a comment."""
    joined = re.sub(r"""["']\s+[bfru]*["']""", "", text)  # a string may be written in several parts
    return any(first.search(joined) and pattern.search(joined) for first, pattern in STEPS)


def texts(tree):
    """Return docstrings, with their owners, and all other strings of a module, with their lines."""
    docstrings, own = [], set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            docstrings.append((node, ast.get_docstring(node)))
            own.add(id(node.body[0].value))
    strings = [n for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return docstrings, [(n.lineno, n.value) for n in strings if id(n) not in own]


def faults(patterns, text):
    return [f"{match[0]!r}: {better}" for pattern, better in patterns.items() for match in re.finditer(pattern, text)]


def faults_of(path):
    """Return the faults of messages and docstrings of a module, with their lines."""
    text = path.read_text(encoding="utf-8")
    if not may_have_faults(text):
        return []
    docstrings, strings = texts(ast.parse(text))
    return [
        *((line, fault) for line, text in strings for fault in faults(MESSAGES, text)),
        *((getattr(node, "lineno", 1), fault) for node, text in docstrings for fault in faults(DOCSTRINGS, text)),
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_messages_and_docstrings_are_plain_english(package):
    modules = sorted((SOURCE / package).rglob("*.py") if package else SOURCE.glob("*.py"))
    assert modules
    assert {path.relative_to(SOURCE).as_posix(): errors for path in modules if (errors := faults_of(path))} == {}


@pytest.mark.parametrize(
    "text",
    [
        'raise InputError("the key is " "no number")',
        'f(\n    "the key is "\n    "no number"\n)',
        '"""\nWhat it does."""',
    ],
)
def test_a_fault_is_found_however_it_is_written(text):
    assert may_have_faults(text)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_documents_are_plain_english(path):
    assert faults(MESSAGES, path.read_text(encoding="utf-8")) == []
