"""Damage to whole files."""

import random

import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import read

# Few damaged files always, many of the same sequence if slow tests are asked for.
few_or_many_copies = pytest.mark.parametrize("count", [25, pytest.param(300, marks=pytest.mark.slow)])


def refusals(path, head, *, count, bytes_=range(256), seed=3, **settings):
    """Read damaged versions of a file, cut off or with other bytes behind its head; return how many are refused."""
    content, generator = path.read_bytes(), random.Random(seed)
    refused = 0
    for _ in range(count):
        mutant = bytearray(content[: generator.choice([len(content), generator.randrange(head + 1, len(content))])])
        for _ in range(generator.randint(0, 4)):
            mutant[generator.randrange(head, len(mutant))] = generator.choice(bytes_)
        path.write_bytes(mutant)
        try:
            read(path, **settings)
        except InputError:
            refused += 1
    return refused
