"""Code on matrices stored in block rows: eight rows each, column by column, from a first block column on."""

from kennfeld.native.envelope import BLOCK
from kennfeld.native.ir import EIGHT, Function, literal

__all__ = ["FACTOR", "ZERO", "column_of", "divide", "first_of", "less", "more", "panel_of", "reduced"]

FACTOR = (("ptr", "panels"), ("ptr", "start"), ("ptr", "first"), ("ptr", "inverse"), ("i64", "blocks"))
ZERO = literal(0.0)


def panel_of(f: Function, block: str) -> str:
    """The address of column 0 of a block row; only those from its first on exist."""
    return f.at("%panels", f.load("%start", block, "i64"))


def first_of(f: Function, block: str) -> str:
    """The first column of a block row."""
    return f.mul(f.load("%first", block, "i64"), BLOCK)


def column_of(f: Function, panel: str, column: str) -> str:
    """The address of a column of a block row."""
    return f.at(panel, column, EIGHT)


def reduced(f: Function, panel: str, other: str, first: str, end: str) -> list[str]:
    """The eight columns of a block, less the product of the columns from `first` on; `other` is the block column's."""
    rest = [f.slot(EIGHT) for _ in range(BLOCK)]
    for c, column in enumerate(rest):
        f.store(f.load(column_of(f, panel, f.add(end, c)), kind=EIGHT), column, kind=EIGHT)
    with f.loop(first, end) as k:
        own = f.load(column_of(f, panel, k), kind=EIGHT)
        scalars = column_of(f, other, k)
        for c, column in enumerate(rest):
            f.store(less(f, f.load(column, kind=EIGHT), own, f.load(scalars, c)), column, kind=EIGHT)
    return [f.load(column, kind=EIGHT) for column in rest]


def less(f: Function, column: str, vector: str, scalar: str) -> str:
    """The column less vector times scalar."""
    product = f.new(f"fmul contract {EIGHT} {vector}, {f.splat(scalar)}")
    return f.new(f"fsub contract {EIGHT} {column}, {product}")


def more(f: Function, column: str, vector: str, scalar: str) -> str:
    """The column and vector times scalar."""
    product = f.new(f"fmul contract {EIGHT} {vector}, {f.splat(scalar)}")
    return f.new(f"fadd contract {EIGHT} {column}, {product}")


def divide(f: Function, panel: str, other: str, j: str, rest: list[str]) -> None:
    """Columns of the block: X L' = rest with the diagonal block L of block row j."""
    at = f.mul(j, BLOCK)
    done: list[str] = []
    for c in range(BLOCK):
        column = rest[c]
        for d, solved in enumerate(done):
            column = less(f, column, solved, f.load(column_of(f, other, f.add(at, d)), c))
        scale = f.splat(f.load("%inverse", f.add(at, c)))
        done.append(f.new(f"fmul {EIGHT} {column}, {scale}"))
    for c, column in enumerate(done):
        f.store(column, column_of(f, panel, f.add(at, c)), kind=EIGHT)
