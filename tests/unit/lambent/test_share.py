"""Links to a bundle, from the client and from the command line."""

import json

import httpx2
import pytest
from lambent import Client
from lambent.cli import transfer
from lambent.errors import JobNotSucceededError, UsageProblemError
from lambent.models import Share

SHOP = "https://shop.example"


class Server:
    """Answers requests for links, and keeps them."""

    def __init__(self, bundle_id: str = "bundle_1") -> None:
        self.bundle_id = bundle_id
        self.asked: list[tuple[str, str, object]] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        body = json.loads(request.content) if request.content else None
        self.asked.append((request.method, request.url.path, body))
        if request.url.path.startswith("/v1/jobs/"):
            job = {"id": "job_1", "state": "running" if not self.bundle_id else "succeeded"}
            return httpx2.Response(200, json=job | {"bundle_id": self.bundle_id})
        if request.method == "DELETE":
            return httpx2.Response(204)
        share = {
            "id": "share_1",
            "bundle_id": "bundle_1",
            "url": "https://lambent.example/embed/share_1#share_1.abc",
            "created_at": "2030-01-01T00:00:00Z",
            "expires_at": "2030-01-08T00:00:00Z",
            "frame_ancestors": body["frame_ancestors"],
        }
        return httpx2.Response(201, json=share)

    def client(self) -> Client:
        return Client("http://127.0.0.1:1", "key", transport=httpx2.MockTransport(self))


def test_a_link_to_the_bundle_of_a_job_names_who_may_show_it():
    server = Server()
    share = server.client().share("job_1", expires_in_s=3600, frame_ancestors=[SHOP])
    assert share.frame_ancestors == (SHOP,)
    body = {"expires_in_s": 3600, "frame_ancestors": [SHOP]}
    assert server.asked[-1] == ("POST", "/v1/bundles/bundle_1/shares", body)
    assert f'src="{share.url}"' in share.snippet
    server.client().delete(share.id)
    assert server.asked[-1] == ("DELETE", "/v1/shares/share_1", None)


def test_a_bundle_is_shared_for_a_week_and_with_no_page_unless_asked_for():
    server = Server()
    server.client().share("bundle_1")
    expected = {"expires_in_s": 604800, "frame_ancestors": []}
    assert server.asked == [("POST", "/v1/bundles/bundle_1/shares", expected)]


def test_a_job_without_a_bundle_has_nothing_to_share():
    with pytest.raises(JobNotSucceededError):
        Server(bundle_id="").client().share("job_1")


@pytest.mark.parametrize(
    "given", [{"frame_ancestors": SHOP}, {"frame_ancestors": [1]}, {"expires_in_s": 5}, {"expires_in_s": "1"}]
)
def test_wrong_arguments_are_refused_before_anything_is_sent(given: dict):
    server = Server()
    with pytest.raises(UsageProblemError):
        server.client().share("bundle_1", **given)
    assert server.asked == []


@pytest.mark.parametrize("embed_in", [[], [SHOP]])
def test_the_command_prints_the_link_and_the_html(embed_in, monkeypatch, capsys):
    server = Server()
    monkeypatch.setattr(transfer, "Client", lambda url: server.client())
    transfer.share("bundle_1", days=0.5, embed_in=embed_in)
    assert server.asked[0][2] == {"expires_in_s": 43200, "frame_ancestors": embed_in}
    printed = capsys.readouterr()
    link, *rest = printed.out.splitlines()
    assert link == "https://lambent.example/embed/share_1#share_1.abc"
    expected = Share(id="share_1", bundle_id="bundle_1", url=link).snippet
    assert rest == ([expected] if embed_in else [])
    assert "lambent delete share_1" in printed.err
