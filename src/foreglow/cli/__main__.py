"""`python -m foreglow.cli`."""

from foreglow.cli import main

main()
