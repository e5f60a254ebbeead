"""The commands with their options, text output, progress and signals."""
