"""`alula doctor`."""

from __future__ import annotations

from dataclasses import asdict

from alula.cli.shell import grouped, options

EXAMPLES = """\b
Examples:
  alula doctor
  alula doctor --json
"""


@grouped.command(epilog=EXAMPLES)
@options.reporting
def command(json: bool, quiet: bool, verbose: int) -> None:
    """Check that everything alula needs is installed.

    The exit code is 4 when something required is missing.
    """
    from alula.cli.shell.present import print_json, print_table
    from alula.cli.verbs.doctor import examine
    from alula.schemas.errors import CheckError

    checks = examine()
    missing = [check for check in checks if check.status == "missing"]
    if json:
        print_json({"ok": not missing, "checks": [asdict(check) for check in checks]})
    elif not quiet:
        rows = [(check.name, check.status, check.found, check.note) for check in checks]
        print_table("", ("what", "status", "found", "note"), rows)
    if missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise CheckError(f"{missing[0].name} is missing: {missing[0].note or missing[0].found}{more}")
