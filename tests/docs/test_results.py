"""Every table of docs/results.md, and the README's, is what the rows of the measurements give."""

import re

import pytest
import tables


@pytest.mark.parametrize("name", tables.TABLES)
def test_a_table_is_what_its_rows_give(name):
    printed = [
        table for page in tables.PAGES for mark, table in marked(page.read_text()) if mark == name
    ]
    assert printed == [tables.TABLES[name]()], "run python benchmarks/tables.py"


def marked(text: str) -> list[tuple[str, str]]:
    """Return the name and the lines of each table below a mark."""
    return [(name, table) for _, name, table in tables.MARK.findall(text)]


def test_every_table_has_rows():
    text = tables.PAGES[0].read_text()
    assert {name for name, _ in marked(text)} <= tables.TABLES.keys()
    without = []
    for section in re.split(r"^## ", text, flags=re.MULTILINE):
        if len(re.findall(r"^\| ---", section, re.MULTILINE)) > len(marked(section)):
            without.append(section.partition("\n")[0])
    assert without == []
