"""Options and arguments whose value is missing, as after an empty variable of a shell, are errors that name them."""

from collections.abc import Iterator

import click
import pytest

from kennfeld import cli

EMPTY_BY_DESIGN = {"--title", "--author", "--comment"}  # an empty one removes that of the project


def commands(group: click.Group, *names: str) -> Iterator[tuple[list[str], click.Command]]:
    """Yield all commands with the words that call them."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, *names, name)
        else:
            yield [*names, name], command


COMMANDS = list(commands(cli.app))
OPTIONS = [
    (words, option)
    for words, command in COMMANDS
    for option in command.params
    if isinstance(option, click.Option) and not option.is_flag
]


def test_every_command_is_looked_at() -> None:
    assert len(COMMANDS) >= 13
    assert len(OPTIONS) >= 30


@pytest.mark.parametrize(
    ("words", "option"), OPTIONS, ids=lambda each: each.name if isinstance(each, click.Option) else " ".join(each)
)
def test_a_value_that_is_missing_is_an_error(
    words: list[str], option: click.Option, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in option.opts:
        assert cli.run([*words, "a.toml", name]) == 2
        assert f"Option '{name}' requires an argument" in capsys.readouterr().err
        assert cli.run([*words, "a.toml", name, "--help"]) == 2
        assert f"Option {' / '.join(option.opts)} requires a value, got the option --help." in capsys.readouterr().err
        if name not in EMPTY_BY_DESIGN:
            for empty in ([name, ""], [f"{name}="] if name.startswith("--") else [name, ""]):
                assert cli.run([*words, "a.toml", *empty]) == 2
                assert (
                    f"Option {' / '.join(option.opts)} requires a value, got an empty one." in capsys.readouterr().err
                )


@pytest.mark.parametrize("line", [["calibrate", "p.toml", "-o", "--resume"], ["calibrate", "p.toml", "-o", "-q"]])
def test_an_option_does_not_take_another_one_for_its_value(line: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(line) == 2
    assert f"Option -o / --output requires a value, got the option {line[-1]}." in capsys.readouterr().err


def test_a_value_may_begin_with_a_hyphen(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["info", "gone.dcm", "--search", "-x"]) == 2
    assert "requires a value" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [words for words, command in COMMANDS if any(isinstance(each, click.Argument) for each in command.params)]
)
def test_an_empty_argument_is_an_error(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run([*words, "", "x"]) == 2
    err = capsys.readouterr().err
    assert "must not be empty" in err or "unexpected extra argument" in err
