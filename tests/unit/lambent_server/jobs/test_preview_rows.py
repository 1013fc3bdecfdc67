"""The choice of the pictures of a long training that are kept."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from lambent_server.jobs.previews import EARLIER, NEWEST
from lambent_server.maintenance.housekeeping import sweep
from support.api import Api, expect, sha256
from support.runs import Stage, staged

MANY = 400


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path, garbage_after_s=0.001, local_slots=2) as stage:
        yield stage


def report(stage: Stage, job: str, names: list[str], sequence: int) -> list[str]:
    """Report pictures with names, and return their hashes."""
    found = [sha256(f"{job} {sequence} {place}".encode()) for place in range(len(names))]
    told = [
        {"type": "preview", "name": name, "sha256": digest} for name, digest in zip(names, found, strict=True)
    ]
    stage.call("Report", job, sequence=sequence, events=told)
    return found


def kept(api: Api, job: str) -> list[str]:
    """Return the hashes of a job's pictures, the oldest first."""
    items = expect(api.get(f"/v1/jobs/{job}/events", params={"limit": 1000}), 200)["items"]
    assert [each["seq"] for each in items] == list(range(1, len(items) + 1))
    return [each["sha256"] for each in items if each["type"] == "preview" and each["sha256"]]


def test_a_long_training_keeps_its_newest_pictures_and_ever_fewer_of_earlier_ones(stage: Stage):
    job = stage.start()
    sheet = report(stage, job, ["evaluation"], 1)
    sent: list[str] = []
    for sequence in range(2, 2 + MANY // 10):
        sent += report(stage, job, ["turning_cache"] * 10, sequence)
        found = kept(stage.api, job)[1:]
        assert found[-NEWEST:] == sent[-NEWEST:]
        assert len(found) <= NEWEST + EARLIER
    found = kept(stage.api, job)
    # In the order they were made in, from the first one on, and what is not a turning picture stays.
    assert found[0] == sheet[0]
    places = [sent.index(digest) for digest in found[1:]]
    assert places == sorted(places)
    assert places[0] == 0
    gaps = [later - earlier for earlier, later in pairwise(places)]
    assert gaps == sorted(gaps, reverse=True)
    assert len(found) > NEWEST + EARLIER // 2


def test_the_bytes_of_a_picture_that_was_let_go_of_are_removed(stage: Stage):
    job = stage.start()
    data = [f"picture {place}".encode() for place in range(NEWEST + EARLIER + 1)]
    # The second is let go of first; the fourth shows the same as the newest.
    data[3] = data[-1]
    real = {place: stage.put(job, data[place]) for place in (1, 2, len(data) - 1)}
    told = [{"type": "preview", "name": "turning_cache", "sha256": sha256(each)} for each in data]
    stage.call("Report", job, sequence=1, events=told)
    assert real[1] not in kept(stage.api, job)
    sweep(stage.api.services)
    found = [stage.api.get(f"/v1/blobs/{digest}").status_code for digest in real.values()]
    assert found == [404, 200, 200]
    assert stage.job(job)["thumbnail_url"] == f"/v1/blobs/{real[len(data) - 1]}"


def test_pictures_of_other_jobs_and_of_two_stages_are_counted_as_they_belong(stage: Stage):
    first, second = stage.start(), stage.start()
    stages = ["turning_cache", "turning_joint"]
    for sequence in range(1, 1 + (NEWEST + EARLIER) // 2):
        report(stage, first, stages, sequence)
        report(stage, second, stages[:1], sequence)
    assert len(kept(stage.api, first)) == NEWEST + EARLIER
    report(stage, first, stages[:1], 1000)
    assert len(kept(stage.api, first)) == NEWEST + EARLIER // 2 + 1
    assert len(kept(stage.api, second)) == (NEWEST + EARLIER) // 2
