"""`python -m sigmax.cli` is `sigmax`."""

from sigmax.cli import main

main()
