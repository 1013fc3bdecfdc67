from pathlib import Path

from check_docs import broken_links, unreachable


def page(folder: Path, text: str) -> Path:
    path = folder / "page.md"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_link_to_a_missing_file_is_reported(tmp_path: Path):
    (problem,) = broken_links(page(tmp_path, "see [this](nowhere.md)"))
    assert "nowhere.md" in problem


def test_a_link_to_a_missing_heading_is_reported(tmp_path: Path):
    assert broken_links(page(tmp_path, "# One thing\n[up](#another-thing)"))


def test_links_to_files_headings_and_the_outside_are_accepted(tmp_path: Path):
    text = "# One thing, or two\n[up](#one-thing-or-two) [me](page.md) [web](https://example.org/x)"
    assert broken_links(page(tmp_path, text)) == []


def test_text_in_code_is_not_a_link(tmp_path: Path):
    assert broken_links(page(tmp_path, "`[a](b)`\n```\n[c](d)\n```\n")) == []


def test_a_page_that_no_link_leads_to_is_found(tmp_path: Path):
    start = page(tmp_path, "[one](one.md)")
    one, two, lost = (tmp_path / f"{name}.md" for name in ("one", "two", "lost"))
    one.write_text("[two](two.md) [back](page.md)", encoding="utf-8")
    two.write_text("# Two", encoding="utf-8")
    lost.write_text("[two](two.md)", encoding="utf-8")
    assert unreachable([one, two, lost], start) == [lost]
