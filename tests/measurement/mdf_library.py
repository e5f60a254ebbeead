"""MDF files by asammdf, which is loaded when it is first used: as tests are collected, it would be in each process."""

from typing import Any


def mdf_file(*arguments: Any, **options: Any) -> Any:
    from asammdf import MDF

    return MDF(*arguments, **options)


def signal(*arguments: Any, **options: Any) -> Any:
    from asammdf import Signal

    return Signal(*arguments, **options)
