"""Write what the documentation shows of the commands: usage, description, arguments and options of each.

python scripts/command_docs.py docs
"""

import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from kennfeld.cli import app

__all__ = ["commands", "documents"]

_BLOCK = re.compile(r"(<!-- options of ([^>]*) -->\n).*?(<!-- end of options -->)", re.DOTALL)
_CODE = re.compile(r"(?<![\w`-])(--[a-z][\w-]*(?: [\w.]+@\w+)?|\[[a-z]+\]|[a-z]+_[a-z]+|s3://[\w/.]+|kennfeld\.toml)")


def documents(folder: Path) -> dict[Path, str]:
    """Return the page of the commands, filled in; a command that it does not mention gets a section at its end."""
    path = folder / "commands.md"
    text = path.read_text(encoding="utf-8")
    for name in commands():
        if f"<!-- options of {name} -->" not in text:
            text += f"\n## {name}\n\n<!-- options of {name} -->\n<!-- end of options -->\n"
    return {path: _BLOCK.sub(_fill, text)}


def commands() -> dict[str, click.Context]:
    """Return the context of each command by its full name, such as `kennfeld surrogate train`."""
    return dict(_contexts(click.Context(app, info_name="kennfeld")))


def _contexts(context: click.Context) -> Iterator[tuple[str, click.Context]]:
    group = context.command
    if not isinstance(group, click.Group):
        yield context.command_path, context
        return
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        yield from _contexts(click.Context(command, info_name=name, parent=context))


def _fill(match: re.Match[str]) -> str:
    context = commands()[match[2]]
    usage = context.command.get_usage(context).removeprefix("Usage: ")
    parts = ["```text", " ".join(usage.split()), "```", "", _description(context.command), "", *_table(context)]
    return "\n".join([match[1], *parts, "", match[3]])


def _description(command: click.Command) -> str:
    return _CODE.sub(r"`\1`", inspect.cleandoc(command.help or ""))


def _table(context: click.Context) -> list[str]:
    rows = [_argument_row(part, context) for part in context.command.params if isinstance(part, click.Argument)]
    rows += [_option_row(part, context) for part in context.command.params if isinstance(part, click.Option)]
    return ["| argument or option | default | meaning |", "|---|---|---|", *rows]


def _argument_row(argument: click.Argument, context: click.Context) -> str:
    text, default = argument.get_help_record(context)[1], ""
    if stated := re.fullmatch(r"(.*?)\s+\[default: (.*)\]", text):
        text, default = stated.groups()
    return _row(f"`{argument.make_metavar(context)}`", default, text)


def _option_row(option: click.Option, context: click.Context) -> str:
    value = "" if option.is_flag else f" {option.make_metavar(context)}"
    names = ", ".join(f"`{name}{value}`" for name in option.opts)
    if option.required:
        default = "required"
    elif isinstance(option.show_default, str):
        default = option.show_default
    else:
        default = f"`{option.default}`" if option.show_default else ""
    return _row(names, default, option.help or "")


def _row(*cells: str) -> str:
    texts = [_CODE.sub(r"`\1`", cell) if "`" not in cell else cell for cell in cells]
    return "|" + "|".join(f" {text.replace('|', chr(92) + '|')} " if text else " " for text in texts) + "|"


if __name__ == "__main__":
    for path, text in documents(Path(sys.argv[1])).items():
        path.write_text(text, encoding="utf-8", newline="\n")
