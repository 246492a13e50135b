"""`python -m alula.cli` is `alula`."""

from alula.cli.start import main

main()
