"""The documentation of back-ups names every secret that a server keeps in its data folder."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
_NAME = re.compile(r'"([a-z]+\.(?:secret|key|authority)|server\.id)"')


def test_the_sentence_on_back_ups_names_every_secret_of_the_code():
    sources = (ROOT / "server" / "lambent_server").rglob("*.py")
    secrets = {name for path in sources for name in _NAME.findall(path.read_text(encoding="utf-8"))}
    assert {"api.key", "share.secret", "provenance.key", "server.id"} <= secrets
    text = (ROOT / "docs" / "howto" / "operate.md").read_text(encoding="utf-8")
    (sentence,) = re.findall(r"^Back up the database.*?\n\n", text, re.DOTALL | re.MULTILINE)
    table = text[: text.index(sentence)]
    for name in secrets:
        assert f"`{name}`" in sentence, name
        assert f"| `{name}` |" in table, name
