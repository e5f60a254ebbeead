"""Subsystems dissolved: the blocks of a model in one list, connected."""
