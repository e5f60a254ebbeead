"""Write what the documentation shows of the keys of project files: the tables of keys, and the JSON schemas.

python scripts/project_file_docs.py docs

The schemas go to the documentation and into the package.
"""

import json
import re
import sys
from collections.abc import Iterable
from dataclasses import Field
from pathlib import Path
from typing import Any

from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.project import schemas
from kennfeld.project.criteria_schema import CriterionEntry, EqualityEntry, LimitEntry
from kennfeld.project.design_table import CurveEntry, DesignEntry, ManoeuvreEntry
from kennfeld.project.forms import entry_schema, form_of, keys_of, meaning_of
from kennfeld.project.key_descriptions import default_text
from kennfeld.project.model_schema import ModelEntry
from kennfeld.project.run_schema import CalibrationEntry, ClusterEntry, OptimizerEntry, ReportEntry, StepEntry
from kennfeld.project.schema import ProjectFile
from kennfeld.project.surrogate_training import SurrogateEntry, TrainingFile
from kennfeld.project.table_schema import GroupAxisEntry, ParameterEntry

__all__ = ["documents"]

_TABLE = re.compile(r"(<!-- keys of ([^>]*) -->\n).*?(<!-- end of keys -->)", re.DOTALL)
_SURROGATE = keys_of(SurrogateEntry).values()
_TABLES: dict[str, Iterable[Field[Any]]] = {
    "[model]": keys_of(ModelEntry).values(),
    "[[dataset]]": keys_of(DatasetEntry).values(),
    "[calibration]": keys_of(CalibrationEntry).values(),
    "[axes.NAME]": keys_of(GroupAxisEntry).values(),
    "[parameters.NAME]": keys_of(ParameterEntry).values(),
    "[[criterion]]": keys_of(CriterionEntry).values(),
    "[[limit]]": keys_of(LimitEntry).values(),
    "[[equality]]": keys_of(EqualityEntry).values(),
    "[[step]]": keys_of(StepEntry).values(),
    "[optimizer]": keys_of(OptimizerEntry).values(),
    "[cluster]": keys_of(ClusterEntry).values(),
    "[report]": keys_of(ReportEntry).values(),
    "[design]": keys_of(DesignEntry).values(),
    "curves of [design]": keys_of(CurveEntry).values(),
    "manoeuvres of [design]": keys_of(ManoeuvreEntry).values(),
    "[surrogate]": [part for part in _SURROGATE if not part.metadata.get("dynamic")],
    "[surrogate], dynamic": [part for part in _SURROGATE if part.metadata.get("dynamic")],
}
_SCHEMAS = {
    schemas.PROJECT_SCHEMA: (ProjectFile, "Project file of Kennfeld"),
    schemas.TRAINING_SCHEMA: (TrainingFile, "Training file of Kennfeld, for surrogates"),
}


def documents(folder: Path) -> dict[Path, str]:
    """Return the generated files in the folder of the documentation and in the package with their contents."""
    pages = {name: (folder / name).read_text(encoding="utf-8") for name in ("project-file.md", "surrogates.md")}
    written = {folder / name: _TABLE.sub(_fill, text) for name, text in pages.items()}
    for name, (entry, title) in _SCHEMAS.items():
        schema = {"$schema": "http://json-schema.org/draft-07/schema#", "title": title, **entry_schema(entry)}
        text = json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
        written |= dict.fromkeys((folder / name, Path(schemas.__file__).with_name(name)), text)
    return written


def _fill(match: re.Match[str]) -> str:
    head = ["| key | type | default | meaning |", "|---|---|---|---|"]
    rows = [_row(part) for part in _TABLES[match[2]]]
    return "\n".join([match[1], *head, *rows, "", match[3]])


def _row(part: Field[Any]) -> str:
    cells = (f"`{part.metadata['name'] or part.name}`", form_of(part).label, default_text(part), meaning_of(part))
    return "|" + "|".join(f" {cell.replace('|', chr(92) + '|')} " if cell else " " for cell in cells) + "|"


if __name__ == "__main__":
    for path, text in documents(Path(sys.argv[1])).items():
        path.write_text(text, encoding="utf-8", newline="\n")
