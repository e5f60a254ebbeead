"""`python -m kennfeld` is the command `kennfeld`."""

from kennfeld.cli import main

if __name__ == "__main__":
    main()
