"""The JSON schemas by which editors complete and check project files and training files.

A new project gets its schema as a file beside it, which its first line names: an editor then needs no network, and
checks by the version of Kennfeld that wrote the project. `scripts/project_file_docs.py` writes the schemas.
"""

from pathlib import Path

PROJECT_SCHEMA, TRAINING_SCHEMA = "kennfeld.schema.json", "surrogate.schema.json"
ENDING = ".schema.json"
DIRECTIVE = "#:schema"  # of the first line, as the TOML extensions of editors read it


def schema_text(name: str) -> str:
    """Return the text of a schema, `PROJECT_SCHEMA` or `TRAINING_SCHEMA`."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def directive(name: str) -> str:
    """Return the first line of a file that has its schema beside it.

    >>> directive(PROJECT_SCHEMA)
    '#:schema ./kennfeld.schema.json'
    """
    return f"{DIRECTIVE} ./{name}"
