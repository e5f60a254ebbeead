"""Kennfeld side by side with other tools, in one run on one machine. See README.md."""
