"""`python -m alula.cli` is `alula`."""

from alula.cli.main import main

main()
