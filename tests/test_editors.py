"""The TextMate grammar of formula text splits all texts of this repository as the lexer does."""

import json
import re
from importlib import import_module
from pathlib import Path

import pytest

import kennfeld
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.models.formula.lexer import DECLARATIONS, RESERVED, split, tokens
from kennfeld.project.demo import NAMES

ROOT = Path(__file__).parents[1]
EXTENSION = ROOT / "editors" / "vscode"
KINDS = {  # of the lexer, by the beginning of a scope
    "entity.name": "name",
    "keyword.declaration": "name",
    "support.function": "name",
    "constant.language": "name",
    "variable.other.quoted": "quoted",
    "variable.other": "name",
    "constant.numeric": "number",
    "keyword.operator": "op",
    "punctuation": "op",
    "string.unquoted.unit": "unit",
    "comment": "comment",
    "invalid": "bad",
}
HOSTILE = """
12 y[%] = a.b_1 * 1e-3^.5 + %any [3] # name% - map(x)  # 50 % of it
input %engine speed%[1/min]
  step 0.01
step = mapping + def_1 + t1
x == y and not z or dt >= inf
größe[°C] = Kennfeld (n,  m_1)[K]
z = 3x + 1.2.3 + a..b + 5 ** 2 && ; "
min = min(1, min)
"""

pytestmark = pytest.mark.skipif(not EXTENSION.is_dir(), reason="the grammar is not part of an installed package")


@pytest.fixture(scope="module")
def grammar():
    return json.loads((EXTENSION / "kf.tmLanguage.json").read_text(encoding="utf-8"))


def texts():
    files = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "examples").rglob("*.kf")}
    demos = {f"demo {name}": import_module(f"kennfeld.project.demo.{name}").FORMULA for name in NAMES}
    blocks = {}
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        texts_of_page = re.findall(r"^```kf\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        blocks |= {f"{page.name} {number}": text for number, text in enumerate(texts_of_page, 1)}
    return files | demos | blocks | {"hostile": HOSTILE}


TEXTS = texts()


def scopes(grammar, line):
    """Yield column, text and scope of each token, as TextMate forms them: the first match, and of these the first."""
    at = 0
    while at < len(line):
        matches = [(match.start(), number, match) for number, match in candidates(grammar, line, at)]
        if not matches:
            return
        _, number, match = min(matches, key=lambda entry: entry[:2])
        pattern = grammar["patterns"][number]
        if "name" in pattern:
            yield match.start(), match[0], pattern["name"]
        for group, capture in pattern.get("captures", {}).items():
            if match[int(group)] is not None:
                yield match.start(int(group)), match[int(group)], capture["name"]
        assert match.end() > at
        at = match.end()


def candidates(grammar, line, at):
    for number, pattern in enumerate(grammar["patterns"]):
        if match := re.compile(pattern["match"]).search(line, at):
            yield number, match


def kind(scope):
    return next(word for start, word in KINDS.items() if scope.startswith(start))


@pytest.mark.parametrize("name", TEXTS)
def test_the_grammar_splits_a_text_as_the_lexer_does(grammar, name):
    for number, line in enumerate(split(TEXTS[name]), 1):
        expected = [(token.column - 1, token.text, token.kind) for token in tokens(line, number)]
        ours = [(column, text, kind(scope)) for column, text, scope in scopes(grammar, line)]
        assert [token for token in ours if token[2] != "comment"] == expected, line


def test_the_texts_have_every_scope(grammar):
    lines = [line for text in TEXTS.values() for line in split(text)]
    used = {scope for line in lines for _, _, scope in scopes(grammar, line)}
    assert {start for start in KINDS if any(scope.startswith(start) for scope in used)} == set(KINDS)


@pytest.mark.parametrize(
    ("line", "scope", "words"),
    [
        ("T[K] = PT1(Map(n), 2) + Offset", "entity.name.variable", ["T"]),
        ("T[K] = PT1(Map(n), 2) + Offset", "support.function", ["PT1"]),
        ("T[K] = PT1(Map(n), 2) + Offset", "entity.name.function", ["Map"]),
        ("T[K] = PT1(Map(n), 2) + Offset", "variable.other", ["n", "Offset"]),
        ("map Torque[Nm]  # of the engine", "keyword.declaration", ["map"]),
        ("map Torque[Nm]  # of the engine", "comment", ["# of the engine"]),
        ("3 y = x and not z", "keyword.operator.word", ["and", "not"]),
        ("a == b", "entity.name.variable", []),
    ],
)
def test_names_have_the_scope_of_what_they_are(grammar, line, scope, words):
    assert [text for _, text, name in scopes(grammar, line) if name.startswith(scope)] == words


@pytest.mark.parametrize(
    ("scope", "words"),
    [
        ("support.function", set(FUNCTIONS)),
        ("constant.language", RESERVED - {"and", "or", "not", "if"}),
        ("keyword.operator.word", {"and", "or", "not"}),
        ("keyword.declaration", DECLARATIONS),
    ],
)
def test_the_grammar_lists_the_words_of_the_language(grammar, scope, words):
    text = next(pattern["match"] for pattern in grammar["patterns"] if scope in json.dumps(pattern))
    lists = [set(words.split("|")) for words in re.findall(r"\((?:\?:)?(\w+(?:\|\w+)+)\)", text)]
    assert lists == [words]


def test_the_extension_has_the_version_of_the_package_and_all_its_files():
    package = json.loads((EXTENSION / "package.json").read_text(encoding="utf-8"))
    assert package["version"] == kennfeld.__version__
    language, grammar = package["contributes"]["languages"][0], package["contributes"]["grammars"][0]
    assert language["id"] == grammar["language"]
    json.loads((EXTENSION / language["configuration"]).read_text(encoding="utf-8"))
    assert (EXTENSION / grammar["path"]).is_file()
