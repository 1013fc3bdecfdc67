"""JSON bodies: what they must say of themselves, and that every route reads them in one way."""

import pytest
from fastapi import APIRouter
from lambent_server.api.json_bodies import StrictRoute, require_strict
from lambent_server.api.messages import NewScene
from support.api import Api, expect, expect_problem, served

BODY = b'{"name": "a"}'


api = served(scope="module")


@pytest.mark.parametrize(
    "given", [None, "text/plain", "application/x-www-form-urlencoded", "multipart/form-data"]
)
def test_a_body_that_does_not_say_that_it_is_json_is_told_how_to(api: Api, given: str | None):
    headers = {} if given is None else {"content-type": given}
    answer = api.post("/v1/scenes", content=BODY, headers=headers)
    problem = expect_problem(answer, 415, "unsupported_media_type")
    assert "Content-Type: application/json" in problem["detail"]
    assert (given or "missing") in problem["detail"]


@pytest.mark.parametrize(
    "given", ["application/json", "Application/JSON; charset=utf-8", "application/x+json"]
)
def test_json_is_read_under_each_of_its_names(api: Api, given: str):
    expect(api.post("/v1/scenes", content=BODY, headers={"content-type": given}), 201)


def test_a_packed_body_is_not_unpacked(api: Api):
    headers = {"content-type": "application/json", "content-encoding": "gzip"}
    expect_problem(api.post("/v1/scenes", content=BODY, headers=headers), 415, "unsupported_media_type")


def test_a_missing_body_is_missing_whatever_its_type_would_be(api: Api):
    expect_problem(api.post("/v1/scenes"), 422, "invalid_request")


def test_names_that_no_answer_could_repeat_are_refused(api: Api):
    headers = {"content-type": "application/json"}
    for body in (rb'{"\ud800": 1}', rb'{"name": "a", "\u0000": 1}'):
        expect_problem(api.post("/v1/scenes", content=body, headers=headers), 400, "text_invalid")


def test_an_application_does_not_start_with_a_route_that_reads_json_otherwise():
    lenient, strict = APIRouter(), APIRouter(route_class=StrictRoute)
    for router in (lenient, strict):

        @router.post("/x")
        def take(body: NewScene) -> None: ...

    require_strict([strict])
    with pytest.raises(LookupError, match="take"):
        require_strict([strict, lenient])
