"""All generated pages of the documentation, by their place in the site."""

from __future__ import annotations

from alula.cli.pages.artifacts import artifact_pages
from alula.cli.pages.interface import interface_page
from alula.cli.pages.parameters import configs_page, filters_page


def generated_pages() -> dict[str, str]:
    """Markdown by path in the site."""
    pages = {f"reference/artifacts/{name}.md": text for name, text in artifact_pages().items()}
    return pages | {
        "reference/filters.md": filters_page(),
        "reference/configs.md": configs_page(),
        "reference/python.md": interface_page(),
    }
