"""Make one page of all papers from the records of the comparisons: every claim, with ours beside it.

Usage: python write_pages.py [--markdown FILE] [--head TEXT] [--links FOLDER] OUTPUT RECORD [RECORD ...]

A record is EXAMPLE.record.json of a compare.py, its figures beside it. Of several records of one paper the
first counts; later ones fill the claims that it leaves open. OUTPUT.html, OUTPUT.md and OUTPUT.json are
written; FILE gets the Markdown page, with TEXT below its title. FOLDER has the detailed pages,
as seen from OUTPUT.html.
"""

import argparse
from pathlib import Path

from alula.schemas.artifacts.manifest import producer
from alula.schemas.atomic import write_text
from papers.collected import collect
from papers.compared import read_comparison, write_comparison_record
from papers.markdown import papers_markdown
from papers.page import papers_page, sentence

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the Markdown page to FILE")
parser.add_argument("--head", default="", metavar="TEXT", help="paragraph below its title")
parser.add_argument("--links", default="../../../docs/results", metavar="FOLDER", help="of detailed pages")
parser.add_argument("output", type=Path)
parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
options = parser.parse_args()
records = [(path, read_comparison(path)) for path in options.records]
papers = collect([record for _, record in records], producer())
drawings = {
    (record.paper, figure.name): file.read_text("utf-8")
    for path, record in reversed(records)
    for figure in record.figures
    if (file := path.parent / f"{figure.name}.svg").is_file()
}
write_text(options.output.with_suffix(".html"), papers_page(papers, drawings, folder=options.links))
write_text(options.output.with_suffix(".md"), papers_markdown(papers, options.head))
write_text(options.output.with_suffix(".json"), write_comparison_record(papers))
if options.markdown is not None:
    write_text(options.markdown, papers_markdown(papers, options.head))
print(sentence(papers.counts))
print(f"page: {options.output.with_suffix('.html').resolve()}")
