"""The command line: bodies of commands, text output, progress and signals."""
