import pytest
from check_words import phrases, problems_of


@pytest.mark.parametrize(
    "text",
    [
        "While the store is away, runs wait.",
        "It reads what is there.",
        "The run goes on.",
        "The user is told why.",
        "This is no number.",
        "They are no\n    numbers.",
        "Somebody else has it.",
        "A row that is nobody's",
        "The network is asked for each point, and is believed.",
        "It stands at the origin.",
        "The file lies beside it.",
    ],
)
def test_a_translated_phrase_is_refused(text: str):
    assert list(phrases(text))


@pytest.mark.parametrize(
    "text",
    [
        "The camera moves away from the object.",
        "There is no such file, and it is no longer used.",
        "It is no more than a pixel wide, and no smaller.",
        "Whether there is a mask",
        "The user is asked to confirm.",
        "A trainer that sleeps stands in for the method.",
        "Close cameras cannot be told apart.",
    ],
)
def test_plain_english_passes(text: str):
    assert not list(phrases(text))


def test_places_of_python_are_docstrings_comments_strings_and_names():
    text = '"""What a thing is."""\n\nx = "it goes on"\n# one that\n# is away\nfound = 1\n'
    assert [line for line, _ in problems_of("worker/a.py", text)] == [1, 3, 6, 4]
    assert [line for line, _ in problems_of("tests/a.py", text)] == [1, 3, 4]
    assert [line for line, _ in problems_of("docs/a.md", "fine\nit goes on\n")] == [2]
