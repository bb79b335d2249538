"""``python -m legtool``."""

from legtool.cli import main

main()
