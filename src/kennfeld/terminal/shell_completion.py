"""Completion of the command line in shells. click has bash, zsh and fish; PowerShell is added here.

A shell runs `kennfeld` with the environment variable `COMPLETE` and the words typed so far, and reads the completions.
"""

import os
from typing import Any

import click

PROGRAM = "kennfeld"
COMPLETE = "_KENNFELD_COMPLETE"
SHELLS = ("bash", "zsh", "fish", "powershell")

# PowerShell completes file names itself if the block returns nothing.
_POWERSHELL = """
Register-ArgumentCompleter -Native -CommandName %(prog_name)s -ScriptBlock {
    param($wordToComplete, $commandAst, $cursorPosition)
    $words = $commandAst.CommandElements | Where-Object { $_.Extent.EndOffset -lt $cursorPosition } | ForEach-Object {
        if ($_ -is [System.Management.Automation.Language.StringConstantExpressionAst]) { $_.Value }
        else { $_.Extent.Text }
    }
    $env:COMP_WORDS = @($words) -join "`n"
    $env:COMP_INCOMPLETE = $wordToComplete
    $env:%(complete_var)s = "powershell_complete"
    try {
        & %(prog_name)s | ForEach-Object {
            $type, $value, $text = $_ -split "`t", 3
            if ($type -eq "plain") {
                if (-not $text) { $text = $value }
                [System.Management.Automation.CompletionResult]::new($value, $value, "ParameterValue", $text)
            }
        }
    }
    finally {
        $env:COMP_WORDS = $env:COMP_INCOMPLETE = $env:%(complete_var)s = $null
    }
}
"""


def completion_script(command: click.Command, shell: str) -> str:
    """Return the script that makes a shell complete the words of a command."""
    from click.shell_completion import get_completion_class

    register_powershell()
    completer = get_completion_class(shell)
    assert completer is not None, f"no completion for {shell}"
    return completer(command, {}, PROGRAM, COMPLETE).source().strip()


def register_powershell() -> None:
    """Let click know PowerShell, as it knows bash, zsh and fish."""
    from click.shell_completion import CompletionItem, ShellComplete, add_completion_class

    class PowerShellComplete(ShellComplete):
        """Reads words a line each from the environment, and writes type, value and help separated by tabs."""

        name = "powershell"
        source_template = _POWERSHELL

        def get_completion_args(self) -> tuple[list[str], str]:
            # the first word is the program
            return os.environ.get("COMP_WORDS", "").split("\n")[1:], os.environ.get("COMP_INCOMPLETE", "")

        def format_completion(self, item: CompletionItem[Any]) -> str:
            return "\t".join([item.type, item.value, " ".join((item.help or "").split())])

    add_completion_class(PowerShellComplete)
