"""Holds what textual programming languages share, whichever they are: positions in a text, and the syntax tree."""
