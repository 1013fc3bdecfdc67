"""The example of a proxy: what it says of clients, and what it keeps clients from saying."""

import re

import pytest
from support.deployed import ROOT

NGINX = (ROOT / "deploy" / "proxy" / "nginx.conf").read_text(encoding="utf-8")
PEOPLE = (ROOT / "docs" / "howto" / "people.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"LAMBENT_LOGIN_(?:ORGANISATIONS_)?HEADER=([\w-]+)", PEOPLE)))


def test_the_documentation_names_headers():
    assert NAMED == ["X-Forwarded-Email", "X-Forwarded-Groups"]


@pytest.mark.parametrize("header", [*NAMED, "X-Forwarded-User"])
def test_nobody_outside_says_who_has_signed_in(header: str):
    assert f'proxy_set_header {header} "";' in NGINX


def test_address_and_scheme_are_replaced():
    assert "proxy_set_header X-Forwarded-For $remote_addr;" in NGINX
    assert "proxy_set_header X-Forwarded-Proto $scheme;" in NGINX


@pytest.mark.parametrize("name", ["docker.md", "scale-out.md"])
def test_a_walkthrough_names_what_a_minimal_debian_lacks(name: str):
    text = (ROOT / "docs" / "howto" / name).read_text(encoding="utf-8")
    wanted = {
        "docker.md": ("Docker Engine 23.0", "Compose 2.20"),
        "scale-out.md": ("python3-venv", "python3-dev", "gcc"),
    }
    assert all(each in text for each in wanted[name])
    assert "sudo " not in text
