"""Makes the pictures in `docs/images`: `python -m scripts.pictures`, or some groups of them, `... surfaces trust`.

Run it in the root of the repository. The groups `flows` and `screens` need Chromium, playwright and pillow.
"""

import argparse
from importlib import import_module
from pathlib import Path

# a new group is a new file with `make`
GROUPS = [
    file.stem for file in sorted(Path(__file__).parent.glob("*.py")) if "\ndef make() " in file.read_text("utf-8")
]


def main() -> None:
    """Make the groups of pictures that the command line names, or all."""
    parser = argparse.ArgumentParser(prog="python -m scripts.pictures", description="Make the pictures in docs/images.")
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=", ".join(GROUPS))
    for group in parser.parse_args().groups or GROUPS:
        if group not in GROUPS:
            parser.error(f"unknown group {group!r}. The groups are: {', '.join(GROUPS)}.")
        import_module(f"scripts.pictures.{group}").make()


if __name__ == "__main__":
    main()
