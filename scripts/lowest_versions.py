"""Print the oldest versions that a pyproject.toml admits, as constraints for pip.

python scripts/lowest_versions.py pyproject.toml
"""

import re
import sys
import tomllib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

__all__ = ["lowest"]

_REQUIREMENT = re.compile(r"([\w.-]+)(?:\[[\w,-]+\])?[>=]=([\w.]+)")  # a constraint names no extras


def lowest(text: str) -> Iterator[str]:
    r"""Yield a constraint such as `numpy==1.26` for each dependency, extras included.

    Raises `ValueError` if one states no lowest version, or more than that.

    >>> list(lowest('[project]\ndependencies = ["numpy>=1.26"]\n'))
    ['numpy==1.26']
    """
    project = tomllib.loads(text)["project"]
    extras = project.get("optional-dependencies", {}).values()
    for requirement in dict.fromkeys(chain(project["dependencies"], *extras)):
        if requirement.startswith(f"{project.get('name')}["):  # extras that an extra consists of
            continue
        match = _REQUIREMENT.fullmatch(requirement)
        if match is None:
            raise ValueError(f"{requirement!r} must have the form name>=version or name==version")
        yield "==".join(match.groups())


if __name__ == "__main__":
    print(*lowest(Path(sys.argv[1]).read_text(encoding="utf-8")), sep="\n")
