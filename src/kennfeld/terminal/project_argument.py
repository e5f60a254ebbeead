"""The project file on the command line: a folder stands for its `kennfeld.toml`, other files are named as such."""

from pathlib import Path

from kennfeld.base.errors import InputError, Location

NAME = "kennfeld.toml"
PROJECT = "a project file"
_CONTENTS = {
    "measurement": "a recording",
    "calibration": "a calibration file",
    "formula": "formula text",
    "surrogate": "a surrogate",
    "fmu": "an FMU",
    "functions": "a file of functions",
    "network": "an ONNX network",
    "A2L": "an A2L file",
}


def find_project(path: Path, expected: str = PROJECT) -> Path:
    """Return the project file that a command line names.

    Args:
        path: a file, or the folder of a `kennfeld.toml`.
        expected: what the command works on.

    Raises:
        InputError: a folder without that file, or a file of another kind.
    """
    if path.is_dir():
        file = path / NAME
        if not file.is_file():
            others = sorted(each.name for each in path.glob("*.toml"))
            remedy = f"Name a project file: {', '.join(others[:4])}." if others else "Name a project file."
            raise InputError.of(Location(str(path)), f"the folder has no {NAME}", remedy)
        return file
    if path.is_file() and not _is_project(path):
        raise _other_kind(path, expected)
    return path


def _is_project(path: Path) -> bool:
    from kennfeld.files import Role, identify

    try:
        return identify(path).role is Role.PROJECT
    except InputError:
        return False


def _other_kind(path: Path, expected: str) -> InputError:
    """Return the error that names what a file is, and the command that fits."""
    from kennfeld.terminal.file_info import describe_file

    try:
        content = str(describe_file(path).as_json.get("content", ""))
    except (InputError, OSError):
        content = ""
    message = f"is {_CONTENTS.get(content, f'a file with the content {content}')}, not {expected}"
    if not content:
        message = f"is not {expected}"
    # a recording or formula text of a project is named in place of the project
    beside = path.with_name(NAME)
    guess = f"Did you mean {beside}? " if beside.is_file() and expected == PROJECT else ""
    return InputError.of(Location(str(path)), message, f"{guess}`kennfeld info {path}` shows what it contains.")
